"""The values of one parameter of a sweep: one value, a list, a range, or random samples."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np

from softdyn import InputError
from softdyn.checks import number, real
from softdyn.toml_table import TomlTable

MAX_CASES = 100_000
# distribution → whether it applies to the logarithm
DRAWN = {"uniform": False, "log_uniform": True}
# keys by which a table is the values of one parameter, and no table of parameters
ONE_VALUE = {"from", "to", "count", *DRAWN, "default"}
Check = Callable[[Any], Any]
"""A value of a file → the parameter's value; it raises an `InputError`."""


@dataclass(frozen=True)
class Axis:
    """The values of one parameter: those of the grid, or one per random sample.

    Attributes
    ----------
    name : str
        ``gains.Kp``, ``run.period``, ``theta``, …
    values : tuple
        In the file's order.
    drawn : str, optional
        The distribution of random samples, ``uniform`` or ``log_uniform``; None in a grid.
    controller, robot : str, optional
        The only controller, and the only robot, that it is for.
    link : str, optional
        The name that all lists have in common whose values go together; None for a list of its own.
    """

    name: str
    values: tuple[Any, ...]
    drawn: str | None = None
    controller: str | None = None
    robot: str | None = None
    link: str | None = None

    @property
    def varies(self) -> bool:
        """Whether there is more than one value."""
        return len(self.values) > 1


@dataclass(frozen=True)
class AxisReader:
    """It reads the axes of one file.

    Attributes
    ----------
    path : str
        The file, for messages.
    count : int, optional
        Number of random samples; None without any.
    seed : int
        Their seed.
    links : mapping
        Name of a linked parameter → the first name of its set.
    """

    path: str
    count: int | None = None
    seed: int = 0
    links: Mapping[str, str] = field(default_factory=dict)

    def __call__(self, key: str, name: str, value: Any, check: Check) -> Axis:
        """The axis `name`, which stands at `key` in the file.

        Raises
        ------
        InputError
            The values are none, not distinct, or refused by `check`. Those of a linked parameter
            may repeat.
        """
        drawn = None

        def checked(one: Any) -> Any:
            try:
                return check(one)
            except InputError as error:
                raise error.about(f"{self.path}: {key}") from None

        if isinstance(value, Mapping):
            drawn = next((kind for kind in DRAWN if kind in value), None)
            table = TomlTable(value, f"{self.path}: {key}")
            values = self._draw(table, key, drawn, checked) if drawn else self._spread(
                table, key, checked)  # fmt: skip
        else:
            values = tuple(map(checked, value if isinstance(value, list) else [value]))
        if not values:
            raise InputError(f"{self.path}: {key}", "at least one value", value)
        distinct = len({(isinstance(v, bool), v) for v in values}) == len(values)
        if not distinct and drawn is None and name not in self.links:
            many = f"{len(values)} " if isinstance(value, Mapping) else ""
            raise InputError(f"{self.path}: {key}", f"{many}distinct values", value)
        return Axis(name, values, drawn, link=self.links.get(name))

    def _draw(self, table: TomlTable, key: str, kind: str, check: Check) -> tuple[Any, ...]:
        """Random values between both ends of a distribution: numbers, or vectors of numbers."""
        ends = table.rest([kind])[kind]
        if not isinstance(ends, list) or len(ends) != 2:
            raise table.error(kind, "[lower, upper]", ends)
        if self.count is None:
            expected = f"a table with the count of samples of {key}"
            raise InputError(f"{self.path}: samples", expected, "none")
        if not all(isinstance(end, list) for end in ends):
            low, high = ends
            self._check_ends(key, low, high, check, DRAWN[kind])
            return draw(key, self.seed, self.count, low, high, DRAWN[kind])
        lower, upper = map(check, ends)
        if len(lower) != len(upper):
            raise table.error(kind, "two lists of equal length", ends)
        columns = []
        for k, (low, high) in enumerate(zip(lower, upper, strict=True)):
            if low != high:  # a component may be fixed
                self._check_ends(f"{key}.{k}", low, high, float, DRAWN[kind])
            columns.append(draw(f"{key}.{k}", self.seed, self.count, low, high, DRAWN[kind]))
        return tuple(zip(*columns, strict=True))

    def _spread(self, table: TomlTable, key: str, check: Check) -> tuple[float, ...]:
        """The values of a range."""
        if not all(name in table.values for name in ("from", "to", "count")):
            expected = "a range {from, to, count}, {uniform} or {log_uniform}"
            raise InputError(table.where, expected, dict(table.values))
        log = table.choice("spacing", {"linear": False, "log": True}, "linear")
        count = table.count("count", least=2, most=MAX_CASES)
        lower, upper = table.number("from"), table.number("to")
        table.rest()
        self._check_ends(key, lower, upper, check, log)
        make = np.geomspace if log else np.linspace
        return tuple(make(lower, upper, count).tolist())

    def _check_ends(self, key: str, lower: float, upper: float, check: Check, log: bool) -> None:
        """Refuse a range with a wrong order, or with an end that is no value of the parameter."""
        where = f"{self.path}: {key}"
        for end in (lower, upper):
            number(where, end, above=0.0 if log else -math.inf)
            check(end)
        if not lower < upper or not math.isfinite(upper - lower):
            raise InputError(where, "a lower end below the upper", [lower, upper])


def combinations(axes: Iterable[Axis]) -> Iterator[dict[str, Any]]:
    """Every combination of the values by name, the last axis varying fastest.

    Linked axes go through their values together, at the place of the first of them.
    """
    groups: dict[str, list[Axis]] = {}
    for axis in axes:
        groups.setdefault(axis.link or axis.name, []).append(axis)
    for picked in product(*(range(len(group[0].values)) for group in groups.values())):
        yield {
            axis.name: axis.values[k]
            for group, k in zip(groups.values(), picked, strict=True) for axis in group
        }  # fmt: skip


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


def plain(value: Any) -> Any:
    """A number as float, true or false, a text, or a tuple of these.

    Raises
    ------
    InputError
        For anything else.
    """
    if isinstance(value, list | tuple):
        return tuple(map(plain, value))
    return value if isinstance(value, bool | str) else real("value", value)


def flat(table: TomlTable, robots: Collection[str] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Path and values of each parameter in a table and the tables below it.

    A table with names of `robots` is the values of one parameter.

    Raises
    ------
    InputError
        A table below it is empty.
    """
    for key, value in table.rest(table.values).items():
        if not isinstance(value, Mapping) or {*ONE_VALUE, *robots} & set(value):
            yield (key,), value
        elif not value:
            raise table.error(key, "a value, or a table of some", "an empty table")
        else:
            below = table.table(key)
            assert below is not None
            yield from (((key, *path), inner) for path, inner in flat(below, robots))
