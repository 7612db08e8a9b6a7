"""The soft inverse-dynamics programme, condensed: exact, and of a size that n does not enter.

Paper, "Soft ID-CLF-QP" and "IC-QP": minimise over q̈ and u

    w1 ‖μ - μ_ref‖² + w2 ‖q̈‖² + w3 ‖u‖² + w4 ‖N (q̈ + D q̇)‖²,    μ = J q̈ + J̇ q̇ - ÿ_ref,

subject to the actuated rows of the dynamics, which read u = B⁺(M q̈ + h) (+ a free null input
where B loses rank). `docs/derivations.md` proves that its optimum is q̈ = -c q̇ + Z z with
c = w4 D / (w2 + w4) and Z an orthonormal basis of range[Jᵀ Aᵀ], A = B⁺ M.
"""

from __future__ import annotations

import numpy as np

from controllers.gains import Gains
from controllers.linear_algebra import InputFactors, factor, row_space
from controllers.task import Task
from controllers.task_qp import Condensed
from softdyn import State


class SoftInverseDynamics:
    """Builds the condensed programme; keeps B⁺ while B does not change.

    `size` is the number of unknowns, 3 + m: what rank(J) or rank(B) leaves unused is padded.
    """

    def __init__(self, gains: Gains, nu: int) -> None:
        self.gains = gains
        self.size = 3 + nu
        total = gains.w2 + gains.w4
        # w2 = w4 = 0 leaves q̈ outside Z undetermined: take the least-norm one
        self._c = gains.w4 * gains.null_damping / total if total > 0 else 0.0
        self._B: np.ndarray | None = None
        self._factors = InputFactors(*[np.empty((0, 0))] * 3)

    def condense(self, state: State, task: Task) -> Condensed:
        """The programme at this state."""
        if state.B is not self._B:
            self._factors, self._B = factor(state.B), state.B
        w, c, v, B = self.gains, self._c, state.v, self._factors
        actuated = B.range @ state.M  # spans the rows of A = B⁺ M
        reach = row_space(state.J)
        Z = np.linalg.qr(np.concatenate((reach, actuated)).T)[0]  # leading columns span range(Jᵀ)
        r, k, null = len(reach), Z.shape[1], B.null.shape[1]

        mu_map = np.zeros((3, self.size))
        mu_map[:, :r] = state.J @ Z[:, :r]
        u_map = np.zeros((B.inverse.shape[0], self.size))
        u_map[:, :k] = B.inverse @ (actuated @ Z)
        u_map[:, k : k + null] = B.null
        mu_0 = state.Jdot @ v - task.yddot - c * state.ydot
        u_0 = B.inverse @ (B.range @ state.h - c * (actuated @ v))

        weights = np.full(self.size, w.w2 + w.w4)
        weights[:r] = w.w2
        weights[k : k + null] = 0.0
        weights[k + null :] = 1.0  # unused unknowns: zero at the optimum
        H = 2 * (w.w1 * mu_map.T @ mu_map + w.w3 * u_map.T @ u_map + np.diag(weights))
        g = 2 * (w.w1 * mu_map.T @ (mu_0 - task.mu_ref) + w.w3 * u_map.T @ u_0)
        g[:r] -= 2 * w.w2 * c * (Z[:, :r].T @ v)
        return Condensed(H, g, mu_map, mu_0, u_map, u_0)
