"""A sweep: closed loops over a grid or random samples, spelt out.

Every case is plain data with nothing left to look up, in an order that depends on the sweep file
alone. `softdyn.validation.studies.sweep_file` reads that file; ``docs/sweeps.md`` describes it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

from softdyn import InputError, SoftModel
from softdyn.controllers import CONTROLLERS, Gains
from softdyn.controllers.gains import from_table
from softdyn.validation.loop.time_grid import TimeGrid
from softdyn.validation.studies.engine import worker
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.store import Store
from softdyn.validation.studies.engine.worker import CaseJob
from softdyn.validation.twin.plant_errors import PlantErrors

FIGURES = {
    "final_error_cm": "final error (cm)",
    "mse_cm2": "mean squared error (cm²)",
    "second_cycle_mse_cm2": "mean squared error, second cycle (cm²)",
}
PLANT = ("period", "duration", "timestep", "contacts", "friction")
GAINS = tuple(field.name for field in fields(Gains))
TARGETS = {"theta": "set_point", "omega": "tracking", "point": "point"}  # in a file → of a case
NAMES = {kind: name for name, kind in TARGETS.items()}


def inputs(case: Case) -> dict[str, Any]:
    """A case in the words of a sweep file."""
    return {
        "robot": case.robot,
        "controller": case.controller,
        "kind": NAMES[case.kind],
        "target": case.value,
        "gains": case.parameters,
        "period": case.period,
        "duration": case.duration,
        "timestep": case.timestep,
        "contacts": case.plant.contacts,
        "friction": case.plant.friction,
        "sample": case.sample,
    }


def parameter(case: Case, name: str) -> Any:
    """The value of ``gains.Kp``, ``plant.period``, ``theta``, … in a case; None without."""
    group, _, key = name.rpartition(".")
    found = inputs(case)
    if group == "gains":
        return (found["gains"] or {}).get(key)
    if group == "plant":
        return found[key]
    return found["target"] if found["kind"] == name else None


def store(folder: Path) -> Store:
    """Where a sweep keeps what came of its cases."""
    return Store(folder, runs="cases")


@dataclass(frozen=True)
class Axis:
    """The values of one parameter: of the grid, or one per sample.

    Attributes
    ----------
    name : str
        ``gains.Kp``, ``plant.period``, ``theta``, …
    values : tuple
        In the file's order.
    drawn : str, optional
        The distribution of random samples, ``uniform`` or ``log_uniform``; None in a grid.
    """

    name: str
    values: tuple[Any, ...]
    drawn: str | None = None

    @property
    def varies(self) -> bool:
        """Whether there is more than one value."""
        return len(self.values) > 1


@dataclass(frozen=True, eq=False)
class Sweep:
    """What a sweep file says, checked.

    Attributes
    ----------
    path : Path
        The file.
    robots, controllers : tuple of str
        Their names in the file.
    targets : tuple of Axis
        One per kind of target in the file.
    axes : tuple of Axis
        Of gains and plant, in the file's order.
    samples, seed : int
        Number of random samples (None without) and their seed.
    logs : bool
        Whether every run's log is kept.
    figure : str
        What the best cases are best in, one of `FIGURES`.
    models : dict of str to SoftModel
        The robots' analytic models.
    annotations : dict of str to str
        Robot → the file of its annotations, where its own has none.
    """

    path: Path
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

    def jobs(self) -> list[CaseJob]:
        """Every case with what it depends on."""
        heads = [{"inputs": inputs(case)} for case in self.cases]
        return worker.jobs_of(self.cases, heads=heads, folder=self.path.parent, log=self.logs)

    def varying(self) -> list[Axis]:
        """Gains and plant parameters with more than one value."""
        return [axis for axis in self.axes if axis.varies]

    @cached_property
    def cases(self) -> list[Case]:
        """Every case: robots, controllers, targets, grid, samples; the last varies fastest.

        Raises
        ------
        InputError
            For a combination that cannot be run, e.g. a timestep that does not divide the period.
        """
        found = list(self._expand())
        names: dict[str, Case] = {}
        for case in found:
            if names.setdefault(case.name, case) is not case:
                raise InputError(str(self.path), "cases that differ", f"{case.name} twice")
        return found

    def _expand(self) -> Iterator[Case]:
        grid = [axis for axis in self.axes if not axis.drawn]
        drawn = [axis for axis in self.axes if axis.drawn]
        targets = [
            (axis, value)
            for axis in self.targets
            for value in ([None] if axis.drawn else axis.values)
        ]
        combinations = [dict(zip((a.name for a in grid), values, strict=True))
                        for values in product(*(axis.values for axis in grid))]  # fmt: skip
        for robot, controller, (axis, target), fixed in product(
            self.robots, self.controllers, targets, combinations
        ):
            for sample in range(self.samples or 1):
                values = fixed | {a.name: a.values[sample] for a in drawn}
                goal = axis.values[sample] if axis.drawn else target
                index = None if self.samples is None else sample
                yield self._case(robot, controller, axis.name, goal, values, index)

    def _case(
        self, robot: str, controller: str, kind: str, target: Any, values: dict[str, Any],
        sample: int | None,
    ) -> Case:  # fmt: skip
        groups: dict[str, dict[str, Any]] = {"gains": {}, "plant": {}}
        for name, value in values.items():
            group, _, key = name.partition(".")
            groups[group][key] = value
        plant, model = groups["plant"], self.models[robot]
        case = Case(
            robot, controller, TARGETS[kind], target,
            parameters=resolve_gains(model, controller, groups["gains"]),
            period=plant.get("period"),
            plant=PlantErrors(plant.get("contacts", False), plant.get("friction", False)),
            annotations=self.annotations.get(robot),
            sample=sample,
        )  # fmt: skip
        try:
            experiment = case.experiment(model)
            duration = plant.get("duration", experiment.duration)
            grid = TimeGrid.plan(duration, experiment.period, plant.get("timestep"))
        except InputError as error:
            where = f"{self.path}: {robot}, {error.name}"
            raise InputError(where, error.expected, error.got) from None
        times = {name: getattr(grid, name) for name in ("period", "duration", "timestep")}
        return replace(case, **times)


def resolve_gains(model: SoftModel, controller: str, given: dict[str, Any]) -> Any:
    """All gains of a controller of the paper, the published ones where `given` has none.

    Its options, such as a horizon, are as given. Any other controller gets what is given, and None
    without any.
    """
    if controller not in CONTROLLERS:
        return given or None
    options = CONTROLLERS[controller].options
    own = {name: value for name, value in given.items() if name in GAINS}
    gains = from_table(model, controller, own)
    return {name: float(value) for name, value in asdict(gains).items()} | {
        name: value for name, value in given.items() if name in options
    }
