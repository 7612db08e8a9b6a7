"""Follow a plan where a target acts and the tip still does not arrive."""

from __future__ import annotations

from concurrent.futures import Future
from functools import partial

import numpy as np

from softdyn import SoftModel, State
from softdyn.controllers.predictive.plan import Plan, make_plan
from softdyn.controllers.predictive.rest_target import WITHIN, RestTarget, in_future

STUCK = 1.0  # s without arriving after which a target is searched for, or with one a plan made
ARRIVES = 0.5  # s later it acts, however long the search took
BENT = 0.3  # rad, m: a joint this far from the target's shape


class PlanFollower:
    """The plan of the predictive controller: when it is made, and its command.

    Where the tip stays farther than 5 mm from where the target holds it, for 1 s after the target
    began to act, a plan is made from the present state. 0.5 s later it is followed with its gains,
    to its end, once for each target, if its tip ends nearer than it begins. Near the target's
    shape, within 0.3 rad or m in each joint, the predictive controller needs no plan.

    Parameters
    ----------
    model : SoftModel
        The robot.
    lag : float
        Time constant (s) of the actuators.
    background : bool
        Whether to make the plan in a thread, for a loop in real time.
    """

    def __init__(self, model: SoftModel, lag: float, background: bool) -> None:
        self._model, self._lag, self._background = model, lag, background
        self.reset(0.0)

    def reset(self, period: float) -> None:
        """Begin a run with a control period (s)."""
        self._period = period
        self.begin(None)

    def begin(self, target: RestTarget | None, plan: Plan | None = None) -> None:
        """Follow a plan to a target, or wait for the tip to arrive there without one."""
        self._target, self._plan = target, plan
        self._away = self._time = 0.0  # s, without arriving and since the plan's begin
        self._asked: Future[Plan | None] | None = None

    def __call__(
        self, target: RestTarget | None, goal: np.ndarray, state: State,
        p: np.ndarray, v: np.ndarray, acting: np.ndarray,
    ) -> np.ndarray | None:  # fmt: skip
        """The command (nu,) of the plan, not yet bounded; None where none is followed.

        Parameters
        ----------
        target : RestTarget, optional
            The one that acts.
        goal : ndarray, (3,)
            The reference for the tip (m).
        state : State
            The present state.
        p, v, acting : ndarray, (nv,), (nv,), (nu,)
            Displacement from the present configuration, velocity and acting input at the instant
            when the command begins to act.
        """
        if target is not self._target:
            self.begin(target)
        if target is None:
            return None
        q = self._model.integrate(state.q, p)
        if self._plan is None:
            self._wait(target, goal, state.y, (q, v, acting))
        if self._plan is None or self._time >= self._plan.times[-1]:
            return None
        command = self._plan.command(self._time, self._model.coordinates(q), v, acting)
        self._time += self._period
        return command

    def _wait(
        self, target: RestTarget, goal: np.ndarray, y: np.ndarray, start: tuple[np.ndarray, ...]
    ) -> None:
        """A period goes by without a plan, with the tip at y."""
        coordinates = self._model.coordinates
        bent = np.abs(coordinates(start[0]) - coordinates(target.q)).max(initial=0.0)
        away = bent > BENT and np.linalg.norm(y - goal) > target.distance + WITHIN
        stays = away or self._asked is not None
        self._away = self._away + self._period if stays else 0.0
        if self._asked is None and self._away > STUCK:
            q, v, acting = (x.copy() for x in start)
            work = partial(make_plan, self._model, q, v, acting, target, goal.copy(), self._lag)
            self._asked = in_future(work, self._background)
        if self._asked is not None and self._away > STUCK + ARRIVES and self._asked.done():
            found, self._away = self._asked.result(), -np.inf
            if found is not None and found.error[-1] < found.error[0]:
                self._plan = found
