"""Search for the bounded commands that move a robot from a state to an equilibrium (q*, u*).

The path obeys the analytic model in steps T of backward Euler,

    M (q̇⁺ - q̇) / T + h - B ā + stops = 0 at (q⁺, q̇⁺),   q⁺ = q ⊕ T q̇⁺,   a⁺ = E a + (1 - E) c,

where a joint beyond a limit meets a stiff spring. E = e^(-T/λ) is the share of the acting input a
that actuators of lag λ keep, and ā its mean over the step (`actuation`). The commands c minimise

    Σ ‖y - y*‖² + speed² ‖q̇‖²_W + κ ‖a - u*‖²_diag(R) + σ ‖q - q*‖²_S / λ_S + rate ‖a⁺ - a‖²_R

in the metric of `Mpc`, where the last state counts `TAIL` times more. The method is iLQR with
bounds (`riccati`) from states that are no motion: the shape goes straight to q*. Each iteration
closes part of the gaps between these states and the model's steps, as in Mastalli et al.,
"Crocoddyl" (2020). Simulated from the start alone, an arm that buckles loses the target's shape.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from softdyn import SoftModel, State
from softdyn.controllers.predictive.rest_target import RestTarget
from softdyn.controllers.predictive.riccati import backward
from softdyn.dynamics.derivatives import residual_derivatives

STEP = 0.01  # T (s)
STEPS = 150
FORM = 0.3  # σ
HORIZON, SPEED, RATE, HOLD = 0.3, 0.05, 1e-3, 1e-3  # s, s; the weights, as `Mpc` has them
TAIL = 50.0
STOP = 1e4  # stiffness of a stop, in M_jj / T²
ITERATIONS = 60
SETTLED = 1e-3  # relative decrease of the cost at which it ends
DAMPED = 1.0  # in diag(R): a step shorter than with this is not tried
SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)  # of a step, tried until the cost falls
CLOSING = (0.15, 0.07)  # the same while there are gaps
CLOSED = 1.0  # sum of the gaps below which a whole step closes them
GAPS = 1e3  # cost of the sum of the gaps
NEWTON = 12  # iterations of a step
CLOSE = 1e-4  # rad, m: a step's error before Newton's last iteration
USEFUL = 1e-3  # rad, m: a larger one is no solution


@dataclass(frozen=True, eq=False)
class PathProblem:
    """The model, its start and its target, and the weights.

    Attributes
    ----------
    start : tuple of ndarray, (nq,), (nv,), (nu,)
        Configuration, velocity and acting input at the begin.
    goal : ndarray, (3,)
        The point (m) for the tip.
    kept, mean : float
        Shares of the first input in the acting input after a step, and in its mean over it.
    weight : ndarray, (2 nv + nu, 2 nv + nu)
        Of a state's distance from the target.
    change : ndarray, (nu, nu)
        Of a command's distance from the acting input.
    """

    model: SoftModel
    start: tuple[np.ndarray, np.ndarray, np.ndarray]
    target: RestTarget
    goal: np.ndarray
    kept: float
    mean: float
    weight: np.ndarray
    change: np.ndarray

    @property
    def aim(self) -> np.ndarray:
        """The target's state (2 nv + nu,)."""
        model, target = self.model, self.target
        return np.concatenate((model.coordinates(target.q), np.zeros(model.nv), target.u))


@dataclass(frozen=True, eq=False)
class Path:
    """A path of N steps, linearised.

    Attributes
    ----------
    cost, gaps : float
        The objective (m²), and the sum of |drift|.
    x : ndarray, (N + 1, 2 nv + nu)
        States: joint coordinates, velocities, acting inputs.
    commands : ndarray, (N, nu)
    A, B, J, error, away, gap, drift
        See `riccati.backward`.
    """

    cost: float
    gaps: float
    x: np.ndarray
    commands: np.ndarray
    A: np.ndarray
    B: np.ndarray
    J: np.ndarray
    error: np.ndarray
    away: np.ndarray
    gap: np.ndarray
    drift: np.ndarray

    @property
    def merit(self) -> float:
        """The cost, with that of the gaps."""
        return self.cost + GAPS * self.gaps

    def left(self, problem: PathProblem) -> float:
        """Share of ‖q - q*‖²_S of the begin that is left at the end."""
        n = problem.model.nv
        first, last = (self.x[0] - problem.aim)[:n], self.away[-1][:n]
        form = problem.weight[:n, :n]
        return float(last @ form @ last) / max(float(first @ form @ first), 1e-300)


