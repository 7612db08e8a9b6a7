"""Paths of least cost under bounded commands, by iLQR, for any discrete step with derivatives.

The cost of a path of N steps is

    Σ ‖e(x_k)‖² + ‖x_k - x*‖²_W + ‖c_k - a_k‖²_R,   and ‖x_N - x*‖²_L more at its end,

where a state x ends with the input a that acts. The method is iLQR with bounds from states that are
no motion: a guess that the commands need not lead to. Each iteration closes part of the gaps
between these states and the model's steps, as in Mastalli et al., "Crocoddyl" (2020).

The backward pass has a quadratic cost-to-go ½ xᵀVx + sᵀx along x_{k+1} = A x_k + B c_k + d_k, where
the path misses the model's step by the drift d_k. With V d_k in s,

    Q_cc = Bᵀ V B + R,   Q_cx = Bᵀ V A + N,   Q_c = Bᵀ s + r,   c = step + gain x,

where the step minimises ½ cᵀ Q_cc c + Q_cᵀ c within the bounds, and the gain -Q_cc⁻¹ Q_cx is that
of the commands that are not at one (Tassa, Mansard and Todorov, "Control-limited differential
dynamic programming", 2014).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from softdyn.controllers.qps.qp import DenseQp, QpProblem

# Lines "x 0.1" and "x 10" say what a tenth and ten times did to two plans of SpiRob through a fold.
# As it is they end 0.6 and 1.4 cm from their targets and take 2 and 3 s.
ITERATIONS = 60
# x 0.1: no plan. x 10: the same plans. A third plan ends with it, where 10 000 gave one more.
SETTLED = 1e-3  # relative decrease of the cost at which it ends
# x 0.1: 0.5 and 0.8 cm, in 3 and 5 s. x 10: 0.8 and 1.9 cm.
DAMPED = 1.0  # in the problem's `unit`: a step shorter than with this is not tried
# x 0.1, x 10: the same plans, and without it; it ends searches that find no lower cost.
SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)  # of a step, tried until the cost falls
# x 0.1: no plan. Two plans to 0.25π and 0.3π that end 3.2 and 1.4 cm away: whole steps alone, 27
# and 32 cm; a twentieth and less after the whole one, 25 and 2.2 cm.
CLOSING = (0.15, 0.07)  # the same while there are gaps
# x 0.1: no plan within the iterations. x 10: the other plan ends 7.7 cm away.
CLOSED = 1.0  # sum of the gaps below which a whole step closes them
# x 0.1: 1.0 and 1.0 cm. x 10: 1.8 and 1.0 cm. Without it the gaps would never be 0.


@dataclass(frozen=True, eq=False)
class PathProblem(ABC):
    """A discrete step, its first state, and the cost of a path.

    Attributes
    ----------
    start, aim : ndarray, (nx,)
        The first state, and x*.
    weight, last : ndarray, (nx, nx)
        W and L.
    change, unit : ndarray, (m, m)
        R, and a unit of the damping that keeps a step of the search short.
    lower, upper : ndarray, (m,)
        Bounds of the commands.
    """

    start: np.ndarray
    aim: np.ndarray
    weight: np.ndarray
    last: np.ndarray
    change: np.ndarray
    unit: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    @abstractmethod
    def step(
        self, x: np.ndarray, c: np.ndarray, guess: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """The state (nx,) after a step, its derivatives by x and c; None without a solution."""

    @abstractmethod
    def output(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The error e (r,) of a state, and its derivatives (r, n) by the first n numbers of x."""


@dataclass(frozen=True, eq=False)
class Path:
    """A path of N steps, linearised.

    Attributes
    ----------
    cost, gaps : float
        The cost, and the sum of |drift|.
    x : ndarray, (N + 1, nx)
        States.
    commands : ndarray, (N, m)
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
    def merit(self) -> tuple[float, float]:
        """The order of paths: a better path has the lower value, and gaps come before the cost."""
        return self.gaps, self.cost


def search_path(problem: PathProblem, guess: np.ndarray) -> tuple[Path, np.ndarray] | None:
    """A path of least cost, and its gains (N, m, nx); None if none could be simulated.

    Parameters
    ----------
    problem : PathProblem
    guess : ndarray, (N, nx)
        States after each step. Their last m numbers are also the first guess of the commands.
    """
    m = len(problem.change)
    path = _simulate(problem, guess[:, -m:], states=guess)
    if path is None:
        return None
    damping = 1e-6
    for _ in range(ITERATIONS):
        steps, gains = _backward(problem, path, damping * problem.unit)
        shares = SHARES if path.gaps == 0 else CLOSING if path.gaps > CLOSED else SHARES[:1]
        tried = (_simulate(problem, path.commands, path, share, steps, gains) for share in shares)
        after = next((one for one in tried if one and one.merit < path.merit), None)
        if after is None:
            damping *= 10
            if damping > DAMPED:
                break
            continue
        before, path, damping = path, after, max(damping / 5, 1e-9)
        if before.gaps == 0 and before.cost - path.cost < SETTLED * path.cost:
            break
    if path.gaps > 0:
        return None
    return path, _backward(problem, path, np.zeros((m, m)))[1]


def _backward(problem: PathProblem, path: Path, extra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return backward(
        path.A, path.B, path.J, path.error, path.away, path.gap, path.drift, problem.weight,
        problem.last, problem.change, extra, problem.lower - path.commands,
        problem.upper - path.commands,
    )  # fmt: skip


def _simulate(
    problem: PathProblem, commands: np.ndarray, near: Path | None = None, share: float = 1.0,
    steps: np.ndarray | None = None, gains: np.ndarray | None = None,
    states: np.ndarray | None = None,
) -> Path | None:  # fmt: skip
    """The path under commands, with feedback to a near path, or through the given states.

    It keeps the rest of the near path's gaps. None where a step has no solution, or where it is no
    better than the near path.
    """
    x, m, cost, gaps = problem.start, len(problem.change), 0.0, 0.0
    rows: list[tuple[np.ndarray, ...]] = []
    for k, command in enumerate(commands):
        c, guess, drift = command, x, np.zeros_like(x)
        if near is not None and steps is not None and gains is not None:
            off = x - near.x[k]
            c = np.clip(c + share * steps[k] + gains[k] @ off, problem.lower, problem.upper)
            drift = (1 - share) * near.drift[k]
            moved = near.A[k] @ off + near.B[k] @ (c - near.commands[k])
            guess = near.x[k + 1] + near.drift[k] + moved
        c = np.clip(c, problem.lower, problem.upper)
        solved = problem.step(x, c, guess)
        if solved is None:
            return None
        end, A, B = solved
        if states is not None:
            drift = end - states[k]
        end = end - drift
        error, J = problem.output(end)
        away, gap = end - problem.aim, c - x[-m:]
        cost += error @ error + away @ problem.weight @ away + gap @ problem.change @ gap
        gaps += float(np.abs(drift).sum())
        if not math.isfinite(cost) or (near is not None and (gaps, cost) >= near.merit):
            return None
        rows.append((x, c, A, B, J, error, away, gap, drift))
        x = end
    cost += away @ problem.last @ away
    first, *columns = (np.array(column) for column in zip(*rows, strict=True))
    return Path(float(cost), gaps, np.vstack((first, x)), *columns)


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
    J, error : ndarray, (N, r, n), (N, r)
        The error after each step, and its Jacobian by the first n numbers of x.
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
