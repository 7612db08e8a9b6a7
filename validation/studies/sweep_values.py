"""The strict reader of a sweep file's values: numbers, lists, ranges and distributions.

A check takes a key and a value, and returns the value.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import InputError, UrdfError
from softdyn.checks import did_you_mean, instance, number
from softdyn.controllers import Gains
from softdyn.description.rig import LONGEST_DELAY, CommandKind

Check = Callable[[str, Any], Any]
POINTS = "[x, y, z] in m, or a list of such"
MAX_CASES = 100_000
RANGE = ("from", "to", "count", "spacing")
# distribution → whether it applies to the logarithm
DRAWN = {"uniform": False, "log_uniform": True}


def draw(
    key: str, seed: int, count: int, lower: float, upper: float, log: bool
) -> tuple[float, ...]:
    """Random values of one parameter in [lower, upper].

    Every parameter has its own random stream. So its samples stay the same when another parameter
    is added or `count` grows.
    """
    share = np.random.Generator(np.random.PCG64([seed, *key.encode()])).random(count)
    if log:
        low, high = math.log(lower), math.log(upper)
        values = np.exp(low + (high - low) * share)
    else:
        values = lower + (upper - lower) * share
    return tuple(np.clip(values, lower, upper).tolist())


def positive(key: str, value: Any) -> float:
    """A finite number above 0."""
    return number(key, value, above=0.0)


def point(key: str, value: Any) -> tuple[float, ...]:
    """Three finite numbers."""
    if not isinstance(value, list) or len(value) != 3:
        raise InputError(key, POINTS, repr(value))
    return tuple(number(key, x) for x in value)


def gain(key: str, value: Any) -> float:
    """A valid value for this field of `Gains`."""
    Gains(**{"Kp": 1.0, key.rpartition(".")[2]: value})
    return float(value)


def anything(key: str, value: Any) -> Any:
    """A number, true or false, a text, or a list of these, for a user's own controller."""
    if isinstance(value, list):
        return tuple(anything(key, item) for item in value)
    return value if isinstance(value, bool | str) else number(key, value)


def of_paper(*controllers: Any) -> dict[str, Check]:
    """The gains of these controllers of the paper and their options, each with its check."""
    options = {name: anything for one in controllers for name in one.options}
    return {**{field.name: gain for field in fields(Gains)}, **options}


def flag(key: str, value: Any) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise InputError(key, "true or false", repr(value))
    return value


def not_negative(key: str, value: Any) -> float:
    """A finite number >= 0."""
    return number(key, value, lower=0.0)


def delay(key: str, value: Any) -> float:
    """A delay (s) of a rig."""
    return number(key, value, lower=0.0, upper=LONGEST_DELAY)


def step(key: str, value: Any) -> float:
    """A plant step (s); ``inf`` means one step per control period."""
    return math.inf if value == math.inf else positive(key, value)


def command(key: str, value: Any) -> str:
    """The kind of command of all inputs."""
    words = [kind.value for kind in CommandKind]
    if value not in words:
        raise InputError(key, " or ".join(words), repr(value))
    return str(value)


def words(key: str, value: Any) -> str:
    """Names of the observer's disturbances, separated by commas, or FILE.py:CLASS."""
    return instance(key, value, str, "a text")


# group → its parameters and their checks; those of [gains] depend on the controllers
GROUPS: dict[str, dict[str, Check]] = {
    "plant": {
        "period": positive, "duration": positive, "timestep": step, "contacts": flag,
        "payload": not_negative,
        "friction": flag, "mass": positive, "stiffness": not_negative, "damping": not_negative,
        "dry_friction": not_negative, "soft_stops": flag,
    },
    "rig": {
        "file": flag, "command": command, "stiffness": positive, "damping": not_negative,
        "lag": not_negative, "rate": positive, "delay": delay, "latency": delay,
        "noise": not_negative, "bias": not_negative, "observer": words, "friction": not_negative,
    },
}  # fmt: skip


@dataclass(frozen=True)
class Axis:
    """The values of one parameter: those of the grid, or one per random sample.

    Attributes
    ----------
    name : str
        ``gains.Kp``, ``plant.period``, ``theta``, …
    values : tuple
        In the file's order.
    drawn : str, optional
        The distribution of random samples, ``uniform`` or ``log_uniform``; None in a grid.
    controller, robot : str, optional
        The only controller, and the only robot, that it is for.
    """

    name: str
    values: tuple[Any, ...]
    drawn: str | None = None
    controller: str | None = None
    robot: str | None = None

    @property
    def varies(self) -> bool:
        """Whether there is more than one value."""
        return len(self.values) > 1


def is_one_value(value: Any) -> bool:
    """Whether this is one parameter's value; other tables have a value for each joint."""
    return not isinstance(value, dict) or bool({"from", "default", *DRAWN} & set(value))


