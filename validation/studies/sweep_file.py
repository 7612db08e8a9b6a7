"""The strict reading of a sweep file: every error names the file, the key, what was expected."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import InputError, SoftModel, UrdfError
from softdyn.checks import number
from softdyn.controllers import CONTROLLERS, Gains
from softdyn.controllers.gains import PUBLISHED
from softdyn.files import read_toml
from softdyn.validation.studies.engine import sources
from softdyn.validation.studies.sweep import FIGURES, GAINS, PLANT, TARGETS, Axis, Sweep

MAX_CASES = 100_000
KEYS = ("robots", "controllers", "targets", "gains", "plant", "samples", "logs", "figure")
OVERLAYS = "annotations"
RANGE = ("from", "to", "count", "spacing")
DRAWN = {"uniform": False, "log_uniform": True}  # distribution → whether of the logarithm

Check = Callable[[str, Any], Any]


def read(path: str | Path) -> Sweep:
    """Read and check a sweep file; its robots are loaded, its controllers found.

    Relative paths in the file are relative to it.

    Raises
    ------
    InputError
        One line with the file, the key, what was expected and what was got.
    """
    path = Path(path)
    return _Reader(path, read_toml(path)).sweep()


class _Reader:
    """The strict reading of one file; every error names the file and the key."""

    def __init__(self, path: Path, table: dict[str, Any]) -> None:
        self.path, self.table = path, table
        self.count: int | None = None
        self.seed = 0

    def check(self, fits: Any, key: str, expected: str, got: Any) -> None:
        """Refuse what does not fit."""
        if not fits:
            where = f"{self.path}: {key}" if key else str(self.path)
            raise InputError(where, expected, got if isinstance(got, str) else repr(got))

    def sweep(self) -> Sweep:
        self.known("", self.table, (*KEYS, OVERLAYS))
        if "samples" in self.table:
            table = self.section("samples", ("count", "seed"))
            self.count = self.whole("samples.count", table.get("count"), 1, MAX_CASES)
            self.seed = self.whole("samples.seed", table.get("seed", 0), 0, 2**63 - 1)
        models = self.read_robots()
        controllers = self.read_controllers()
        targets = self.read_targets()
        axes = [*self.read_gains(controllers), *self.read_plant()]
        drawn = any(axis.drawn for axis in (*targets, *axes))
        expected = "a parameter with uniform or log_uniform"
        self.check(self.count is None or drawn, "samples", expected, "none")
        self.check_gains(controllers, models, axes)
        self.check_size(models, controllers, targets, axes)
        logs = self.table.get("logs", False)
        self.check(isinstance(logs, bool), "logs", "true or false", logs)
        sweep = Sweep(
            self.path, tuple(models), tuple(controllers), tuple(targets), tuple(axes), self.count,
            self.seed, logs, self.read_figure(targets, axes), models, self.overlays(),
        )  # fmt: skip
        _ = sweep.cases  # finds what no single key tells
        return sweep

    # -- what runs ---------------------------------------------------------------------------------

    def read_robots(self) -> dict[str, SoftModel]:
        models = {}
        overlays = self.overlays()
        for text in self.names("robots"):
            try:
                _, model = sources.of_robot(text, self.path.parent, overlays.get(text))
            except (InputError, UrdfError) as error:
                # of a defect in a robot's file, also where
                where = f" in {text}: {error.element}" if isinstance(error, UrdfError) else ""
                raise self.told("robots", error, where) from None
            self.check(model.nu > 0, "robots", "robots with actuators", f"{text!r} without any")
            models[text] = model
        return models

    def overlays(self) -> dict[str, str]:
        """Robot → the file of its annotations, for those that have them in a file of their own."""
        table = self.section(OVERLAYS, tuple(self.names("robots")))
        for name, file in table.items():
            self.check(isinstance(file, str), f"{OVERLAYS}.{name}", "a file's name", file)
        return table

    def read_controllers(self) -> list[str]:
        found = self.names("controllers")
        for text in found:
            try:
                sources.of_controller(text, self.path.parent)
            except InputError as error:
                raise self.told("controllers", error) from None
        return found

    def told(self, key: str, error: InputError | UrdfError, where: str = "") -> InputError:
        """An error as one of this file."""
        return InputError(f"{self.path}: {key}", error.expected, error.got + where)

    def names(self, key: str) -> list[str]:
        value = self.table.get(key, [])
        found = [value] if isinstance(value, str) else value
        fits = isinstance(found, list) and found and all(isinstance(n, str) and n for n in found)
        got = found if key in self.table else "nothing"
        expected = "a list of distinct names"
        self.check(fits and len(set(found)) == len(found), key, expected, got)
        return list(found)

    def read_targets(self) -> list[Axis]:
        table = self.section("targets", tuple(TARGETS))
        self.check(bool(table), "targets", f"at least one of {', '.join(TARGETS)}", "none")
        axes = []
        for kind, check in (("theta", number), ("omega", positive), ("point", point)):
            if kind not in table:
                continue
            value = table[kind]
            if kind == "point":
                self.check(isinstance(value, list), "targets.point", POINTS, value)
                single = not any(isinstance(v, list) for v in value)
                value = [value] if single else value
            axes.append(self.axis(f"targets.{kind}", kind, value, check))
        return axes

    # -- what varies -------------------------------------------------------------------------------

    def read_gains(self, controllers: Sequence[str]) -> list[Axis]:
        laws = [CONTROLLERS[name] for name in controllers if name in CONTROLLERS]
        options = dict.fromkeys(name for law in laws for name in law.options)
        table = self.section("gains", (*GAINS, *options) if laws else None)
        return [
            self.axis(f"gains.{k}", f"gains.{k}", v, gain if laws and k in GAINS else anything)
            for k, v in table.items()
        ]

    def read_plant(self) -> list[Axis]:
        checks: dict[str, Check] = dict.fromkeys(PLANT[:3], positive)
        checks |= dict.fromkeys(PLANT[3:], flag)
        table = self.section("plant", PLANT)
        return [self.axis(f"plant.{k}", f"plant.{k}", v, checks[k]) for k, v in table.items()]

    def read_figure(self, targets: list[Axis], axes: list[Axis]) -> str:
        tracks = [axis.name == "omega" for axis in targets]
        figure = self.table.get("figure", "mse_cm2" if any(tracks) else "final_error_cm")
        known = isinstance(figure, str) and figure in FIGURES
        self.check(known, "figure", f"one of {', '.join(FIGURES)}", figure)
        whole = all(tracks) and all(axis.name != "plant.duration" for axis in axes)
        expected = "final_error_cm or mse_cm2 unless every case tracks two whole cycles"
        self.check(figure != "second_cycle_mse_cm2" or whole, "figure", expected, figure)
        return str(figure)

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
        """Both ends of a range, each a value that the parameter may have."""
        for end in ends:
            number(key, end, above=0.0 if log else -math.inf)
            check(key, end)
        fits = ends[0] < ends[1] and math.isfinite(ends[1] - ends[0])
        self.check(fits, key, "a lower end below the upper", ends)
        return float(ends[0]), float(ends[1])

    # -- what only the whole tells -----------------------------------------------------------------

    def check_gains(
        self, controllers: Sequence[str], models: dict[str, SoftModel], axes: list[Axis]
    ) -> None:
        given = any(axis.name == "gains.Kp" for axis in axes)
        for robot, controller in product(models, controllers):
            published = controller in PUBLISHED.get(models[robot].bundled or "", {})
            expected = f"a value for {robot}, which has no published gains"
            has = given or published or controller not in CONTROLLERS
            self.check(has, "gains.Kp", expected, "none")

    def check_size(self, robots: Any, controllers: Any, targets: list[Axis], axes: Any) -> None:
        sizes = {"robots": len(robots), "controllers": len(controllers)}
        sizes["targets"] = sum(1 if axis.drawn else len(axis.values) for axis in targets)
        sizes |= {a.name: len(a.values) for a in axes if a.varies and not a.drawn}
        sizes |= {} if self.count is None else {"samples": self.count}
        total = math.prod(sizes.values())
        parts = " × ".join(f"{size} {name}" for name, size in sizes.items())
        expected = f"at most {MAX_CASES} cases"
        self.check(total <= MAX_CASES, "", expected, f"{total} = {parts}")

    # -- small things ------------------------------------------------------------------------------

    def section(self, key: str, names: tuple[str, ...] | None) -> dict[str, Any]:
        value = self.table.get(key, {})
        self.check(isinstance(value, dict), key, f"a table [{key}]", value)
        if names is not None:
            self.known(key, value, names)
        return dict(value)

    def known(self, key: str, table: dict[str, Any], names: tuple[str, ...]) -> None:
        for name in table:
            where = f"{key}.{name}" if key else name
            self.check(name in names, where, f"one of {', '.join(names)}", "an unknown key")

    def whole(self, key: str, value: Any, lower: int, upper: int) -> int:
        fits = isinstance(value, int) and not isinstance(value, bool) and lower <= value <= upper
        expected = f"a whole number from {lower} to {upper}"
        self.check(fits, key, expected, "none" if value is None else value)
        return int(value)


def draw(
    key: str, seed: int, count: int, lower: float, upper: float, log: bool
) -> tuple[float, ...]:
    """Random values of one parameter in [lower, upper].

    Every parameter has a stream of its own, so that neither another parameter nor a larger `count`
    changes the samples that were already drawn.
    """
    share = np.random.Generator(np.random.PCG64([seed, *key.encode()])).random(count)
    if log:
        low, high = math.log(lower), math.log(upper)
        values = np.exp(low + (high - low) * share)
    else:
        values = lower + (upper - lower) * share
    return tuple(np.clip(values, lower, upper).tolist())


# -- checks of single values -----------------------------------------------------------------------

POINTS = "[x, y, z] in m, or a list of such"


def positive(key: str, value: Any) -> float:
    """A finite number above 0."""
    return number(key, value, above=0.0)


def point(key: str, value: Any) -> tuple[float, ...]:
    """Three finite numbers."""
    if not isinstance(value, list) or len(value) != 3:
        raise InputError(key, POINTS, repr(value))
    return tuple(number(key, x) for x in value)


def gain(key: str, value: Any) -> float:
    """A value that this field of `Gains` may have."""
    Gains(**{"Kp": 1.0, key.removeprefix("gains."): value})
    return float(value)


def anything(key: str, value: Any) -> Any:
    """A number, true or false, a text, or a list of such, for a user's own controller."""
    if isinstance(value, list):
        return tuple(anything(key, item) for item in value)
    return value if isinstance(value, bool | str) else number(key, value)


def flag(key: str, value: Any) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise InputError(key, "true or false", repr(value))
    return value
