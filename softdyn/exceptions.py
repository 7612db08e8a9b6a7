"""Every exception softdyn raises on purpose; all derive from `SoftdynError`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


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
        raise InputError(f"{where}: {error.name}", error.expected, error.got) from None
    except ArithmeticError as error:
        raise InputError(where, "numbers that can be computed with", error) from None


def one_line(value: object, limit: int = 120) -> str:
    """`value` as text without line breaks, cut to `limit` characters."""
    text = " ".join(str(value).split()) or repr(value)
    return text if len(text) <= limit else text[: limit - 1] + "…"