class ValueReader:
    """Reads values of one file; every error names the file and the key."""

    def __init__(self, path: Path, table: dict[str, Any]) -> None:
        self.path, self.table = path, table
        self.count: int | None = None
        self.seed = 0

    def check(self, fits: Any, key: str, expected: str, got: Any) -> None:
        """Raise an error for this key if a condition does not hold."""
        if not fits:
            where = f"{self.path}: {key}" if key else str(self.path)
            raise InputError(where, expected, got if isinstance(got, str) else repr(got))

    def told(self, key: str, error: InputError | UrdfError, where: str = "") -> InputError:
        """An error with the name of this file."""
        return InputError(f"{self.path}: {key}", error.expected, error.got + where)

    def axis(self, key: str, name: str, value: Any, check: Check) -> Axis:
        """The values of one parameter: a number, a list, a range, or a distribution."""
        drawn = None
        try:
            if isinstance(value, dict) and check not in (flag, point):
                drawn = next((kind for kind in DRAWN if kind in value), None)
                values = self.draw(key, value, check, drawn) if drawn else (
                    self.spread(key, value, check))  # fmt: skip
            else:
                values = tuple(
                    check(key, v) for v in (value if isinstance(value, list) else [value])
                )
        except InputError as error:
            raise (
                error if error.name.startswith(f"{self.path}: ") else self.told(key, error)
            ) from None
        self.check(bool(values), key, "at least one value", value)
        distinct = len({(isinstance(v, bool), v) for v in values}) == len(values)
        many = f"{len(values)} " if isinstance(value, dict) else ""
        self.check(distinct or drawn is not None, key, f"{many}distinct values", value)
        return Axis(name, values, drawn)

    def draw(self, key: str, table: dict[str, Any], check: Check, kind: str) -> tuple[float, ...]:
        """Random values between both ends of a distribution."""
        self.known(key, table, (kind,))
        ends = table[kind]
        pair = isinstance(ends, list) and len(ends) == 2
        self.check(pair, f"{key}.{kind}", "[lower, upper]", ends)
        if self.count is None:
            expected = f"a table with the count of samples of {key}"
            raise InputError(f"{self.path}: samples", expected, "none")
        lower, upper = self.ends(key, ends, check, DRAWN[kind])
        return draw(key, self.seed, self.count, lower, upper, DRAWN[kind])

    def spread(self, key: str, table: dict[str, Any], check: Check) -> tuple[float, ...]:
        """The values of a range."""
        self.known(key, table, RANGE)
        expected = "a range {from, to, count}, {uniform} or {log_uniform}"
        self.check(all(name in table for name in RANGE[:3]), key, expected, table)
        spacing = table.get("spacing", "linear")
        self.check(spacing in ("linear", "log"), f"{key}.spacing", "linear or log", spacing)
        count = self.whole(f"{key}.count", table["count"], 2, MAX_CASES)
        lower, upper = self.ends(key, [table["from"], table["to"]], check, spacing == "log")
        make = np.geomspace if spacing == "log" else np.linspace
        return tuple(make(lower, upper, count).tolist())

    def ends(self, key: str, ends: list[Any], check: Check, log: bool) -> tuple[float, float]:
        """Both ends of a range, each a valid value of the parameter."""
        for end in ends:
            number(key, end, above=0.0 if log else -math.inf)
            check(key, end)
        fits = ends[0] < ends[1] and math.isfinite(ends[1] - ends[0])
        self.check(fits, key, "a lower end below the upper", ends)
        return float(ends[0]), float(ends[1])

    def names(self, key: str, known: Collection[str] = ()) -> list[str]:
        """A list of distinct names; if `known` is given, only those, and the list may be empty."""
        value = self.table.get(key, [])
        found = [value] if isinstance(value, str) else value
        fits = isinstance(found, list) and all(isinstance(n, str) and n for n in found)
        fits = fits and len(set(found)) == len(found) and bool(found or known)
        got = found if key in self.table else "nothing"
        self.check(fits, key, "a list of distinct names", got)
        for name in found:
            self.check(not known or name in known, key, f"any of {', '.join(known)}", name)
        return list(found)

    def yes(self, key: str, table: Mapping[str, Any]) -> bool:
        """A key that is true or false, by default false."""
        value = table.get(key.rpartition(".")[2], False)
        self.check(isinstance(value, bool), key, "true or false", value)
        return bool(value)

    def section(self, key: str, names: tuple[str, ...] | None) -> dict[str, Any]:
        """A table of the file with only the keys `names`; empty if it is missing."""
        value = self.table.get(key, {})
        self.check(isinstance(value, dict), key, f"a table [{key}]", value)
        if names is not None:
            self.known(key, value, names)
        return dict(value)

    def known(self, key: str, table: dict[str, Any], names: tuple[str, ...]) -> None:
        """Refuse a table with keys other than `names`."""
        for name in table:
            where = f"{key}.{name}" if key else name
            got = did_you_mean(str(name), names)
            self.check(name in names, where, f"one of {', '.join(names)}", got)

    def whole(self, key: str, value: Any, lower: int, upper: int) -> int:
        """A whole number between both."""
        fits = isinstance(value, int) and not isinstance(value, bool) and lower <= value <= upper
        expected = f"a whole number from {lower} to {upper}"
        self.check(fits, key, expected, "none" if value is None else value)
        return int(value)
