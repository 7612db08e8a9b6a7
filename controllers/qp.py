"""Small dense quadratic programs on ProxQP, with answers that know their own residuals.

    minimise ½ xᵀ H x + gᵀ x   subject to   lower ≤ A x ≤ upper

The only file that imports ProxSuite. Bad numbers never reach it: NaN in H, g or A holds it (and
the GIL) for up to a minute, NaN in a bound is dropped in silence, lower > upper spins.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from proxsuite import proxqp

from softdyn.compiled import compiled

COARSE, FINE = 1e-6, 1e-9  # what ProxQP is asked for, in scaled variables
MU_IN = 1e-3  # its initial penalty on inequalities, for problems of this scaling
ACCEPTED = 1e-6  # the largest scaled residual of an answer that counts as solved
MAX_ITERATIONS, MAX_INNER = 200, 100
POLISH_STEPS = 8


class Problem(NamedTuple):
    """min ½ xᵀHx + gᵀx s.t. lower ≤ A x ≤ upper."""

    H: np.ndarray  # (n, n) symmetric, positive semidefinite
    g: np.ndarray  # (n,)
    A: np.ndarray  # (rows, n)
    lower: np.ndarray  # (rows,), -inf where open
    upper: np.ndarray  # (rows,), +inf where open


class Solution(NamedTuple):
    """An answer with the residuals of its optimality conditions, recomputed from the problem.

    Attributes
    ----------
    x : (n,) the minimiser.
    multipliers : (rows,) positive at an upper bound, negative at a lower one.
    primal, dual, gap : scaled residuals; all at most `ACCEPTED` in a solved problem.
    """

    x: np.ndarray
    multipliers: np.ndarray
    primal: float
    dual: float
    gap: float

    @property
    def solved(self) -> bool:
        """Whether every residual is small enough; NaN is not."""
        return self.primal <= ACCEPTED and self.dual <= ACCEPTED and self.gap <= ACCEPTED


def residuals(problem: Problem, x: np.ndarray, z: np.ndarray) -> tuple[float, float, float]:
    """Primal, dual and duality-gap residuals, each over the size of the terms that cancel in it.

    A row whose bounds are closer than 1 is judged in units of that width.
    """
    return _residuals(*problem, x, z)


def polish(problem: Problem, x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The exact optimum on the active set that an approximate (x, z) points at, or None.

    Solves the optimality conditions with the active rows as equalities (as in Stellato et al.
    2020, OSQP, section 5.2): the answer then depends neither on the warm start nor on the
    tolerance. Whether it is the optimum is for its residuals to say; where it is not, polishing
    it again is a step of the primal-dual active set method (Hintermüller et al. 2002).
    """
    found, *exact = _polish(*problem, x, z)
    return (exact[0], exact[1]) if found else None


class DenseQp:
    """A persistent ProxQP workspace for problems of one size.

    Variables are scaled to a unit Hessian diagonal, rows to unit norm and the answer to the order
    of one first: entries of a decrease row are ~1/ε, those of a nearly singular input map larger
    still, and ProxQP's own test is absolute. ProxQP is asked for a coarse answer, which mostly
    tells the active set, and goes on to a fine one where the polished answer is not the optimum.
    Every problem starts from scratch: the answer depends on nothing but the problem.
    """

    def __init__(self, variables: int, rows: int) -> None:
        self._qp = proxqp.dense.QP(
            variables, 0, rows, False,
            proxqp.dense.HessianType.Dense, proxqp.dense.DenseBackend.PrimalDualLDLT,
        )  # fmt: skip
        settings = self._qp.settings
        settings.eps_rel = 0.0
        settings.max_iter, settings.max_iter_in = MAX_ITERATIONS, MAX_INNER
        settings.default_mu_in = MU_IN
        settings.compute_preconditioner = False
        settings.eps_primal_inf = settings.eps_dual_inf = 0.0  # false alarms; bounds are ordered
        self._fresh = True

    def solve(self, problem: Problem) -> Solution | None:
        """The answer, whatever its quality; None where no solver may see the problem."""
        sane, H, g, A, lower, upper, scale, norms, size = _scaled(*problem)
        if not sane:
            return None
        update = self._qp.init if self._fresh else self._qp.update
        update(H, g, None, None, A, lower, upper, False)
        self._fresh = False
        scaled = Problem(H, g, A, lower, upper)
        guesses = proxqp.InitialGuess
        solution = self._attempt(scaled, COARSE, guesses.NO_INITIAL_GUESS)
        if not all(residual <= FINE for residual in solution[2:]):  # NaN is not
            solution = self._attempt(scaled, FINE, guesses.WARM_START_WITH_PREVIOUS_RESULT)
        x, z = solution.x * scale * size, solution.multipliers / norms * size
        return Solution(x, z, solution.primal, solution.dual, solution.gap)

    def _attempt(self, scaled: Problem, eps: float, guess: proxqp.InitialGuess) -> Solution:
        """ProxQP's answer to the scaled problem, polished where that is better."""
        settings, results = self._qp.settings, self._qp.results
        settings.eps_abs, settings.initial_guess = eps, guess
        self._qp.solve()
        return Solution(*_refined(*scaled, np.array(results.x), np.array(results.z)))


