"""Small dense QPs solved by ProxQP, and by DAQP where ProxQP's answer is not exact.

Every answer has its own residuals:

    minimise ½ xᵀ H x + gᵀ x   subject to   lower ≤ A x ≤ upper

Only this file imports the two solvers. Bad numbers never reach them. NaN in H, g or A would block
ProxQP (and the GIL) for up to a minute; it ignores NaN in a bound silently; lower > upper lets it
spin.
"""

from __future__ import annotations

from functools import partial
from time import perf_counter_ns
from typing import Any, NamedTuple

import daqp
import numpy as np
from proxsuite import proxqp

from softdyn.compiled import compiled
from softdyn.controllers.qps.linear_algebra import lu_solve

# ProxQP's tolerances, in scaled variables. The coarse one mostly gives the active set, from which
# polishing finds the optimum. If polishing fails and DAQP fails too, ProxQP solves to the fine one.
COARSE, FINE = 1e-3, 1e-9
MU_IN = 1e-3  # ProxQP's initial penalty on inequalities, for problems of this scaling
ACCEPTED = 1e-6  # the largest scaled residual of an answer that counts as solved
# Ordinary problems take up to 32 iterations with one or two inner ones each. A problem that needs
# more will not be solved, and must end within milliseconds.
MAX_ITERATIONS, MAX_INNER = 60, 5
POLISH_STEPS = 8
DAQP_ITERATIONS = 200  # ten times those of the problems that ProxQP and polishing leave
OPEN = 1e30  # DAQP's bound of an open row
ROUNDING = 2.0**-44  # of an LU of a scaled problem, relative to its largest row
NO_GUESS = proxqp.InitialGuess.NO_INITIAL_GUESS
WARM = proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT


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
        return self.primal <= ACCEPTED and self.dual <= ACCEPTED and self.gap <= ACCEPTED


def residuals(problem: QpProblem, x: np.ndarray, z: np.ndarray) -> tuple[float, float, float]:
    """Primal, dual and duality-gap residuals, each relative to the size of its cancelling terms.

    The primal residual of a row whose bounds are closer than 1 is relative to their distance;
    there, an excess within rounding counts as none.
    """
    return _residuals(*problem, x, z)


