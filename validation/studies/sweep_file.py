"""The strict reader of a sweep file: every error names the file, the key, the expected value.

A parameter is a keyword of `RunOptions`, which refuses a bad value, or a gain.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from softdyn import InputError, SoftModel, UrdfError
from softdyn.checks import did_you_mean, number
from softdyn.controllers import CONTROLLERS, Gains
from softdyn.controllers.registry import LAWS, is_own, keys_of, make_controller
from softdyn.dynamics.forces import with_number
from softdyn.exceptions import errors_in
from softdyn.files import read_toml
from softdyn.toml_table import TomlTable
from softdyn.validation.loop.closed_loop import ClosedLoop
from softdyn.validation.loop.settings import RunOptions, declarations, make_forces
from softdyn.validation.loop.trajectories import Trajectory
from softdyn.validation.studies.axes import DRAWN, MAX_CASES, Axis, AxisReader, Check, flat, plain
from softdyn.validation.studies.engine import sources, worker
from softdyn.validation.studies.engine.case import FILES
from softdyn.validation.studies.experiments import within_reach
from softdyn.validation.studies.paper_table import MERITS, SPREADS, TARGET, labelled
from softdyn.validation.studies.sweep import (
    FIGURES,
    FORCE,
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

PARAMETERS = ("gains", *GROUPS, FORCE, "ellipse_scale")
KEYS = (
    "robots", "controllers", "annotations", "targets", "forces", "depends", *PARAMETERS, "linked",
    "shorter_periods", "changes", "samples", "logs", "figure", "rows", "columns", "figures",
    "spread", "labels", "means", "must_not_fail",
    "statics_beyond_cm",
)  # fmt: skip
TRIED = 100  # loops that are built at most before anything runs
POINTS = "[x, y, z] in m, or a list of such"
DEFAULT = "default"  # in a table by robots, any other robot
positive = partial(number, "value", above=0.0)


def shipped() -> dict[str, Path]:
    """The sweep files that come with softdyn, by name."""
    found = sorted((Path(__file__).parent / "sweeps").glob("*.toml"))
    return {path.stem: path for path in found}


def read_sweep(name: str | Path, instead: Mapping[str, Any] | None = None) -> Sweep:
    """Read and check a sweep file; its robots are loaded, its controllers built with their gains.

    Parameters
    ----------
    name : str or Path
        A file, or the name of a shipped sweep if no such file exists. Relative paths in a file are
        relative to it.
    instead : mapping, optional
        Values that replace the file's: lists of `robots`, `controllers` and `forces`, `period` (s),
        numbers of forces, `force`, by ``NAME.FIELD``, and for a single robot the file of its
        `annotations` and a table of `gains`. Paths in it are relative to the current folder; None
        keeps the file's value.

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
    return sweep_of(read_toml(path), path, folder, said)


