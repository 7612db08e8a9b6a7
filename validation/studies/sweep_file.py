"""The strict reading of a sweep file: every error names the file, the key, what was expected."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from softdyn import InputError, SoftModel, UrdfError
from softdyn.checks import number
from softdyn.controllers import CONTROLLERS
from softdyn.controllers.gains import PUBLISHED, from_table
from softdyn.controllers.registry import is_own, make_controller
from softdyn.files import read_toml
from softdyn.validation.studies.engine import sources
from softdyn.validation.studies.sweep import (
    FIGURES,
    GAINS,
    HORIZON_SHARE,
    NOMINAL,
    TARGETS,
    Sweep,
    resolve_gains,
)  # fmt: skip
from softdyn.validation.studies.sweep_values import (
    GROUPS,
    MAX_CASES,
    POINTS,
    Axis,
    ByRobot,
    Check,
    ValueReader,
    anything,
    gain,
    not_negative,
    point,
    positive,
)  # fmt: skip

OVERLAYS = "annotations"
KEYS = (
    "robots", "controllers", "targets", "gains", "plant", "signals", "ellipse_scale", "changes",
    "samples", "logs", "figure", "rows", "means", "must_not_fail",
)  # fmt: skip
SHIPPED = Path(__file__).parent / "sweeps"


def shipped() -> dict[str, Path]:
    """The sweep files that come with softdyn, by name."""
    return {path.stem: path for path in sorted(SHIPPED.glob("*.toml"))}


@dataclass(frozen=True)
class Instead:
    """What a caller says instead of a sweep file.

    Attributes
    ----------
    robots, controllers : sequence of str, optional
        Paths in them are relative to the current folder.
    annotations : str, optional
        The file with the one robot's ``<softdyn>`` block.
    gains : mapping, optional
        Gains of the one robot, above the file's.
    period : float, optional
        Control period (s).
    """

    robots: Sequence[str] | None = None
    controllers: Sequence[str] | None = None
    annotations: str | None = None
    gains: Mapping[str, Any] | None = None
    period: float | None = None


def read(name: str | Path, instead: Instead | None = None) -> Sweep:
    """Read and check a sweep file; its robots are loaded, its controllers found.

    Parameters
    ----------
    name : str or Path
        A file, or the name of one that comes with softdyn where there is no such file. Relative
        paths in a file are relative to it.
    instead : Instead, optional

    Raises
    ------
    InputError
        One line with the file, the key, what was expected and what was got.
    """
    path, known = Path(name), shipped()
    if not path.exists() and str(name) in known:
        path, folder = known[str(name)], Path()
    elif path.suffix or path.exists():
        folder = path.parent
    else:
        raise InputError(str(name), f"a readable file, or one of {', '.join(known)}", "neither")
    return _Reader(path, read_toml(path), folder, instead or Instead()).sweep()


class _Reader(ValueReader):
    """The strict reading of one file."""

    def __init__(self, path: Path, table: dict[str, Any], folder: Path, instead: Instead) -> None:
        super().__init__(path, table)
        self.folder, self.instead = folder, instead

    def sweep(self) -> Sweep:
        self.known("", self.table, (*KEYS, OVERLAYS))
        self.replace()
        if "samples" in self.table:
            table = self.section("samples", ("count", "seed"))
            self.count = self.whole("samples.count", table.get("count"), 1, MAX_CASES)
            self.seed = self.whole("samples.seed", table.get("seed", 0), 0, 2**63 - 1)
        models = self.read_robots()
        controllers = self.read_controllers()
        targets = self.read_targets()
        checks = self.checks(controllers)
        periods = self.read_shorter_periods()
        axes = self.read_axes(checks)
        changes: dict[str, dict[str, Any]] = {NOMINAL: {}} | dict(self.read_changes(checks))
        drawn = any(axis.drawn for axis in (*targets, *axes))
        expected = "a parameter with uniform or log_uniform"
        self.check(self.count is None or drawn, "samples", expected, "none")
        equilibria = self.yes("targets.equilibria", self.section("targets", None))
        fits = not equilibria or {a.name for a in targets if not a.drawn} <= {"theta", "omega"}
        self.check(fits and not (equilibria and drawn), "targets.equilibria",
                   "values of theta and omega alone", "others")  # fmt: skip
        self.check_gains(controllers, models, axes)
        sizes = {"changes": len(changes), "periods": 1 + len(periods)}
        self.check_size(models, controllers, targets, axes, sizes)
        sweep = Sweep(
            self.path, self.folder, tuple(models), tuple(controllers), tuple(targets), tuple(axes),
            self.count, self.seed, self.yes("logs", self.table), self.read_figure(targets, axes),
            models, self.overlays(), equilibria, periods, changes, self.read_rows(axes),
            self.yes("means", self.table),
            tuple(self.texts("must_not_fail", "names of changes", changes)),
            self.instead.gains or {},
        )  # fmt: skip
        _ = sweep.cases  # finds what no single key tells
        return sweep

    def replace(self) -> None:
        """Put what the caller says in the file's place."""
        said, table = self.instead, self.table
        if said.robots is not None:
            table["robots"] = [self.beside(robot) for robot in said.robots]
            table.pop(OVERLAYS, None)
        if said.controllers is not None:
            table["controllers"] = [self.beside(name) for name in said.controllers]
        if said.annotations or said.gains is not None:
            robots = self.names("robots")
            expected = "one robot with --annotations or --gains"
            self.check(len(robots) == 1, "robots", expected, f"{len(robots)} robots")
        if said.annotations:
            table[OVERLAYS] = {self.names("robots")[0]: self.beside(said.annotations)}
        if said.gains is not None:
            table["gains"] = {
                k: v for k, v in self.section("gains", None).items() if k not in said.gains
            }
        if said.period is not None:
            table["plant"] = self.section("plant", None) | {"period": said.period}

    def beside(self, name: str) -> str:
        """A path from the current folder as one from the file's; any other name as it is."""
        file, colon, kind = name.rpartition(":") if is_own(name) else (name, "", "")
        if self.folder == Path() or os.path.isabs(file) or not os.path.isfile(file):
            return name
        return os.path.relpath(file, self.folder) + colon + kind

    # -- what runs ---------------------------------------------------------------------------------

    def read_robots(self) -> dict[str, SoftModel]:
        models = {}
        overlays = self.overlays()
        for text in self.names("robots"):
            try:
                _, model = sources.of_robot(text, self.folder, overlays.get(text))
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
                sources.of_controller(text, self.folder)
            except InputError as error:
                raise self.told("controllers", error) from None
        return found

    def names(self, key: str) -> list[str]:
        value = self.table.get(key, [])
        found = [value] if isinstance(value, str) else value
        fits = isinstance(found, list) and found and all(isinstance(n, str) and n for n in found)
        got = found if key in self.table else "nothing"
        expected = "a list of distinct names"
        self.check(fits and len(set(found)) == len(found), key, expected, got)
        return list(found)

    def read_targets(self) -> list[Axis]:
        table = self.section("targets", (*TARGETS, "equilibria"))
        self.check(
            bool(set(table) & set(TARGETS)),
            "targets",
            f"at least one of {', '.join(TARGETS)}",
            "none",
        )
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

    def checks(self, controllers: Sequence[str]) -> dict[str, dict[str, Check] | None]:
        """Group → its parameters with their checks; None where any name is one."""
        laws = [CONTROLLERS[name] for name in controllers if name in CONTROLLERS]
        options = dict.fromkeys((name for law in laws for name in law.options), anything)
        if laws and all(
            "horizon" in getattr(CONTROLLERS.get(n), "options", ()) for n in controllers
        ):
            options[HORIZON_SHARE.removeprefix("gains.")] = not_negative
        return {"gains": dict.fromkeys(GAINS, gain) | options if laws else None, **GROUPS}

    def read_axes(self, checks: Mapping[str, dict[str, Check] | None]) -> list[Axis]:
        axes = [
            self.axis(name, name, value, check)
            for group in checks
            for name, value, check in self.parameters(group, self.section(group, None), checks)
        ]
        if "ellipse_scale" in self.table:
            value = self.table["ellipse_scale"]
            axes.append(self.axis("ellipse_scale", "ellipse_scale", value, positive))
        return axes

    def parameters(
        self, group: str, table: Any, checks: Mapping[str, dict[str, Check] | None], at: str = ""
    ) -> Iterator[tuple[str, Any, Check]]:
        """Name, value and check of each parameter in a table of one group."""
        known = checks[group]
        self.check(isinstance(table, dict), f"{at}{group}", "a table", table)
        if known is not None:
            self.known(f"{at}{group}", table, tuple(known))
        for key, value in table.items():
            yield f"{group}.{key}", value, anything if known is None else known[key]

    def read_shorter_periods(self) -> tuple[float, ...]:
        table = self.section("plant", None)
        value = table.pop("shorter_periods", [])
        self.table["plant"] = table
        key = "plant.shorter_periods"
        self.check(isinstance(value, list), key, "a list of control periods in s", value)
        return self.axis(key, key, value, positive).values if value else ()

    def read_changes(
        self, checks: Mapping[str, dict[str, Check] | None]
    ) -> Iterator[tuple[str, dict[str, Any]]]:
        """Each change by its name; a list of values is as many changes."""
        names: set[str] = {NOMINAL}
        for text, table in self.section("changes", None).items():
            key = f"changes.{text}"
            fields, listed = {}, ""
            self.known(key, table if isinstance(table, dict) else {}, (*checks, "ellipse_scale"))
            self.check(isinstance(table, dict) and table, key, "a table of parameters", table)
            for group, inner in table.items():
                given = (
                    [(group, inner, positive)] if group == "ellipse_scale"
                    else self.parameters(group, inner, checks, f"{key}.")
                )  # fmt: skip
                for name, value, check in given:
                    at = f"{key}.{name}"
                    if isinstance(value, dict) and "default" in value:
                        each = {k: self.axis(at, name, v, check).values for k, v in value.items()}
                        single = all(len(values) == 1 for values in each.values())
                        self.check(single, at, "one value for each robot", value)
                        others = {k: v[0] for k, v in each.items() if k != "default"}
                        fields[name] = (ByRobot(others, each["default"][0]),)
                        continue
                    axis = self.axis(at, name, value, check)
                    self.check(axis.drawn is None, at, "values that are not random", value)
                    self.check(not (axis.varies and listed), at, f"one list, {listed}", value)
                    fields[name] = axis.values
                    listed = name if axis.varies else listed
            for k in range(len(fields.get(listed, (None,)))):
                values = {n: v[k if n == listed else 0] for n, v in fields.items()}
                title = text.replace("{}", f"{values[listed]:g}") if listed else text
                fits = title and "/" not in title and title not in names
                self.check(fits, key, "a name of its own, with {} for a list and no /", title)
                names.add(title)
                yield title, values

    def read_rows(self, axes: list[Axis]) -> tuple[str, ...]:
        known = ("robot", "controller", "change", "plant.period", "gains.horizon",
                 *(axis.name for axis in axes), "sample")  # fmt: skip
        rows = self.texts("rows", "parameters", known)
        if rows and self.instead.period is not None and "plant.period" not in rows:
            rows.insert(rows.index("change") if "change" in rows else len(rows), "plant.period")
        return tuple(rows)

    def read_figure(self, targets: list[Axis], axes: list[Axis]) -> str:
        tracks = [axis.name == "omega" for axis in targets]
        figure = self.table.get("figure", "mse_cm2" if any(tracks) else "final_error_cm")
        known = isinstance(figure, str) and figure in FIGURES
        self.check(known, "figure", f"one of {', '.join(FIGURES)}", figure)
        whole = all(tracks) and all(axis.name != "plant.duration" for axis in axes)
        expected = "final_error_cm or mse_cm2 unless every case tracks two whole cycles"
        self.check(figure != "second_cycle_mse_cm2" or whole, "figure", expected, figure)
        return str(figure)

    # -- what only the whole tells -----------------------------------------------------------------

    def check_gains(
        self, controllers: Sequence[str], models: dict[str, SoftModel], axes: list[Axis]
    ) -> None:
        said = self.instead.gains
        given = "Kp" in (said or {}) or any(axis.name == "gains.Kp" for axis in axes)
        for robot, controller in product(models, controllers):
            published = controller in PUBLISHED.get(models[robot].bundled or "", {})
            expected = f"a value for {robot}, which has no published gains"
            has = given or published or controller not in CONTROLLERS
            self.check(has, "gains.Kp", expected, "none")
            if said is not None and not is_own(controller):
                options = getattr(CONTROLLERS.get(controller), "options", ())
                if controller in CONTROLLERS:  # it knows no others
                    own = {name: value for name, value in said.items() if name not in options}
                    from_table(models[robot], controller, own, options)
                parameters = resolve_gains(models[robot], controller, said)
                make_controller(controller, models[robot], parameters)

    def check_size(
        self, robots: Any, controllers: Any, targets: list[Axis], axes: Any, more: dict[str, int]
    ) -> None:
        sizes = {"robots": len(robots), "controllers": len(controllers)}
        sizes["targets"] = sum(1 if axis.drawn else len(axis.values) for axis in targets)
        sizes |= {a.name: len(a.values) for a in axes if a.varies and not a.drawn}
        sizes |= {name: size for name, size in more.items() if size > 1}
        sizes |= {} if self.count is None else {"samples": self.count}
        total = math.prod(sizes.values())
        parts = " × ".join(f"{size} {name}" for name, size in sizes.items())
        expected = f"at most {MAX_CASES} cases"
        self.check(total <= MAX_CASES, "", expected, f"{total} = {parts}")