def polish(
    problem: QpProblem, x: np.ndarray, z: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """The exact optimum for the active set of an approximate (x, z), or None.

    It solves the optimality conditions with the active rows as equalities (as in Stellato et al.
    2020, OSQP, section 5.2). The answer then depends neither on the warm start nor on the
    tolerance. Its residuals show whether it is the optimum. If not, polishing it again is a step of
    the primal-dual active set method (Hintermüller et al. 2002).
    """
    x, z = np.array(x, float), np.array(z, float)
    return (x, z) if _polish(*problem, x, z) else None


class DenseQp:
    """A persistent ProxQP workspace for problems of one size.

    First, variables are scaled to a unit Hessian diagonal, rows to unit norm, and the answer to the
    order of one. Scaling is necessary, because ProxQP's own test is absolute: entries of a decrease
    row are ~1/ε, and those of a nearly singular input map are larger still. ProxQP then computes a
    coarse answer, which mostly gives the active set. If the polished answer is not the optimum,
    DAQP finds the active set (Arnström, Bemporad and Axehill 2022). If that fails, ProxQP computes
    a fine answer. Every problem starts from scratch, so the answer depends on the problem only.
    ProxQP's own answer depends on the alignment of its memory too: by 3e-7 of the input of `Mpc` on
    the SpiRob, where the Hessian's condition is 1e11.

    Parameters
    ----------
    variables, rows : int
        The size.
    guess : bool
        First polish x = 0 and no active row, and call ProxQP if that fails. It pays where few rows
        are active, as in predictive control.
    """

    def __init__(self, variables: int, rows: int, *, guess: bool = False) -> None:
        self._qp: Any = proxqp.dense.QP(
            variables, 0, rows, False,
            proxqp.dense.HessianType.Dense, proxqp.dense.DenseBackend.PrimalDualLDLT,
        )  # fmt: skip
        settings = self._qp.settings
        settings.eps_rel = 0.0
        settings.max_iter, settings.max_iter_in = MAX_ITERATIONS, MAX_INNER
        settings.default_mu_in = MU_IN
        settings.compute_preconditioner = False
        settings.eps_primal_inf = settings.eps_dual_inf = 0.0  # these tests raise false alarms
        settings.eps_abs, settings.initial_guess = COARSE, NO_GUESS
        self._scaled = QpProblem.empty(variables, rows)
        self._scale, self._norms = np.ones(variables), np.ones(rows)
        self._kinds = np.zeros(rows, np.int32)  # of DAQP's rows: all are inequalities
        self._guess = (np.zeros(variables), np.zeros(rows)) if guess else None
        _, g, A, lower, upper = self._scaled
        self._qp.init(np.eye(variables), g, None, None, A, lower, upper, False)
        self._qp.solve()
        # views of ProxQP's memory, which every solve updates
        self._x, self._z = self._qp.results.x, self._qp.results.z
        if self._x.flags.owndata or self._x.ctypes.data != self._qp.results.x.ctypes.data:
            raise RuntimeError("this ProxSuite hands out copies of its results")

    def __reduce__(self) -> tuple[Any, ...]:
        # A copy cannot keep views of the solver's memory. It needs only the sizes, because no
        # problem depends on an earlier one.
        sizes = len(self._scale), len(self._norms)
        return partial(DenseQp, *sizes, guess=self._guess is not None), ()

    def clocked(self) -> QpClock:
        """Start to time ProxQP's calls; solvers without a clock have no cost from it."""
        if not isinstance(self._qp, QpClock):
            self._qp = QpClock(self._qp)
        return self._qp

    def solve(self, problem: QpProblem) -> QpSolution | None:
        """The answer, maybe not solved; None if the problem has invalid numbers."""
        H, g, A, lower, upper = scaled = self._scaled
        sane, size = _scale(*problem, *scaled, self._scale, self._norms)
        if not sane:
            return None
        if self._guess is not None:
            answer = QpSolution(*_refined(*scaled, *self._guess, self._scale, self._norms, size))
            if max(answer[2:]) <= FINE:  # NaN is not
                return answer
        qp = self._qp
        qp.update(H, g, None, None, A, lower, upper, False)
        qp.solve()
        answer = QpSolution(*_refined(*scaled, self._x, self._z, self._scale, self._norms, size))
        if max(answer[2:]) <= FINE:  # NaN is not
            return answer
        x, _, found, info = daqp.solve(
            H, g, A, np.minimum(upper, OPEN), np.maximum(lower, -OPEN), self._kinds,
            iter_limit=DAQP_ITERATIONS,
        )  # fmt: skip
        if found > 0:
            exact = QpSolution(*_refined(*scaled, x, info["lam"], self._scale, self._norms, size))
            if max(exact[2:]) <= FINE:
                return exact
        settings = qp.settings
        settings.eps_abs, settings.initial_guess = FINE, WARM
        qp.solve()
        settings.eps_abs, settings.initial_guess = COARSE, NO_GUESS
        return QpSolution(*_refined(*scaled, self._x, self._z, self._scale, self._norms, size))


class QpClock:
    """Wraps a ProxQP object and times its calls.

    Attributes
    ----------
    outside : int
        Time in ``update`` and ``solve`` measured in Python (ns).
    inside : float
        The same time by ProxQP's own clocks (µs).
    """

    def __init__(self, qp: Any) -> None:
        self._qp, self.settings, self._info = qp, qp.settings, qp.results.info
        self.settings.compute_timings = True
        self.reset()

    def __reduce__(self) -> tuple[Any, ...]:
        raise TypeError("a clock belongs to one solver: copy the solver, and ask it for its clock")

    def reset(self) -> None:
        """Set both times to zero."""
        self.outside, self.inside = 0, 0.0

    def update(self, *data: Any) -> None:
        """Call ProxQP's ``update``, timed."""
        began = perf_counter_ns()
        self._qp.update(*data)
        self.outside += perf_counter_ns() - began
        self.inside += self._info.setup_time

    def solve(self) -> None:
        """Call ProxQP's ``solve``, timed."""
        began = perf_counter_ns()
        self._qp.solve()
        self.outside += perf_counter_ns() - began
        self.inside += self._info.solve_time


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
def _polish(H, g, A, lower, upper, x, z):
    """A step of `polish` in place; False if it fails."""
    n, rows = len(x), len(z)
    active, count = np.empty(rows, np.int64), 0
    target = np.empty(n + rows)
    for i in range(n):
        target[i] = -g[i]
    for i in range(rows):
        Ax = 0.0
        for j in range(n):
            Ax += A[i, j] * x[j]
        if z[i] > upper[i] - Ax:
            target[n + count] = upper[i]
        elif -z[i] > Ax - lower[i]:
            target[n + count] = lower[i]
        else:
            continue
        active[count] = i
        count += 1
    kkt = np.zeros((n + count, n + count))
    for i in range(n):
        for j in range(n):
            kkt[i, j] = H[i, j]
        for k in range(count):
            kkt[n + k, i] = kkt[i, n + k] = A[active[k], i]
    if not lu_solve(kkt, target):
        return False
    for i in range(n):
        x[i] = target[i]
    for i in range(rows):
        z[i] = 0.0
    for k in range(count):
        z[active[k]] = target[n + k]
    return True


@compiled
def _refined(H, g, A, lower, upper, x, z, scale, norms, size):
    """The polished answer if it is the optimum, else (x, z); unscaled, with its residuals."""
    n, rows, total = len(x), len(z), 0.0
    x1, z1, x2, z2 = np.empty(n), np.empty(rows), np.empty(n), np.empty(rows)
    for i in range(n):
        x1[i] = x2[i] = x[i]
        total += abs(x[i])
    for i in range(rows):
        # an open bound has no multiplier; setting it to zero leaves a dual residual
        closed = not ((z[i] > 0 and upper[i] == np.inf) or (z[i] < 0 and lower[i] == -np.inf))
        z1[i] = z2[i] = z[i] if closed else 0.0
        total += abs(z[i])
    primal = dual = gap = np.inf
    optimal = False
    if total < np.inf:
        for _ in range(POLISH_STEPS):
            if not _polish(H, g, A, lower, upper, x2, z2):
                break
            primal, dual, gap = _residuals(H, g, A, lower, upper, x2, z2)
            optimal = primal <= FINE and dual <= FINE and gap <= FINE  # NaN is not
            if optimal:
                break
        if not optimal:
            primal, dual, gap = _residuals(H, g, A, lower, upper, x1, z1)
    for i in range(n):
        x1[i] = (x2[i] if optimal else x1[i]) * (scale[i] * size)
    for i in range(rows):
        z1[i] = (z2[i] if optimal else z1[i]) / norms[i] * size
    return x1, z1, primal, dual, gap
