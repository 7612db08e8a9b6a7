"""Small dense quadratic programs on ProxQP, with answers that know their own residuals.

    minimise ½ xᵀ H x + gᵀ x   subject to   lower ≤ A x ≤ upper

The only file that imports ProxSuite. Bad numbers never reach it: NaN in H, g or A holds it (and
the GIL) for up to a minute, NaN in a bound is dropped in silence, lower > upper spins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from proxsuite import proxqp

EPS = 1e-9  # what ProxQP is asked for, in scaled variables
ACCEPTED = 1e-6  # the largest scaled residual of an answer that counts as solved
MAX_ITERATIONS, MAX_INNER = 200, 100
POLISH_STEPS = 8


@dataclass(frozen=True, slots=True)
class Problem:
    """min ½ xᵀHx + gᵀx s.t. lower ≤ A x ≤ upper."""

    H: np.ndarray  # (n, n) symmetric, positive semidefinite
    g: np.ndarray  # (n,)
    A: np.ndarray  # (rows, n)
    lower: np.ndarray  # (rows,), -inf where open
    upper: np.ndarray  # (rows,), +inf where open

    def is_sane(self) -> bool:
        """Whether a solver may see it: finite data, bounds that are ordered and not NaN."""
        finite = np.isfinite(self.H).all() and np.isfinite(self.g).all()
        return bool(finite and np.isfinite(self.A).all() and (self.lower <= self.upper).all())


@dataclass(frozen=True, slots=True)
class Solution:
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

    def within(self, tolerance: float) -> bool:
        """Whether every residual is at most `tolerance`; NaN is not."""
        return self.primal <= tolerance and self.dual <= tolerance and self.gap <= tolerance

    @property
    def solved(self) -> bool:
        """Whether every residual is small enough."""
        return self.within(ACCEPTED)


def residuals(problem: Problem, x: np.ndarray, z: np.ndarray) -> tuple[float, float, float]:
    """Primal, dual and duality-gap residuals, each over the size of the terms that cancel in it."""
    Ax, Hx, Atz = problem.A @ x, problem.H @ x, problem.A.T @ z
    excess = np.maximum(np.maximum(problem.lower - Ax, Ax - problem.upper), 0.0)
    primal = excess.max() / max(1.0, np.abs(Ax).max())
    dual = np.abs(Hx + problem.g + Atz).max()
    dual /= max(1.0, np.abs(Hx).max(), np.abs(problem.g).max(), np.abs(Atz).max())
    # Lagrangian duality: xᵀHx + gᵀx + Σ (z⁺ upper - z⁻ lower) = 0 at the optimum
    up, down = z > 0, z < 0
    support = z[up] @ problem.upper[up] + z[down] @ problem.lower[down]
    if not math.isfinite(support):  # a multiplier on an open bound
        return float(primal), float(dual), math.inf
    quadratic, linear = x @ Hx, problem.g @ x
    gap = abs(quadratic + linear + support)
    gap /= max(1.0, abs(quadratic), abs(linear), abs(support))
    return float(primal), float(dual), float(gap)


def polish(problem: Problem, x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The exact optimum on the active set that an approximate (x, z) points at, or None.

    Solves the optimality conditions with the active rows as equalities (as in Stellato et al.
    2020, OSQP, section 5.2): the answer then depends neither on the warm start nor on the
    tolerance. Whether it is the optimum is for its residuals to say; where it is not, polishing
    it again is a step of the primal-dual active set method (Hintermüller et al. 2002).
    """
    n, Ax = len(x), problem.A @ x
    at_upper = z > problem.upper - Ax
    at_lower = -z > Ax - problem.lower
    active = np.flatnonzero(at_upper | at_lower)
    rows = problem.A[active]
    kkt = np.zeros((n + len(active), n + len(active)))
    kkt[:n, :n] = problem.H
    kkt[:n, n:], kkt[n:, :n] = rows.T, rows
    target = np.where(at_upper, problem.upper, problem.lower)[active]
    try:
        answer = np.linalg.solve(kkt, np.concatenate((-problem.g, target)))
    except np.linalg.LinAlgError:
        return None
    multipliers = np.zeros_like(z)
    multipliers[active] = answer[n:]
    return answer[:n], multipliers


