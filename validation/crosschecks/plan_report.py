"""A plan through a fold, and the twin's verdict on it.

report = plan_report(model, point)
print(report)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from softdyn import Reference, SetPoint, SoftModel, State, statics
from softdyn.controllers import Command, Mpc
from softdyn.controllers.predictive.plan import Plan, make_plan
from softdyn.controllers.predictive.rest_target import RestTargets
from softdyn.statics import StaticsError
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.simulate import simulate
from softdyn.validation.tables import Table
from softdyn.validation.twin.rig import Rig

CM = 100.0  # per metre
ROWS = 16  # of the table, spread over the path
SHAPED = 0.2  # of the first distance of the joints: beyond the fold they stay nearer


@dataclass(frozen=True, eq=False)
class PlanReport:
    """A plan and its run in the twin.

    Attributes
    ----------
    plan : Plan
        It begins at the stable equilibrium that is nearest to the goal on the branch from rest.
    residual : float
        Largest unbalanced force (N m, N) of the target's equilibrium.
    log : Log
        The twin's run: the plan with its gains, then `Mpc` with the plan's target.
    """

    plan: Plan
    residual: float
    log: Log

    @property
    def through(self) -> float:
        """Time (s) after which the joints stay within a fifth of their first distance to q*."""
        away = np.linalg.norm(self.plan.q - self.plan.q[-1], axis=1)
        far = np.flatnonzero(away > SHAPED * away[0])
        return float(self.plan.times[far[-1] + 1]) if far.size else 0.0

    def to_dict(self) -> dict[str, Any]:
        """In numbers."""
        plan = self.plan
        return {
            "target": {
                "u": plan.target.u.tolist(), "q": plan.target.q.tolist(),
                "stable": plan.target.stable, "distance_cm": CM * plan.target.distance,
                "residual": self.residual,
            },
            "start_error_cm": CM * float(plan.error[0]),
            "planned_error_cm": CM * float(plan.error[-1]),
            "through_s": self.through,
            "largest_input": float(np.abs(plan.commands).max()),
            "twin_error_cm": self.log.final_error_cm,
            "t": plan.times[:-1].tolist(),
            "u": plan.commands.tolist(),
            "tip": plan.y.tolist(),
        }  # fmt: skip

    def __str__(self) -> str:
        plan, found = self.plan, self.to_dict()
        every = max(1, len(plan.commands) // ROWS)
        rows = [
            [plan.times[k], *plan.commands[k], CM * plan.error[k]]
            for k in range(0, len(plan.commands), every)
        ]
        names = [one.name for one in self.log.source.model().robot.actuators]
        formats = [".2f", *(".3g" for _ in names), ".2f"]
        kind = "stable" if plan.target.stable else "unstable"
        return "\n".join((
            f"{kind} target {CM * plan.target.distance:.3f} cm from the point, "
            f"unbalanced forces {self.residual:.1e}",
            f"plan: {plan.error[0] * CM:.2f} cm from the point at first, "
            f"{found['planned_error_cm']:.2f} at its end; through the fold after "
            f"{self.through:.2f} s; largest input {found['largest_input']:.3g}",
            Table(["t (s)", *names, "error (cm)"], rows, formats).text(),
            f"twin: {found['twin_error_cm']:.2f} cm after {self.log.t[-1]:g} s",
        ))  # fmt: skip


class _Planned:
    """A controller that begins with a plan."""

    name = "plan"

    def __init__(self, controller: Mpc, plan: Plan) -> None:
        self._controller, self._plan, self.guard = controller, plan, controller.guard

    def reset(self, period: float) -> None:
        self._controller.reset(period)
        self._controller.follow(self._plan)

    def __call__(self, state: State, reference: Reference) -> Command:
        return self._controller(state, reference)


def plan_report(
    model: SoftModel, goal: np.ndarray, lag: float = 0.0, delay: float = 0.0, seconds: float = 5.0
) -> PlanReport:
    """Plan from where the robot comes without a snap to an equilibrium at the goal; run the twin.

    Parameters
    ----------
    model : SoftModel
        The robot.
    goal : ndarray, (3,)
        The point (m) for the tip.
    lag, delay : float
        Lag and delay of the actuators (s).
    seconds : float
        Length of the twin's run (s).

    Raises
    ------
    StaticsError
        The robot has no equilibrium to start from, or no path could be simulated.
    """
    goal = np.asarray(goal, float)
    targets = RestTargets(model)
    found = targets.find(goal, waits=True) or ()
    if not found:
        raise StaticsError(f"no equilibrium of {model.name} for the tip at {goal} m", np.inf)
    start = statics.approach(statics.rest(model), goal, stay_stable=True)
    plan = make_plan(model, start.q, np.zeros(model.nv), start.u, found, goal, lag)
    if plan is None:
        raise StaticsError(f"no path of {model.name} could be simulated", np.inf)
    controller = Mpc(model, lag=lag, delay=delay, targets=targets)
    log = simulate(
        model, _Planned(controller, plan), SetPoint(goal), q0=start.q, duration=seconds,
        rig=Rig(delay=delay, lag=lag, file=False),
    )  # fmt: skip
    force = float(np.abs(statics.residual(model, plan.target.q, plan.target.u)).max())
    return PlanReport(plan, force, log)
