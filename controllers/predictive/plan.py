"""Plans through a fold: bounded commands that move a robot from a state to an equilibrium (q*, u*).

The path obeys the analytic model in steps T of backward Euler,

    M (q̇⁺ - q̇) / T + h - B ā + stops = 0 at (q⁺, q̇⁺),   q⁺ = q ⊕ T q̇⁺,   a⁺ = E a + (1 - E) c,

where a joint beyond a limit meets a stiff spring. E = e^(-T/λ) is the share of the acting input a
that actuators of lag λ keep, and ā its mean over the step (`actuation`). The commands c minimise

    Σ ‖y - y*‖² + speed² ‖q̇‖²_W + κ ‖a - u*‖²_diag(R) + σ ‖q - q*‖²_S / λ_S + rate ‖a⁺ - a‖²_R

by iLQR with bounds (`riccati`), in the metric of `Mpc`. The weight σ of the shape is large, because
the tip's error alone leads back to the branch of equilibria where the path starts. The first guess
is the target's inputs, multiplied by a factor for half a second.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from softdyn import InputError, SoftModel, State
from softdyn.checks import array, number
from softdyn.controllers.predictive.rest_target import RestTarget
from softdyn.controllers.predictive.riccati import backward
from softdyn.dynamics.derivatives import residual_derivatives
from softdyn.dynamics.model import check_model

STEP = 0.01  # T (s)
STEPS = 150
FORM = 3.0  # σ
PULLS = (4.0, 8.0, 12.0)  # factors on the target's inputs, tried one after the other
PULL = 0.5  # s, how long a factor acts
NEAR = 0.2  # of the first ‖q - q*‖²_S: a path that ends nearer needs no further factor
HORIZON, SPEED, RATE, HOLD = 0.3, 0.05, 1e-4, 1e-3  # s, s; the weights, as `Mpc` has them
STOP = 1e4  # stiffness of a stop, in M_jj / T²
ITERATIONS = 30
SETTLED = 1e-4  # relative decrease of the cost at which a pass ends
DAMPED = 1.0  # in diag(R): a step shorter than with this is not tried
SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)  # of a step, tried until the cost falls
NEWTON = 12  # iterations of a step
EXACT, USEFUL = 1e-7, 1e-3  # rad, m: error of a step at which Newton's method ends; largest allowed


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


@dataclass(frozen=True, eq=False)
class _Problem:
    """The model, its start and its target, and the weights."""

    model: SoftModel
    start: tuple[np.ndarray, np.ndarray, np.ndarray]
    target: RestTarget
    goal: np.ndarray
    kept: float
    mean: float  # share of the first input in its mean over a step
    form: np.ndarray  # S / λ_S
    weight: np.ndarray
    change: np.ndarray


@dataclass(frozen=True, eq=False)
class _Path:
    """A path, linearised: x before each step, and after it the arguments of `backward`."""

    cost: float
    x: np.ndarray
    commands: np.ndarray
    A: np.ndarray
    B: np.ndarray
    J: np.ndarray
    error: np.ndarray
    away: np.ndarray
    gap: np.ndarray


def make_plan(
    model: SoftModel, q: np.ndarray, v: np.ndarray, acting: np.ndarray, target: RestTarget,
    goal: np.ndarray, lag: float = 0.0,
) -> Plan | None:  # fmt: skip
    """A plan from a state to an equilibrium; None if no path could be simulated.

    It depends on the arguments alone.

    Parameters
    ----------
    model : SoftModel
        The robot.
    q, v, acting : ndarray, (nq,), (nv,), (nu,)
        The state at its begin, and the input that acts then.
    target : RestTarget
        The equilibrium.
    goal : ndarray, (3,)
        The point (m) for the tip.
    lag : float
        Time constant (s) of the actuators.

    Raises
    ------
    InputError
        Arrays of other shapes, or that are not finite; a robot without inputs; a negative lag.
    """
    problem = _pose(model, q, v, acting, target, goal, number("lag", lag, lower=0.0))
    factor = np.where(np.arange(STEPS) * STEP < PULL, 1.0, 0.0)[:, None]
    best: tuple[_Path, np.ndarray] | None = None
    for pull in PULLS:
        found = _improve(problem, (1.0 + (pull - 1.0) * factor) * target.u)
        if found is not None and (best is None or found[0].cost < best[0].cost):
            best = found
        if best is not None and _form(problem, best[0], -1) < NEAR * _form(problem, best[0], 0):
            break
    return None if best is None else _plan(problem, lag, *best)


def _pose(
    model: SoftModel, q: np.ndarray, v: np.ndarray, acting: np.ndarray, target: RestTarget,
    goal: np.ndarray, lag: float,
) -> _Problem:  # fmt: skip
    """The problem, from checked arguments."""
    n, m = check_model(model).nv, model.nu
    if m == 0:
        raise InputError("model", "a robot with actuators", model.name)
    start = array("q", q, (model.nq,)), array("v", v, (n,)), array("acting", acting, (m,))
    state = model.state(model.q0, np.zeros(n))
    S = state.M / HORIZON**2 + state.D / HORIZON + np.diag(model.stiffness)
    compliance = float(np.linalg.norm(state.J @ np.linalg.solve(S, state.J.T), 2))
    R = compliance * state.B.T @ np.linalg.solve(S, state.B)
    kept = math.exp(-STEP / lag) if lag > 0 else 0.0
    weight = np.zeros((2 * n + m, 2 * n + m))
    weight[:n, :n] = FORM * compliance * S
    weight[n : 2 * n, n : 2 * n] = (SPEED * HORIZON) ** 2 * compliance * S
    weight[2 * n :, 2 * n :] = HOLD * np.diag(np.diag(R))
    change = (1 - kept) ** 2 * RATE * (R + 1e-8 * np.trace(R) * np.eye(m))
    goal = array("goal", goal, (3,))
    mean = (1 - kept) * lag / STEP
    return _Problem(model, start, target, goal, kept, mean, compliance * S, weight, change)


def _improve(problem: _Problem, commands: np.ndarray) -> tuple[_Path, np.ndarray] | None:
    """The path of least cost near that of the commands, and its gains; None if there is none."""
    n, m = problem.model.nv, problem.model.nu
    path, scale = _simulate(problem, commands), problem.weight[2 * n :, 2 * n :] / HOLD
    if path is None:
        return None
    damping = 1e-6
    for _ in range(ITERATIONS):
        steps, gains = _backward(problem, path, damping * scale)
        tried = (_simulate(problem, path.commands + a * steps, path, gains) for a in SHARES)
        after = next((one for one in tried if one is not None and one.cost < path.cost), None)
        if after is None:
            damping *= 10
            if damping > DAMPED:
                break
            continue
        gain, path, damping = path.cost - after.cost, after, max(damping / 5, 1e-9)
        if gain < SETTLED * path.cost:
            break
    return path, _backward(problem, path, np.zeros((m, m)))[1]


def _backward(problem: _Problem, path: _Path, extra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    model = problem.model
    lower, upper = model.u_min - path.commands, model.u_max - path.commands
    steps, gains = backward(
        path.A, path.B, path.J, path.error, path.away, path.gap, problem.weight, problem.change,
        extra, lower, upper,
    )  # fmt: skip
    return steps, gains


def _simulate(
    problem: _Problem, commands: np.ndarray, near: _Path | None = None,
    gains: np.ndarray | None = None,
) -> _Path | None:  # fmt: skip
    """The path under the commands, with the gains' feedback to another path; None if it ends early.

    It ends where a step has no solution, or where it already costs more than the other path.
    """
    model = problem.model
    (q, v, a), cost = problem.start, 0.0
    aim = model.coordinates(problem.target.q)
    rows: list[tuple[np.ndarray, ...]] = []
    for k, command in enumerate(commands):
        x = np.concatenate((model.coordinates(q), v, a))
        c = command if near is None or gains is None else command + gains[k] @ (x - near.x[k])
        c = np.clip(c, model.u_min, model.u_max)
        after = _step(problem, q, v, problem.mean * a + (1 - problem.mean) * c)
        if after is None:
            return None
        state, A, B = after
        gap, a = c - a, problem.kept * a + (1 - problem.kept) * c
        away = np.concatenate((model.coordinates(state.q) - aim, state.v, a - problem.target.u))
        error = state.y - problem.goal
        cost += error @ error + away @ problem.weight @ away + gap @ problem.change @ gap
        if not cost < (np.inf if near is None else near.cost):
            return None
        rows.append((x, c, A, B, state.J, error, away, gap))
        q, v = state.q, state.v
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    return _Path(float(cost), *columns)


def _step(
    problem: _Problem, q: np.ndarray, v: np.ndarray, mean: np.ndarray
) -> tuple[State, np.ndarray, np.ndarray] | None:
    """The state after a step under a mean input, and its derivatives by (q, q̇, a) and c.

    Newton's method; None if it does not converge.
    """
    model, n, m = problem.model, problem.model.nv, problem.model.nu
    after = v
    for _ in range(NEWTON):
        state = model.state(model.integrate(q, STEP * after), after)
        rate, at = (after - v) / STEP, model.coordinates(state.q)
        beyond = at - np.clip(at, model.lower, model.upper)
        spring = STOP / STEP**2 * np.diag(state.M)
        force = state.M @ rate + state.h - state.B @ mean + spring * beyond
        K, D = residual_derivatives(model, state.q, after, rate, mean)
        K = K + np.diag(np.where(beyond != 0, spring, 0.0))
        matrix = state.M + STEP * D + STEP**2 * K
        right = np.column_stack((force, K, state.M, state.B))
        try:
            solved = STEP * np.linalg.solve(matrix, right)
        except np.linalg.LinAlgError:
            return None
        missed = STEP * float(np.abs(solved[:, 0]).max())
        if not missed > EXACT:  # NaN ends it, too
            break
        after = after - solved[:, 0]
    if not missed < USEFUL:
        return None
    A, B = np.zeros((2 * n + m, 2 * n + m)), np.zeros((2 * n + m, m))
    A[n : 2 * n, :n], A[n : 2 * n, n : 2 * n] = (
        -solved[:, 1 : n + 1],
        solved[:, n + 1 : 2 * n + 1] / STEP,
    )
    A[n : 2 * n, 2 * n :] = problem.mean * solved[:, 2 * n + 1 :]
    B[n : 2 * n] = (1 - problem.mean) * solved[:, 2 * n + 1 :]
    A[:n], B[:n] = STEP * A[n : 2 * n], STEP * B[n : 2 * n]
    A[:n, :n] += np.eye(n)
    A[2 * n :, 2 * n :], B[2 * n :] = problem.kept * np.eye(m), (1 - problem.kept) * np.eye(m)
    return state, A, B


def _form(problem: _Problem, path: _Path, k: int) -> float:
    """‖q - q*‖²_S / λ_S after step k."""
    away = path.away[k][: problem.model.nv]
    return float(away @ problem.form @ away)


def _plan(problem: _Problem, lag: float, path: _Path, gains: np.ndarray) -> Plan:
    """The plan of a path."""
    model, target = problem.model, problem.target
    n = model.nv
    aim = np.concatenate((model.coordinates(target.q), np.zeros(n), target.u))
    x = np.vstack((path.x, path.away[-1] + aim))
    begin = model.state(*problem.start[:2]).y
    y = np.vstack((begin, path.error + problem.goal))
    q, v, acting = x[:, :n], x[:, n : 2 * n], x[:, 2 * n :]
    return Plan(target, problem.goal, lag, q, v, acting, y, path.commands, gains, path.cost)
