"""Plans through a fold: bounded commands that move a robot from a state to an equilibrium (q*, u*).

`path_search` finds them. A plan also has the gains that keep the robot on its path.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.checks import array, instances, number
from softdyn.controllers.predictive.objective import stiffness_at_rest
from softdyn.controllers.predictive.path_search import (
    FORM,
    HOLD,
    HORIZON,
    RATE,
    SPEED,
    STEP,
    Path,
    PathProblem,
    coast,
    search_path,
)
from softdyn.controllers.predictive.rest_target import RestTarget
from softdyn.dynamics.model import check_model

TRAVELS = (1.0, 0.6)  # s, durations of the first guess, tried one after the other
NEAR = 0.05  # of the first ‖q - q*‖²_S: a path that ends nearer is taken
USEFUL = 0.25  # one that ends farther is no plan


@dataclass(frozen=True, eq=False)
class Plan:
    """A path of commands and states through N steps, and the gains that keep a robot on it.

    Attributes
    ----------
    target : RestTarget
        The equilibrium it goes to.
    goal : ndarray, (3,)
        The point (m) that the tip has to reach.
    lag : float
        Time constant (s) of the actuators.
    q, v, acting : ndarray, (N + 1, nv), (N + 1, nv), (N + 1, nu)
        Joint coordinates, velocities and acting inputs.
    y : ndarray, (N + 1, 3)
        Tip positions (m).
    commands : ndarray, (N, nu)
        The command during each step, within the bounds.
    gains : ndarray, (N, nu, 2 nv + nu)
        Change of the command by the differences of (q, q̇, a); zero for a command at a bound.
    cost : float
        The objective (m²).
    """

    target: RestTarget
    goal: np.ndarray
    lag: float
    q: np.ndarray
    v: np.ndarray
    acting: np.ndarray
    y: np.ndarray
    commands: np.ndarray
    gains: np.ndarray
    cost: float

    @property
    def times(self) -> np.ndarray:
        """Times (N + 1,) of the states (s)."""
        return STEP * np.arange(len(self.q))

    @property
    def error(self) -> np.ndarray:
        """Distance (N + 1,) of the tip from the goal (m)."""
        distance: np.ndarray = np.linalg.norm(self.y - self.goal, axis=1)
        return distance

    def command(self, t: float, q: np.ndarray, v: np.ndarray, acting: np.ndarray) -> np.ndarray:
        """The command (nu,), not yet bounded, at the time t in a state of the robot.

        Parameters
        ----------
        t : float
            Time since the plan's begin (s), before its end.
        q, v, acting : ndarray, (nv,), (nv,), (nu,)
            Joint coordinates, velocities, acting input.
        """
        k = min(int(t / STEP + 1e-9), len(self.commands) - 1)
        part = t / STEP - k
        planned = [(1 - part) * x[k] + part * x[k + 1] for x in (self.q, self.v, self.acting)]
        # an input that acts at once is no state between the plan's steps
        late = acting - planned[2] if self.lag > 0 else np.zeros_like(acting)
        away = np.concatenate((q - planned[0], v - planned[1], late))
        command: np.ndarray = self.commands[k] + self.gains[k] @ away
        return command


def make_plan(
    model: SoftModel, q: np.ndarray, v: np.ndarray, acting: np.ndarray,
    targets: Sequence[RestTarget], goal: np.ndarray | None = None, lag: float = 0.0,
    wait: float = 0.0,
) -> Plan | None:  # fmt: skip
    """A plan from a state to one of some equilibria; None if no path comes near a target's shape.

    The targets are tried one after the other, until a path ends in the target's shape. If none
    does, the plan is the path that ends nearest. It depends on the arguments alone.

    Parameters
    ----------
    model : SoftModel
        The robot.
    q, v, acting : ndarray, (nq,), (nv,), (nu,)
        The state at its begin, and the input that acts then.
    targets : sequence of RestTarget
        The equilibria, the best first.
    goal : ndarray, (3,), optional
        The point (m) for the tip, by default the tip of the target.
    lag : float
        Time constant (s) of the actuators.
    wait : float
        Time (s) for which the acting input stays before the plan begins.

    Raises
    ------
    InputError
        Arrays of other shapes, or that are not finite; a robot without inputs; a negative lag.
    """
    n, m = check_model(model).nv, model.nu
    if m == 0:
        raise InputError("model", "a robot with actuators", model.name)
    start = array("q", q, (model.nq,)), array("v", v, (n,)), array("acting", acting, (m,))
    lag = number("lag", lag, lower=0.0)
    point = None if goal is None else array("goal", goal, (3,))
    given = instances("targets", targets, RestTarget, "a RestTarget")
    best: tuple[float, Plan] | None = None
    for target, travel in product(given, TRAVELS):
        y = model.state(target.q, np.zeros(n)).y if point is None else point
        problem = coast(_pose(model, start, target, y, lag), wait)
        found = None if problem is None else search_path(problem, travel)
        if problem is None or found is None:
            continue
        left = found[0].left(problem)
        if left < (USEFUL if best is None else best[0]):
            best = left, _plan(problem, lag, *found)
        if left < NEAR:
            break
    return None if best is None else best[1]


def _pose(
    model: SoftModel, start: tuple[np.ndarray, np.ndarray, np.ndarray], target: RestTarget,
    goal: np.ndarray, lag: float,
) -> PathProblem:  # fmt: skip
    n, m = model.nv, model.nu
    state, S, compliance = stiffness_at_rest(model, HORIZON)
    R = compliance * state.B.T @ np.linalg.solve(S, state.B)
    kept = math.exp(-STEP / lag) if lag > 0 else 0.0
    weight = np.zeros((2 * n + m, 2 * n + m))
    weight[:n, :n] = FORM * compliance * S
    weight[n : 2 * n, n : 2 * n] = (SPEED * HORIZON) ** 2 * compliance * S
    weight[2 * n :, 2 * n :] = HOLD * np.diag(np.diag(R))
    change = (1 - kept) ** 2 * RATE * (R + 1e-8 * np.trace(R) * np.eye(m))
    mean = (1 - kept) * lag / STEP
    return PathProblem(model, start, target, goal, kept, mean, weight, change)


def _plan(problem: PathProblem, lag: float, path: Path, gains: np.ndarray) -> Plan:
    """The plan of a path."""
    n = problem.model.nv
    begin = problem.model.state(*problem.start[:2]).y
    y = np.vstack((begin, path.error + problem.goal))
    q, v, acting = path.x[:, :n], path.x[:, n : 2 * n], path.x[:, 2 * n :]
    return Plan(problem.target, problem.goal, lag, q, v, acting, y, path.commands, gains, path.cost)
