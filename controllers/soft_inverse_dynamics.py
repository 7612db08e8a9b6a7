"""The soft inverse-dynamics programme, condensed: exact, and of a size that n does not enter.

Paper, "Soft ID-CLF-QP" and "IC-QP": minimise over q̈ and u

    w1 ‖μ - μ_ref‖² + w2 ‖q̈‖² + w3 ‖u‖² + w4 ‖N (q̈ + D q̇)‖²,    μ = J q̈ + J̇ q̇ - ÿ_ref,

subject to the actuated rows of the dynamics, which read u = B⁺(M q̈ + h) (+ a free null input
where B loses rank), or U (M q̈ + h) = U B u with U an orthonormal basis of range(B) as its rows.
`docs/derivations.md` proves that the optimum is q̈ = -c q̇ + Zᵀ z with c = w4 D / (w2 + w4) and the
rows of Z an orthonormal basis of the rows of [U M; J], and that u and at most three of z determine
all of it.
"""

from __future__ import annotations

import numpy as np

from controllers.gains import Gains
from controllers.linear_algebra import InputFactors, factor, row_space
from controllers.task import Task
from controllers.task_qp import Condensed
from softdyn import State


class SoftInverseDynamics:
    """Builds the condensed programme; keeps the factors of B while B does not change.

    The unknowns are u and the part of z that the actuated rows leave free. `size` is always
    m + 3; what rank(J) leaves unused is padded.
    """

    def __init__(self, gains: Gains, nu: int) -> None:
        self.gains = gains
        self.size = nu + 3
        total = gains.w2 + gains.w4
        # w2 = w4 = 0 leaves q̈ outside Z undetermined: take the least-norm one
        self._c = gains.w4 * gains.null_damping / total if total > 0 else 0.0
        self._u_map, self._u_0 = np.eye(nu, self.size), np.zeros(nu)
        self._B: np.ndarray | None = None
        self._factors: InputFactors

    def condense(self, state: State, task: Task) -> Condensed:
        """The programme at this state."""
        if state.B is not self._B:
            self._factors, self._B = factor(state.B), state.B
        w, c, v, B, m = self.gains, self._c, state.v, self._factors, len(self._u_0)
        actuated = B.range @ state.M
        reach = row_space(state.J)
        # The actuated rows first: their triangle is no worse conditioned than M, whatever B is.
        basis, triangle = np.linalg.qr(np.concatenate((actuated, reach)).T)
        a, k = len(actuated), basis.shape[1]
        # They read triangle[:a, :a]ᵀ z[:a] = forward u - U (h - c M v), so that
        # z = z_0 + Y x in the unknowns x = (u, z[a:], padding).
        drift = c * (actuated @ v) - B.range @ state.h
        solved = np.linalg.solve(triangle[:a, :a].T, np.column_stack((B.forward, drift)))
        Y, z_0 = np.zeros((k, self.size)), np.zeros(k)
        Y[:a, :m], z_0[:a] = solved[:, :m], solved[:, m]
        Y[a:, m : m + k - a] = np.eye(k - a)

        along = state.J @ basis
        mu_map = along @ Y
        mu_0 = state.Jdot @ v - task.yddot - c * state.ydot + along @ z_0
        # w2 ‖q̈‖² + w4 ‖N (q̈ + D q̇)‖² = (w2 + w4) ‖z‖² - w4 ‖R z‖² - 2 w2 c (R z)·(reach q̇) + const
        R = reach @ basis
        RY = R @ Y
        both = w.w2 + w.w4
        H = 2 * (w.w1 * mu_map.T @ mu_map + both * Y.T @ Y - w.w4 * RY.T @ RY)
        g = 2 * (w.w1 * mu_map.T @ (mu_0 - task.mu_ref) + both * Y.T @ z_0)
        g -= 2 * RY.T @ (w.w4 * (R @ z_0) + w.w2 * c * (reach @ v))
        diagonal = np.einsum("ii->i", H)
        diagonal[:m] += 2 * w.w3
        diagonal[m + k - a :] = 1.0  # padding: zero at the optimum
        return Condensed(H, g, mu_map, mu_0, self._u_map, self._u_0)
