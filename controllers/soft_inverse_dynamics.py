"""The soft inverse-dynamics programme, condensed: exact, and of a size that n does not enter.

Paper, "Soft ID-CLF-QP" and "IC-QP": minimise over q̈ and u

    w1 ‖μ - μ_ref‖² + w2 ‖q̈‖² + w3 ‖u‖² + w4 ‖N (q̈ + D q̇)‖²,    μ = J q̈ + J̇ q̇ - ÿ_ref,

subject to the actuated rows of the dynamics, u = B⁺(M q̈ + h) (+ a free null input where B loses
rank): U (M q̈ + h) = U B u, with the rows of U an orthonormal basis of range(B).
`docs/derivations.md` proves that the optimum is q̈ = -c q̇ + Zᵀ z with c = w4 D / (w2 + w4) and the
rows of Z an orthonormal basis of the rows of [U M; J]. The actuated rows give the first part of z
in terms of u; the unknowns are u and the rest, at most three.
"""

from __future__ import annotations

import numpy as np

from controllers.gains import Gains
from controllers.linear_algebra import extended, row_space
from controllers.task import Task
from controllers.task_qp import Condensed
from softdyn import State
from softdyn.compiled import compiled


class SoftInverseDynamics:
    """Builds the condensed programme; keeps the range of B while B does not change.

    `size` is the number of unknowns, m + 3: what rank(J) leaves unused is padded.
    """

    def __init__(self, gains: Gains, nu: int) -> None:
        self.size = 3 + nu
        total = gains.w2 + gains.w4
        # w2 = w4 = 0 leaves q̈ outside Z undetermined: take the least-norm one
        c = gains.w4 * gains.null_damping / total if total > 0 else 0.0
        self._weights = (gains.w1, gains.w2, gains.w3, gains.w4, c)
        self._B: np.ndarray | None = None
        self._span = np.empty((0, 0))

    def condense(self, state: State, task: Task) -> Condensed:
        """The programme at this state."""
        if state.B is not self._B:
            self._span, self._B = row_space(state.B.T.copy()), state.B
        return Condensed(
            *_condense(
                state.M, state.h, state.v, state.J, state.Jdot, state.ydot,
                self._span, state.B, task.mu_ref, task.yddot, *self._weights,
            )
        )  # fmt: skip


@compiled
def _condense(M, h, v, J, Jdot, ydot, span, B, mu_ref, yddot, w1, w2, w3, w4, c):
    a, m = len(span), B.shape[1]
    size = m + 3
    reach = row_space(J)
    if a:
        # The actuated rows come first: their triangle is no worse conditioned than M, whatever B
        # is. They read triangleᵀ z[:a] = span (B u - h + c M v).
        actuated = span @ M
        basis, triangle = np.linalg.qr(actuated.T.copy())
        Z = extended(basis.T.copy(), reach)
        right = np.zeros((a, m + 1))
        right[:, :m] = span @ B
        right[:, m] = c * (actuated @ v) - span @ h
        right = np.linalg.solve(triangle.T.copy(), right)
    else:
        Z, right = reach, np.zeros((0, m + 1))
    # z = z_0 + Y x in the unknowns x = (u, z[a:], padding)
    k = len(Z)
    Y, z_0 = np.zeros((k, size)), np.zeros(k)
    Y[:a, :m], z_0[:a] = right[:, :m], right[:, m]
    for i in range(a, k):
        Y[i, m + i - a] = 1.0

    along = J @ Z.T.copy()
    mu_map = along @ Y
    mu_0 = Jdot @ v - yddot - c * ydot + along @ z_0
    # w2 ‖q̈‖² + w4 ‖N (q̈ + D q̇)‖² is (w2 + w4) ‖z‖² - w4 ‖R z‖² - 2 w2 c (R z)·(reach q̇) + const
    R = reach @ Z.T.copy()
    RY, both = R @ Y, w2 + w4
    H = 2 * (w1 * mu_map.T @ mu_map + both * Y.T @ Y - w4 * RY.T @ RY)
    g = 2 * (w1 * mu_map.T @ (mu_0 - mu_ref) + both * Y.T @ z_0)
    g -= 2 * RY.T @ (w4 * (R @ z_0) + w2 * c * (reach @ v))
    for i in range(m):
        H[i, i] += 2 * w3
    for i in range(m + k - a, size):
        H[i, i] = 1.0  # unused: zero at the optimum
    return H, g, mu_map, mu_0, np.eye(m, size), np.zeros(m)
