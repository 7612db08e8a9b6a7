"""The strict reader of a sweep file: every error names the file, the key, the expected value."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

from softdyn import InputError, SoftModel, UrdfError
from softdyn.checks import did_you_mean, number
from softdyn.controllers import CONTROLLERS
from softdyn.controllers.gains import PUBLISHED, from_table
from softdyn.controllers.registry import is_own, make_controller
from softdyn.files import read_toml
from softdyn.validation.studies import sweep_values as values
from softdyn.validation.studies.engine import sources
from softdyn.validation.studies.sweep import FIGURES, NOMINAL, SHARE, TARGETS, Sweep, place
from softdyn.validation.studies.sweep_values import Axis, Check, ValueReader
from softdyn.validation.twin.plant_errors import BY_JOINT, EACH

OVERLAYS, BEYOND = "annotations", "statics_beyond_cm"
KEYS = (
    "robots", "controllers", "targets", "gains", "plant", "rig", "ellipse_scale",
    "changes", "samples", "logs", "figure", "rows", "means", "must_not_fail", BEYOND,
)  # fmt: skip


def shipped() -> dict[str, Path]:
    """The sweep files that come with softdyn, by name."""
    found = sorted((Path(__file__).parent / "sweeps").glob("*.toml"))
    return {path.stem: path for path in found}


def read_sweep(name: str | Path, instead: Mapping[str, Any] | None = None) -> Sweep:
    """Read and check a sweep file; its robots are loaded, its controllers found.

    Parameters
    ----------
    name : str or Path
        A file, or the name of a shipped sweep if no such file exists. Relative paths in a file are
        relative to it.
    instead : mapping, optional
        Values that replace the file's: lists of `robots` and `controllers`, `period` (s), and for a
        single robot the file of its `annotations` and a table of `gains`. Paths in it are relative
        to the current folder; None keeps the file's value.

    Raises
    ------
    InputError
        One line with the file, the key, the expected and the given value.
    """
    path, known, folder = Path(name), shipped(), Path(name).parent
    if not path.exists() and not path.suffix:
        if str(name) not in known:
            expected = f"a readable file, or one of {', '.join(known)}"
            raise InputError(str(name), expected, "neither")
        path, folder = known[str(name)], Path()
    said = {key: value for key, value in (instead or {}).items() if value is not None}
    table = read_toml(path)
    for one in (table, *_tables(table.get("changes"))):
        if "signals" in one and "rig" not in one:  # their name in older files
            one["rig"] = one.pop("signals")
    return _Reader(path, table, folder, said).sweep()


def _tables(table: Any) -> list[dict[str, Any]]:
    """The tables in a table."""
    inner = table.values() if isinstance(table, dict) else ()
    return [one for one in inner if isinstance(one, dict)]


class _Reader(ValueReader):
    """The strict reader of one file."""

    def __init__(
        self, path: Path, table: dict[str, Any], folder: Path, said: Mapping[str, Any]
    ) -> None:
        super().__init__(path, table)
        self.folder, self.said = folder, said
        self.gains: dict[str, Check] | None = None  # a user's controller may have any gains
        self.said_own: dict[str, Any] = {}

    def sweep(self) -> Sweep:
        self.known("", self.table, (*KEYS, OVERLAYS))
        self.replace()
        if "samples" in self.table:
            table = self.section("samples", ("count", "seed"))
            self.count = self.whole("samples.count", table.get("count"), 1, values.MAX_CASES)
            self.seed = self.whole("samples.seed", table.get("seed", 0), 0, 2**63 - 1)
        models = self.read_robots()
        controllers = self.read_controllers()
        targets = self.read_targets()
        plant, key = self.section("plant", None), "plant.shorter_periods"
        shorter = plant.pop("shorter_periods", None)
        periods = () if shorter is None else self.axis(key, key, shorter, values.positive).values
        self.table["plant"] = plant
        own_axes, own_gains = self.read_own_gains(controllers)
        axes = [self.axis(n, n, value, check) for n, value, check in self.flat(self.table)]
        axes = [one for axis in axes for one in self.of_each_joint(axis, axes, models)] + own_axes
        changes = {NOMINAL: dict[str, Any]()} | dict(self.read_changes(models))
        drawn = any(axis.drawn for axis in (*targets, *axes))
        expected = "a parameter with uniform or log_uniform"
        self.check(self.count is None or drawn, "samples", expected, "none")
        equilibria = self.yes("targets.equilibria", self.section("targets", None))
        fits = not equilibria or all(a.name != "point" and not a.drawn for a in targets)
        self.check(fits, "targets.equilibria", "only values of theta and omega", "others")
        self.check_gains(controllers, models, axes, own_gains)
        sizes = {"changes": len(changes), "periods": 1 + len(periods)}
        self.check_size(models, controllers, targets, axes, sizes)
        sweep = Sweep(
            self.path, self.folder, tuple(models), tuple(controllers), tuple(targets), tuple(axes),
            self.count, self.seed, self.yes("logs", self.table), self.read_figure(targets, axes),
            models, self.overlays(), equilibria, periods, changes, self.read_rows(axes, changes),
            self.yes("means", self.table), self.read_beyond(),
            tuple(self.names("must_not_fail", changes)), self.said.get("gains", {}), own_gains,
        )  # fmt: skip
        _ = sweep.cases, sweep.rows and sweep.cells  # finds errors that no single key shows
        self.try_controllers(sweep)
        return sweep

    def replace(self) -> None:
        """Replace values of the file by the caller's."""
        table, said = self.table, self.said
        for key in {"robots", "controllers"} & set(said):
            table[key] = [self.beside(name) for name in said[key]]
        if "robots" in said:
            table.pop(OVERLAYS, None)
        if {"annotations", "gains"} & set(said):
            robots = self.names("robots")
            got = f"{len(robots)} robots"
            self.check(len(robots) == 1, "robots", "one robot for annotations or gains", got)
        if "annotations" in said:
            table[OVERLAYS] = {robots[0]: self.beside(said["annotations"])}
        if "gains" in said:  # tables of single controllers come first, by their names here
            named = {self.beside(key): value for key, value in said["gains"].items()}
            self.said_own = {n: named.pop(n) for n in self.names("controllers") if n in named}
            self.said = said = {**said, "gains": named}
            gains = self.section("gains", None)
            table["gains"] = {k: v for k, v in gains.items() if k not in named}
        if "period" in said:
            table["plant"] = self.section("plant", None) | {"period": said["period"]}

    def beside(self, name: str) -> str:
        """A path in the current folder, made relative to the file's; other names unchanged."""
        file = name.rpartition(":")[0] if is_own(name) else name
        return os.path.relpath(name, self.folder) if os.path.isfile(file) else name

    # -- what runs ---------------------------------------------------------------------------------

    def read_robots(self) -> dict[str, SoftModel]:
        models = {}
        overlays = self.overlays()
        for text in self.names("robots"):
            try:
                _, model = sources.of_robot(text, self.folder, overlays.get(text))
            except (InputError, UrdfError) as error:
                # a defect in a robot's file: name the element, too
                where = f" in {text}: {error.element}" if isinstance(error, UrdfError) else ""
                raise self.told("robots", error, where) from None
            self.check(model.nu > 0, "robots", "robots with actuators", f"{text!r} without any")
            models[text] = model
        return models

    def overlays(self) -> dict[str, str]:
        """Robot → the file of its annotations, if that is a separate file."""
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
        ours = [CONTROLLERS[name] for name in found if name in CONTROLLERS]
        if ours:
            self.gains = values.of_paper(*ours)
            if len(ours) == len(found) and all("horizon" in one.options for one in ours):
                self.gains[SHARE] = values.not_negative
        return found

    def read_targets(self) -> list[Axis]:
        table = self.section("targets", (*TARGETS, "equilibria"))
        some = any(kind in table for kind in TARGETS)
        self.check(some, "targets", f"at least one of {', '.join(TARGETS)}", "none")
        axes = []
        for kind, check in (("theta", number), ("omega", values.positive), ("point", values.point)):
            if kind not in table:
                continue
            value = table[kind]
            if kind == "point":
                self.check(isinstance(value, list), "targets.point", values.POINTS, value)
                single = not any(isinstance(v, list) for v in value)
                value = [value] if single else value
            axes.append(self.axis(f"targets.{kind}", kind, value, check))
        return axes

    # -- what varies -------------------------------------------------------------------------------

    def flat(self, table: Mapping[str, Any], at: str = "") -> Iterator[tuple[str, Any, Check]]:
        """Name, value and check of each parameter, group by group."""
        for group, known in (("gains", self.gains), *values.GROUPS.items()):
            inner = table.get(group, {})
            self.check(isinstance(inner, dict), f"{at}{group}", f"a table [{group}]", inner)
            if known is not None:
                self.known(f"{at}{group}", inner, tuple(known))
            for key, value in inner.items():
                check = values.anything if known is None else known[key]
                if group == "plant" and key in BY_JOINT and not values.is_one_value(value):
                    self.check(value, f"{at}{group}.{key}", "a factor, or some by joint", value)
                    for joint, factor in value.items():
                        yield f"plant.{key}.{joint}", factor, check
                else:
                    yield f"{group}.{key}", value, check
        if "ellipse_scale" in table:
            yield "ellipse_scale", table["ellipse_scale"], values.positive

    def of_each_joint(
        self, axis: Axis, axes: list[Axis], models: Mapping[str, SoftModel]
    ) -> Iterator[Axis]:
        """An axis; instead of a random one of each joint, one for every joint without its own."""
        *of, joint = place(axis.name)
        if not joint:
            yield axis
        elif joint != EACH:
            self.check_joint(axis.name, joint, models)
            yield axis
        elif not axis.drawn:
            self.check(not axis.varies, axis.name, "one value, or a random one", axis.values)
            yield axis
        else:
            named = {place(one.name)[2] for one in axes if [*place(one.name)[:2]] == of}
            value = self.table[of[0]][of[1]][EACH]
            for robot, model in models.items():
                for other in model.robot.moving_joints:
                    if other.name not in named:
                        name = ".".join((*of, other.name))
                        check = values.GROUPS[of[0]][of[1]]
                        yield replace(self.axis(name, name, value, check), robot=robot)

    def check_joint(self, key: str, joint: str, models: Mapping[str, SoftModel]) -> None:
        """Refuse a name that is not a joint of every robot."""
        for robot, model in models.items():
            known = [one.name for one in model.robot.moving_joints]
            expected = f"a joint of {robot}, or {EACH}"
            self.check(joint in known, key, expected, did_you_mean(joint, known))

    def read_own_gains(
        self, controllers: Sequence[str]
    ) -> tuple[list[Axis], dict[str, dict[str, Any]]]:
        """Remove the tables of single controllers from [gains]: varying gains, and fixed ones.

        A table in such a table, as the stages of a schedule, is fixed.
        """
        axes, fixed, gains = list[Axis](), dict[str, dict[str, Any]](), self.section("gains", None)
        spread = {"from", *values.DRAWN}
        for name in controllers:
            said, table = self.said_own.get(name, {}), gains.pop(name, {})
            for one in (said, table):
                self.check(isinstance(one, dict), f"gains.{name}", "a table of gains", one)
            known = values.of_paper(CONTROLLERS[name]) if name in CONTROLLERS else None
            if known is not None:
                self.known(f"gains.{name}", table, tuple(known))
            fixed[name] = {}
            for key, value in table.items():
                if key not in said and (not isinstance(value, dict) or spread & set(value)):
                    check = values.anything if known is None else known[key]
                    axis = self.axis(f"gains.{name}.{key}", f"gains.{key}", value, check)
                    axes.append(replace(axis, controller=name))
                else:
                    fixed[name][key] = value
            fixed[name] |= said
        for name, value in gains.items():
            single = not isinstance(value, dict) or (spread | {"count"}) & set(value)
            expected = f"a gain, or one of the controllers {', '.join(controllers)}"
            self.check(single or self.gains is None, f"gains.{name}", expected, "a table")
        self.table["gains"] = gains
        return axes, fixed

    def read_changes(self, models: Mapping[str, SoftModel]) -> Iterator[tuple[str, dict[str, Any]]]:
        """Each change by its name; a list of values makes one change per value."""
        names = {NOMINAL}
        for text, table in self.section("changes", None).items():
            key, fields, lists = f"changes.{text}", dict[str, Any](), list[Axis]()
            self.check(isinstance(table, dict) and table, key, "a table of parameters", table)
            self.known(key, table, ("gains", *values.GROUPS, "ellipse_scale"))
            for name, value, check in self.flat(table, f"{key}."):
                at = f"{key}.{name}"
                differs = isinstance(value, dict) and "default" in value  # between robots
                each = value if differs else {"default": value}
                read = {robot: self.axis(at, name, x, check) for robot, x in each.items()}
                if (joint := place(name)[2]) not in ("", EACH):
                    self.check_joint(at, joint, models)
                lists += [axis for axis in read.values() if axis.varies]
                fits = not any(axis.drawn for axis in read.values()) and not (differs and lists)
                self.check(fits and len(lists) < 2, at, "one value, or one list per change", value)
                fields[name] = {robot: axis.values[0] for robot, axis in read.items()}
            for value in lists[0].values if lists else [None]:
                title = text if value is None else text.replace("{}", f"{value:g}")
                known = title in names or "/" in title or not title
                self.check(not known, key, "a unique name, with {} for a list and without /", title)
                names.add(title)
                yield title, fields | {axis.name: {"default": value} for axis in lists}

    def read_rows(self, axes: list[Axis], changes: Mapping[str, Any]) -> tuple[str, ...]:
        known = ("robot", "controller", "change", "sample", "plant.period", "gains.horizon",
                 *(axis.name for axis in axes))  # fmt: skip
        rows = self.names("rows", known)
        self.check(
            rows or len(changes) == 1, "rows", "parameters that distinguish the changes", "nothing"
        )
        if rows and "period" in self.said and "plant.period" not in rows:
            rows.insert(rows.index("change") if "change" in rows else len(rows), "plant.period")
        return tuple(rows)

    def read_beyond(self) -> float:
        if BEYOND not in self.table:
            return math.inf
        self.check("rows" in self.table, BEYOND, "a file with rows", "none")
        (found,) = self.axis(BEYOND, BEYOND, [self.table[BEYOND]], values.positive).values
        return float(found)

    def read_figure(self, targets: list[Axis], axes: list[Axis]) -> str:
        tracks = [axis.name == "omega" for axis in targets]
        figure = self.table.get("figure", "mse_cm2" if any(tracks) else "final_error_cm")
        known = isinstance(figure, str) and figure in FIGURES
        self.check(known, "figure", f"one of {', '.join(FIGURES)}", figure)
        whole = all(tracks) and all(axis.name != "plant.duration" for axis in axes)
        expected = "final_error_cm or mse_cm2 unless every case tracks two whole cycles"
        self.check(figure != "second_cycle_mse_cm2" or whole, "figure", expected, figure)
        return str(figure)

    # -- checks of the whole file -----------------------------------------------------------------

    def check_gains(
        self, controllers: Sequence[str], models: dict[str, SoftModel], axes: list[Axis],
        own: Mapping[str, Mapping[str, Any]],
    ) -> None:  # fmt: skip
        for robot, controller in product(models, controllers):
            given = "Kp" in {**self.said.get("gains", {}), **own[controller]}
            given |= any(a.name == "gains.Kp" and a.controller in (None, controller) for a in axes)
            published = controller in PUBLISHED.get(models[robot].bundled or "", {})
            expected = f"a value for {robot}, which has no published gains"
            has = given or published or controller not in CONTROLLERS
            self.check(has, "gains.Kp", expected, "none")
            if controller in CONTROLLERS:  # finds gains that the controller does not accept
                said = {**self.said.get("gains", {}), **self.said_own.get(controller, {})}
                options = CONTROLLERS[controller].options
                gains = {k: v for k, v in said.items() if k not in options}
                from_table(models[robot], controller, {"Kp": 1.0, **gains}, options)

    def try_controllers(self, sweep: Sweep) -> None:
        """Build each controller with its gains: its errors appear before anything runs.

        Of a grid, each value of each gain is tried once.
        """
        first: dict[tuple[str, str], Any] = {}
        tried: set[str] = set()
        for case in sweep.cases:
            table = case.parameters
            begin = first.setdefault((case.robot, case.controller), table)
            others = sum(table[key] != (begin or {}).get(key) for key in table) if table else 0
            key = repr((case.robot, case.controller, table))
            if others > 1 or key in tried:
                continue
            tried.add(key)
            cls = sources.class_at(case.controller, self.folder)
            try:
                with redirect_stdout(sys.stderr):  # a user's class may print
                    make_controller(case.controller, sweep.models[case.robot], table, cls)
            except InputError as error:
                origin = "--gains" if "gains" in self.said else self.path
                where = f"{origin}: {case.controller} for {case.robot}: {error.name}"
                raise InputError(where, error.expected, error.got) from None

    def check_size(
        self, robots: Any, controllers: Any, targets: list[Axis], axes: Any, more: dict[str, int]
    ) -> None:
        sizes = {"robots": len(robots), "controllers": len(controllers)}
        sizes["targets"] = sum(1 if axis.drawn else len(axis.values) for axis in targets)
        names = [f"{a.controller or ''} {a.name}".strip() for a in axes]
        sizes |= {
            name: len(a.values) for name, a in zip(names, axes, strict=True)
            if a.varies and not a.drawn
        }  # fmt: skip
        sizes |= {name: size for name, size in more.items() if size > 1}
        sizes |= {} if self.count is None else {"samples": self.count}
        total = math.prod(sizes.values())
        parts = " × ".join(f"{size} {name}" for name, size in sizes.items())
        expected = f"at most {values.MAX_CASES} cases"
        self.check(total <= values.MAX_CASES, "", expected, f"{total} = {parts}")
