"""Solve r(q, u) = 0 and y(q) = y* together, from arbitrary shapes.

`explore` lets the tip give way, so that it ends at an equilibrium in most cases. Here the tip ends
at the target or there is no answer. It takes milliseconds, so that hundreds of shapes can be tried.
"""

from __future__ import annotations

import numpy as np

from softdyn.checks import array
from softdyn.dynamics.derivatives import stiffness
from softdyn.dynamics.model import State
from softdyn.dynamics.stops import Stops
from softdyn.statics.branch import REACHED
from softdyn.statics.equilibria import balance
from softdyn.statics.equilibrium import Equilibrium, StaticsError
from softdyn.statics.explore import TipProblem

ITERATIONS = 40
LARGEST_STEP = 0.5  # of a joint's scale in one iteration
ENOUGH = 1e-16  # sum of the squared scaled residuals
CLOSE = 1e-10  # of it: from here `balance` is tried


def solve_at_tip(problem: TipProblem, q: np.ndarray, u: np.ndarray) -> Equilibrium:
    """The equilibrium, stable or not, with its tip at the problem's target, from any shape.

    The method is Levenberg-Marquardt; steps are cut at the bounds of joints and inputs. It does not
    find equilibria at a joint's limit.

    Parameters
    ----------
    problem : TipProblem
        The robot and the target.
    q, u : ndarray, (nq,), (nu,)
        The first configuration and input.

    Raises
    ------
    StaticsError
        If it ends elsewhere.
    """
    model, n = problem.model, problem.model.nv
    size = np.concatenate((problem.force, np.full(3, problem.length)))
    locked = Stops.of(model).locked
    joints = problem.free < n

    def residual(x: np.ndarray) -> tuple[np.ndarray, State]:
        """The scaled residuals, and the state at rest."""
        q, u = problem.shape(x)
        state = model.state(q, np.zeros(n))
        r = state.K + state.bias - state.B @ u
        r[locked] = 0.0  # their stops take any force
        return np.concatenate((r, state.y - problem.target)) / size, state

    x = problem.unknowns(array("q", q, (model.nq,)), array("u", u, (model.nu,)))
    x = np.clip(x, problem.low, problem.high)
    (r, state), damping = residual(x), 1e-2
    for _ in range(ITERATIONS):
        cost = r @ r
        if cost < ENOUGH or damping > 1.0:
            break
        slope = np.zeros((n + 3, n + model.nu))
        slope[:n, :n] = stiffness(model, state.q, problem.shape(x)[1])
        slope[:n, n:], slope[n:, :n] = -state.B, state.J
        slope[:n][locked] = 0.0
        slope = problem.scaled(slope, size[:, None])
        square, fall = slope.T @ slope, slope.T @ r
        while damping <= 1.0:
            step = np.linalg.solve(square + damping * np.eye(len(x)), -fall)
            step *= min(1.0, LARGEST_STEP / max(np.abs(step[joints]).max(initial=0.0), 1e-300))
            trial = np.clip(x + step, problem.low, problem.high)
            after, there = residual(trial)
            if after @ after < cost:
                x, r, state, damping = trial, after, there, max(damping / 10, 1e-12)
                break
            damping = max(10 * damping, 1e-8)
    missed = float(np.abs(r * size)[:n].max(initial=0.0))
    if r @ r < CLOSE:
        q, u = problem.shape(x)
        found = balance(model, u, q)
        if np.linalg.norm(found.y - problem.target) < REACHED:
            return found
    raise StaticsError(f"no equilibrium of {model.name} with the tip at {problem.target} m", missed)