class DenseQp:
    """A persistent ProxQP workspace for problems of one size, warm-started by the last answer.

    A warm start that fails is tried once more from scratch.

    Variables are scaled to a unit Hessian diagonal, rows to unit norm and the answer to the order
    of one first: entries of a decrease row are ~1/ε, those of a nearly singular input map larger
    still, and ProxQP's own test is absolute.
    """

    def __init__(self, variables: int, rows: int) -> None:
        self._shape = (variables, rows)
        self._qp: proxqp.dense.QP | None = None

    def solve(self, problem: Problem) -> Solution | None:
        """The answer, whatever its quality; None where no solver may see the problem."""
        with np.errstate(all="ignore"):  # bad numbers surface in the scaled problem
            scaled, scale, norms, size = self._scale(problem)
        if not scaled.is_sane():
            return None
        warm = self._qp is not None
        solution = self._attempt(scaled)
        if warm and not solution.solved:
            self._qp = None
            solution = self._attempt(scaled)
        if not solution.solved:
            self._qp = None  # never warm-start from a bad answer
        return Solution(
            solution.x * scale * size,
            solution.multipliers / norms * size,
            solution.primal,
            solution.dual,
            solution.gap,
        )

    @staticmethod
    def _scale(problem: Problem) -> tuple[Problem, np.ndarray, np.ndarray, float]:
        """The scaled problem, and the scales of its variables, rows and answer."""
        diagonal = problem.H.diagonal()
        scale = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        A = problem.A * scale
        norms = np.sqrt(np.einsum("ij,ij->i", A, A))
        norms[norms == 0] = 1.0
        g, lower, upper = problem.g * scale, problem.lower / norms, problem.upper / norms
        size = max(1.0, np.abs(g).max(), lower.max(), -upper.min())
        scaled = Problem(
            problem.H * np.outer(scale, scale),
            g / size,
            A / norms[:, None],
            lower / size,
            upper / size,
        )
        return scaled, scale, norms, size

    def _attempt(self, scaled: Problem) -> Solution:
        """ProxQP's answer to the scaled problem, polished where that is better."""
        results = self._run(scaled)
        x, z = np.array(results.x), np.array(results.z)
        if not (np.isfinite(x).all() and np.isfinite(z).all()):
            return Solution(x, z, np.inf, np.inf, np.inf)
        # an open bound has no multiplier; what the solver leaves there counts as a dual residual
        z[((z > 0) & np.isposinf(scaled.upper)) | ((z < 0) & np.isneginf(scaled.lower))] = 0.0
        exact: tuple[np.ndarray, np.ndarray] | None = (x, z)
        for _ in range(POLISH_STEPS):
            exact = polish(scaled, *exact)
            if exact is None:
                break
            solution = Solution(*exact, *residuals(scaled, *exact))
            if solution.within(EPS):
                return solution
        return Solution(x, z, *residuals(scaled, x, z))

    def _run(self, p: Problem) -> proxqp.dense.Results:
        if self._qp is not None:
            self._qp.update(p.H, p.g, None, None, p.A, p.lower, p.upper, False)
        else:
            self._qp = proxqp.dense.QP(
                self._shape[0], 0, self._shape[1], False,
                proxqp.dense.HessianType.Dense, proxqp.dense.DenseBackend.PrimalDualLDLT,
            )  # fmt: skip
            settings = self._qp.settings
            settings.eps_abs, settings.eps_rel = EPS, 0.0
            settings.check_duality_gap = True
            settings.eps_duality_gap_abs, settings.eps_duality_gap_rel = EPS, 0.0
            settings.max_iter, settings.max_iter_in = MAX_ITERATIONS, MAX_INNER
            settings.initial_guess = proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
            settings.compute_preconditioner = False
            self._qp.init(p.H, p.g, None, None, p.A, p.lower, p.upper, False)
        self._qp.solve()
        return self._qp.results