def sweep_of(
    table: Mapping[str, Any], path: Path, folder: Path = Path(),
    said: Mapping[str, Any] | None = None,
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
    said : mapping, optional
        `instead` of `read_sweep`.

    Raises
    ------
    InputError
        One line with the file, the key, the expected and the given value.
    """
    reader = _Reader(dict(table), path, folder, dict(said or {}))
    sweep = reader.sweep()
    # these find errors that no single key shows
    _ = sweep.cases, sweep.cells
    reader.check_labels(sweep)
    reader.try_controllers(sweep)
    reader.try_options(sweep)
    return sweep


def read_axes(
    table: Mapping[str, Any], path: str, model: SoftModel
) -> tuple[AxisReader, list[Axis], dict[str, tuple[Axis, ...]], list[Axis]]:
    """The axes in tables of a file's form, for one robot.

    Parameters
    ----------
    table : mapping
        Tables of `PARAMETERS`, `changes`, `samples`, `targets`.
    path : str
        Their name, for messages.
    model : SoftModel
        The robot.

    Returns
    -------
    AxisReader
        Number and seed of the samples.
    list of Axis
        The axes of all cases.
    dict of str to tuple of Axis
        Each change by its name, and ``none``.
    list of Axis
        The targets.

    Raises
    ------
    InputError
        One line with the key, the expected and the given value.
    """
    reader, models = _Reader(dict(table), Path(path), Path(), {}), {model.name: model}
    reader.robots = (model.name,)
    axes = reader.axes_in(reader.top, models)
    axes = [one for axis in axes for one in reader.of_each_joint(axis, axes, models)]
    changes = {NOMINAL: ()} | dict(reader.read_changes(models))
    return reader.axis, axes, changes, reader.read_targets()[1] if "targets" in table else []


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
    if group == RUN and key in FILES and isinstance(value, str):
        return value  # `_Reader.try_options` reads the file
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


def text_of(expected: str, value: Any) -> str:
    """A text that is not empty: the name of a file, or of a class in one.

    Raises
    ------
    InputError
        For anything else.
    """
    if not isinstance(value, str) or not value or is_own(value) != (":" in expected):
        raise InputError("name", expected, repr(value))
    return value


def short(value: Any) -> str:
    """A value as a title and a message have it."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def _with_numbers(table: Mapping[str, Any], numbers: Mapping[str, Any]) -> dict[str, Any]:
    """The tables of forces by name, with numbers by ``NAME.FIELD`` in the place of theirs."""
    found = dict(table)
    for at, value in numbers.items():
        name, _, key = at.rpartition(".")
        own = found.get(name)
        found[name] = {**(own if isinstance(own, Mapping) else {}), key: value}
    return found


def idle(*_: Any) -> Any:
    """A controller in the loops that are only built."""


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
        self.axis = AxisReader(self.path, count, seed, self.read_links())
        self.gains: list[str] | None = None  # a user's controller may have any gains
        self.robots: tuple[str, ...] = ()
        self.controllers: tuple[str, ...] = ()
        self.forces: list[Any] = []

    def sweep(self) -> Sweep:
        """The sweep of the file."""
        top, count = self.top, self.axis.count
        models, forces = self.read_robots(), self.read_forces()
        if forces:
            models = {name: model.with_forces(*self.forces) for name, model in models.items()}
        self.robots = tuple(models)
        controllers = self.read_controllers()
        equilibria, targets = self.read_targets()
        depends = self.read_depends()
        periodic, trajectories = self.read_trajectories(targets, models)
        own_gains, axes = self.split(self.axes_in(top, models))
        axes = [one for axis in axes for one in self.of_each_joint(axis, axes, models)]
        periods = self.values("shorter_periods")
        changes = {NOMINAL: ()} | dict(self.read_changes(models))
        every = [*targets, *axes, *(axis for change in changes.values() for axis in change)]
        for name in self.axis.links:
            if name not in (known := dict.fromkeys(axis.name for axis in every[len(targets) :])):
                raise top.error("linked", f"any of {', '.join(known)}", did_you_mean(name, known))
        if count is not None and not any(axis.drawn for axis in every):
            raise top.error("samples", "a parameter with uniform or log_uniform", "none")
        sizes = {"changes": len(changes), "periods": 1 + len(periods)}
        self.check_size(models, controllers, targets, axes, sizes)
        rows, columns = self.read_rows(axes, changes)
        figures = top.names("figures", (), MERITS)
        if figures and not rows:
            raise top.error("figures", "a file with rows", "none")
        labels = top.table("labels")
        beyond = self.values("statics_beyond_cm")
        if beyond and not rows:
            raise top.error("statics_beyond_cm", "a file with rows", "none")
        return Sweep(
            Path(self.path), self.folder, tuple(models), controllers, tuple(targets), tuple(axes),
            count, self.axis.seed, top.flag("logs"), self.read_figure(targets, axes), models,
            self.overlays(), trajectories, periodic, forces, depends, equilibria, periods, changes,
            rows, columns, figures, top.choice("spread", {name: name for name in SPREADS}, "std"),
            {} if labels is None else {k: labels.text(k) for k in labels.values},
            top.flag("means"), beyond[0] if beyond else math.inf,
            top.names("must_not_fail", (), changes), self.said.get("gains", {}), own_gains,
        )  # fmt: skip

    def values(self, name: str) -> tuple[float, ...]:
        """The positive numbers of a key; none if it is missing."""
        value = self.top.rest(KEYS).get(name)
        return () if value is None else self.axis(name, name, value, positive).values

    def replaced(self, table: dict[str, Any]) -> TomlTable:
        """The table, with values of the caller in the place of the file's."""
        said, top = self.said, TomlTable(table, self.path)
        for key in {"robots", "controllers", "forces"} & set(said):
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
        if said.get("force"):
            every = top.table(FORCE)
            table[FORCE] = _with_numbers({} if every is None else every.values, said["force"])
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
        self.controllers = found
        if not any(is_own(name) for name in found):
            self.gains = [*dict.fromkeys(key for name in found for key in keys_of(name))]
            options = [CONTROLLERS[name].options for name in found if name in CONTROLLERS]
            if len(options) == len(found) and all("horizon" in names for names in options):
                self.gains.append(SHARE)
        return found

    def read_targets(self) -> tuple[bool, list[Axis]]:
        """Whether other robots than the paper's go to equilibria, and an axis per kind."""
        table = self.top.needed("targets")
        equilibria = table.flag("equilibria")
        checks: dict[str, Check] = {
            "theta": partial(number, "theta"), "omega": positive, "point": point,
            "file": partial(text_of, "a CSV file"), "class": partial(text_of, "FILE.py:CLASS"),
        }  # fmt: skip
        table.flag("periodic")  # `read_trajectories` reads it
        axes = []
        for kind, value in table.rest(TARGETS).items():
            if kind == "point" and not isinstance(value, dict):
                if not isinstance(value, list) or not value:
                    raise table.error(kind, POINTS, value)
                value = value if any(isinstance(v, list) for v in value) else [value]
            axes.append(self.axis(f"targets.{kind}", kind, value, checks[kind]))
        if not axes:
            raise InputError(table.where, f"at least one of {', '.join(TARGETS)}", "none")
        if equilibria and any(a.name not in ("theta", "omega") or a.drawn for a in axes):
            raise table.error("equilibria", "only values of theta and omega", "others")
        return equilibria, sorted(axes, key=lambda axis: list(TARGETS).index(axis.name))

    def read_trajectories(
        self, targets: list[Axis], models: Mapping[str, SoftModel]
    ) -> tuple[bool, dict[tuple[str, str], Trajectory]]:
        """Whether files repeat, and the trajectory of each robot and each file or class."""
        table = self.top.needed("targets")
        periodic, found = table.flag("periodic"), dict[tuple[str, str], Trajectory]()
        named = {axis.name: axis.values for axis in targets if axis.name in ("file", "class")}
        if periodic and "file" not in named:
            raise table.error("periodic", "a file of a trajectory", "none")
        for (name, texts), (robot, model) in product(named.items(), models.items()):
            for text in texts:
                with errors_in(f"{self.path}: targets.{name}"), redirect_stdout(sys.stderr):
                    repeats = periodic and name == "file"
                    source = self.folder / text
                    found[robot, text] = within_reach(model, source, periodic=repeats)
        return periodic, found

    def read_forces(self) -> tuple[str, ...]:
        """The classes of forces of one's own; the objects are then `self.forces`."""
        found = self.top.names("forces", ())
        for name in found:
            if not is_own(name):
                raise self.top.error("forces", "FILE.py:CLASS", repr(name))
        with errors_in(f"{self.path}: forces"), redirect_stdout(sys.stderr):
            self.forces = make_forces(found, {}, partial(sources.class_at, folder=self.folder))
        return found

    def read_depends(self) -> tuple[str, ...]:
        """The files that classes of one's own read."""
        found = self.top.names("depends", ())
        for name in found:
            if not (self.folder / name).is_file():
                raise self.top.error("depends", "files that exist", repr(name))
        return found

    # -- what varies -------------------------------------------------------------------------------

    def read_links(self) -> dict[str, str]:
        """Name of a parameter whose list goes together with others → the first name of its set."""
        given = self.top.rest(KEYS).get("linked")
        if given is None:
            return {}
        alone = isinstance(given, list) and all(isinstance(name, str) for name in given)
        sets = [given] if alone else given
        fits = isinstance(sets, list) and all(
            isinstance(one, list) and len(one) > 1 and all(isinstance(name, str) for name in one)
            for one in sets
        )
        names = [name for one in sets for name in one] if fits else []
        if not fits or len(set(names)) < len(names):
            expected = "two names of parameters or more, each once, or a list of such lists"
            raise self.top.error("linked", expected, repr(given))
        return {name: one[0] for one in sets for name in one}

    def check_links(self, axes: list[Axis], at: str) -> None:
        """Refuse linked lists of different lengths, and a list without those of its set."""
        lists = [axis for axis in axes if axis.link is not None and axis.varies]
        for robot, axis in product(self.robots, lists):
            of_set = [one for one in axes if one.link == axis.link and one.robot in (None, robot)]
            names = [name for name, first in self.axis.links.items() if first == axis.link]
            lacking = {*names} - {one.name for one in of_set}
            if lacking or any(one.drawn for one in of_set):
                got = f"none of {min(lacking)}" if lacking else "a random value"
                raise InputError(f"{self.path}: linked: {at}{axis.name}", "a list of each", got)
            if len({len(one.values) for one in of_set}) > 1:
                got = ", ".join(f"{len(one.values)} of {at}{one.name}" for one in of_set)
                raise self.top.error("linked", "lists of the same length", got)

    def axes_in(
        self, table: TomlTable, models: Mapping[str, SoftModel], at: str = ""
    ) -> list[Axis]:
        """The axes of the parameters in a table, which stands at `at`: of the file, or of a change.

        Gains of single controllers come last, so that they override those of all. A table in such a
        table, as the stages of a schedule, is one value, unless it is a range or by robots.
        """
        found = []
        for name, value in self.parameters(table):
            found += self.by_robot(at + name, name, value, self.check(name))
            self.check_joint(name, models, at)
        gains = table.table("gains")
        for controller in self.controllers:
            own = None if gains is None else gains.table(controller)
            if own is None:
                continue
            known = own.values if is_own(controller) else own.rest(keys_of(controller))
            for key, value in known.items():
                name, where = f"gains.{key}", f"{at}gains.{controller}.{key}"
                check = partial(gain, key) if controller in CONTROLLERS else plain
                ranges = isinstance(value, dict) and {"from", *DRAWN} & set(value)
                whole = isinstance(value, dict) and not ranges and not self.differs(value, at != "")
                axes = [Axis(name, (value,))] if whole else self.by_robot(where, name, value, check)
                found += [replace(axis, controller=controller) for axis in axes]
        self.check_links(found, at)
        return found

    def split(self, axes: list[Axis]) -> tuple[dict[str, dict[str, Any]], list[Axis]]:
        """The fixed gains of each controller, those of the caller too; and what is left of axes."""
        own: dict[str, dict[str, Any]] = {}
        for name in self.controllers:
            where = f"{self.path}: gains.{name}"
            said = dict(TomlTable(self.said_own.get(name, {}), where).values)
            mine = {axis.name.partition(".")[2]: axis.values[0] for axis in axes
                    if axis.controller == name and isinstance(axis.values[0], dict)}  # fmt: skip
            own[name] = mine | said
        return own, [
            axis for axis in axes
            if axis.name.partition(".")[2] not in own.get(axis.controller or "", {})
        ]  # fmt: skip

    def parameters(self, table: TomlTable) -> Iterator[tuple[str, Any]]:
        """Name and values of each parameter in a table, but not of gains of one controller."""
        for group in ("gains", *GROUPS, FORCE):
            below = table.table(group)
            if below is None:
                continue
            if group == RUN:
                keys = [key for key in declarations() if key not in ("name", *GROUPS)]
                below.rest([*keys, "plant"])
                if "plant" in below.values and "plant" in table.values:
                    raise below.error("plant", "a file here, or a table [plant]", "both")
            if group == "gains":
                of_all = {k: v for k, v in below.values.items() if k not in self.controllers}
                below = TomlTable(of_all, below.where)
                self.check_gains(below)
            for path, value in flat(below, self.robots):
                yield ".".join((group, *path)), value
        if "ellipse_scale" in table.values:
            yield "ellipse_scale", table.values["ellipse_scale"]

    def check_gains(self, table: TomlTable) -> None:
        """Refuse a table of a controller that the file does not run, and a gain that none has."""
        for key in table.values:
            if is_own(key) or key in LAWS:
                expected = f"one of {', '.join(self.controllers)}"
                raise table.error(key, expected, did_you_mean(key, self.controllers))
        if self.gains is not None:
            table.rest([*self.gains, *self.controllers])

    def check(self, name: str) -> Check:
        """The check of a parameter's value, by its name."""
        group, key, _ = place(name)
        if group == "gains":
            return partial(gain, key)
        if group == FORCE:
            return partial(self.force_number, key)
        return partial(option, name) if group else positive

    def force_number(self, key: str, value: Any) -> float:
        """The value of a number of a force, by ``NAME.FIELD``."""
        with_number(self.forces, key, value)
        return float(value)

    def differs(self, value: Any, change: bool) -> bool:
        """Whether a value is a table with a value for each robot; in a change also for others."""
        if not value or not isinstance(value, Mapping):
            return False
        return {*value} <= {*self.robots, DEFAULT} or (change and DEFAULT in value)

    def by_robot(self, key: str, name: str, value: Any, check: Check) -> list[Axis]:
        """The axis at `key`; of a table with names of robots, one for each robot."""
        change = key.startswith("changes.")  # the draws of one are the same for each robot
        if not self.differs(value, change):
            return [self.axis(key, name, value, check)]
        for one in value.values() if change else ():
            axis = self.axis(key, name, one, check)
            if axis.varies and not axis.drawn:
                raise self.not_one_list(key, axis)
        lacking = [robot for robot in self.robots if robot not in value]
        if lacking and DEFAULT not in value:
            expected = f"a value of {lacking[0]}, or {DEFAULT}"
            raise InputError(f"{self.path}: {key}", expected, f"those of {', '.join(value)}")
        found = {robot: value.get(robot, value.get(DEFAULT)) for robot in self.robots}
        return [
            replace(self.axis(key if change else f"{key}.{robot}", name, one, check), robot=robot)
            for robot, one in found.items()
        ]

    def not_one_list(self, key: str, axis: Axis) -> InputError:
        """The error of a change with a list too many, or with a list that holds for one robot."""
        got = axis.drawn or f"[{', '.join(short(value) for value in axis.values)}]"
        return InputError(f"{self.path}: {key}", "one value, or one list per change", got)

    def of_each_joint(
        self, axis: Axis, axes: list[Axis], models: Mapping[str, SoftModel]
    ) -> Iterator[Axis]:
        """An axis; instead of a random one of each joint, one for every joint without its own."""
        group, key, path = place(axis.name)
        if path != (EACH,):
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

    def read_changes(
        self, models: Mapping[str, SoftModel]
    ) -> Iterator[tuple[str, tuple[Axis, ...]]]:
        """Each change by its name; a list of values makes one change per value.

        Linked lists make one change per set of values. ``{}`` in the name stands for the value of
        the first list, or for the only value.
        """
        names, every = {NOMINAL}, self.top.table("changes")
        for text in every.values if every is not None else ():
            assert every is not None
            key, table = f"changes.{text}", every.needed(text)
            table.rest(PARAMETERS)
            axes = self.axes_in(table, models, f"{key}.")
            lists = [axis for axis in axes if axis.varies and not axis.drawn]
            odd = [axis for axis in axes if axis.drawn and place(axis.name)[2] == (EACH,)]
            apart = [axis for axis in lists[1:] if axis.link is None or axis.link != lists[0].link]
            for axis in [*odd, *apart]:
                raise self.not_one_list(f"{key}.{axis.name}", axis)
            if not axes:
                raise every.error(text, "a table of parameters", "an empty one")
            alone = lists[:1] or (axes if len(axes) == 1 and not axes[0].drawn else [])
            if "{}" in text and not alone:
                raise every.error(text, "one value or one list, for which {} stands", "others")
            for k in range(len(lists[0].values) if lists else 1):
                title = text.replace("{}", short(alone[0].values[k])) if alone else text
                if title in names or "/" in title or not title:
                    expected = "a unique name, with {} for a list and without /"
                    raise every.error(text, expected, title)
                names.add(title)
                yield (
                    title,
                    tuple(
                        replace(axis, values=(axis.values[k],)) if axis in lists else axis
                        for axis in axes
                    ),
                )

    def read_rows(
        self, axes: list[Axis], changes: Mapping[str, Any]
    ) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The parameters of the rows and the columns of a table of all cases."""
        known = ("robot", "controller", "change", "sample", "run.period", "gains.horizon",
                 *(axis.name for axis in axes))  # fmt: skip
        columns = self.top.names("columns", (TARGET,), (TARGET, *known))
        rows = [*self.top.names("rows", (), known)]
        if not rows and len(changes) > 1:
            raise self.top.error("rows", "parameters that distinguish the changes", "nothing")
        if rows and "period" in self.said and "run.period" not in rows:
            rows.insert(rows.index("change") if "change" in rows else len(rows), "run.period")
        return tuple(rows), columns

    def read_figure(self, targets: list[Axis], axes: list[Axis]) -> str:
        tracks = [axis.name == "omega" for axis in targets]
        usual = "mse_cm2" if any(tracks) else "final_error_cm"
        figure = str(self.top.choice("figure", {name: name for name in FIGURES}, usual))
        whole = all(tracks) and all(axis.name != "run.duration" for axis in axes)
        if figure == "second_cycle_mse_cm2" and not whole:
            expected = "final_error_cm or mse_cm2 unless every case tracks two whole cycles"
            raise self.top.error("figure", expected, figure)
        return figure

    def check_labels(self, sweep: Sweep) -> None:
        """Refuse a label of something that is in no table."""
        known = labelled(sweep) if sweep.labels else []
        for name in sweep.labels:
            if name not in known:
                expected = f"one of {', '.join(known)}"
                where = f"{self.path}: [labels]: {name}"
                raise InputError(where, expected, did_you_mean(name, known))

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
                raise error.about(where) from None

    def try_options(self, sweep: Sweep) -> None:
        """Build a loop with each start, scene, obstacles and observer: as a run would refuse them.

        Each combination is tried once with each robot, at most `TRIED` of them.
        """
        tried: set[str] = set()
        for case in sweep.cases:
            given = {k: case.options[k] for k in ("q0", "v0", *FILES) if k in case.options}
            some = {k: v for k, v in given.items() if not isinstance(v, Mapping)}
            key = repr((case.robot, some))
            if not some or key in tried or len(tried) == TRIED:
                continue
            tried.add(key)
            model, options = sweep.models[case.robot], dict(case.options)
            with errors_in(f"{self.path}: run"), redirect_stdout(sys.stderr):
                for name, text in worker.files_of(case):
                    where = f"{self.path}: run.{name}"
                    with errors_in(where), self.one_line(where):
                        source = sources.of_option(name, text, self.folder, sweep.depends)
                        options[name] = sources.option_of(source, name, model, {})
                path = sweep.trajectories.get((case.robot, str(case.value)))
                ClosedLoop(model, idle, case.experiment(model, path), RunOptions.of(options))

    @contextmanager
    def one_line(self, where: str) -> Iterator[None]:
        """Turn an error of a file that an option names into one of this file."""
        try:
            yield
        except UrdfError as error:
            raise InputError(where, error.expected, f"{error.got} in {error.element}") from None
        except OSError as error:
            got = f"{error.filename}: {error.strerror}"
            raise InputError(where, "a readable file", got) from None

    def check_size(
        self, robots: Any, controllers: Any, targets: list[Axis], axes: Any, more: dict[str, int]
    ) -> None:
        sizes = {"robots": len(robots), "controllers": len(controllers)}
        sizes["targets"] = sum(1 if axis.drawn else len(axis.values) for axis in targets)
        names = [f"{a.controller or ''} {a.name}".strip() for a in axes]
        sizes |= {
            name: len(a.values) for name, a in zip(names, axes, strict=True)
            if a.varies and not a.drawn and a.link in (None, a.name)
        }  # fmt: skip
        sizes |= {name: size for name, size in more.items() if size > 1}
        sizes |= {} if self.axis.count is None else {"samples": self.axis.count}
        total = math.prod(sizes.values())
        parts = " × ".join(f"{size} {name}" for name, size in sizes.items())
        if total > MAX_CASES:
            raise InputError(self.path, f"at most {MAX_CASES} cases", f"{total} = {parts}")
