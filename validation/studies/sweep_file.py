"""The strict reading of a sweep file: every error names the file, the key, what was expected."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import fields, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import softdyn
from softdyn import InputError, SoftModel
from softdyn.checks import number
from softdyn.controllers import CONTROLLERS, Gains, find_controller
from softdyn.controllers.gains import PUBLISHED
from softdyn.description import library as catalogue
from softdyn.validation.files import read_toml
from softdyn.validation.studies.fingerprint import sources as own_sources
from softdyn.validation.studies.sweep import FIGURES, PLANT, Axis, Source, Sweep

MAX_CASES = 100_000
TARGETS = ("theta", "omega", "point")
GAINS = tuple(field.name for field in fields(Gains))
KEYS = ("robots", "controllers", "targets", "gains", "plant", "samples", "logs", "figure")
RANGE = ("from", "to", "count", "spacing")
DRAWN = {"uniform": "linear", "log_uniform": "log"}


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

    def fail(self, key: str, expected: str, got: Any) -> InputError:
        where = f"{self.path}: {key}" if key else str(self.path)
        return InputError(where, expected, got if isinstance(got, str) else repr(got))

    def sweep(self) -> Sweep:
        self.known("", self.table, KEYS)
        self.read_samples()
        robots, models = self.read_robots()
        controllers = self.read_controllers()
        targets = self.read_targets()
        axes = self.read_gains(controllers) + self.read_plant()
        drawn = any(axis.drawn for axis in (*targets, *axes))
        if self.count is None and drawn:  # never: `axis` asks for it
            raise self.fail("samples", "a table with a count", "none")
        if self.count is not None and not drawn:
            raise self.fail("samples", "a parameter with uniform or log_uniform", "none")
        self.check_gains(robots, controllers, models, axes)
        self.check_size(robots, controllers, targets, axes)
        logs = self.table.get("logs", False)
        if not isinstance(logs, bool):
            raise self.fail("logs", "true or false", logs)
        sweep = Sweep(
            self.path, robots, controllers, tuple(targets), tuple(axes), self.count, self.seed,
            logs, self.read_figure(targets, axes), models,
        )  # fmt: skip
        _ = sweep.cases  # finds what no single key tells
        return sweep

    # -- what runs ---------------------------------------------------------------------------------

    def read_robots(self) -> tuple[dict[str, Source], dict[str, SoftModel]]:
        sources, models = {}, {}
        for text in self.names("robots"):
            beside = self.path.parent / text
            own = text not in catalogue.bundled_names() and beside.is_file()
            try:
                model = softdyn.load(beside if own else text)
            except softdyn.SoftdynError as error:
                expected = getattr(error, "expected", "a robot")
                raise self.fail("robots", expected, self.reason(error, text)) from None
            if model.nu == 0:
                raise self.fail("robots", "robots with actuators", f"{text!r} without any")
            own = own and model.bundled is None
            sources[text] = Source.of(model.bundled or text, [model.robot.path], own)
            models[text] = model
        return sources, models

    @staticmethod
    def reason(error: Exception, text: str) -> str:
        """What was got; of a defect in a robot's file, also where."""
        if isinstance(error, softdyn.UrdfError):
            return f"{error.got} in {text}: {error.element}"
        return str(getattr(error, "got", error))

    def read_controllers(self) -> dict[str, Source | None]:
        found: dict[str, Source | None] = {}
        for text in self.names("controllers"):
            if text in CONTROLLERS:
                found[text] = None
                continue
            file, _, kind = text.rpartition(":")
            path = self.path.parent / file
            try:
                with redirect_stdout(sys.stderr):  # what a user's module prints
                    find_controller(f"{path}:{kind}" if file else text)
            except InputError as error:
                raise self.fail("controllers", error.expected, error.got) from None
            beside = [p for p in own_sources(path) if p != path.resolve()]
            found[text] = Source.of(text, [path, *beside], own=True)
        return found

    def names(self, key: str) -> list[str]:
        value = self.table.get(key)
        found = [value] if isinstance(value, str) else value
        expected = "a list of distinct names"
        if not isinstance(found, list) or not found:
            raise self.fail(key, expected, "nothing" if value is None else value)
        if not all(isinstance(name, str) and name for name in found):
            raise self.fail(key, expected, found)
        if len(set(found)) < len(found):
            raise self.fail(key, expected, found)
        return found

    def read_targets(self) -> list[Axis]:
        table = self.section("targets")
        self.known("targets", table, TARGETS)
        if not table:
            raise self.fail("targets", f"at least one of {', '.join(TARGETS)}", "none")
        axes = []
        for kind in TARGETS:
            if kind not in table:
                continue
            value = table[kind]
            if kind == "point":
                single = isinstance(value, list) and not any(isinstance(v, list) for v in value)
                if not isinstance(value, list):
                    raise self.fail("targets.point", "[x, y, z] in m, or a list of such", value)
                axes.append(self.axis("targets.point", [value] if single else value, self.point))
            else:
                above = 0.0 if kind == "omega" else -math.inf
                axes.append(self.axis(f"targets.{kind}", value, number_above(above)))
        return [replace(axis, name=axis.name.removeprefix("targets.")) for axis in axes]

    @staticmethod
    def point(key: str, value: Any) -> tuple[float, ...]:
        if not isinstance(value, list) or len(value) != 3:
            raise InputError(key, "[x, y, z] in m, or a list of such", repr(value))
        return tuple(number(key, x) for x in value)

    # -- what varies -------------------------------------------------------------------------------

    def read_gains(self, controllers: dict[str, Source | None]) -> list[Axis]:
        table = self.section("gains")
        if any(source is None for source in controllers.values()):
            self.known("gains", table, GAINS)
            check: Callable[[str, Any], Any] = gain
        else:
            check = plain
        return [self.axis(f"gains.{name}", value, check) for name, value in table.items()]

    def read_plant(self) -> list[Axis]:
        table = self.section("plant")
        self.known("plant", table, PLANT)
        return [
            self.axis(
                f"plant.{name}", value, flag if name in PLANT[3:] else number_above(0.0)
            )
            for name, value in table.items()
        ]  # fmt: skip

    def read_samples(self) -> None:
        if "samples" not in self.table:
            return
        table = self.section("samples")
        self.known("samples", table, ("count", "seed"))
        self.count = self.whole("samples.count", table.get("count"), 1, MAX_CASES)
        self.seed = self.whole("samples.seed", table.get("seed", 0), 0, 2**63 - 1)

    def read_figure(self, targets: list[Axis], axes: list[Axis]) -> str:
        tracks = [axis.name == "omega" for axis in targets]
        figure = self.table.get("figure", "mse_cm2" if any(tracks) else "final_error_cm")
        if not isinstance(figure, str) or figure not in FIGURES:
            raise self.fail("figure", f"one of {', '.join(FIGURES)}", figure)
        shortened = any(axis.name == "plant.duration" for axis in axes)
        if figure == "second_cycle_mse_cm2" and (not all(tracks) or shortened):
            expected = "final_error_cm or mse_cm2 unless every case tracks two whole cycles"
            raise self.fail("figure", expected, figure)
        return figure

    def axis(self, key: str, value: Any, check: Callable[[str, Any], Any]) -> Axis:
        """The values of one parameter: a number, a list, a range, or a distribution."""
        try:
            if isinstance(value, dict):
                return self.spread(key, value, check)
            values = tuple(check(key, v) for v in (value if isinstance(value, list) else [value]))
        except InputError as error:
            if error.name.startswith(f"{self.path}: "):
                raise
            raise self.fail(key, error.expected, error.got) from None
        if not values:
            raise self.fail(key, "at least one value", value)
        if len({(isinstance(v, bool), v) for v in values}) < len(values):
            raise self.fail(key, "distinct values", value)
        return Axis(key, values)

    def spread(self, key: str, table: dict[str, Any], check: Callable[[str, Any], Any]) -> Axis:
        """A range of a grid, or a distribution."""
        if check is flag or check is self.point:
            check(key, table)  # refuses it
        drawn = [name for name in DRAWN if name in table]
        if drawn:
            (name, ends) = drawn[0], table[drawn[0]]
            self.known(key, table, (name,))
            if not isinstance(ends, list) or len(ends) != 2:
                raise self.fail(f"{key}.{name}", "[lower, upper]", ends)
            if self.count is None:
                raise self.fail("samples", f"a table with the count of samples of {key}", "none")
            lower, upper = self.ends(key, ends[0], ends[1], check, DRAWN[name] == "log")
            values = draw(key, self.seed, self.count, lower, upper, DRAWN[name] == "log")
            return Axis(key, values, drawn=name)
        self.known(key, table, RANGE)
        for name in RANGE[:3]:
            if name not in table:
                raise self.fail(
                    key, "a range {from, to, count}, {uniform} or {log_uniform}", table
                )  # fmt: skip
        spacing = table.get("spacing", "linear")
        if spacing not in ("linear", "log"):
            raise self.fail(f"{key}.spacing", "linear or log", spacing)
        count = self.whole(f"{key}.count", table["count"], 2, MAX_CASES)
        log = spacing == "log"
        lower, upper = self.ends(key, table["from"], table["to"], check, log)
        values = tuple((np.geomspace if log else np.linspace)(lower, upper, count).tolist())
        if len(set(values)) < count:
            raise self.fail(key, f"{count} distinct values", table)
        return Axis(key, values)

    def ends(
        self, key: str, lower: Any, upper: Any, check: Callable[[str, Any], Any], log: bool
    ) -> tuple[float, float]:
        """Both ends of a range, each a value that the parameter may have."""
        for end in (lower, upper):
            number(key, end, above=0.0 if log else -math.inf)
            check(key, end)
        if not lower < upper or not math.isfinite(upper - lower):
            raise self.fail(key, "a lower end below the upper", [lower, upper])
        return float(lower), float(upper)

    # -- what only the whole tells -----------------------------------------------------------------

    def check_gains(
        self,
        robots: dict[str, Source],
        controllers: dict[str, Source | None],
        models: dict[str, SoftModel],
        axes: list[Axis],
    ) -> None:
        given = any(axis.name == "gains.Kp" for axis in axes)
        for robot, controller in product(robots, controllers):
            published = controller in PUBLISHED.get(models[robot].bundled or "", {})
            if controllers[controller] is None and not published and not given:
                expected = f"a value for {robot}, which has no published gains"
                raise self.fail("gains.Kp", expected, "none")

    def check_size(self, robots: Any, controllers: Any, targets: list[Axis], axes: Any) -> None:
        sizes = {"robots": len(robots), "controllers": len(controllers)}
        sizes["targets"] = sum(1 if axis.drawn else len(axis.values) for axis in targets)
        sizes |= {a.name: len(a.values) for a in axes if a.varies and not a.drawn}
        sizes |= {} if self.count is None else {"samples": self.count}
        total = math.prod(sizes.values())
        if total > MAX_CASES:
            parts = " × ".join(f"{size} {name}" for name, size in sizes.items())
            raise self.fail("", f"at most {MAX_CASES} cases", f"{total} = {parts}")

    # -- small things ------------------------------------------------------------------------------

    def section(self, key: str) -> dict[str, Any]:
        value = self.table.get(key, {})
        if not isinstance(value, dict):
            raise self.fail(key, f"a table [{key}]", value)
        return value

    def known(self, key: str, table: dict[str, Any], names: tuple[str, ...]) -> None:
        for name in table:
            if name not in names:
                raise self.fail(f"{key}.{name}" if key else name, f"one of {', '.join(names)}",
                                "an unknown key")  # fmt: skip

    def whole(self, key: str, value: Any, lower: int, upper: int) -> int:
        if not isinstance(value, int) or isinstance(value, bool) or not lower <= value <= upper:
            got = "none" if value is None else value
            raise self.fail(key, f"a whole number from {lower} to {upper}", got)
        return value


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


def number_above(limit: float) -> Callable[[str, Any], float]:
    """A check: a finite number above `limit`."""
    return lambda key, value: number(key, value, above=limit)


def gain(key: str, value: Any) -> float:
    """A check: a value that this field of `Gains` may have."""
    Gains(**{"Kp": 1.0, key.removeprefix("gains."): value})
    return float(value)


def plain(key: str, value: Any) -> Any:
    """A check: a number, true or false, or a text, for a user's own controller."""
    if isinstance(value, bool | str):
        return value
    return number(key, value)


def flag(key: str, value: Any) -> bool:
    """A check: true or false."""
    if not isinstance(value, bool):
        raise InputError(key, "true or false", repr(value))
    return value
