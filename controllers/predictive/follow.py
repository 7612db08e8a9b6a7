"""Lead a robot to the shape of a target: by a plan, then by the target's terms."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from softdyn import SoftModel, State
from softdyn.controllers.predictive.background import Job
from softdyn.controllers.predictive.plan import Plan, make_plan
from softdyn.controllers.predictive.rest_target import WITHIN, RestTarget

STUCK = 1.0  # s without arriving after which targets are searched for, or another plan is made
ARRIVES = 0.5  # s later they act, however long the search took
BENT = 0.3  # rad, m: a joint this far from the target's shape
PLANS = 3  # for one set point


class PlanFollower:
    """The target that acts, and the command while a plan leads to it.

    Where the shape differs from the best target's by more than 0.3 rad or m in some joint, the
    acting input stays for 0.5 s, and a plan to one of the targets is made from the state to which
    this leads. It is followed with its gains to its end, and then its target acts. Without such a
    plan the best target acts at once. If tip and shape stay away for 1 s, another plan is made.

    Parameters
    ----------
    model : SoftModel
        The robot.
    lag : float
        Time constant (s) of the actuators.
    Attributes
    ----------
    target : RestTarget or None
        The one that acts.
    """

    def __init__(self, model: SoftModel, lag: float) -> None:
        self._model, self._lag = model, lag
        self.reset(0.0)

    def reset(self, period: float) -> None:
        """Begin a run with a control period (s)."""
        self._period = period
        self.begin(())

    def begin(self, targets: Sequence[RestTarget], plan: Plan | None = None) -> None:
        """Lead to one of some targets, the best first, or follow a plan."""
        self._targets, self._plan = targets, plan
        self.target = None if plan is None else plan.target
        self._away, self._time = STUCK, 0.0  # s, without arriving and since the plan's begin
        self._asked: Job[Plan | None] | None = None
        self._left = PLANS

    @property
    def planning(self) -> bool:
        """Whether a plan is being made in the background."""
        return self._asked is not None and not self._asked.done()

    def __call__(
        self,
        goal: np.ndarray | None,
        far: float,
        state: State,
        p: np.ndarray,
        v: np.ndarray,
        acting: np.ndarray,
        *,
        waits: bool,
    ) -> np.ndarray | None:
        """The command (nu,) of the plan or before it, not yet bounded; None without a plan.

        Parameters
        ----------
        goal : ndarray, (3,), optional
            The reference for the tip (m), by default the tip of the target.
        far : float
            Distance from the reference (m, rad).
        state : State
            The present state.
        p, v, acting : ndarray, (nv,), (nv,), (nu,)
            Displacement from the present configuration, velocity and acting input at the instant
            when the command begins to act.
        waits : bool
            Whether to make a plan in this call, and not in a process of its own.
        """
        if not self._targets:
            return None
        q = self._model.integrate(state.q, p)
        if self._plan is None:
            self._wait(goal, far, (q, v, acting), waits)
        if self._asked is not None:
            return self._kept
        if self._plan is None:
            return None
        if self._time >= self._plan.times[-1]:
            self._plan, self._away = None, 0.0
            return None
        command = self._plan.command(self._time, self._model.coordinates(q), v, acting)
        self._time += self._period
        return command

    def _wait(
        self, goal: np.ndarray | None, far: float, start: tuple[np.ndarray, ...], waits: bool
    ) -> None:
        """A period goes by without a plan."""
        target, coordinates = self.target or self._targets[0], self._model.coordinates
        bent = np.abs(coordinates(start[0]) - coordinates(target.q)).max(initial=0.0) > BENT
        if self._asked is None:
            away = bent and far > target.distance + WITHIN
            self._away = self._away + self._period if away else 0.0
            if self._left > 0 and self._away >= STUCK:
                q, v, self._kept = (x.copy() for x in start)
                work = partial(
                    make_plan, self._model, q, v, self._kept, self._targets,
                    None if goal is None else goal.copy(), self._lag, ARRIVES,
                )  # fmt: skip
                self._asked, self._away = Job(work, waits), 0.0
                self._left -= 1
            elif self.target is None:
                self.target = target
            return
        self._away += self._period
        if self._away >= ARRIVES and self._asked.done():
            found, self._asked, self._away = self._asked.result(), None, 0.0
            if found is None:
                self.target, self._left = self.target or target, 0
            else:
                self._plan, self._time, self.target = found, 0.0, found.target
