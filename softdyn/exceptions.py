"""Every exception softdyn raises on purpose; all derive from `SoftdynError`."""

from __future__ import annotations

import sysconfig
import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

STANDARD_LIBRARY = (sysconfig.get_path("stdlib"), sysconfig.get_path("platstdlib"))
# functions of softdyn that load a user's file and make its objects
MAKERS = ("_load", "make_controller", "make_observer", "read_trajectory")


class SoftdynError(Exception):
    """Root of softdyn's exceptions: its text is one line that says what to do next."""


class UrdfError(SoftdynError, ValueError):
    """A robot description that cannot be used.

    Attributes
    ----------
    file : Path
        The URDF.
    element : str
        The offending element, e.g. ``<joint name="j1"><limit>``.
    expected, got : str
        The format's rule and the file's content.
    line : int or None
        Line number in the file, or None if the defect has no single place.
    """

    def __init__(
        self, file: Path | str, element: str, expected: str, got: object, line: int | None = None
    ) -> None:
        self.file, self.element, self.line = Path(file), element, line
        self.expected, self.got = expected, one_line(got)
        place = one_line(file, 4096) + (f":{line}" if line else "")
        super().__init__(f"{place}: {element}: expected {expected}, got {self.got}")

    def __reduce__(self) -> tuple[Any, ...]:  # crosses process boundaries
        return type(self), (self.file, self.element, self.expected, self.got, self.line)


class InputError(SoftdynError, ValueError):
    """An argument of the wrong shape, range or kind.

    Attributes
    ----------
    name : str
        The argument.
    expected, got : str
        The expected and the actual value.
    text : str
        The whole message, if a sentence is clearer than the three parts.
    """

    def __init__(self, name: str, expected: str, got: object, text: str = "") -> None:
        self.name, self.expected, self.got, self.text = name, expected, one_line(got), text
        super().__init__(text or f"{one_line(name, 1000)}: expected {expected}, got {self.got}")

    def __reduce__(self) -> tuple[Any, ...]:  # crosses process boundaries
        return type(self), (self.name, self.expected, self.got, self.text)

    def about(self, name: str) -> InputError:
        """The same error, of the same class, about another name, such as one with its file."""
        return type(self)(name, self.expected, self.got)


class OutOfReach(InputError):
    """A target that the robot cannot reach, whatever its inputs."""


class NotIdentifiable(InputError):
    """Data that show none of the unknowns."""


class ForceError(InputError):
    """A force of one's own that cannot be used at a configuration.

    Attributes
    ----------
    kind, method : str
        Its class, and the method that was called.
    q : tuple of float
        The configuration.
    """

    def __init__(
        self, force: object, method: str, q: Iterable[float], expected: str, got: object
    ) -> None:
        self.kind = force if isinstance(force, str) else type(force).__name__
        self.method, self.q = method, tuple(float(x) for x in q)
        at = " ".join(f"{x:.4g}" for x in self.q)
        super().__init__(f"{self.kind}.{method} at q = [{at}]", expected, got)

    def __reduce__(self) -> tuple[Any, ...]:  # crosses process boundaries
        return type(self), (self.kind, self.method, self.q, self.expected, self.got)

    def about(self, name: str) -> InputError:
        """The same defect as an `InputError` about another name."""
        return InputError(name, self.expected, self.got)


class FormatError(InputError):
    """A file that is not of the format that is read, or of another version of it."""


class OwnCodeError(SoftdynError):
    """A user's own code raised an error while it ran.

    Attributes
    ----------
    text : str
        The error in one line, with file and line number.
    trace : str
        Python's traceback, from the user's file on.
    """

    def __init__(self, text: str, trace: str) -> None:
        self.text, self.trace = text, trace
        super().__init__(text)

    def __reduce__(self) -> tuple[Any, ...]:  # crosses process boundaries
        return type(self), (self.text, self.trace)


@contextmanager
def own_code_errors(program: str = "softdyn") -> Iterator[None]:
    """Turn errors of a user's running code into an `OwnCodeError`.

    Code is a user's own if it belongs neither to softdyn nor to an installed package. Errors while
    a user's file is loaded or its objects are made pass unchanged, because they are bad input.
    Ctrl-C passes too.

    Parameters
    ----------
    program : str
        The package of the program that runs, whose code is no user's either.
    """
    try:
        yield
    except (KeyboardInterrupt, GeneratorExit):
        raise
    except BaseException as error:  # a user's code may raise anything
        own = own_frames(error, program)
        if own is None:
            raise
        steps, kind = traceback.extract_tb(own), type(error)
        lines = [step.lineno for step in steps if step.filename == steps[0].filename]
        place = f"{Path(steps[0].filename).name}:{lines[-1]}"
        trace = printable("".join(traceback.format_exception(kind, error, own)))
        raise OwnCodeError(one_line(f"{place}: {kind.__name__}: {error}", 500), trace) from error


def own_frames(error: BaseException, program: str = "softdyn") -> Any:
    """The traceback of an error from the first frame of running user's code on, else None."""
    found = error.__traceback__
    while found is not None and not runs_own_code(found.tb_frame, program):
        if found.tb_frame.f_code.co_name in MAKERS:
            return None
        found = found.tb_next
    return found


def runs_own_code(frame: FrameType, program: str = "softdyn") -> bool:
    """Whether a frame runs a user's code: not softdyn's, a package's or the program's."""
    file, module = frame.f_code.co_filename, str(frame.f_globals.get("__name__", ""))
    installed = file.startswith(("<", *STANDARD_LIBRARY)) or "-packages" in file
    return not installed and module.partition(".")[0] not in ("softdyn", "__main__", program)


@contextmanager
def errors_in(where: str) -> Iterator[None]:
    """Add the place in a file to every InputError of the block that does not name the file.

    An ArithmeticError, for example from a length of 1e-320 m, becomes an InputError too.
    """
    try:
        yield
    except InputError as error:
        if error.name.startswith(where.split(":")[0]):
            raise
        raise error.about(f"{where}: {error.name}") from None
    except ArithmeticError as error:
        raise InputError(where, "numbers that can be computed with", error) from None


def one_line(value: object, limit: int = 120) -> str:
    """`value` as text without line breaks, cut to `limit` characters; see `printable`."""
    text = printable(" ".join(str(value).split()) or repr(value))
    return text if len(text) <= limit else text[: limit - 1] + "…"


def printable(text: str) -> str:
    """`text` with control characters as escapes, so that none of them changes a terminal.

    Line breaks and tabs remain.
    """
    return "".join(
        c if c.isprintable() or c in "\n\t" else c.encode("unicode_escape").decode() for c in text
    )
