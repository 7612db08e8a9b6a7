"""The soft inverse-dynamics QP, condensed exactly; its size does not depend on n.

Paper, "Soft ID-CLF-QP" and "IC-QP": minimise over q̈ and u

    w1 ‖μ - μ_ref‖² + w2 ‖q̈‖² + w3 ‖u - u_ref‖² + w4 ‖N (q̈ + D q̇)‖²,    μ = J q̈ + J̇ q̇ - ÿ_ref,

subject to the actuated rows of the dynamics, u = B⁺(M q̈ + h), plus a free null input if B loses
rank. As equations they read U (M q̈ + h) = U B u; the rows of U are an orthonormal basis of
range(B). `docs/derivations.md` proves that the optimum is q̈ = -c q̇ + Zᵀ z with
c = w4 D / (w2 + w4); the rows of Z are an orthonormal basis of the rows of [U M; J]. The actuated
rows give the first part of z from u. The unknowns are u and the rest of z, at most as many numbers
as J has rows. u_ref is 0 in the paper.
"""

from __future__ import annotations

import numpy as np

from softdyn import State
from softdyn.compiled import compiled
from softdyn.controllers.gains import Gains
from softdyn.controllers.qps.linear_algebra import (
    RANK_TOLERANCE,
    add,
    add_squares,
    dot,
    extend,
    inner,
    lq,
    row_space,
)
from softdyn.controllers.qps.stacked_error import TaskRows
from softdyn.controllers.qps.task_qp import Condensed


class SoftInverseDynamics:
    """Builds the condensed QP; keeps the range of B while B does not change.

    `size` is the number of unknowns, m + rows; if J has a lower rank, some of them are unused.

    Parameters
    ----------
    gains : Gains
        The controller's gains.
    nu : int
        Number m of inputs.
    u_ref : ndarray, (nu,), optional
        The input that has no cost.
    rows : int
        Number of rows of J.
    """

    def __init__(
        self, gains: Gains, nu: int, u_ref: np.ndarray | None = None, rows: int = 3
    ) -> None:
        self.size = rows + nu
        self._u_ref = np.zeros(nu) if u_ref is None else np.array(u_ref)
        total = gains.w2 + gains.w4
        # w2 = w4 = 0 leaves q̈ outside Z undetermined: take the least-norm one
        c = gains.w4 * gains.null_damping / total if total > 0 else 0.0
        self._weights = np.array([gains.w1, gains.w2, gains.w3, gains.w4, c], float)
        self._B: np.ndarray | None = None
        self._span = self._span_B = np.empty((0, 0))
        self._condensed = Condensed.empty(self.size, rows)

    def condense(self, state: State, M: np.ndarray, h: np.ndarray, tip: TaskRows) -> Condensed:
        """The QP at this state."""
        if state.B is not self._B:
            # orthonormal rows U (a, n) that span range(B), and U B (a, m)
            Bt, self._B = state.B.T, state.B
            self._span = row_space(Bt, RANK_TOLERANCE)
            self._span_B = inner(self._span, Bt)
        _condense(
            M, h, state.v, tip.J, tip.Jdot, tip.ydot, self._span, self._span_B,
            tip.mu_ref, tip.yddot, self._u_ref, self._weights, *self._condensed,
        )  # fmt: skip
        return self._condensed


@compiled
def _condense(
    M, h, v, J, Jdot, ydot, span, span_B, mu_ref, yddot, u_ref, weights, H, g, mu_map, mu_0
):  # fmt: skip
    w1, w2, w3, w4, c = weights[0], weights[1], weights[2], weights[3], weights[4]
    a, m = span_B.shape
    n, size = len(v), len(g)
    row_basis = row_space(J, RANK_TOLERANCE)
    r, both = len(row_basis), w2 + w4
    Z, triangle, right = np.empty((a + r, n)), np.empty((a, a)), np.empty((a, m + 1))
    if a:
        # The actuated rows come first, because their triangle is no worse conditioned than M for
        # any B. They are triangle z[:a] = span (B u - h + c M v).
        actuated = inner(span, M)  # M is symmetric
        lq(actuated, Z, triangle)
        for i in range(a):
            for j in range(m):
                right[i, j] = span_B[i, j]
            right[i, m] = c * dot(actuated[i], v) - dot(span[i], h)
            for j in range(m + 1):
                for x in range(i):
                    right[i, j] -= triangle[i, x] * right[x, j]
                right[i, j] /= triangle[i, i]
    k = extend(Z, a, row_basis)

    # z = z_0 + Y x in the unknowns x = (u, z[a:], padding), with Y = [right 0; 0 I]
    RY, Rz, none = np.empty((r, size)), np.empty(r), np.zeros(r)
    task, short = np.empty((len(J), n)), np.empty(len(J))
    for x in range(len(J)):
        for i in range(n):
            task[x, i] = J[x, i]  # a State's J is read-only, another type
    _through(row_basis, Z, right, k, RY, Rz)
    _through(task, Z, right, k, mu_map, mu_0)
    for x in range(len(J)):
        mu_0[x] += dot(Jdot[x], v) - yddot[x] - c * ydot[x]
        short[x] = mu_0[x] - mu_ref[x]

    # with R = row_basis Zᵀ, w2 ‖q̈‖² + w4 ‖N (q̈ + D q̇)‖² is
    # (w2 + w4) ‖z‖² - w4 ‖R z‖² - 2 w2 c (R z)·(row_basis q̇) + const
    for i in range(size):
        g[i] = 0.0
        for j in range(size):
            H[i, j] = 0.0
    add_squares(H, g, w1, mu_map, short)
    add_squares(H, g, -w4, RY, none)
    for x in range(r):
        add(g, -2 * (w4 * Rz[x] + w2 * c * dot(row_basis[x], v)), RY[x])
    for x in range(a):
        for i in range(m):
            part = 2 * both * right[x, i]
            g[i] += part * right[x, m]
            for j in range(i + 1):
                H[i, j] += part * right[x, j]
    for i in range(m):
        for j in range(i):
            H[j, i] = H[i, j]
        H[i, i] += 2 * w3
        g[i] -= 2 * w3 * u_ref[i]
    for i in range(m, size):
        H[i, i] += 2 * both if i < m + k - a else 1.0  # an unused unknown is zero at the optimum


@compiled
def _through(rows, Z, right, k, product, constant):
    """Write rows Zᵀ (p, k) times Y into `product` (p, size), and times z_0 into `constant` (p,)."""
    a, m = len(right), right.shape[1] - 1
    for x in range(len(rows)):
        for j in range(product.shape[1]):
            product[x, j] = 0.0
        constant[x] = 0.0
        for i in range(k):
            along = dot(rows[x], Z[i])
            if i < a:
                for j in range(m):
                    product[x, j] += along * right[i, j]
                constant[x] += along * right[i, m]
            else:
                product[x, m + i - a] = along
