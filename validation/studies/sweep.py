"""A sweep: the list of closed loops over a grid, over random samples or one change at a time.

Every case is complete plain data, and the order of the cases depends only on the sweep file.
`softdyn.validation.studies.sweep_file` reads that file; ``docs/sweeps.md`` describes it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

from softdyn import InputError, SoftModel
from softdyn.controllers import CONTROLLERS, Gains
from softdyn.controllers.gains import from_table
from softdyn.controllers.qps.horizon import default_horizon
from softdyn.validation.files import safe_filename
from softdyn.validation.loop.labels import cell_title
from softdyn.validation.loop.time_grid import TimeGrid
from softdyn.validation.studies import experiments
from softdyn.validation.studies.engine import worker
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.store import Store
from softdyn.validation.studies.engine.worker import CaseJob
from softdyn.validation.studies.study_targets import Target, study_targets
from softdyn.validation.studies.sweep_values import GROUPS, Axis
from softdyn.validation.twin.plant_errors import BY_JOINT, EACH, PlantErrors
from softdyn.validation.twin.rig import Rig

FIGURES = {
    "final_error_cm": "final error (cm)",
    "mse_cm2": "mean squared error (cm²)",
    "second_cycle_mse_cm2": "mean squared error, second cycle (cm²)",
}
# in [plant], but fields of the case and not of its plant
TIMES = ("period", "duration", "timestep")
GAINS = tuple(field.name for field in fields(Gains))
# name in a file → name in a case
TARGETS = {"theta": "set_point", "omega": "tracking", "point": "point"}
NAMES = {kind: name for name, kind in TARGETS.items()}
PARAMETERS = (*(f"{group}.{name}" for group in GROUPS for name in GROUPS[group]), "ellipse_scale")
NOMINAL = "none"  # the name of the case without a change
IDEAL = Rig(file=False)
SHARE = "horizon_per_eps"  # of [gains]
IN_MS = ("gains.horizon", "plant.period", "rig.delay", "rig.lag", "rig.latency")


def inputs(case: Case) -> dict[str, Any]:
    """A case with the keys of a sweep file."""
    return {
        "robot": case.robot,
        "controller": case.controller,
        "kind": NAMES[case.kind],
        "target": case.value,
        "gains": case.parameters,
        **{
            name.removeprefix("plant."): parameter(case, name)
            for name in (*PARAMETERS, *joint_parameters([case]))
        },
        "sample": case.sample,
    }


def place(name: str) -> tuple[str, str, str]:
    """The group, key and joint of a parameter's name; without a group or a joint these are empty.

    ``plant.stiffness.bend_1``, ``gains.Kp``, ``theta``.
    """
    group, _, key = name.partition(".") if "." in name else ("", "", name)
    if group == "plant":
        key, _, joint = key.partition(".")
        return group, key, joint
    return group, key, ""


def joint_parameters(cases: Iterable[Case]) -> tuple[str, ...]:
    """The names of the factors by joint in these cases."""
    found = (
        f"plant.{key}.{joint}"
        for case in cases for key in BY_JOINT
        if isinstance(factors := getattr(case.plant, key), Mapping) for joint in factors
    )  # fmt: skip
    return tuple(dict.fromkeys(found))


def parameter(case: Case, name: str) -> Any:
    """The value of ``gains.Kp``, ``plant.period``, ``theta``, … in a case, or None."""
    group, key, joint = place(name)
    gains = case.parameters or {}
    if group == "gains":
        return gains["horizon"] / gains["eps"] if key == SHARE else gains.get(key)
    if group == "plant":
        value = getattr(case if key in TIMES else case.plant, key)
        by_joint = isinstance(value, Mapping)
        return value.get(joint or EACH, value.get(EACH, 1.0)) if by_joint else value
    if name == "rig.observer":
        return case.observer
    if group == "rig":
        value = getattr(case.rig or IDEAL, key)
        return getattr(value, "value", value)
    if name in NAMES.values():
        return case.value if NAMES[case.kind] == name else None
    return getattr(case, name)


def store(folder: Path) -> Store:
    """The store of a sweep's results."""
    return Store(folder, runs="cases")


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
        The robots' analytic models.
    annotations : dict of str to str
        Robot → the file of its annotations, if its own file has none.
    equilibria : bool
        Whether a robot that is not in the paper moves to equilibria instead.
    shorter_periods : tuple of float
        Control periods (s) to which set points also run, if they are shorter than the usual one.
    changes : mapping
        Name → changed parameter → robot → its value, with ``default`` for any other robot. Each
        change runs by itself.
    rows : tuple of str
        Parameters that distinguish the rows of a table of all cases. Without any, there is no such
        table.
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
    equilibria: bool
    shorter_periods: tuple[float, ...]
    changes: Mapping[str, Mapping[str, Mapping[str, Any]]]
    rows: tuple[str, ...]
    means: bool
    statics_beyond_cm: float
    must_not_fail: tuple[str, ...]
    gains: Mapping[str, Any]
    own_gains: Mapping[str, Mapping[str, Any]]

    def jobs(self) -> list[CaseJob]:
        """Every case with its dependencies."""
        heads = [{"inputs": inputs(case)} for case in self.cases]
        return worker.jobs_of(self.cases, heads=heads, folder=self.folder, log=self.logs)

    def varying(self) -> list[Axis]:
        """Parameters with more than one value, apart from random ones of each joint."""
        return [axis for axis in self.axes if axis.varies and axis.robot is None]

    @cached_property
    def cases(self) -> list[Case]:
        """Every case, the last of the file's parameters varying fastest.

        Raises
        ------
        InputError
            A combination cannot run, e.g. the timestep does not divide the period.
        """
        names: dict[str, Case] = {}
        for case, _ in self._expanded:
            if names.setdefault(case.name, case) is not case:
                raise InputError(str(self.path), "cases that differ", f"{case.name} twice")
        return list(names.values())

    @cached_property
    def cells(self) -> dict[str, Case]:
        """Every case by its place ``row/…/target`` in the table of all cases, row by row.

        Raises
        ------
        InputError
            Two cases have the same place.
        """
        table: dict[str, dict[str, Case]] = {}
        for case, change in self._expanded:
            row = "/".join(change if n == "change" else _text(case, n) for n in self.rows)
            column = cell_title(case.kind, case.value)
            if table.setdefault(row, {}).setdefault(column, case) is not case:
                expected = "parameters that tell all cases apart"
                raise InputError(f"{self.path}: rows", expected, f"two of {row}/{column}")
        return {f"{row}/{column}": table[row][column] for row in table for column in table[row]}

    def failures(self, failed: Collection[str]) -> int:
        """The number of failed cases, among these, that must not fail."""
        names = (c.name for c, change in self._expanded if change in self.must_not_fail)
        return sum(name in failed for name in names)

    @cached_property
    def _expanded(self) -> list[tuple[Case, str]]:
        """Every case, and the name of its change."""
        return list(self._expand())

    def _expand(self) -> Iterator[tuple[Case, str]]:
        targets = {robot: self._targets_of(robot) for robot in self.robots}
        for robot, controller in product(self.robots, self.controllers):
            axes = self.axes_of(robot, controller)
            grid = [axis for axis in axes if not axis.drawn]
            drawn = [axis for axis in axes if axis.drawn]
            combinations = [dict(zip((a.name for a in grid), values, strict=True))
                            for values in product(*(axis.values for axis in grid))]  # fmt: skip
            for (kind, target), combination in product(targets[robot], combinations):
                for fixed, change in product(
                    self._at_periods(robot, kind, combination), self.changes
                ):
                    if kind == "point" and "ellipse_scale" in self.changes[change]:
                        continue  # a point lies on no ellipse
                    other = {n: v.get(robot, v["default"]) for n, v in self.changes[change].items()}
                    for sample in range(self.samples or 1):
                        values = fixed | {a.name: a.values[sample] for a in drawn} | other
                        goal = target.values[sample] if isinstance(target, Axis) else target
                        index = None if self.samples is None else sample
                        yield self._case(robot, controller, kind, goal, values, index), change

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
        found = [
            (TARGETS[axis.name], value)
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
        usual = values.get("plant.period", experiments.setup_of(self.models[robot]).period)
        if kind != "tracking":
            yield from (
                values | {"plant.period": period} for period in self.shorter_periods
                if period < usual
            )  # fmt: skip
        yield values

    def _case(
        self, robot: str, controller: str, kind: str, target: Any, values: dict[str, Any],
        sample: int | None,
    ) -> Case:  # fmt: skip
        groups: dict[str, dict[str, Any]] = {group: {} for group in ("gains", *GROUPS, "")}
        for name, value in values.items():
            group, key, joint = place(name)
            if joint:
                others = groups[group].get(key, 1.0)
                value = (others if isinstance(others, dict) else {EACH: others}) | {joint: value}
            groups[group][key] = value
        plant, rig, model = groups["plant"], dict(groups["rig"]), self.models[robot]
        observer = rig.pop("observer", None)
        times = {name: plant.pop(name) for name in TIMES if name in plant}
        case = Case(
            robot, controller, kind, target,
            parameters=resolve_gains(
                model, controller,
                {**self.gains, **self.own_gains.get(controller, {}), **groups["gains"]},
            ),
            period=times.get("period"),
            plant=PlantErrors(**plant),
            rig=Rig(**{"file": observer is not None, **rig}) if groups["rig"] else None,
            observer=observer,
            annotations=self.annotations.get(robot),
            sample=sample,
            **groups[""],
        )  # fmt: skip
        try:
            experiment = case.experiment(model)
            duration = times.get("duration", experiment.duration)
            step = times.get("timestep")
            step = None if step is None else min(step, experiment.period)
            grid = TimeGrid.plan(duration, experiment.period, step)
        except InputError as error:
            where = f"{self.path}: {robot}, {error.name}"
            raise InputError(where, error.expected, error.got) from None
        return replace(case, **{name: getattr(grid, name) for name in TIMES})


def _text(case: Case, name: str) -> str:
    """A parameter in a row's name."""
    value = parameter(case, name)
    if not isinstance(value, float):
        return safe_filename(str(value))
    return f"{1e3 * value:g} ms" if name in IN_MS else f"{value:g}"


def resolve_gains(model: SoftModel, controller: str, given: Mapping[str, Any]) -> Any:
    """All gains of a controller of the paper: those of `given`, else the published ones.

    Its options, such as a horizon, are kept; a horizon may be given as a share of ε. Any other
    controller gets `given`, or None if that is empty.
    """
    if controller not in CONTROLLERS:
        return dict(given) or None
    options = CONTROLLERS[controller].options
    gains = from_table(model, controller, {n: v for n, v in given.items() if n in GAINS})
    found = {name: float(value) for name, value in asdict(gains).items()}
    found |= {name: value for name, value in given.items() if name in options}
    return found | ({"horizon": given[SHARE] * default_horizon(gains)} if SHARE in given else {})