def coast(problem: PathProblem, duration: float) -> PathProblem | None:
    """The problem some time (s) later, if the acting input stays; None if that has no solution."""
    q, v, a = problem.start
    for _ in range(round(duration / STEP)):
        solved = _step(problem, q, v, a, v)
        if solved is None:
            return None
        q, v = solved[0].q, solved[0].v
    return replace(problem, start=(q, v, a))


def search_path(problem: PathProblem, travel: float) -> tuple[Path, np.ndarray] | None:
    """A path of least cost, and its gains (N, nu, 2 nv + nu); None if none could be simulated.

    Parameters
    ----------
    problem : PathProblem
    travel : float
        Time (s) in which the first guess moves the shape to the target's.
    """
    guess = _straight(problem, travel)
    n, m = problem.model.nv, problem.model.nu
    scale = problem.weight[2 * n :, 2 * n :]
    path = _simulate(problem, guess[:, 2 * n :], states=guess)
    if path is None:
        return None
    damping = 1e-6
    for _ in range(ITERATIONS):
        steps, gains = _backward(problem, path, damping * scale / HOLD)
        shares = SHARES if path.gaps == 0 else CLOSING if path.gaps > CLOSED else SHARES[:1]
        tried = (_simulate(problem, path.commands, path, share, steps, gains) for share in shares)
        after = next((one for one in tried if one and one.merit < path.merit), None)
        if after is None:
            damping *= 10
            if damping > DAMPED:
                break
            continue
        gain, path, damping = path.merit - after.merit, after, max(damping / 5, 1e-9)
        if path.gaps == 0 and gain < SETTLED * path.cost:
            break
    if path.gaps > 0:
        return None
    return path, _backward(problem, path, np.zeros((m, m)))[1]


def _straight(problem: PathProblem, travel: float) -> np.ndarray:
    """States (N, 2 nv + nu) on the straight line to the target."""
    model, n = problem.model, problem.model.nv
    q, _, a = problem.start
    t = np.minimum(STEP * np.arange(1, STEPS + 1) / travel, 1.0)[:, None]
    share, rate = t * t * (3 - 2 * t), 6 * t * (1 - t) / travel
    first = np.concatenate((model.coordinates(q), np.zeros(n), a))
    states: np.ndarray = first + share * (problem.aim - first)
    states[:, n : 2 * n] = rate * (problem.aim - first)[:n]
    return states


