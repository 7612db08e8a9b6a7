"""A sweep: closed loops over a grid or random samples, spelt out.

Every case is plain data with nothing left to look up, in an order that depends on the sweep file
alone. `softdyn.validation.studies.sweep_file` reads that file; ``docs/sweeps.md`` describes it.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

from softdyn import InputError, SoftModel
from softdyn.controllers import CONTROLLERS, Gains
from softdyn.controllers.gains import PUBLISHED
from softdyn.validation.loop.experiment import Experiment
from softdyn.validation.loop.time_grid import TimeGrid
from softdyn.validation.studies import paper
from softdyn.validation.studies.benchmark import safe
from softdyn.validation.studies.fingerprint import digest

FIGURES = {
    "final_error_cm": "final error (cm)",
    "mse_cm2": "mean squared error (cm²)",
    "second_cycle_mse_cm2": "mean squared error, second cycle (cm²)",
}
PLANT = ("period", "duration", "timestep", "contacts", "friction")


@dataclass(frozen=True)
class Source:
    """The files of a robot or a controller, so that a worker can tell whether it has the same.

    Attributes
    ----------
    text : what the sweep file calls it; a bundled robot's own name.
    path : the main file on the machine that reads the sweep file.
    files : (path relative to the main file's folder, SHA-256) of each, in order.
    own : the user's own; any other is part of a package that every worker has.
    """

    text: str
    path: str
    files: tuple[tuple[str, str], ...]
    own: bool

    @classmethod
    def of(cls, text: str, paths: Sequence[Path], own: bool) -> Source:
        """The files at `paths`, the main one first."""
        main = paths[0].resolve()
        found = [(path.resolve().relative_to(main.parent).as_posix(), path) for path in paths]
        return cls(text, str(main), tuple((name, digest(path)) for name, path in found), own)


@dataclass(frozen=True)
class Case:
    """One closed loop, everything resolved.

    Attributes
    ----------
    robot, controller : as the sweep file calls them.
    kind, target : ``"theta"`` or ``"omega"`` and its multiple of π, or ``"point"`` and (x, y, z) m.
    gains : every gain of a controller of the paper; what the file gives to a user's own, else None.
    period, duration, timestep : control period, length of the run, plant step (s).
    contacts, friction : of the plant.
    sample : number of the random sample, None in a sweep without any.
    """

    robot: str
    controller: str
    kind: str
    target: float | tuple[float, float, float]
    gains: dict[str, Any] | None
    period: float
    duration: float
    timestep: float
    contacts: bool
    friction: bool
    sample: int | None

    @cached_property
    def name(self) -> str:
        """A relative path that is safe as a file's and unique to the inputs."""
        text = json.dumps(asdict(self), sort_keys=True)
        goal = self.kind if self.kind == "point" else f"{self.kind}_{self.target:g}"
        mark = hashlib.sha256(text.encode()).hexdigest()[:16]
        return f"{safe(self.robot)}/{safe(self.controller)}/{goal}-{mark}"

    def parameter(self, name: str) -> Any:
        """The value of ``gains.Kp``, ``plant.period``, ``theta``, … in this case; None without."""
        group, _, key = name.rpartition(".")
        if group == "gains":
            return (self.gains or {}).get(key)
        if group == "plant":
            return getattr(self, key)
        return self.target if self.kind == name else None

    def experiment(self, model: SoftModel) -> Experiment:
        """What to run."""
        setup = replace(paper.setup_of(model), period=self.period)
        if self.kind == "point":
            return setup.target(self.target)
        make = setup.set_point if self.kind == "theta" else setup.tracking
        return make(self.target)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Axis:
    """The values of one parameter: of the grid, or one per sample.

    Attributes
    ----------
    name : ``gains.Kp``, ``plant.period``, ``theta``, …
    values : in the file's order.
    drawn : the distribution of random samples, ``uniform`` or ``log_uniform``; None in a grid.
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
    path : the file.
    robots : name in the file → where it comes from.
    controllers : likewise; None for those of the paper.
    targets : one axis per kind of target in the file.
    axes : of gains and plant, in the file's order.
    samples, seed : number of random samples (None without) and their seed.
    logs : whether every run's log is kept.
    figure : what the best cases are best in, one of `FIGURES`.
    models : robot → its analytic model.
    """

    path: Path
    robots: dict[str, Source]
    controllers: dict[str, Source | None]
    targets: tuple[Axis, ...]
    axes: tuple[Axis, ...]
    samples: int | None
    seed: int
    logs: bool
    figure: str
    models: dict[str, SoftModel]

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
        model = self.models[robot]
        given = {n.removeprefix("gains."): v for n, v in values.items() if n.startswith("gains.")}
        plant = {n.removeprefix("plant."): v for n, v in values.items() if n.startswith("plant.")}
        gains = resolve_gains(model, controller, given)
        period = plant.get("period", paper.setup_of(model).period)
        case = Case(
            robot, controller, kind, target, gains, period, math.nan, math.nan,
            plant.get("contacts", False), plant.get("friction", False), sample,
        )  # fmt: skip
        try:
            duration = plant.get("duration", case.experiment(model).duration)
            schedule = TimeGrid.plan(duration, period, plant.get("timestep"))
        except InputError as error:
            where = f"{self.path}: {robot}, {error.name}"
            raise InputError(where, error.expected, error.got) from None
        return replace(case, duration=schedule.duration, timestep=schedule.timestep)


def resolve_gains(model: SoftModel, controller: str, given: dict[str, Any]) -> Any:
    """All gains of a controller of the paper, the published ones where `given` has none.

    A user's own controller gets what is given, and None without any.
    """
    if controller not in CONTROLLERS:
        return given or None
    base = PUBLISHED.get(model.bundled or "", {}).get(controller)
    gains = Gains(**given) if base is None else replace(base, **given)
    return {name: float(value) for name, value in asdict(gains).items()}