@compiled
def _scaled(H, g, A, lower, upper):
    """(sane, scaled problem, scales of variables and rows, size of the answer).

    Sane is what a solver may see: finite data, bounds that are ordered and not NaN.
    """
    n, rows = len(g), len(lower)
    scale = np.ones(n)
    for i in range(n):
        if H[i, i] > 0:
            scale[i] = 1.0 / np.sqrt(H[i, i])
    H2, g2, A2 = H * np.outer(scale, scale), g * scale, A * scale
    norms = np.ones(rows)
    for i in range(rows):
        norm = np.sqrt(np.dot(A2[i], A2[i]))
        if norm != 0:
            norms[i] = norm
        A2[i] = A2[i] / norms[i]
    lower2, upper2 = lower / norms, upper / norms
    size = max(1.0, np.abs(g2).max())
    if rows:
        size = max(size, lower2.max(), -upper2.min())
    g2, lower2, upper2 = g2 / size, lower2 / size, upper2 / size
    sane = np.isfinite(size) and np.isfinite(H2).all() and np.isfinite(g2).all()
    sane = sane and np.isfinite(A2).all() and (lower2 <= upper2).all()
    return sane, H2, g2, A2, lower2, upper2, scale, norms, size


@compiled
def _residuals(H, g, A, lower, upper, x, z):
    Hx = H @ x
    primal, largest, support = 0.0, 1.0, 0.0
    stationarity = Hx + g
    dual_scale = max(1.0, np.abs(Hx).max(), np.abs(g).max())
    if len(z):
        Ax, Atz = A @ x, z @ A
        largest = max(largest, np.abs(Ax).max())
        for i in range(len(z)):
            excess = max(0.0, lower[i] - Ax[i], Ax[i] - upper[i]) / largest
            width = upper[i] - lower[i]
            if 0 < width < 1:
                excess = excess * largest / width  # in the units of its own range
            primal = max(primal, excess)
        stationarity = stationarity + Atz
        dual_scale = max(dual_scale, np.abs(Atz).max())
        # Lagrangian duality: xᵀHx + gᵀx + Σ (z⁺ upper - z⁻ lower) = 0 at the optimum
        for i in range(len(z)):
            if z[i] > 0:
                support += z[i] * upper[i]
            elif z[i] < 0:
                support += z[i] * lower[i]
    quadratic, linear = np.dot(x, Hx), np.dot(g, x)
    gap = abs(quadratic + linear + support)
    if np.isfinite(gap):
        gap /= max(1.0, abs(quadratic), abs(linear), abs(support))
    else:  # a multiplier on an open bound
        gap = np.inf
    return primal, np.abs(stationarity).max() / dual_scale, gap


@compiled
def _polish(H, g, A, lower, upper, x, z):
    n = len(x)
    Ax = A @ x
    at_upper = z > upper - Ax
    at_lower = -z > Ax - lower
    active = np.flatnonzero(at_upper | at_lower)
    multipliers = np.zeros_like(z)
    kkt = np.zeros((n + len(active), n + len(active)))
    target = np.zeros(n + len(active))
    kkt[:n, :n] = H
    target[:n] = -g
    for k in range(len(active)):
        i = active[k]
        kkt[:n, n + k] = A[i]
        kkt[n + k, :n] = A[i]
        target[n + k] = upper[i] if at_upper[i] else lower[i]
    try:
        answer = np.linalg.solve(kkt, target)
    except Exception:  # singular; Numba knows no narrower clause
        return False, x, z
    multipliers[active] = answer[n:]
    return True, answer[:n].copy(), multipliers


@compiled
def _refined(H, g, A, lower, upper, x, z):
    """The polished answer if that is the optimum, else (x, z); with its residuals."""
    if not (np.isfinite(x).all() and np.isfinite(z).all()):
        return x, z, np.inf, np.inf, np.inf
    for i in range(len(z)):
        # an open bound has no multiplier; what the solver leaves there counts as a dual residual
        if (z[i] > 0 and upper[i] == np.inf) or (z[i] < 0 and lower[i] == -np.inf):
            z[i] = 0.0
    x2, z2 = x, z
    for _ in range(POLISH_STEPS):
        found, x2, z2 = _polish(H, g, A, lower, upper, x2, z2)
        if not found:
            break
        primal, dual, gap = _residuals(H, g, A, lower, upper, x2, z2)
        if primal <= FINE and dual <= FINE and gap <= FINE:  # NaN is not
            return x2, z2, primal, dual, gap
    primal, dual, gap = _residuals(H, g, A, lower, upper, x, z)
    return x, z, primal, dual, gap
