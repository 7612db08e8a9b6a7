"""Soft ID-CLF-QP with a horizon in two stages: one set of gains to arrive, one to stay."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SetPoint, SoftModel, State
from softdyn.actuation import Capstan
from softdyn.checks import number
from softdyn.controllers.channels import PHASE
from softdyn.controllers.controller import Command, GuardedController, KnownRig, WrappingController
from softdyn.controllers.law import NamedLaw
from softdyn.controllers.mpc import DEFAULT_PERIOD, LINK, Mpc
from softdyn.controllers.predictive.actuation import Actuation
from softdyn.controllers.predictive.compensated import Compensated
from softdyn.controllers.predictive.pulls import FrictionPulls
from softdyn.controllers.predictive.rest_target import RestTargets
from softdyn.controllers.predictive.supervisor import Phase, StageSupervisor
from softdyn.controllers.qps.stacked_error import checked_tasks
from softdyn.controllers.schedule import Schedule, make_schedule, tuned
from softdyn.controllers.soft_id_clf_qp import SoftIdClfQp
from softdyn.copies import keep_making
from softdyn.dynamics.model import check_model
from softdyn.tasks.task import Task


class Staged(GuardedController):
    """`SoftIdClfQp` with the gains and the horizon of a schedule's present stage.

    Parameters
    ----------
    model : SoftModel
        The robot.
    gains : Schedule or mapping, optional
        A schedule, or the tables that `make_schedule` takes; by default the tuned one.
    period : float
        Control period (s); `reset` sets another.

    Attributes
    ----------
    stages : tuple of SoftIdClfQp
        The controller to arrive and the controller to stay.

    Raises
    ------
    InputError
        If there is no schedule for this robot, or the robot has no inputs.
    """

    name = "best"
    channels = (PHASE,)

    def __init__(
        self,
        model: SoftModel,
        gains: Schedule | Mapping[str, Any] | None = None,
        period: float = DEFAULT_PERIOD,
    ) -> None:
        schedule = make_schedule(gains) if isinstance(gains, Mapping) else gains
        if gains is None:
            schedule = tuned(model)
            if schedule is None:
                expected = f"Schedule(…) for {model.robot.path}, which has no tuned one"
                raise InputError("gains", expected, None)
        if not isinstance(schedule, Schedule):
            raise InputError("gains", "softdyn.controllers.Schedule(…) or tables", repr(schedule))
        self.gains = schedule
        self.stages = approach, stay = tuple(
            SoftIdClfQp(model, stage.gains, horizon=stage.horizon, u_ref=stage.u_ref)
            for stage in (schedule.approach, schedule.stay)
        )
        self.supervisor = StageSupervisor(schedule.arrive, schedule.leave, schedule.dwell)
        self.guard = stay.guard = approach.guard
        self.solvers = approach.solvers + stay.solvers
        self.reset(period)

    def reset(self, period: float) -> None:
        """Begin a run with a control period (s), in the first stage."""
        self.period = number("period", period, above=0.0)
        self.guard.reset()
        self.supervisor.reset(self.period)

    @property
    def stage(self) -> SoftIdClfQp:
        """The controller that gave the last command."""
        return self.stages[self.supervisor.phase is Phase.STAY]

    def _command(self, state: State, reference: Reference | SetPoint) -> Command:
        distance = math.dist(state.y.tolist(), reference.y.tolist())  # lists save 1 µs
        phase = self.supervisor(distance)
        self.guard.values = phase.channel
        return self.stages[phase is Phase.STAY]._command(state, reference)


class Best(WrappingController, NamedLaw):
    """`Staged` on a plant whose actuators act at once, `Mpc` with targets from statics elsewhere.

    Each `reset` chooses by the lag and the delay of the plant. If the cables rub, `Compensated`
    makes up for it. `best` makes one for a robot that has a tuned schedule.

    Parameters
    ----------
    model : SoftModel
        The robot.
    schedule : Schedule
        Its schedule.
    lag, delay, friction
        As for `best`.
    period : float
        Control period (s); `reset` sets another.
    """

    name = Staged.name
    order = 7
    options = LINK
    parameter_class = Schedule

    def __init__(
        self,
        model: SoftModel,
        schedule: Schedule,
        lag: float | None = None,
        delay: float | None = None,
        friction: np.ndarray | float | None = None,
        period: float = DEFAULT_PERIOD,
    ) -> None:
        self._model, self._lag, self._delay, self._friction = model, lag, delay, friction
        self._staged = Staged(model, schedule)
        self._predictive: Mpc | None = None
        super().__init__(self._staged, model, Staged.name)
        self.guard = self._staged.guard  # all that take turns share it
        self.reset(period)

    def reset(self, period: float, rig: KnownRig | None = None) -> None:
        """Begin a run with a control period (s), on a plant behind a rig; by default the file's."""
        model, lag, delay, friction = self._model, self._lag, self._delay, self._friction
        link = Actuation.of(model, delay, lag, rig)
        if link.lag > 0 or link.delay > 0:
            if self._predictive is None:
                self._predictive = Mpc(
                    model, lag=lag, delay=delay, friction=friction, targets=RestTargets(model)
                )
                self._predictive.guard = self.guard
            self.inner = self._predictive
        else:
            self.inner = self._staged
            if FrictionPulls(model, friction, rig).rubs:
                self.inner = Compensated(
                    self._staged, model, lag=lag, delay=delay, friction=friction
                )
                self.inner.guard = self.guard
        super().reset(period, rig)

    @property
    def planning(self) -> bool:
        """Whether targets or a plan are searched in the background."""
        return bool(getattr(self.inner, "planning", False))

    def applied(self, u: np.ndarray) -> None:
        """The input u (nu,) was sent instead of the last command's."""
        if hasattr(self.inner, "applied"):
            self.inner.applied(u)

    def _command(self, state: State, reference: Reference | SetPoint) -> Command:
        command: Command = self.inner(state, reference)
        return command


