"""One closed loop of a study: its definition, its run, its figures of merit."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SoftModel
from softdyn.controllers.registry import one_line_errors
from softdyn.exceptions import own_code_errors
from softdyn.validation.loop import setups
from softdyn.validation.loop.experiment import Experiment
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.metrics import input_change
from softdyn.validation.loop.time_grid import TimeGrid
from softdyn.validation.loop.trajectories import Trajectory
from softdyn.validation.plain_data import to_plain_data
from softdyn.validation.simulate import simulate
from softdyn.validation.studies import experiments

LONGEST_NAME = 80  # characters of a file's name before its hash

NAMES = {
    "set_point": "theta", "tracking": "omega", "point": "point",
    "once": "file", "periodic": "file", "class": "class",
}  # fmt: skip
"""Kind → name in files and tables."""
OWN = ("once", "periodic", "class")  # trajectories of one's own: the value is a file or a class
MOVING = ("tracking", *OWN)
FILES = ("plant", "surroundings", "observer")  # options that may name a file of one's own
KINDS: dict[str, Callable[[setups.Setup, Any], Experiment]] = {
    "set_point": setups.Setup.set_point,
    "tracking": setups.Setup.tracking,
    "point": setups.Setup.target,
}
"""Kind of a case → its experiment, from a robot's setup and the case's value."""


@dataclass(frozen=True)
class Case:
    """One closed loop: a call of `simulate` as plain data.

    Attributes
    ----------
    robot, controller : str
        As on the command line.
    kind : str
        One of `NAMES`.
    value : float, tuple of float or str
        θ or ω in multiples of π (rad, rad/s), the point (3,) in the world (m), or the file or class
        of a trajectory of one's own.
    parameters : Any
        Arguments of the controller besides the model; None for its defaults.
    options : mapping
        The keywords of `RunOptions` that are not the default, as `RunOptions.of` takes them.
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
    forces : tuple of str
        Forces of one's own that act on the robot, ``FILE.py:CLASS``.
    force : mapping
        Those of their numbers that are not the class's, by ``NAME.FIELD``.
    sample : int, optional
        Number of the random sample with these parameters.
    words : str
        What makes this case different from its neighbours, for the names of its files. It does not
        make it another case.
    """

    robot: str
    controller: str
    kind: str
    value: Any
    parameters: Any = None
    options: Mapping[str, Any] = field(default_factory=dict)
    ellipse_scale: float = 1.0
    nudge: float = 0.0
    draw: tuple[int, int] | None = None
    target: Callable[[str, Experiment], Callable[[float], Reference]] | None = None
    law: Callable[[str, SoftModel], Any] | None = None
    around: Callable[[Any], Any] | None = None
    reference_sampling: bool = False
    annotations: str | None = None
    forces: tuple[str, ...] = ()
    force: Mapping[str, float] = field(default_factory=dict)
    sample: int | None = None
    words: str = field(default="", compare=False)

    def __hash__(self) -> int:
        return hash(self.name)  # mappings have no hash

    @cached_property
    def name(self) -> str:
        """A unique relative path, safe as a file name; a hash stands for non-default values."""
        if self.kind in OWN:
            value = legible(self.value)
        else:
            value = "_".join(map(number_text, self.value if self.kind == "point" else [self.value]))
        folder = f"{legible(self.robot)}/{legible(self.controller)}"
        file = f"{self.kind}_{value}"
        if self == Case(self.robot, self.controller, self.kind, self.value) and folder == (
            f"{self.robot}/{self.controller}"
        ):
            return f"{folder}/{file}"
        text = json.dumps(to_plain_data(replace(self, words="")), sort_keys=True)
        mark = hashlib.sha256(text.encode()).hexdigest()[:12]
        file = "_".join(filter(None, [file, safe(self.words)]))[:LONGEST_NAME]
        return f"{folder}/{file}-{mark}"

    @property
    def inputs(self) -> dict[str, Any]:
        """The case in the words of a sweep file."""
        return {
            "robot": self.robot, "controller": self.controller,
            "kind": self.kind if self.kind in OWN else NAMES[self.kind],
            "target": self.value, "gains": self.parameters, "options": self.options,
            "forces": self.forces, "force": self.force,
            "ellipse_scale": self.ellipse_scale, "sample": self.sample,
        }  # fmt: skip

    def experiment(self, model: SoftModel, trajectory: Trajectory | None = None) -> Experiment:
        """The experiment; a robot that is not in the paper gets an ellipse of its own size.

        `trajectory` is the one of one's own, where the case is of such a kind.
        """
        setup = replace(setups.setup_of(model), ellipse_scale=self.ellipse_scale)
        period = self.options.get("period")
        setup = setup if period is None else replace(setup, period=period)
        if trajectory is not None:
            experiment = setup.trajectory(trajectory)
        else:
            experiment = KINDS[self.kind](setup, self.value)
        if self.target is not None:
            experiment = replace(experiment, reference=self.target(self.robot, experiment))
        return experiment

    def start(self, size: int) -> np.ndarray:
        """The initial velocities (size,)."""
        if self.draw is None:
            return np.full(size, self.nudge)
        return self.nudge * np.random.default_rng(self.draw).normal(size=size)

    def grid(self, model: SoftModel, trajectory: Trajectory | None = None) -> TimeGrid:
        """The run's control periods and plant steps.

        Raises
        ------
        InputError
            The case's times do not fit together.
        """
        experiment = self.experiment(model, trajectory)
        duration = self.options.get("duration", experiment.duration)
        return TimeGrid.plan(duration, experiment.period, self.options.get("timestep"))


def run(
    case: Case,
    model: SoftModel,
    make: Callable[[], Any],
    trajectory: Trajectory | None = None,
    files: Mapping[str, Any] | None = None,
) -> Log:
    """Run a case with the controller that `make` builds; `files` are what its `FILES` mean.

    Raises
    ------
    InputError
        The case cannot run.
    OwnCodeError
        A user's controller or observer raised an exception.
    """
    experiment = case.experiment(model, trajectory)
    controller = case.law(case.controller, model) if case.law else make()
    controller = case.around(controller) if case.around else controller
    options = {**case.options, **(files or {}), "name": case.controller}
    options["v0"] = case.start(model.nv) + np.asarray(options.get("v0", 0.0))
    with own_code_errors(), one_line_errors(case.controller, "a command"):
        return simulate(model, controller, experiment, **options)


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
        "period_s": log.period,
        "timestep_s": log.timestep,
    }


def number_text(value: float) -> str:
    """The shortest text of a number that reads back as the same number."""
    short = f"{value:g}"
    return short if float(short) == value else repr(value)


def safe(text: str) -> str:
    """Text with letters, digits, ``.``, ``_`` and ``-`` alone, as a part of a file's name."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", text).strip("_.")


def legible(name: str) -> str:
    """A short name of a robot or a controller: that of the file without its folder, or the class.

    Two of them may have the same short name.
    """
    file, _, kind = name.rpartition(".py:")
    return safe(kind if file else Path(name).stem).replace(".", "_") or "_"
