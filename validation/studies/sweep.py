"""A sweep: the list of closed loops over a grid, over random samples or one change at a time.

Every case is complete plain data, and the order of the cases depends only on the sweep file.
`softdyn.validation.studies.sweep_file` reads that file; ``docs/sweeps_reference.md`` describes it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

from softdyn import InputError, SoftModel
from softdyn.controllers import BEYOND, CONTROLLERS, Gains
from softdyn.controllers.gains import from_table
from softdyn.controllers.qps.horizon import default_horizon
from softdyn.controllers.registry import LAWS, is_own, keys_of
from softdyn.exceptions import errors_in
from softdyn.validation.files import safe_filename
from softdyn.validation.loop import setups
from softdyn.validation.loop.labels import cell_title
from softdyn.validation.loop.trajectories import Trajectory
from softdyn.validation.studies.axes import Axis, combinations
from softdyn.validation.studies.engine import worker
from softdyn.validation.studies.engine.case import MOVING, NAMES, OWN, Case, legible
from softdyn.validation.studies.engine.store import Store
from softdyn.validation.studies.engine.worker import CaseJob
from softdyn.validation.studies.study_targets import Target, study_targets
from softdyn.validation.twin.plant_errors import BY_JOINT, EACH
from softdyn.validation.twin.rig import Rig

FIGURES = {
    "final_error_cm": "final error (cm)",
    "mse_cm2": "mean squared error (cm²)",
    "second_cycle_mse_cm2": "mean squared error, second cycle (cm²)",
}
GAINS = tuple(field.name for field in fields(Gains))
# name in a file → name in a case; a file is "periodic" if the sweep says so
TARGETS = {name: kind for kind, name in NAMES.items() if kind != "periodic"}
RUN = "run"  # the group of the keywords of `RunOptions`; those that are tables are groups too
GROUPS = (RUN, "plant", "rig")
FORCE = "force"  # the group of the numbers of forces of one's own, ``force.NAME.FIELD``
SENSORS = "sensors"  # the table of [rig] with a table for each sensor
NOMINAL = "none"  # the name of the case without a change
EMPTY = '""'  # an empty text, such as an observer without disturbances, in a table
SHARE = "horizon_per_eps"  # of [gains]
IN_MS = ("gains.horizon", "run.period", "rig.delay", "rig.lag", "rig.latency")


def place(name: str) -> tuple[str, str, tuple[str, ...]]:
    """The group of a parameter's name, empty without one, its key, and the path below the key.

    ``theta``, ``gains.Kp``, ``plant.stiffness.JOINT``, ``rig.sensors.SENSOR.noise``: the path has a
    joint, or a sensor and its field.
    """
    group, _, key = name.partition(".") if "." in name else ("", "", name)
    if group not in ("plant", "rig") or "." not in key:
        return group, key, ()
    key, _, below = key.partition(".")
    return group, key, tuple(below.rsplit(".", 1)) if key == SENSORS else (below,)


def nested(key: str, path: Sequence[str], value: Any) -> dict[str, Any]:
    """A table with a value at a key, or at a path below the key."""
    for name in reversed((key, *path)):
        value = {name: value}
    found: dict[str, Any] = value
    return found


def by_group(values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Values of parameters, by their names, as the tables of each group; ``""`` has the others."""
    groups: dict[str, dict[str, Any]] = {group: {} for group in ("gains", *GROUPS, FORCE, "")}
    for name, value in values.items():
        group, key, path = place(name)
        table = groups[group]
        if key == SENSORS:
            table = table.setdefault(key, {}).setdefault(path[0], {})
            key = path[1]
        elif path:
            others = table.get(key, 1.0)
            table[key] = table = others if isinstance(others, dict) else {EACH: others}
            (key,) = path
        table[key] = value
    return groups