def _backward(problem: PathProblem, path: Path, extra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    model = problem.model
    lower, upper = model.u_min - path.commands, model.u_max - path.commands
    steps, gains = backward(
        path.A, path.B, path.J, path.error, path.away, path.gap, path.drift, problem.weight,
        TAIL * problem.weight, problem.change, extra, lower, upper,
    )  # fmt: skip
    return steps, gains


def _simulate(
    problem: PathProblem, commands: np.ndarray, near: Path | None = None, share: float = 1.0,
    steps: np.ndarray | None = None, gains: np.ndarray | None = None,
    states: np.ndarray | None = None,
) -> Path | None:  # fmt: skip
    """The path under commands, with feedback to a near path, or through the given states.

    It keeps the rest of the near path's gaps. None where a step has no solution, or where it costs
    more than the near path.
    """
    model, n, aim = problem.model, problem.model.nv, problem.aim
    (q, v, a), cost, gaps = problem.start, 0.0, 0.0
    rows: list[tuple[np.ndarray, ...]] = []
    x = np.concatenate((model.coordinates(q), v, a))
    for k, command in enumerate(commands):
        c, guess, drift = command, v, np.zeros_like(x)
        if near is not None and steps is not None and gains is not None:
            off = x - near.x[k]
            c = np.clip(c + share * steps[k] + gains[k] @ off, model.u_min, model.u_max)
            drift = (1 - share) * near.drift[k]
            moved = near.A[k] @ off + near.B[k] @ (c - near.commands[k])
            guess = (near.x[k + 1] + near.drift[k] + moved)[n : 2 * n]
        c = np.clip(c, model.u_min, model.u_max)
        solved = _step(problem, q, v, problem.mean * a + (1 - problem.mean) * c, guess)
        if solved is None:
            return None
        state, A, B = solved
        after = problem.kept * a + (1 - problem.kept) * c
        end = np.concatenate((model.coordinates(state.q), state.v, after))
        if states is not None:
            drift = end - states[k]
        if drift.any():
            end = end - drift
            state = model.state(model.configuration(end[:n]), end[n : 2 * n])
        error, away, gap = state.y - problem.goal, end - aim, c - a
        cost += error @ error + away @ problem.weight @ away + gap @ problem.change @ gap
        gaps += float(np.abs(drift).sum())
        if not cost + GAPS * gaps < (np.inf if near is None else near.merit):
            return None
        rows.append((x, c, A, B, state.J, error, away, gap, drift))
        q, v, a, x = state.q, end[n : 2 * n], end[2 * n :], end
    cost += TAIL * (away @ problem.weight @ away)
    first, *columns = (np.array(column) for column in zip(*rows, strict=True))
    return Path(float(cost), gaps, np.vstack((first, x)), *columns)


def _step(
    problem: PathProblem, q: np.ndarray, v: np.ndarray, mean: np.ndarray, guess: np.ndarray
) -> tuple[State, np.ndarray, np.ndarray] | None:
    """The state after a step under a mean input, and its derivatives by (q, q̇, a) and c.

    Newton's method from a guess of the velocity after it; None if it does not converge.
    """
    model, n, m = problem.model, problem.model.nv, problem.model.nu
    after, missed = guess, np.inf
    for _ in range(NEWTON):
        state = model.state(model.integrate(q, STEP * after), after)
        if missed < CLOSE:  # the last iteration left its square
            break
        rate, at = (after - v) / STEP, model.coordinates(state.q)
        beyond = at - np.clip(at, model.lower, model.upper)
        spring = STOP / STEP**2 * state.M.diagonal()
        force = state.M @ rate + state.h - state.B @ mean + spring * beyond
        K, D = residual_derivatives(model, state.q, after, rate, mean)
        K.flat[:: n + 1] += np.where(beyond != 0, spring, 0.0)
        matrix = state.M + STEP * D + STEP**2 * K
        right = np.column_stack((force, K, state.M, state.B))
        try:
            solved = STEP * np.linalg.solve(matrix, right)
        except np.linalg.LinAlgError:
            return None
        missed = STEP * float(np.abs(solved[:, 0]).max())
        after = after - solved[:, 0]
        if not np.isfinite(missed):
            return None
    if not missed < USEFUL:
        return None
    A, B = np.zeros((2 * n + m, 2 * n + m)), np.zeros((2 * n + m, m))
    by_q, by_v, by_u = solved[:, 1 : n + 1], solved[:, n + 1 : 2 * n + 1], solved[:, 2 * n + 1 :]
    A[n : 2 * n] = np.hstack((-by_q, by_v / STEP, problem.mean * by_u))
    B[n : 2 * n] = (1 - problem.mean) * by_u
    A[:n], B[:n] = STEP * A[n : 2 * n], STEP * B[n : 2 * n]
    A[:n, :n] += np.eye(n)
    A[2 * n :, 2 * n :], B[2 * n :] = problem.kept * np.eye(m), (1 - problem.kept) * np.eye(m)
    return state, A, B
