"""Soft ID-CLF-QP with a horizon in two stages: one set of gains to arrive, one to stay."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SetPoint, SoftModel, State
from softdyn.actuation import Capstan
from softdyn.checks import number
from softdyn.controllers.controller import Command, GuardedController
from softdyn.controllers.mpc import DEFAULT_PERIOD, Mpc
from softdyn.controllers.predictive.actuation import Actuation
from softdyn.controllers.predictive.compensated import Compensated
from softdyn.controllers.predictive.rest_target import RestTargets
from softdyn.controllers.qps.stacked_error import checked_tasks
from softdyn.controllers.schedule import Schedule, make_schedule, tuned
from softdyn.controllers.soft_id_clf_qp import SoftIdClfQp
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
        self.guard = stay.guard = approach.guard
        self.solvers = approach.solvers + stay.solvers
        self.reset(period)

    def reset(self, period: float) -> None:
        """Begin a run with a control period (s), in the first stage."""
        self.period = number("period", period, above=0.0)
        self.guard.reset()
        self._near = 0.0  # s
        self._staying = False

    @property
    def stage(self) -> SoftIdClfQp:
        """The controller that gave the last command."""
        return self.stages[self._staying]

    def _command(self, state: State, reference: Reference | SetPoint) -> Command:
        schedule = self.gains
        distance = math.dist(state.y.tolist(), reference.y.tolist())  # lists save 1 µs
        self._near = self._near + self.period if distance < schedule.arrive else 0.0
        if self._staying:
            self._staying = not distance > schedule.leave
        else:
            self._staying = self._near > schedule.dwell
        return self.stages[self._staying]._command(state, reference)


def best(
    model: SoftModel,
    gains: Any = None,
    *,
    lag: float | None = None,
    delay: float | None = None,
    friction: np.ndarray | float | None = None,
    tasks: Sequence[Task] | None = None,
) -> Staged | Mpc | Compensated:
    """The recommended controller: `Mpc` with targets from statics, `Staged` if there is a schedule.

    A schedule is for the tip and actuators that act at once: with tasks, a lag or a delay it is not
    used. If the cables rub, `Compensated` makes up for it.

    Parameters
    ----------
    model : SoftModel
        The robot.
    gains : Schedule or mapping, optional
        A schedule or its tables. The tuned one is used if there is one and no other is given.
    lag, delay : float, optional
        Lag and delay of the actuators (s); by default those of the robot's file, see `Mpc`.
    friction : float or array_like, (tendons,), optional
        Coefficients of the cables' friction; by default those of the robot's file, see `Mpc`.
    tasks : sequence of softdyn.tasks.Task, optional
        Tasks of one level; by default the position of the tip.

    Raises
    ------
    InputError
        A schedule together with tasks, a lag or a delay, and whatever the controller raises.
    """
    link = Actuation.of(check_model(model), delay, lag)
    other = link.lag > 0 or link.delay > 0 or not checked_tasks(model, tasks)[1]
    if other and gains is not None:
        raise InputError("gains", "none, for tasks, a lag or a delay", repr(gains))
    schedule = tuned(model) if gains is None and not other else gains
    if schedule is None:
        targets = RestTargets(model)
        return Mpc(model, lag=lag, delay=delay, friction=friction, targets=targets, tasks=tasks)
    staged = Staged(model, schedule)
    if not len(Capstan(model, friction).tendon):
        return staged
    return Compensated(staged, model, lag=lag, delay=delay, friction=friction)