def best(
    model: SoftModel,
    gains: Any = None,
    *,
    lag: float | None = None,
    delay: float | None = None,
    friction: np.ndarray | float | None = None,
    tasks: Sequence[Task] | None = None,
) -> Best | Staged | Mpc | Compensated:
    """The recommended controller: `Mpc` with targets from statics, `Staged` if there is a schedule.

    A schedule is for the tip and actuators that act at once: with tasks, a lag or a delay it is not
    used. If the cables rub, `Compensated` makes up for it. A `Best` chooses by the plant.

    Parameters
    ----------
    model : SoftModel
        The robot.
    gains : Schedule or mapping, optional
        A schedule or its tables. The tuned one is used if there is one and no other is given.
    lag, delay : float, optional
        Lag and delay of the actuators (s); by default those of the plant where `simulate` or
        another loop resets the controller, else those of the robot's file, see `Mpc`.
    friction : float or array_like, (tendons,), optional
        Coefficients of the cables' friction; by default as for lag and delay.
    tasks : sequence of softdyn.tasks.Task, optional
        Tasks of one level; by default the position of the tip.

    Raises
    ------
    InputError
        A schedule together with tasks, a lag or a delay, and whatever the controller raises.
    """
    check_model(model)
    with_tasks = not checked_tasks(model, tasks)[1]
    if gains is not None:
        link = Actuation.of(model, delay, lag)
        if link.lag > 0 or link.delay > 0 or with_tasks:
            raise InputError("gains", "none, for tasks, a lag or a delay", repr(gains))
        staged = Staged(model, gains)
        if not len(Capstan(model, friction).tendon):
            return staged
        return Compensated(staged, model, lag=0.0, delay=0.0, friction=friction)
    schedule, late = tuned(model), bool(lag or delay)
    if schedule is None or late or with_tasks:
        targets = RestTargets(model)
        return Mpc(model, lag=lag, delay=delay, friction=friction, targets=targets, tasks=tasks)
    chosen = Best(model, schedule, lag, delay, friction)
    keep_making(chosen, best, (model,), {"lag": lag, "delay": delay, "friction": friction})
    return chosen


Best.factory = best