def run_options(groups: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The keywords of `RunOptions`, as it takes them, from the tables of `by_group`."""
    options = dict(groups[RUN])
    if groups["plant"]:
        options["plant"] = groups["plant"]
    if groups["rig"] or "observer" in options:
        of_file = "observer" in options or SENSORS in groups["rig"]
        options["rig"] = {"file": of_file, **groups["rig"]}
    return options


def joint_parameters(cases: Iterable[Case]) -> tuple[str, ...]:
    """The names of the factors by joint in these cases."""
    found = (
        f"plant.{key}.{joint}"
        for case in cases for key in BY_JOINT
        if isinstance(plant := case.options.get("plant"), Mapping)
        and isinstance(factors := plant.get(key), Mapping)
        for joint in factors
    )  # fmt: skip
    return tuple(dict.fromkeys(found))


def parameter(case: Case, name: str) -> Any:
    """The value of ``gains.Kp``, ``run.period``, ``theta``, … in a case; None for its default."""
    group, key, path = place(name)
    gains = case.parameters or {}
    if group == "gains":
        return gains["horizon"] / gains["eps"] if key == SHARE else gains.get(key)
    if group == FORCE:
        return case.force.get(key)
    if group in GROUPS:
        table: Mapping[str, Any] = case.options if group == RUN else case.options.get(group, {})
        value = table.get(key)
        if key == SENSORS:
            return (value or {}).get(path[0], {}).get(path[1])
        if isinstance(value, Mapping):  # by joint
            return value.get(path[0] if path else EACH, value.get(EACH, 1.0))
        return value
    if name in TARGETS:
        return case.value if NAMES[case.kind] == name else None
    return getattr(case, name)


def store(folder: Path, timed: bool = False) -> Store:
    """The store of a sweep's results, with step times if it is `timed`."""
    return Store(folder, runs="cases", times="times" if timed else None)


@dataclass(frozen=True, eq=False)
class Sweep:
    """The content of a sweep file, checked.

    Attributes
    ----------
    path, folder : Path
        The file, and the folder to which its relative paths refer.
    robots, controllers : tuple of str
        Their names in the file.
    targets : tuple of Axis
        One axis per kind of target in the file.
    axes : tuple of Axis
        Gains, plant, rig and the ellipse, in the file's order.
    samples, seed : int
        Number of random samples (None without) and their seed.
    logs : bool
        Whether every run's log is kept.
    figure : str
        The figure that ranks the cases, one of `FIGURES`.
    models : dict of str to SoftModel
        The robots' analytic models, with the forces as their classes make them.
    annotations : dict of str to str
        Robot → the file of its annotations, if its own file has none.
    trajectories : mapping
        (robot, file or class) → the trajectory of one's own that is a target.
    periodic : bool
        Whether the trajectories of files repeat.
    forces : tuple of str
        The forces of one's own that act in every case, ``FILE.py:CLASS``.
    depends : tuple of str
        Files that classes of one's own read.
    equilibria : bool
        Whether a robot that is not in the paper moves to equilibria instead.
    shorter_periods : tuple of float
        Control periods (s) to which set points also run, if they are shorter than the usual one.
    changes : mapping
        Name → axes of one value or of random samples. Each change runs by itself.
    rows : tuple of str
        Parameters that distinguish the rows of a table of all cases. Without any, there is no such
        table.
    columns : tuple of str
        Parameters that distinguish the columns of a `PaperTable`.
    figures : tuple of str
        The figures of merit in the cells of a `PaperTable`, some of its `MERITS`; none without one.
    spread : str
        The statistic of its cells, one of its `SPREADS`.
    labels : mapping
        Text → shorter text, in that table and in the figures.
    means : bool
        Whether that table has the mean of each row.
    statics_beyond_cm : float
        Set points that end farther away than this (cm) get the distance of the nearest stable
        equilibrium, in a row of its own.
    must_not_fail : tuple of str
        Names of the changes whose runs from rest decide the exit code.
    gains : mapping
        Gains of every case; gains of the axes override them.
    own_gains : mapping
        Controller → gains of its cases; they override the gains of every case.
    """

    path: Path
    folder: Path
    robots: tuple[str, ...]
    controllers: tuple[str, ...]
    targets: tuple[Axis, ...]
    axes: tuple[Axis, ...]
    samples: int | None
    seed: int
    logs: bool
    figure: str
    models: dict[str, SoftModel]
    annotations: dict[str, str]
    trajectories: Mapping[tuple[str, str], Trajectory]
    periodic: bool
    forces: tuple[str, ...]
    depends: tuple[str, ...]
    equilibria: bool
    shorter_periods: tuple[float, ...]
    changes: Mapping[str, Sequence[Axis]]
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    figures: tuple[str, ...]
    spread: str
    labels: Mapping[str, str]
    means: bool
    statics_beyond_cm: float
    must_not_fail: tuple[str, ...]
    gains: Mapping[str, Any]
    own_gains: Mapping[str, Mapping[str, Any]]

    def jobs(self) -> list[CaseJob]:
        """Every case with its dependencies."""
        return worker.jobs_of(self.cases, folder=self.folder, depends=self.depends, log=self.logs)

    def varying(self) -> list[Axis]:
        """Parameters with more than one value, apart from random ones of each joint."""
        return [axis for axis in self.axes if axis.varies and axis.robot is None]

    @cached_property
    def unitless(self) -> frozenset[str]:
        """The names of gains that a class of one's own gets: nobody knows their units."""
        own = (case for case in self.cases if is_own(case.controller))
        return frozenset(f"gains.{key}" for case in own for key in case.parameters or {})

    @property
    def grouped(self) -> list[str]:
        """The parameters in which cases differ; ``target`` and ``change`` are among them."""
        sizes = {
            "robot": len(self.robots),
            "controller": len(self.controllers),
            "target": len({(case.kind, case.value) for case in self.cases}),
            "change": len(self.changes),
            "run.period": 1 + len(self.shorter_periods),
            **{axis.name: len(axis.values) for axis in self.varying()},
            "sample": self.samples or 1,
        }
        return [name for name, size in sizes.items() if size > 1]

    @property
    def parameters(self) -> list[str]:
        """The names of the parameters of the axes and the changes, without gains."""
        named = [axis.name for axis in self.axes]
        named += ["run.period"] if self.shorter_periods else []
        named += [axis.name for change in self.changes.values() for axis in change]
        named += joint_parameters(self.cases)
        return [name for name in dict.fromkeys(named) if not name.startswith("gains.")]

    @cached_property
    def cases(self) -> list[Case]:
        """Every case, the last of the file's parameters varying fastest.

        Raises
        ------
        InputError
            A combination cannot run, e.g. the timestep does not divide the period.
        """
        names: dict[str, Case] = {}
        for case, _ in self.expanded:
            if names.setdefault(case.name, case) is not case:
                raise InputError(str(self.path), "cases that differ", f"{case.name} twice")
        return list(names.values())

    @cached_property
    def cells(self) -> dict[str, Case]:
        """Every case by its place ``row/…/target`` in the table of all cases, row by row.

        None for a sweep without rows, and for one whose cells are of several cases.

        Raises
        ------
        InputError
            Two cases have the same place.
        """
        table: dict[str, dict[str, Case]] = {}
        if self.figures or not self.rows:
            return {}
        for case, change in self.expanded:
            row = "/".join(change if n == "change" else self.text(case, n) for n in self.rows)
            column = cell_title(case.kind, case.value)
            if table.setdefault(row, {}).setdefault(column, case) is not case:
                expected = "parameters that tell all cases apart"
                raise InputError(f"{self.path}: rows", expected, f"two of {row}/{column}")
        return {f"{row}/{column}": table[row][column] for row in table for column in table[row]}

    def failures(self, failed: Collection[str]) -> int:
        """The number of failed cases, among these, that must not fail."""
        names = (c.name for c, change in self.expanded if change in self.must_not_fail)
        return sum(name in failed for name in names)

    @cached_property
    def expanded(self) -> list[tuple[Case, str]]:
        """Every case, and the name of its change."""
        return list(self._expand())

    def _expand(self) -> Iterator[tuple[Case, str]]:
        targets = {robot: self._targets_of(robot) for robot in self.robots}
        for robot, controller in product(self.robots, self.controllers):
            axes = self.axes_of(robot, controller)
            grid = [axis for axis in axes if not axis.drawn]
            drawn = [axis for axis in axes if axis.drawn]
            for (kind, target), combination in product(targets[robot], combinations(grid)):
                for fixed, change in product(
                    self._at_periods(robot, kind, combination), self.changes
                ):
                    scaled = any(axis.name == "ellipse_scale" for axis in self.changes[change])
                    if kind in ("point", *OWN) and scaled:
                        continue  # it lies on no ellipse
                    other = self._changed(change, robot, controller)
                    if other is None:
                        continue  # it is for other controllers
                    for sample in range(self.samples or 1):
                        values = fixed | {
                            axis.name: axis.values[sample if axis.drawn else 0]
                            for axis in (*drawn, *other)
                        }
                        goal = target.values[sample] if isinstance(target, Axis) else target
                        index = None if self.samples is None else sample
                        words = [f"{n.rpartition('.')[2]}_{_short(v)}" for n, v in fixed.items()]
                        words += [change] if change != NOMINAL else []
                        words += [] if index is None else [f"sample_{index}"]
                        case = self._case(robot, controller, kind, goal, values, index, words)
                        yield case, change

    def _changed(self, change: str, robot: str, controller: str) -> list[Axis] | None:
        """The axes of a change for a robot and a controller; None if it has no effect on them."""
        every = [axis for axis in self.changes[change] if axis.robot in (None, robot)]
        found = [axis for axis in every if concerns(axis, controller)]
        return None if every and not found else found

    def axes_of(self, robot: str, controller: str) -> list[Axis]:
        """The axes of a robot's and controller's cases: its own before those of all controllers."""
        own = [axis for axis in self.axes if axis.controller == controller]
        named = {axis.name for axis in own}
        named |= {f"gains.{key}" for key in self.own_gains.get(controller, {})}
        return [
            axis for axis in self.axes
            if axis.robot in (None, robot)
            and (axis in own or (axis.controller is None and axis.name not in named))
        ]  # fmt: skip

    def _targets_of(self, robot: str) -> list[Target]:
        """Kinds and values of the targets; for random samples, kinds and axes."""
        once = "periodic" if self.periodic else "once"
        kinds = {**TARGETS, "file": once}
        found = [
            (kinds[axis.name], value)
            for axis in self.targets
            for value in ([axis] if axis.drawn else axis.values)
        ]
        if self.equilibria:  # two targets may be the same point
            found = list(dict.fromkeys(study_targets(self.models[robot], found)))
        return found

    def _at_periods(
        self, robot: str, kind: str, values: dict[str, Any]
    ) -> Iterator[dict[str, Any]]:
        """A combination at the shorter periods, then at its own."""
        usual = values.get("run.period", setups.setup_of(self.models[robot]).period)
        if kind not in MOVING:
            yield from (
                values | {"run.period": period} for period in self.shorter_periods
                if period < usual
            )  # fmt: skip
        yield values

    def _case(
        self, robot: str, controller: str, kind: str, target: Any, values: dict[str, Any],
        sample: int | None, words: list[str],
    ) -> Case:  # fmt: skip
        groups = by_group(values)
        model, options = self.models[robot], run_options(groups)
        gains = {**self.gains, **self.own_gains.get(controller, {}), **groups["gains"]}
        with errors_in(f"{self.path}: {robot}, {controller}"):
            case = Case(
                robot, controller, kind, target, resolve_gains(model, controller, gains), options,
                annotations=self.annotations.get(robot), sample=sample, words="_".join(words),
                forces=self.forces, force=groups[FORCE], **groups[""],
            )  # fmt: skip
            case.grid(model, self.trajectories.get((robot, target)) if kind in OWN else None)
            if "rig" in options:
                Rig.of(options["rig"]).robot(model.robot)
        return case

    def text(self, case: Case, name: str) -> str:
        """A parameter in a row's name."""
        value = parameter(case, name)
        if name in ("robot", "controller"):
            every = self.robots if name == "robot" else self.controllers
            alike = [one for one in every if legible(one) == legible(value)]
            bundled = safe_filename(value) == value
            return value if bundled else legible(value) if len(alike) == 1 else safe_filename(value)
        if name == "run.period" and value is None:
            value = setups.setup_of(self.models[case.robot]).period
        if value == "":
            return EMPTY
        if not isinstance(value, float):
            return safe_filename(str(value))
        return f"{1e3 * value:g} ms" if name in IN_MS else f"{value:g}"


def _short(value: Any) -> str:
    """A value in a file's name."""
    if isinstance(value, tuple):
        return "_".join(map(_short, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def concerns(axis: Axis, controller: str) -> bool:
    """Whether an axis of a change has an effect on a controller."""
    group, key, _ = place(axis.name)
    if group != "gains" or axis.controller is not None:
        return axis.controller in (None, controller)
    return is_own(controller) or key in (*keys_of(controller), SHARE)


def resolve_gains(model: SoftModel, controller: str, given: Mapping[str, Any]) -> Any:
    """All gains of a controller of the paper: those of `given`, else the published ones.

    Its options, such as a horizon, are kept; a horizon may be given as a share of ε. ``best`` and
    ``mpc`` get those of their keys, and a user's controller gets `given`. Without any, None stands
    for the controller's own.
    """
    if controller in BEYOND:
        given = {key: value for key, value in given.items() if key in keys_of(controller)}
    if controller not in CONTROLLERS or not given:
        return dict(given) or None
    options = CONTROLLERS[controller].options
    of_others = {SHARE, *(key for name in LAWS for key in keys_of(name))}
    of_others -= {*GAINS}
    own = {name: value for name, value in given.items() if name not in of_others}
    gains = from_table(model, CONTROLLERS[controller].published, own, options)
    found = {name: float(value) for name, value in asdict(gains).items()}
    found |= {name: value for name, value in given.items() if name in options}
    return found | ({"horizon": given[SHARE] * default_horizon(gains)} if SHARE in given else {})
