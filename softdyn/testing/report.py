"""The result of the checks of a user's class, and how its calls become lines of it."""

from __future__ import annotations

import copy
import functools
import inspect
import pickle
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from softdyn import SoftModel
from softdyn.exceptions import one_line, runs_own_code

STEP = 1e-6  # of a central difference; its error is some 1e-10 of the values' size
TOLERANCE = 1e-5  # of a derivative against central differences, relative to its largest entry


@dataclass(frozen=True)
class RuleResult:
    """One check.

    Attributes
    ----------
    name : str
        The rule.
    passed : bool
        Whether the class keeps it.
    detail : str
        A figure, or for a check that failed the call that shows it, with what was expected and got.
    """

    name: str
    passed: bool
    detail: str = ""


@dataclass(frozen=True)
class Conformance:
    """All checks of one class.

    Attributes
    ----------
    kind : str
        ``controller``, ``task`` and so on.
    checks : tuple of RuleResult
        The checks in their order; the first one is that the class can be built.
    """

    kind: str
    checks: tuple[RuleResult, ...]

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return all(check.passed for check in self.checks)

    def to_dict(self) -> dict[str, Any]:
        """The checks as plain data: ``kind``, ``passed``, ``checks``."""
        checks = [vars(check) for check in self.checks]
        return {"kind": self.kind, "passed": self.passed, "checks": checks}

    def __str__(self) -> str:
        """A line for each check."""
        lines = [f"as a {self.kind}:"]
        for one in self.checks:
            verdict = "ok    " if one.passed else "FAILED"
            lines.append(": ".join([f"{verdict} {one.name}", *filter(None, [one.detail])]))
        return "\n".join(lines)


class Unmet(Exception):
    """A rule that a class breaks; the text is the call that shows it."""


class Checks:
    """Collects the checks of a class.

    Parameters
    ----------
    subject : Any
        A class or a function that is called with the model, or an object that is copied.
    model : SoftModel
        The robot.
    """

    def __init__(self, subject: Any, model: SoftModel) -> None:
        self._subject, self._model = subject, model
        self.done: list[RuleResult] = []

    def make(self) -> Any:
        """A new object of the class."""
        if builds(self._subject):
            return self._subject(self._model)
        return copy.deepcopy(self._subject)

    def run(self, name: str, work: Callable[[], str | None]) -> bool:
        """Make one check; whether it passed."""
        try:
            check = RuleResult(name, True, work() or "")
        except Unmet as error:
            check = RuleResult(name, False, str(error))
        except Exception as error:  # a user's code may raise anything
            text = f"{type(error).__name__}: {error}{_own_line(error)}"
            check = RuleResult(name, False, one_line(text, 300))
        self.done.append(check)
        return check.passed

    def report(self, kind: str) -> Conformance:
        """The checks that were made."""
        return Conformance(kind, tuple(self.done))


def _own_line(error: Exception) -> str:
    """The innermost line of a user's code that an error passed; empty if it passed none."""
    found = [
        f" (line {line} of {frame.f_code.co_filename.rpartition('/')[2]})"
        for frame, line in traceback.walk_tb(error.__traceback__) if runs_own_code(frame)
    ]  # fmt: skip
    return found[-1] if found else ""


def builds(subject: Any) -> bool:
    """Whether a subject is called with a model, and is no object of the kind itself."""
    return (
        inspect.isclass(subject)
        or inspect.isroutine(subject)
        or isinstance(subject, functools.partial)
    )


def expect(met: bool, call: str, expected: str, got: Any) -> None:
    """Raise `Unmet` with a line of the usual form unless a rule is met."""
    if not met:
        raise Unmet(f"{call}: expected {expected}, got {one_line(got)}")


def numbers(call: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """`value` as an array of finite numbers of one shape."""
    found = np.asarray(value, dtype=float)
    expect(found.shape == shape, call, f"shape {shape}", f"shape {found.shape}")
    expect(bool(np.isfinite(found).all()), call, "finite numbers", found)
    return found


def close(call: str, found: np.ndarray, differences: np.ndarray) -> str:
    """Compare a derivative with central differences; the worst entry where they differ."""
    size = max(float(np.abs(found).max(initial=0.0)), float(np.abs(differences).max(initial=0.0)))
    error = np.abs(found - differences)
    worst = float(error.max(initial=0.0)) / max(size, 1.0)
    if not worst <= TOLERANCE:
        at = tuple(int(k) for k in np.unravel_index(int(error.argmax()), error.shape))
        expected = f"{differences[at]:.6g} at {at} by central differences"
        raise Unmet(f"{call}: expected {expected}, got {found[at]:.6g}")
    return f"{worst:.1e} from central differences"


def copies(thing: Any) -> dict[str, Any]:
    """A deep copy of an object, and one through pickle.

    Raises
    ------
    Unmet
        Where one of them cannot be made.
    """
    found = {}
    ways: dict[str, Callable[[Any], Any]] = {
        "copy.deepcopy": copy.deepcopy,
        "pickle": lambda one: pickle.loads(pickle.dumps(one)),
    }
    for name, way in ways.items():
        try:
            found[name] = way(thing)
        except Exception as error:  # a user's code may raise anything
            got = f"{type(error).__name__}: {error}"
            raise Unmet(f"{name}(object): expected a copy, got {one_line(got)}") from None
    return found


def timed(calls: list[Callable[[], Any]], period: float | None, call: str) -> str:
    """The median time of calls, which must be shorter than the control period (s), if one is given.

    The first call, which may compile, does not count.
    """
    times = []
    for one in [calls[0], *calls]:
        begin = time.perf_counter()
        one()
        times.append(time.perf_counter() - begin)
    median, slowest = float(np.median(times[1:])), max(times[1:])
    text = f"median {1e6 * median:.0f} us, slowest of {len(calls)} {1e6 * slowest:.0f} us"
    if period is not None:
        expect(median < period, call, f"less than the period, {1e6 * period:g} us", text)
    return text
