"""Small dense QPs solved by DAQP, and by ProxQP where DAQP's answer is not accurate.

Every answer has its own residuals:

    minimise ½ xᵀ H x + gᵀ x   subject to   lower ≤ A x ≤ upper

No other file imports the two solvers. Bad numbers never reach them. NaN in H, g or A would block
ProxQP (and the GIL) for up to a minute; it ignores NaN in a bound silently; lower > upper lets it
spin.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from time import perf_counter_ns
from typing import Any, NamedTuple

import daqp
import numpy as np
from proxsuite import proxqp

from softdyn.compiled import compiled

ACCEPTED = 1e-6  # the largest scaled residual of an answer that counts as solved
FINE = 1e-9  # the same of an answer after which no other solver is tried
# DAQP's tolerances, in scaled variables: of a row, and of the repetitions that a singular Hessian
# needs. Both are below `FINE`, because nothing corrects its answer. Its default for a row is 1e-6;
# at 1e-11 it leaves inputs beyond their bounds, and at 1e-13 it refuses rows with hardly any room.
ROW, REPEATED = 1e-12, 1e-12
# DAQP takes smaller pivots for zero: its default, and a larger one for nearly singular Hessians,
# which are then regularised and solved repeatedly. The larger one loses rows with hardly any room.
PIVOT, LARGE_PIVOT = 1e-11, 1e-8
DAQP_ITERATIONS = 1000  # barriers on the helix take up to 120
INFEASIBLE = -1  # DAQP's exit flag
MU_IN = 1e-3  # ProxQP's initial penalty on inequalities, for problems of this scaling
# Ordinary problems take ProxQP up to 32 iterations with one or two inner ones each. A problem that
# needs more will not be solved, and must end within milliseconds.
MAX_ITERATIONS, MAX_INNER = 60, 5
ROUNDING = 2.0**-44  # of the rows of a scaled problem, relative to its largest row


class QpProblem(NamedTuple):
    """min ½ xᵀHx + gᵀx s.t. lower ≤ A x ≤ upper."""

    H: np.ndarray  # (n, n) symmetric, positive semidefinite
    g: np.ndarray  # (n,)
    A: np.ndarray  # (rows, n)
    lower: np.ndarray  # (rows,), -inf if open
    upper: np.ndarray  # (rows,), +inf if open

    @classmethod
    def empty(cls, variables: int, rows: int) -> QpProblem:
        """An empty problem of this size."""
        A, (lower, upper) = np.zeros((rows, variables)), np.zeros((2, rows))
        return cls(np.zeros((variables, variables)), np.zeros(variables), A, lower, upper)


class QpSolution(NamedTuple):
    """An answer with the residuals of its optimality conditions, computed from the problem.

    Attributes
    ----------
    x : ndarray, (n,)
        The minimiser.
    multipliers : ndarray, (rows,)
        Positive at an upper bound, negative at a lower one.
    primal, dual, gap : float
        Scaled residuals; all at most `ACCEPTED` in a solved problem.
    """

    x: np.ndarray
    multipliers: np.ndarray
    primal: float
    dual: float
    gap: float

    @property
    def solved(self) -> bool:
        """Whether every residual is small enough; False for NaN."""
        return self.within(ACCEPTED)

    def within(self, largest: float) -> bool:
        """Whether no residual exceeds `largest`; False for NaN."""
        return self.primal <= largest and self.dual <= largest and self.gap <= largest


def residuals(problem: QpProblem, x: np.ndarray, z: np.ndarray) -> tuple[float, float, float]:
    """Primal, dual and duality-gap residuals, each relative to the size of its cancelling terms.

    The primal residual of a row whose bounds are closer than 1 is relative to their distance;
    there, an excess within rounding counts as none.
    """
    return _residuals(*problem, x, z)


class DenseQp:
    """A solver of problems of one size.

    First, variables are scaled to a unit Hessian diagonal, rows to unit norm, and the answer to the
    order of one. Scaling is necessary, because the solvers' own tests are absolute: entries of a
    decrease row are ~1/ε, and those of a nearly singular input map are larger still.

    DAQP finds the active rows by a dual method (Arnström, Bemporad and Axehill 2022), so that its
    answer is exact up to rounding. If the residuals say otherwise, as with Hessians of condition
    1e12, DAQP repeats with a regularised Hessian, and then ProxQP solves the problem (Bambade et
    al. 2022). The best answer counts. Every problem starts from scratch, so the answer depends on
    the problem only.

    Parameters
    ----------
    variables, rows : int
        The size.
    """

    def __init__(self, variables: int, rows: int) -> None:
        self._scaled = QpProblem.empty(variables, rows)
        self._scale, self._norms = np.ones(variables), np.ones(rows)
        self._solvers: tuple[Solver, ...] = SOLVERS

    def __reduce__(self) -> tuple[Any, ...]:
        # A copy needs only the sizes, because no problem depends on an earlier one.
        return DenseQp, (len(self._scale), len(self._norms))

    def clocked(self) -> QpClock:
        """Start to time the solvers; a `DenseQp` without a clock has no cost from it."""
        clock = QpClock()
        self._solvers = tuple(clock.timed(solver) for solver in SOLVERS)
        return clock

    def solve(self, problem: QpProblem) -> QpSolution | None:
        """The answer, maybe not solved; None if the problem has invalid numbers."""
        scaled, scale, norms = self._scaled, self._scale, self._norms
        sane, size = _scale(*problem, *scaled, scale, norms)
        if not sane:
            return None
        best = None
        for solver in self._solvers:
            x, z, decided, _ = solver(*scaled)
            answer = QpSolution(*_unscaled(*scaled, x, z, scale, norms, size))
            if best is None or not best.solved or answer.within(max(best[2:])):
                best = answer
            if decided or best.within(FINE):
                break
        return best


# a scaled problem → x, multipliers, whether no other solver is needed, its own time (s)
Solver = Callable[..., tuple[np.ndarray, np.ndarray, bool, float]]


def solve_daqp(
    H: np.ndarray,
    g: np.ndarray,
    A: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    pivot: float = PIVOT,
) -> tuple[np.ndarray, np.ndarray, bool, float]:
    """DAQP's answer; decided, with x = 0, if no x meets the rows.

    DAQP may say so wrongly where the Hessian is nearly singular. It counts only if DAQP says the
    same with the identity as the Hessian.
    """
    x, _, found, info = daqp.solve(
        H, g, A, upper, lower,
        iter_limit=DAQP_ITERATIONS, primal_tol=ROW, eta_prox=REPEATED, zero_tol=pivot,
    )  # fmt: skip
    z, took = info["lam"], info["setup_time"] + info["solve_time"]
    if found != INFEASIBLE:
        return x, z, False, took
    identity = np.eye(len(g))
    *_, found, info = daqp.solve(
        identity, g, A, upper, lower, iter_limit=DAQP_ITERATIONS, primal_tol=FINE
    )
    took += info["setup_time"] + info["solve_time"]
    return np.zeros(len(g)), np.zeros(len(lower)), found == INFEASIBLE, took


def solve_proxqp(
    H: np.ndarray, g: np.ndarray, A: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, np.ndarray, bool, float]:
    """ProxQP's answer; its accuracy may depend on the alignment of memory."""
    qp: Any = proxqp.dense.QP(
        len(g), 0, len(lower), False,
        proxqp.dense.HessianType.Dense, proxqp.dense.DenseBackend.PrimalDualLDLT,
    )  # fmt: skip
    settings = qp.settings
    settings.eps_abs, settings.eps_rel = FINE, 0.0
    settings.max_iter, settings.max_iter_in = MAX_ITERATIONS, MAX_INNER
    settings.default_mu_in = MU_IN
    settings.compute_preconditioner = False
    settings.eps_primal_inf = settings.eps_dual_inf = 0.0  # these tests raise false alarms
    settings.compute_timings = True
    qp.init(H, g, None, None, A, lower, upper, False)
    qp.solve()
    x, z, info = qp.results.x, qp.results.z, qp.results.info
    return x.copy(), z.copy(), True, (info.setup_time + info.solve_time) / 1e6


