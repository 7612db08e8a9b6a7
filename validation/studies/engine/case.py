"""One closed loop of a study: its definition, its run, its figures of merit."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SoftModel
from softdyn.controllers.registry import one_line_errors
from softdyn.exceptions import own_code_errors
from softdyn.validation.files import safe_filename
from softdyn.validation.loop.experiment import Experiment
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.metrics import input_change
from softdyn.validation.plain_data import to_plain_data
from softdyn.validation.simulate import simulate
from softdyn.validation.studies import experiments
from softdyn.validation.twin.plant_errors import PlantErrors
from softdyn.validation.twin.rig import Rig

# kind of a case → its experiment, from a robot's setup and the case's value
KINDS: dict[str, Callable[[experiments.Setup, Any], Experiment]] = {
    "set_point": experiments.Setup.set_point,
    "tracking": experiments.Setup.tracking,
    "point": experiments.Setup.target,
}


@dataclass(frozen=True)
class Case:
    """One closed loop. None stands for the default of the robot, experiment or controller.

    Attributes
    ----------
    robot, controller : str
        As on the command line.
    kind : str
        ``"set_point"``, ``"tracking"`` or ``"point"``.
    value : float or tuple of float
        θ or ω in multiples of π (rad, rad/s), or the point (3,) in the world (m).
    parameters : Any
        Arguments of the controller besides the model.
    period, duration, timestep : float, optional
        Control period, length of the run, plant step (s). A step of ``inf`` means one per period.
    plant : PlantErrors
        Differences between plant and model.
    rig : Rig, optional
        The rig between controller and plant; its plant is that of this case.
    observer : str, optional
        The observer of the states that the controller gets, in the words of
        `softdyn.validation.loop.observation.make_observer`.
    ellipse_scale : float
        Factor on both semi-axes of the paper's ellipse, about its centre.
    nudge : float
        Every initial velocity (rad/s, m/s), or with a `draw` the standard deviation of each.
    draw : tuple of int, optional
        Seed and number of the random initial velocities.
    target : Callable[[str, Experiment], Callable[[float], Reference]], optional
        (robot, the paper's experiment) → another reference for the tip.
    law : Callable[[str, SoftModel], Any], optional
        (controller, model) → a controller that replaces the one of that name.
    around : Callable[[Any], Any], optional
        Controller → the controller that runs in its place.
    reference_sampling : bool
        Whether the mean squared error is the plain mean over every fifth control step, t = 0
        included, as in the reference implementation.
    annotations : str, optional
        A file with the robot's ``<softdyn>`` block, if the robot's own file has none.
    sample : int, optional
        Number of the random sample with these parameters.
    """

    robot: str
    controller: str
    kind: str
    value: Any
    parameters: Any = None
    period: float | None = None
    duration: float | None = None
    timestep: float | None = None
    plant: PlantErrors = field(default_factory=PlantErrors)
    rig: Rig | None = None
    observer: str | None = None
    ellipse_scale: float = 1.0
    nudge: float = 0.0
    draw: tuple[int, int] | None = None
    target: Callable[[str, Experiment], Callable[[float], Reference]] | None = None
    law: Callable[[str, SoftModel], Any] | None = None
    around: Callable[[Any], Any] | None = None
    reference_sampling: bool = False
    annotations: str | None = None
    sample: int | None = None

    @cached_property
    def name(self) -> str:
        """A unique relative path, safe as a file name; a hash stands for non-default values."""
        value = "" if self.kind == "point" else f"_{number_text(self.value)}"
        path = f"{safe_filename(self.robot)}/{safe_filename(self.controller)}/{self.kind}{value}"
        usual = Case(self.robot, self.controller, self.kind, self.value)
        if self == usual and self.kind != "point":
            return path
        text = json.dumps(to_plain_data(self), sort_keys=True)
        return f"{path}-{hashlib.sha256(text.encode()).hexdigest()[:16]}"

    def experiment(self, model: SoftModel) -> Experiment:
        """The experiment; a robot that is not in the paper gets an ellipse of its own size."""
        setup = replace(experiments.setup_of(model), ellipse_scale=self.ellipse_scale)
        setup = setup if self.period is None else replace(setup, period=self.period)
        experiment = KINDS[self.kind](setup, self.value)
        if self.target is not None:
            experiment = replace(experiment, reference=self.target(self.robot, experiment))
        return experiment

    def start(self, size: int) -> np.ndarray:
        """The initial velocities (size,)."""
        if self.draw is None:
            return np.full(size, self.nudge)
        return self.nudge * np.random.default_rng(self.draw).normal(size=size)

    def cost(self, model: SoftModel) -> float:
        """Rough cost of the run: control steps, weighted by the robot's size."""
        experiment = self.experiment(model)
        return (self.duration or experiment.duration) / experiment.period * (10 + model.nv)


def run(case: Case, model: SoftModel, make: Callable[[], Any]) -> Log:
    """Run a case with the controller that `make` builds.

    Raises
    ------
    InputError
        The case cannot run.
    OwnCodeError
        A user's controller or observer raised an exception.
    """
    experiment = case.experiment(model)
    controller = case.law(case.controller, model) if case.law else make()
    controller = case.around(controller) if case.around else controller
    step = case.timestep
    with own_code_errors(), one_line_errors(case.controller, "a command"):
        return simulate(
            model,
            controller,
            experiment,
            duration=case.duration,
            timestep=None if step is None else min(step, experiment.period),
            v0=case.start(model.nv),
            name=case.controller,
            plant=case.plant,
            rig=case.rig,
            observer=case.observer,
        )


def figures(case: Case, log: Log) -> dict[str, Any]:
    """Every figure of merit of a run by name; NaN or None if the run ended early."""
    found = log.report()
    # deadlines depend on the machine, and a study has its own verdict
    for name in ("robot", "controller", "kind", "missed_deadlines", "verdict"):
        del found[name]
    error = 100 * np.linalg.norm(log.error, axis=1)
    if case.reference_sampling and log.complete:
        found["mse_cm2"] = 1e4 * float(np.mean(np.sum(log.error[::5] ** 2, axis=1)))
    try:
        second = experiments.second_cycle_mse_cm2(log)
    except InputError:  # no two whole cycles
        second = None
    change = input_change(log.u, log.u_min, log.u_max) if log.complete else None
    last = float(error[log.t >= log.t[-1] - 1].max()) if log.complete else None
    return found | {
        "second_cycle_mse_cm2": second,
        "input_change_percent": None if change is None else 100 * change,
        "first_error_cm": float(error[0]),
        "last_second_cm": last,
        "simulated_s": float(log.t[-1]),
    }


def number_text(value: float) -> str:
    """The shortest text of a number that reads back as the same number."""
    short = f"{value:g}"
    return short if float(short) == value else repr(value)
