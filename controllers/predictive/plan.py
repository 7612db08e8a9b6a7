"""Plans through a fold: bounded commands that move a robot from a state to an equilibrium (q*, u*).

A path obeys the analytic model in steps T of backward Euler,

    M (q̇⁺ - q̇) / T + h - B ā + stops = 0 at (q⁺, q̇⁺),   q⁺ = q ⊕ T q̇⁺,   a⁺ = E a + (1 - E) c,

where a joint beyond a limit meets a stiff spring (`SpringStops`). (With the stops of `Stops`,
`best` on SpiRob at θ = 0.25 with a lag of 10 ms ended at 7.38 cm instead of 0.29.) E = e^(-T/λ) is
the share of the acting input a that actuators of lag λ keep, and ā its mean over the step
(`softdyn.actuation.drives`). The commands c minimise

    Σ ‖y - y*‖² + speed² ‖q̇‖²_W + κ ‖a - u*‖²_diag(R) + σ ‖q - q*‖²_S / λ_S + rate ‖a⁺ - a‖²_R

in the metric of `Mpc`, where the last state counts `TAIL` times more. The method is iLQR with
bounds from states that are no motion: the shape goes straight to q*. Each iteration closes part of
the gaps between these states and the model's steps, as in Mastalli et al., "Crocoddyl" (2020).
Simulated from the start alone, an arm that buckles loses the target's shape.

The backward pass has a quadratic cost-to-go ½ xᵀVx + sᵀx along x_{k+1} = A x_k + B c_k + d_k, where
the path misses the model's step by the drift d_k. With V d_k in s,

    Q_cc = Bᵀ V B + R,   Q_cx = Bᵀ V A + N,   Q_c = Bᵀ s + r,   c = step + gain x,

where the step minimises ½ cᵀ Q_cc c + Q_cᵀ c within the bounds, and the gain -Q_cc⁻¹ Q_cx is that
of the commands that are not at one (Tassa, Mansard and Todorov, "Control-limited differential
dynamic programming", 2014).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from softdyn import SoftModel, State
from softdyn.controllers.predictive.objective import stiffness_at_rest
from softdyn.controllers.predictive.rest_target import RestTarget
from softdyn.controllers.predictive.stops import SpringStops
from softdyn.controllers.qps.qp import DenseQp, QpProblem
from softdyn.dynamics.balance import ForceBalance
from softdyn.dynamics.implicit_step import ImplicitStep
from softdyn.dynamics.motors import lag_shares
from softdyn.dynamics.stops import Stops

TRAVELS = (1.0, 0.6)  # s, durations of the first guess, tried one after the other
NEAR = 0.05  # of the first ‖q - q*‖²_S: a path that ends nearer is taken
USEFUL = 0.25  # one that ends farther is no plan
STEP = 0.01  # T (s)
STEPS = 150
FORM = 0.3  # σ
HORIZON, SPEED, RATE, HOLD = 0.3, 0.05, 1e-3, 1e-3  # s, s; the weights, as `Mpc` has them
TAIL = 50.0
ITERATIONS = 60
SETTLED = 1e-3  # relative decrease of the cost at which it ends
DAMPED = 1.0  # in diag(R): a step shorter than with this is not tried
SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)  # of a step, tried until the cost falls
CLOSING = (0.15, 0.07)  # the same while there are gaps
CLOSED = 1.0  # sum of the gaps below which a whole step closes them
GAPS = 1e3  # cost of the sum of the gaps
CLOSE = 1e-4  # rad, m: a step's error before Newton's last iteration, which leaves its square


@dataclass(frozen=True, eq=False)
class Plan:
    """A path of commands and states through N steps, and the gains that keep a robot on it.

    Attributes
    ----------
    target : RestTarget
        The equilibrium it goes to.
    lag : float
        Time constant (s) of the actuators.
    q, v, acting : ndarray, (N + 1, nv), (N + 1, nv), (N + 1, nu)
        Joint coordinates, velocities and acting inputs.
    commands : ndarray, (N, nu)
        The command during each step, within the bounds.
    gains : ndarray, (N, nu, 2 nv + nu)
        Change of the command by the differences of (q, q̇, a); zero for a command at a bound.
    """

    target: RestTarget
    lag: float
    q: np.ndarray
    v: np.ndarray
    acting: np.ndarray
    commands: np.ndarray
    gains: np.ndarray

    @property
    def duration(self) -> float:
        """The time to its end (s)."""
        return STEP * len(self.commands)

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


@np.errstate(all="ignore")  # paths that are no solution may overflow
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
    """
    best: tuple[float, Plan] | None = None
    for target, travel in product(targets, TRAVELS):
        y = model.state(target.q, np.zeros(model.nv)).y if goal is None else goal
        try:
            problem = coast(_pose(model, (q, v, acting), target, y, lag), wait)
            found = None if problem is None else search_path(problem, travel)
        except np.linalg.LinAlgError:
            continue
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
    decay, mean = (float(share) for share in lag_shares(STEP, lag))
    weight = np.zeros((2 * n + m, 2 * n + m))
    weight[:n, :n] = FORM * compliance * S
    weight[n : 2 * n, n : 2 * n] = (SPEED * HORIZON) ** 2 * compliance * S
    weight[2 * n :, 2 * n :] = HOLD * np.diag(np.diag(R))
    change = (1 - decay) ** 2 * RATE * (R + 1e-8 * np.trace(R) * np.eye(m))
    return PathProblem(model, start, target, goal, decay, mean, weight, change)