SOLVERS: tuple[Solver, ...] = (solve_daqp, partial(solve_daqp, pivot=LARGE_PIVOT), solve_proxqp)


class QpClock:
    """Times the calls of the solvers.

    Attributes
    ----------
    outside : int
        Time of their calls measured in Python (ns).
    inside : float
        The same time by the solvers' own clocks (µs).
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Set both times to zero."""
        self.outside, self.inside = 0, 0.0

    def timed(self, solver: Solver) -> Solver:
        """The same solver, whose calls this clock counts."""

        def solve(*scaled: np.ndarray) -> tuple[np.ndarray, np.ndarray, bool, float]:
            began = perf_counter_ns()
            answer = solver(*scaled)
            self.outside += perf_counter_ns() - began
            self.inside += answer[-1] * 1e6
            return answer

        return solve


@compiled
def _scale(H, g, A, lower, upper, H2, g2, A2, lower2, upper2, scale, norms):
    """Fill the scaled problem and the scales of variables and rows: (sane, size of the answer).

    A problem is sane if its data are finite and its bounds are ordered and not NaN.
    """
    n, rows = len(g), len(lower)
    size = 1.0
    for i in range(n):
        scale[i] = 1.0 / np.sqrt(H[i, i]) if H[i, i] > 0 else 1.0
        g2[i] = g[i] * scale[i]
        if not abs(g2[i]) <= size:
            size = abs(g2[i])
    for i in range(rows):
        square = 0.0
        for j in range(n):
            A2[i, j] = A[i, j] * scale[j]
            square += A2[i, j] * A2[i, j]
        norms[i] = np.sqrt(square) if square != 0 else 1.0
        lower2[i], upper2[i] = lower[i] / norms[i], upper[i] / norms[i]
        if lower2[i] > size:
            size = lower2[i]
        if -upper2[i] > size:
            size = -upper2[i]
    sane = size < np.inf
    for i in range(n):
        g2[i] /= size
        sane = sane and abs(g2[i]) < np.inf
        for j in range(n):
            H2[i, j] = H[i, j] * (scale[i] * scale[j])
            sane = sane and abs(H2[i, j]) < np.inf
    for i in range(rows):
        lower2[i], upper2[i] = lower2[i] / size, upper2[i] / size
        sane = sane and lower2[i] <= upper2[i]
        for j in range(n):
            A2[i, j] /= norms[i]
            sane = sane and abs(A2[i, j]) < np.inf
    return sane, size


