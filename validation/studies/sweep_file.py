"""The strict reader of a sweep file: every error names the file, the key, the expected value.

A parameter is a keyword of `RunOptions`, which refuses a bad value, or a gain.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import redirect_stdout
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from softdyn import InputError, SoftModel, UrdfError
from softdyn.checks import did_you_mean, number
from softdyn.controllers import CONTROLLERS, Gains
from softdyn.controllers.registry import is_own, make_controller
from softdyn.files import read_toml
from softdyn.toml_table import TomlTable
from softdyn.validation.loop.arguments import RunOptions
from softdyn.validation.studies.axes import DRAWN, MAX_CASES, Axis, AxisReader, Check, flat, plain
from softdyn.validation.studies.engine import sources
from softdyn.validation.studies.sweep import (
    FIGURES,
    GAINS,
    GROUPS,
    NOMINAL,
    RUN,
    SENSORS,
    SHARE,
    TARGETS,
    Sweep,
    nested,
    place,
)
from softdyn.validation.twin.plant_errors import BY_JOINT, EACH

PARAMETERS = ("gains", *GROUPS, "ellipse_scale")
KEYS = (
    "robots", "controllers", "annotations", "targets", *PARAMETERS, "shorter_periods", "changes",
    "samples", "logs", "figure", "rows", "means", "must_not_fail", "statics_beyond_cm",
)  # fmt: skip
POINTS = "[x, y, z] in m, or a list of such"
positive = partial(number, "value", above=0.0)


def shipped() -> dict[str, Path]:
    """The sweep files that come with softdyn, by name."""
    found = sorted((Path(__file__).parent / "sweeps").glob("*.toml"))
    return {path.stem: path for path in found}


def read_sweep(
    name: str | Path, instead: Mapping[str, Any] | None = None, build: bool = True
) -> Sweep:
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
    build : bool
        Whether each controller is built with its gains, so that its errors appear at once.

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
    return sweep_of(read_toml(path), path, folder, said, build)


def sweep_of(
    table: Mapping[str, Any], path: Path, folder: Path = Path(),
    said: Mapping[str, Any] | None = None, build: bool = True,
) -> Sweep:  # fmt: skip
    """The sweep in a table of the form of a file; see `read_sweep`.

    Parameters
    ----------
    table : mapping
        The content of a file.
    path : Path
        Its name, for messages.
    folder : Path
        Relative paths in it are relative to this folder.
    said, build
        `instead` and `build` of `read_sweep`.

    Raises
    ------
    InputError
        One line with the file, the key, the expected and the given value.
    """
    reader = _Reader(dict(table), path, folder, dict(said or {}))
    sweep = reader.sweep()
    _ = sweep.cases, sweep.rows and sweep.cells  # finds errors that no single key shows
    if build:
        reader.try_controllers(sweep)
    return sweep


def option(name: str, value: Any) -> Any:
    """The value of a keyword of `RunOptions`, by its name in a sweep.

    Raises
    ------
    InputError
        The object refuses it.
    """
    group, key, path = place(name)
    if key == SENSORS and len(path) < 2:
        raise InputError("sensors", "a table for each sensor", value)
    value = tuple(value) if isinstance(value, list) else value
    table = nested(key, path, value)
    RunOptions.of(table if group == RUN else {group: table})
    return value if name == "rig.seed" else plain(value)


def gain(key: str, value: Any) -> Any:
    """The value of a gain, or of an option of a controller.

    Raises
    ------
    InputError
        A value that no controller of the paper can have for this gain.
    """
    if key in GAINS:
        Gains(**{"Kp": 1.0, key: value})
    return number(key, value, lower=0.0) if key == SHARE else plain(value)


def point(value: Any) -> tuple[float, ...]:
    """Three finite numbers.

    Raises
    ------
    InputError
        For anything else.
    """
    if not isinstance(value, list) or len(value) != 3:
        raise InputError("point", POINTS, repr(value))
    return tuple(number("point", x) for x in value)


class _Reader:
    """The reader of one file."""

    def __init__(
        self, table: dict[str, Any], path: Path, folder: Path, said: dict[str, Any]
    ) -> None:
        self.path, self.folder, self.said = str(path), folder, said
        TomlTable(table, self.path).rest(KEYS)
        self.said_own: dict[str, Any] = {}
        self.top = self.replaced(table)
        samples = self.top.table("samples")
        count, seed = None, 0
        if samples is not None:
            count = samples.count("count", most=MAX_CASES)
            seed = samples.count("seed", 0, least=0, most=2**63 - 1)
            samples.rest()
        self.axis = AxisReader(self.path, count, seed)
        self.gains: list[str] | None = None  # a user's controller may have any gains

    def sweep(self) -> Sweep:
        """The sweep of the file."""
        top, count = self.top, self.axis.count
        models = self.read_robots()
        controllers = self.read_controllers()
        equilibria, targets = self.read_targets()
        own_axes, own_gains = self.read_own_gains(controllers)
        axes = [self.axis(n, n, x, self.check(n)) for n, x in self.parameters(top, own_gains)]
        axes = [one for axis in axes for one in self.of_each_joint(axis, axes, models)] + own_axes
        periods = self.values("shorter_periods")
        changes = {NOMINAL: dict[str, dict[str, Axis]]()} | dict(self.read_changes(models))
        changed = [
            axis for change in changes.values() for of in change.values() for axis in of.values()
        ]
        if count is not None and not any(axis.drawn for axis in (*targets, *axes, *changed)):
            raise top.error("samples", "a parameter with uniform or log_uniform", "none")
        sizes = {"changes": len(changes), "periods": 1 + len(periods)}
        self.check_size(models, controllers, targets, axes, sizes)
        rows = self.read_rows(axes, changes)
        beyond = self.values("statics_beyond_cm")
        if beyond and not rows:
            raise top.error("statics_beyond_cm", "a file with rows", "none")
        return Sweep(
            Path(self.path), self.folder, tuple(models), controllers, tuple(targets), tuple(axes),
            count, self.axis.seed, top.flag("logs"), self.read_figure(targets, axes), models,
            self.overlays(), equilibria, periods, changes, rows, top.flag("means"),
            beyond[0] if beyond else math.inf, top.names("must_not_fail", (), changes),
            self.said.get("gains", {}), own_gains,
        )  # fmt: skip

    def values(self, name: str) -> tuple[float, ...]:
        """The positive numbers of a key; none if it is missing."""
        value = self.top.rest(KEYS).get(name)
        return () if value is None else self.axis(name, name, value, positive).values

    def replaced(self, table: dict[str, Any]) -> TomlTable:
        """The table, with values of the caller in the place of the file's."""
        said, top = self.said, TomlTable(table, self.path)
        for key in {"robots", "controllers"} & set(said):
            table[key] = [self.beside(name) for name in said[key]]
        if "robots" in said:
            table.pop("annotations", None)
        if {"annotations", "gains"} & set(said):
            robots = top.names("robots")
            if len(robots) > 1:
                expected = "one robot for annotations or gains"
                raise top.error("robots", expected, f"{len(robots)} robots")
        if "annotations" in said:
            table["annotations"] = {robots[0]: self.beside(said["annotations"])}
        if "gains" in said:  # tables of single controllers come first, by their names here
            named = {self.beside(key): value for key, value in said["gains"].items()}
            self.said_own = {n: named.pop(n) for n in top.names("controllers") if n in named}
            self.said = {**said, "gains": named}
            gains = top.table("gains")
            if gains is not None:
                table["gains"] = {k: v for k, v in gains.values.items() if k not in named}
        if "period" in said:
            run = top.table(RUN)
            table[RUN] = {**(run.values if run is not None else {}), "period": said["period"]}
        return TomlTable(table, self.path)

    def beside(self, name: str) -> str:
        """A path in the current folder, made relative to the file's; other names unchanged."""
        file = name.rpartition(":")[0] if is_own(name) else name
        return os.path.relpath(name, self.folder) if os.path.isfile(file) else file and name

    # -- what runs ---------------------------------------------------------------------------------

    def read_robots(self) -> dict[str, SoftModel]:
        models = {}
        overlays = self.overlays()
        for text in self.top.names("robots"):
            try:
                _, model = sources.of_robot(text, self.folder, overlays.get(text))
            except (InputError, UrdfError) as error:
                # a defect in a robot's file: name the element, too
                where = f" in {text}: {error.element}" if isinstance(error, UrdfError) else ""
                raise self.top.error("robots", error.expected, error.got + where) from None
            if model.nu == 0:
                raise self.top.error("robots", "robots with actuators", f"{text!r} without any")
            models[text] = model
        return models

    def overlays(self) -> dict[str, str]:
        """Robot → the file of its annotations, if that is a separate file."""
        table, robots = self.top.table("annotations"), self.top.names("robots")
        if table is None:
            return {}
        found = {name: table.text(name) for name in robots if name in table.values}
        table.rest(robots)
        return found

    def read_controllers(self) -> tuple[str, ...]:
        found = self.top.names("controllers")
        for text in found:
            try:
                sources.of_controller(text, self.folder)
            except InputError as error:
                raise self.top.error("controllers", error.expected, error.got) from None
        ours = [CONTROLLERS[name] for name in found if name in CONTROLLERS]
        if ours:
            self.gains = [*GAINS, *dict.fromkeys(n for one in ours for n in one.options)]
            if len(ours) == len(found) and all("horizon" in one.options for one in ours):
                self.gains.append(SHARE)
        return found

    def read_targets(self) -> tuple[bool, list[Axis]]:
        """Whether other robots than the paper's go to equilibria, and an axis per kind."""
        table = self.top.needed("targets")
        equilibria = table.flag("equilibria")
        checks: dict[str, Check] = {
            "theta": partial(number, "theta"), "omega": positive, "point": point
        }  # fmt: skip
        axes = []
        for kind, value in table.rest(TARGETS).items():
            if kind == "point" and not isinstance(value, dict):
                if not isinstance(value, list) or not value:
                    raise table.error(kind, POINTS, value)
                value = value if any(isinstance(v, list) for v in value) else [value]
            axes.append(self.axis(f"targets.{kind}", kind, value, checks[kind]))
        if not axes:
            raise InputError(table.where, f"at least one of {', '.join(TARGETS)}", "none")
        if equilibria and any(a.name == "point" or a.drawn for a in axes):
            raise table.error("equilibria", "only values of theta and omega", "others")
        return equilibria, sorted(axes, key=lambda axis: list(TARGETS).index(axis.name))

    # -- what varies -------------------------------------------------------------------------------

    def parameters(
        self, table: TomlTable, without: Mapping[str, Any] | None = None
    ) -> Iterator[tuple[str, Any]]:
        """Name and values of each parameter in a table, but not of gains of one controller."""
        for group in ("gains", *GROUPS):
            below = table.table(group)
            if below is None:
                continue
            if group == "gains":
                below = TomlTable({k: v for k, v in below.values.items() if k not in (
                    without or {})}, below.where)  # fmt: skip
                if self.gains is not None:
                    below = TomlTable(below.rest(self.gains), below.where)
            for path, value in flat(below):
                yield ".".join((group, *path)), value
        if "ellipse_scale" in table.values:
            yield "ellipse_scale", table.values["ellipse_scale"]

    def check(self, name: str) -> Check:
        """The check of a parameter's value, by its name."""
        group, key, _ = place(name)
        if group == "gains":
            return partial(gain, key)
        return partial(option, name) if group else positive

    def of_each_joint(
        self, axis: Axis, axes: list[Axis], models: Mapping[str, SoftModel]
    ) -> Iterator[Axis]:
        """An axis; instead of a random one of each joint, one for every joint without its own."""
        group, key, path = place(axis.name)
        if path != (EACH,):
            self.check_joint(axis.name, models)
            yield axis
        elif not axis.drawn:
            if axis.varies:
                where = f"{self.path}: {axis.name}"
                raise InputError(where, "one value, or a random one", axis.values)
            yield axis
        else:
            named = {place(one.name)[2] for one in axes if place(one.name)[:2] == (group, key)}
            value = self.top.values[group][key][EACH]
            for robot, model in models.items():
                for other in model.robot.moving_joints:
                    if (other.name,) not in named:
                        name = f"{group}.{key}.{other.name}"
                        yield replace(self.axis(name, name, value, self.check(name)), robot=robot)

    def check_joint(self, name: str, models: Mapping[str, SoftModel], at: str = "") -> None:
        """Refuse a factor of a joint that not every robot has."""
        _, key, path = place(name)
        if path in ((), (EACH,)) or key not in BY_JOINT:
            return
        (joint,) = path
        for robot, model in models.items():
            known = [one.name for one in model.robot.moving_joints]
            if joint not in known:
                expected = f"a joint of {robot}, or {EACH}"
                raise InputError(f"{self.path}: {at}{name}", expected, did_you_mean(joint, known))

    def read_own_gains(
        self, controllers: tuple[str, ...]
    ) -> tuple[list[Axis], dict[str, dict[str, Any]]]:
        """The gains of single controllers in [gains]: varying ones, and fixed ones.

        A table in such a table, as the stages of a schedule, is fixed.
        """
        axes, fixed = list[Axis](), dict[str, dict[str, Any]]()
        gains, spread = self.top.table("gains"), {"from", *DRAWN}
        for name in controllers:
            table = None if gains is None else gains.table(name)
            values = {} if table is None else table.values
            if table is not None and name in CONTROLLERS:
                values = table.rest([*GAINS, *CONTROLLERS[name].options])
            said = dict(TomlTable(self.said_own.get(name, {}), f"{self.path}: gains.{name}").values)
            fixed[name] = {}
            for key, value in values.items():
                if key not in said and (not isinstance(value, dict) or spread & set(value)):
                    check = partial(gain, key) if name in CONTROLLERS else plain
                    axis = self.axis(f"gains.{name}.{key}", f"gains.{key}", value, check)
                    axes.append(replace(axis, controller=name))
                else:
                    fixed[name][key] = value
            fixed[name] |= said
        return axes, fixed

    def read_changes(
        self, models: Mapping[str, SoftModel]
    ) -> Iterator[tuple[str, dict[str, dict[str, Axis]]]]:
        """Each change by its name; a list of values makes one change per value."""
        names, every = {NOMINAL}, self.top.table("changes")
        for text in every.values if every is not None else ():
            assert every is not None
            key, table = f"changes.{text}", every.table(text)
            fields, lists = dict[str, dict[str, Axis]](), list[Axis]()
            assert table is not None
            table.rest(PARAMETERS)
            for name, value in self.parameters(table):
                at = f"{key}.{name}"
                differs = isinstance(value, dict) and "default" in value  # between robots
                each = value if differs else {"default": value}
                check = self.check(name)
                read = {robot: self.axis(at, name, x, check) for robot, x in each.items()}
                self.check_joint(name, models, f"{key}.")
                lists += [axis for axis in read.values() if axis.varies and not axis.drawn]
                own = place(name)[2] == (EACH,) and any(axis.drawn for axis in read.values())
                if own or (differs and lists) or len(lists) > 1:
                    raise InputError(
                        f"{self.path}: {at}", "one value, or one list per change", value
                    )
                fields[name] = read
            if not fields:
                raise every.error(text, "a table of parameters", "an empty one")
            for value in lists[0].values if lists else [None]:
                short = f"{value:g}" if isinstance(value, float) else str(value)
                title = text if value is None else text.replace("{}", short)
                if title in names or "/" in title or not title:
                    expected = "a unique name, with {} for a list and without /"
                    raise every.error(text, expected, title)
                names.add(title)
                only = {a.name: {"default": replace(a, values=(value,))} for a in lists}
                yield title, fields | only

    def read_rows(self, axes: list[Axis], changes: Mapping[str, Any]) -> tuple[str, ...]:
        known = ("robot", "controller", "change", "sample", "run.period", "gains.horizon",
                 *(axis.name for axis in axes))  # fmt: skip
        rows = [*self.top.names("rows", (), known)]
        if not rows and len(changes) > 1:
            raise self.top.error("rows", "parameters that distinguish the changes", "nothing")
        if rows and "period" in self.said and "run.period" not in rows:
            rows.insert(rows.index("change") if "change" in rows else len(rows), "run.period")
        return tuple(rows)

    def read_figure(self, targets: list[Axis], axes: list[Axis]) -> str:
        tracks = [axis.name == "omega" for axis in targets]
        usual = "mse_cm2" if any(tracks) else "final_error_cm"
        figure = str(self.top.choice("figure", {name: name for name in FIGURES}, usual))
        whole = all(tracks) and all(axis.name != "run.duration" for axis in axes)
        if figure == "second_cycle_mse_cm2" and not whole:
            expected = "final_error_cm or mse_cm2 unless every case tracks two whole cycles"
            raise self.top.error("figure", expected, figure)
        return figure

    # -- checks of the whole file -----------------------------------------------------------------

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
        sizes |= {} if self.axis.count is None else {"samples": self.axis.count}
        total = math.prod(sizes.values())
        parts = " × ".join(f"{size} {name}" for name, size in sizes.items())
        if total > MAX_CASES:
            raise InputError(self.path, f"at most {MAX_CASES} cases", f"{total} = {parts}")
