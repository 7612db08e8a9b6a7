"""CLF-QP: input-output linearisation under bounds, the paper's first controller."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np

from softdyn import SoftModel, State
from softdyn.compiled import compiled
from softdyn.controllers.controller import SILENT, Command, InputGuard, Status
from softdyn.controllers.gains import Gains
from softdyn.controllers.law import InputRule, TaskLaw
from softdyn.controllers.qps.least_norm import bounded_least_norm
from softdyn.controllers.qps.level_qp import LevelQp
from softdyn.controllers.qps.linear_algebra import (
    RANK_TOLERANCE,
    cholesky,
    dot,
    inner,
    lq,
    row_space,
)
from softdyn.controllers.qps.qp import ACCEPTED, DenseQp, QpProblem
from softdyn.controllers.qps.stacked_error import TaskRows, several_levels
from softdyn.controllers.qps.task_qp import Condensed


class ClfQp(TaskLaw):
    """Paper, "CLF-QP": min w1 ‖μ - μ_ref‖² + ρ δ² with L_g L_f y u = -L_f² y + μ + ÿ_ref.

    Its arguments and errors are those of `TaskLaw`.
    """

    name = "clf-qp"
    label = "CLF-QP"
    order = 1
    published = MappingProxyType(
        {
            "finger": Gains(500, 0.05),
            "helix": Gains(500, 0.05),
            "spirob": Gains(500, 0.01),
            "spirob48": Gains(500, 0.01),
        }
    )

    def _make_rule(self, model: SoftModel, gains: Gains, error: TaskRows) -> InputRule:
        """The QP in u alone, or one for each level of the tasks."""
        if several_levels(error):
            return LevelQp(model, gains, LeastInput(model.nu), decrease=True, apart=True)
        return Linearisation(model, gains)


class LeastInput:
    """‖u‖² alone, with μ as a function of u: the lowest level if tasks have several."""

    def __init__(self, nu: int) -> None:
        self.size = nu

    def condense(self, state: State, M: np.ndarray, h: np.ndarray, tip: TaskRows) -> Condensed:
        """The objective at this state, and μ = J M⁻¹(B u - h) + J̇ q̇ - ÿ_ref."""
        mobility = np.linalg.solve(M, tip.J.T).T
        mu_0 = tip.Jdot @ state.v - tip.yddot - mobility @ h
        return Condensed(np.eye(self.size), np.zeros(self.size), mobility @ state.B, mu_0)


class Linearisation:
    """The QP in u alone: L_g L_f y = J M⁻¹ B (3, m), L_f² y = J̇ q̇ - J M⁻¹ h.

    If m > 3 or J M⁻¹ B loses rank, μ does not determine u, and the published objective has no term
    that chooses. The controller then takes exactly the minimiser of least norm.
    """

    solvers: tuple[DenseQp, ...] = ()

    def __init__(self, model: SoftModel, gains: Gains) -> None:
        self._weights = float(gains.w1), float(gains.rho)
        self._bounds = model.u_min, model.u_max
        self._u = np.zeros(model.nu)

    def command(self, state: State, tip: TaskRows, guard: InputGuard) -> Command:
        """The bounded input, or the guard's fallback."""
        residual, delta = _law(
            state.M, state.h, state.v, state.B.T, tip.J, tip.Jdot,
            tip.mu_ref, tip.yddot, tip.row, tip.bound, *self._weights, *self._bounds, self._u,
        )  # fmt: skip
        if residual != residual:
            return guard.fall_back(Status.NON_FINITE, tip.V, np.nan, self._problem(state, tip))
        if residual > ACCEPTED:
            return guard.fall_back(Status.NOT_SOLVED, tip.V, delta, self._problem(state, tip))
        return guard.accept(self._u, tip.V, delta)

    def reset(self) -> None:
        """Do nothing: no call depends on earlier ones."""

    @SILENT
    def _problem(self, state: State, tip: TaskRows) -> QpProblem | None:
        """The published QP in (u, δ), for another solver; None where M is singular."""
        m, (w1, rho) = len(self._u), self._weights
        try:
            _, _, mu_map, mu_0 = LeastInput(m).condense(state, state.M, state.h, tip)
        except np.linalg.LinAlgError:
            return None
        problem = QpProblem.empty(m + 1, m + 1)
        problem.H[:m, :m] = 2 * w1 * mu_map.T @ mu_map
        problem.H[m, m] = 2 * rho
        problem.g[:m] = 2 * w1 * mu_map.T @ (mu_0 - tip.mu_ref)
        problem.A[:m, :m], problem.A[m, :m], problem.A[m, m] = np.eye(m), tip.row @ mu_map, -1
        problem.lower[:m], problem.upper[:m] = self._bounds
        problem.lower[m], problem.upper[m] = -np.inf, tip.bound[0] - tip.row @ mu_0
        return problem


@compiled
def _law(
    M, h, v, Bt, J, Jdot, mu_ref, yddot, row, bound, w1, rho, lower, upper, u
):  # fmt: skip
    """Write the input into `u` (m,); return the residual of its QP, and δ."""
    (m, n), k = Bt.shape, len(J)
    right, stacked, wanted = np.empty((m + k + 1, n)), np.zeros((k + 1, m)), np.empty(k + 1)
    for i in range(n):
        for x in range(k):
            right[x, i] = J[x, i]
        for j in range(m):
            right[k + j, i] = Bt[j, i]
        right[k + m, i] = h[i]
    half = cholesky(M, right)[1]
    # √w1 (μ - μ_ref) and √ρ δ are the rows of stacked u - wanted
    first, second, slack = np.sqrt(w1), np.sqrt(rho), -bound[0]
    along, rest, at_reference, linear = np.zeros(m), slack, slack, np.empty((k, m))
    for x in range(k):
        drift = dot(Jdot[x], v) - dot(half[x], half[k + m]) - yddot[x]
        wanted[x] = first * (mu_ref[x] - drift)
        rest += row[x] * drift
        at_reference += row[x] * mu_ref[x]
        for j in range(m):
            linear[x, j] = dot(half[x], half[k + j])  # of J M⁻¹ B
            stacked[x, j] = first * linear[x, j]
            along[j] += row[x] * linear[x, j]
    for j in range(m):
        stacked[k, j] = second * along[j]
    wanted[k] = -second * rest
    # With δ = max(0, …) the objective is one of two quadratics, with δ or without it. The right one
    # has a minimiser with the sign of δ that it assumes.
    residual, delta, late = np.nan, np.nan, at_reference > 0
    for _ in range(2):
        count = k + 1 if late else k
        Q = row_space(linear if w1 > 0 else stacked[k:count], RANK_TOLERANCE)
        r = len(Q)
        basis, triangle, d = np.empty((r, count)), np.empty((r, r)), np.empty(r)
        lq(inner(Q, stacked[:count]), basis, triangle)
        R = np.empty((r, r))
        for x in range(r):
            d[x] = dot(basis[x], wanted[:count])
            for i in range(r):
                R[x, i] = triangle[i, x]
        residual = bounded_least_norm(R, Q, d, lower, upper, u)
        delta = rest + dot(along, u)
        if (delta > 0) == late:
            break
        late = not late
    return residual, 0.0 if delta <= 0 else delta
