"""Closed loops away from the paper's grid: other periods, targets and plants, one row each."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np

import softdyn
from softdyn import Ellipse, Reference, State
from softdyn.controllers import find_controller
from softdyn.validation.loop.closed_loop import simulate
from softdyn.validation.processes import in_order
from softdyn.validation.studies import paper
from softdyn.validation.twin.twin import Twin


@dataclass(frozen=True)
class Plant:
    """How the plant differs from the model the controller has, and the loop from an ideal one.

    Attributes
    ----------
    mass, stiffness, damping : factors on all masses and moments of inertia (armature apart), on
        all springs, on all damping, in the twin only.
    delay : time (s) from a state to the input that answers it, in whole control periods.
    noise : standard deviation (m) of each coordinate of the tip that the controller sees.
    """

    mass: float = 1.0
    stiffness: float = 1.0
    damping: float = 1.0
    delay: float = 0.0
    noise: float = 0.0

    def twin(self, *arguments: Any, **options: Any) -> Twin:
        """The twin with these factors."""
        twin = Twin(*arguments, **options)
        model = twin.model
        model.body_mass[:] *= self.mass
        model.body_inertia[:] *= self.mass
        model.jnt_stiffness[:] *= self.stiffness
        model.tendon_stiffness[:] *= self.stiffness
        model.dof_damping[:] *= self.damping
        model.tendon_damping[:] *= self.damping
        mujoco.mj_setConst(model, twin.data)
        twin.reset()
        return twin


@dataclass(frozen=True)
class Trial:
    """One closed loop.

    Attributes
    ----------
    robot, controller : command-line names.
    kind : ``"set_point"`` or ``"tracking"``.
    value : θ or ω in multiples of π.
    period : control period (s), the robot's published one by default.
    shrink : factor on both semi-axes of the paper's ellipse, about its centre.
    duration : length (s), the experiment's by default.
    gains : what the controller is built with besides the model; nothing by default.
    seed : of the noise.
    """

    robot: str
    controller: str
    kind: str
    value: float
    period: float | None = None
    shrink: float = 1.0
    duration: float | None = None
    plant: Plant = field(default_factory=Plant)
    gains: Mapping[str, Any] | None = None
    seed: int = 0


class Degraded:
    """A controller behind a delay, seeing a noisy tip."""

    def __init__(self, controller: Any, plant: Plant, period: float, seed: int) -> None:
        self._controller, self._noise = controller, plant.noise
        self._waiting: list[Any] = []
        self._lag = round(plant.delay / period)
        self._random = np.random.default_rng(seed)

    def reset(self, period: float) -> None:
        """Begin a run: nothing waits, and the controller begins one too, where it can."""
        self._waiting.clear()
        if hasattr(self._controller, "reset"):
            self._controller.reset(period)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["_controller"], name)

    def __call__(self, state: State, reference: Reference) -> Any:
        """The answer to the state of `delay` ago, the first one until there is one."""
        if self._noise > 0:
            state = replace(state, y=state.y + self._noise * self._random.normal(size=3))
        self._waiting.append(self._controller(state, reference))
        return self._waiting[0] if len(self._waiting) <= self._lag else self._waiting.pop(0)


def run(trial: Trial) -> dict[str, Any]:
    """Run a trial; the figures of its log, in cm, cm² and µs."""
    model = softdyn.load(trial.robot)
    setup = paper.setup_of(model)
    period = trial.period or setup.period
    set_point = trial.kind == "set_point"
    experiment = (setup.set_point if set_point else setup.tracking)(trial.value)
    if trial.shrink != 1.0:
        whole = setup.ellipse(0.0 if set_point else trial.value)
        small = Ellipse(trial.shrink * whole.a, trial.shrink * whole.b, whole.c, omega=whole.omega)
        at = softdyn.SetPoint(small.point(trial.value)) if set_point else small
        experiment = replace(experiment, reference=at)
    cls = find_controller(trial.controller)
    controller = cls(model) if trial.gains is None else cls(model, dict(trial.gains))
    log = simulate(
        model,
        Degraded(controller, trial.plant, period, trial.seed),
        experiment,
        period=period,
        duration=trial.duration,
        twin=trial.plant.twin,
        name=trial.controller,
    )
    whole_run = trial.duration is None and not set_point
    error = 100 * np.linalg.norm(log.error, axis=1)
    return {
        "first_error_cm": float(error[0]),
        "final_error_cm": log.final_error_cm,
        "last_second_cm": float(error[log.t >= log.t[-1] - 1].max()) if log.complete else None,
        "mse_cm2": log.mse_cm2,
        "second_cycle_cm2": paper.second_cycle_mse_cm2(log) if whole_run else None,
        "failed": log.failed,
        "reason": log.reason,
        "step_us": log.step_times_us,
        "not_solved": log.not_solved,
        "fallbacks": log.fallbacks,
        "max_bound_violation": log.max_bound_violation,
    }


def run_all(trials: Iterable[Trial], jobs: int = -1) -> list[dict[str, Any]]:
    """`run` of each, in the order given, on processes; a bar on a terminal."""
    return in_order(run, ((trial,) for trial in trials), jobs)