@compiled
def _residuals(H, g, A, lower, upper, x, z):
    n, rows = len(x), len(z)
    quadratic = linear = support = dual = primal = 0.0
    dual_scale = largest = 1.0
    Ax = np.empty(rows)
    for i in range(rows):
        Ax[i] = 0.0
        for j in range(n):
            Ax[i] += A[i, j] * x[j]
        if not abs(Ax[i]) <= largest:  # NaN stays
            largest = abs(Ax[i])
    for i in range(n):
        Hx = Atz = 0.0
        for j in range(n):
            Hx += H[i, j] * x[j]
        for j in range(rows):
            Atz += z[j] * A[j, i]
        quadratic += x[i] * Hx
        linear += x[i] * g[i]
        if not abs(Hx + g[i] + Atz) <= dual:
            dual = abs(Hx + g[i] + Atz)
        if abs(Hx) > dual_scale:
            dual_scale = abs(Hx)
        if abs(g[i]) > dual_scale:
            dual_scale = abs(g[i])
        if abs(Atz) > dual_scale:
            dual_scale = abs(Atz)
    for i in range(rows):
        excess, width = Ax[i] - upper[i], upper[i] - lower[i]
        if lower[i] - Ax[i] > excess:
            excess = lower[i] - Ax[i]
        if excess < 0:
            excess = 0.0
        if 0 < width < 1:
            # for a narrow row the error is relative to the width of its bounds, which may be less
            # than the rounding of numbers of order one
            excess -= ROUNDING * largest
            share = excess / width if not excess <= 0 else 0.0
        else:
            share = excess / largest
        if not share <= primal:
            primal = share
        # Lagrangian duality: xᵀHx + gᵀx + Σ (z⁺ upper - z⁻ lower) = 0 at the optimum
        if z[i] != 0:
            support += z[i] * (upper[i] if z[i] > 0 else lower[i])
    gap, scale = abs(quadratic + linear + support), 1.0
    if not gap < np.inf:  # a multiplier on an open bound, or NaN
        return primal, dual / dual_scale, np.inf
    if abs(quadratic) > scale:
        scale = abs(quadratic)
    if abs(linear) > scale:
        scale = abs(linear)
    if abs(support) > scale:
        scale = abs(support)
    return primal, dual / dual_scale, gap / scale


@compiled
def _unscaled(H, g, A, lower, upper, x, z, scale, norms, size):
    """(x, z) in the problem's own units, with its residuals."""
    x2, z2 = np.empty(len(x)), np.empty(len(z))
    for i in range(len(z)):
        # an open bound has no multiplier; setting it to zero leaves a dual residual
        closed = not ((z[i] > 0 and upper[i] == np.inf) or (z[i] < 0 and lower[i] == -np.inf))
        z2[i] = z[i] if closed else 0.0
    primal, dual, gap = _residuals(H, g, A, lower, upper, x, z2)
    for i in range(len(x)):
        x2[i] = x[i] * (scale[i] * size)
    for i in range(len(z)):
        z2[i] *= size / norms[i]
    return x2, z2, primal, dual, gap