def _plan(problem: PathProblem, lag: float, path: Path, gains: np.ndarray) -> Plan:
    """The plan of a path."""
    n = problem.model.nv
    q, v, acting = path.x[:, :n], path.x[:, n : 2 * n], path.x[:, 2 * n :]
    return Plan(problem.target, lag, q, v, acting, path.commands, gains)


@dataclass(frozen=True, eq=False)
class PathProblem:
    """The model, its start and its target, and the weights.

    Attributes
    ----------
    start : tuple of ndarray, (nq,), (nv,), (nu,)
        Configuration, velocity and acting input at the begin.
    goal : ndarray, (3,)
        The point (m) for the tip.
    decay, mean : float
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
    decay: float
    mean: float
    weight: np.ndarray
    change: np.ndarray

    @cached_property
    def step(self) -> ImplicitStep:
        """A step under the inputs that act, with springs for stops."""
        balance = SpringStops(self.model, ForceBalance(self.model, motors=()), STEP)
        return ImplicitStep(self.model, balance, Stops.none(self.model), CLOSE)

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
        See `backward`.
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
        after = problem.decay * a + (1 - problem.decay) * c
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
    found = problem.step(q, v, mean, np.zeros(0), STEP, guess=guess)
    if found is None:
        return None
    state = model.state(found.q, found.v)
    A, B = np.zeros((2 * n + m, 2 * n + m)), np.zeros((2 * n + m, m))
    by_u = found.by_force @ state.B
    A[n : 2 * n] = np.hstack((found.by_state, problem.mean * by_u))
    B[n : 2 * n] = (1 - problem.mean) * by_u
    A[:n], B[:n] = STEP * A[n : 2 * n], STEP * B[n : 2 * n]
    A[:n, :n] += np.eye(n)
    A[2 * n :, 2 * n :], B[2 * n :] = problem.decay * np.eye(m), (1 - problem.decay) * np.eye(m)
    return state, A, B


def backward(
    A: np.ndarray, B: np.ndarray, J: np.ndarray, error: np.ndarray, away: np.ndarray,
    gap: np.ndarray, drift: np.ndarray, weight: np.ndarray, last: np.ndarray, change: np.ndarray,
    extra: np.ndarray, lower: np.ndarray, upper: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Steps (N, m) and gains (N, m, nx) of the commands.

    The cost is the sum over the steps of ‖error + J x‖² + (away + x)ᵀ weight (away + x) after each,
    and of (gap + c - a)ᵀ change (gap + c - a) with the acting input a.

    Parameters
    ----------
    A, B : ndarray, (N, nx, nx), (N, nx, m)
        The linearised steps; a state ends with the acting input (m,).
    J, error : ndarray, (N, 3, n), (N, 3)
        The tip's Jacobian and error after each step.
    away : ndarray, (N, nx)
        The state after each step minus the target's.
    gap : ndarray, (N, m)
        The path's command minus its acting input at the begin of each step.
    drift : ndarray, (N, nx)
        The model's step minus the path's.
    weight, last : ndarray, (nx, nx)
        The weights of a state, and what is added for the last one.
    change : ndarray, (m, m)
        The weight of the command minus the acting input.
    extra : ndarray, (m, m)
        What is added to Q_cc, so that a step stays small.
    lower, upper : ndarray, (N, m)
        The bounds minus the path's commands.

    Raises
    ------
    LinAlgError
        If a step has no minimum.
    """
    count, nx, m = B.shape
    n, acting = J.shape[2], nx - m
    steps, gains, qp = np.zeros((count, m)), np.zeros((count, m, nx)), DenseQp(m, m)
    V, s = last.copy(), last @ away[count - 1]
    for k in range(count - 1, -1, -1):
        V += weight
        V[:n, :n] += J[k].T @ J[k]
        s += weight @ away[k]
        s[:n] += J[k].T @ error[k]
        s += V @ drift[k]
        VB, pull = V @ B[k], change @ gap[k]
        Qcc, Qcx, Qc = B[k].T @ VB + change, VB.T @ A[k], B[k].T @ s + pull
        Qxx, Qx = A[k].T @ (V @ A[k]), A[k].T @ s
        Qcx[:, acting:] -= change
        Qxx[acting:, acting:] += change
        Qx[acting:] -= pull
        found = qp.solve(QpProblem(Qcc + extra, Qc, np.eye(m), lower[k], upper[k]))
        if found is None or not found.solved:
            raise np.linalg.LinAlgError("a step has no minimum")
        step = np.clip(found.x, lower[k], upper[k])
        index = np.flatnonzero(found.multipliers == 0)
        gains[k, index] = -np.linalg.solve((Qcc + extra)[np.ix_(index, index)], Qcx[index])
        K = gains[k]
        V = Qxx + K.T @ (Qcc @ K) + K.T @ Qcx + Qcx.T @ K
        V = 0.5 * (V + V.T)
        s = Qx + K.T @ (Qcc @ step + Qc) + Qcx.T @ step
        steps[k] = step
    return steps, gains
