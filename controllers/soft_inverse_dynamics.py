"""The soft inverse-dynamics programme, condensed: exact, and of a size that n does not enter.

Paper, "Soft ID-CLF-QP" and "IC-QP": minimise over q̈ and u

    w1 ‖μ - μ_ref‖² + w2 ‖q̈‖² + w3 ‖u‖² + w4 ‖N (q̈ + D q̇)‖²,    μ = J q̈ + J̇ q̇ - ÿ_ref,

subject to the actuated rows of the dynamics, which read u = B⁺(M q̈ + h) (+ a free null input
where B loses rank). `docs/derivations.md` proves that its optimum is q̈ = -c q̇ + Z z with
c = w4 D / (w2 + w4) and Z an orthonormal basis of range[Jᵀ Aᵀ], A = B⁺ M.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.gains import Gains
from softdyn import State

# Singular values below this share of the largest count as zero, in J and in B alike.
RANK_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class Condensed:
    """The programme in x = (z, s): ½ xᵀHx + gᵀx, and what x means.

    Attributes
    ----------
    H, g : (k, k), (k,) the objective.
    mu_map, mu_0 : (3, k), (3,) so that μ = mu_0 + mu_map x.
    u_map, u_0 : (m, k), (m,) so that u = u_0 + u_map x.
    """

    H: np.ndarray
    g: np.ndarray
    mu_map: np.ndarray
    mu_0: np.ndarray
    u_map: np.ndarray
    u_0: np.ndarray


@dataclass(frozen=True, slots=True)
class InputFactors:
    """B⁺ = inverse · range and the directions of u that B does not see.

    Attributes
    ----------
    range : (rank, n) orthonormal rows that span range(B).
    inverse : (m, rank).
    null : (m, m - rank) orthonormal basis of null(B).
    """

    range: np.ndarray
    inverse: np.ndarray
    null: np.ndarray


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

    def condense(self, state: State, mu_ref: np.ndarray, yddot: np.ndarray) -> Condensed:
        """The programme at `state` for a task acceleration reference.

        Parameters
        ----------
        mu_ref : (3,) desired μ, -K_d ė - K_p e.
        yddot : (3,) acceleration of the reference.
        """
        if state.B is not self._B:
            self._factors, self._B = factor(state.B), state.B
        w, c, v, B = self.gains, self._c, state.v, self._factors
        actuated = B.range @ state.M  # spans the rows of A = B⁺ M
        task = row_space(state.J)
        Z = np.linalg.qr(np.concatenate((task, actuated)).T)[0]  # leading columns span range(Jᵀ)
        r, k, null = len(task), Z.shape[1], B.null.shape[1]

        mu_map = np.zeros((3, self.size))
        mu_map[:, :r] = state.J @ Z[:, :r]
        u_map = np.zeros((B.inverse.shape[0], self.size))
        u_map[:, :k] = B.inverse @ (actuated @ Z)
        u_map[:, k : k + null] = B.null
        mu_0 = state.Jdot @ v - yddot - c * state.ydot
        u_0 = B.inverse @ (B.range @ state.h - c * (actuated @ v))

        weights = np.full(self.size, w.w2 + w.w4)
        weights[:r] = w.w2
        weights[k : k + null] = 0.0
        weights[k + null :] = 1.0  # unused unknowns: zero at the optimum
        H = 2 * (w.w1 * mu_map.T @ mu_map + w.w3 * u_map.T @ u_map + np.diag(weights))
        g = 2 * (w.w1 * mu_map.T @ (mu_0 - mu_ref) + w.w3 * u_map.T @ u_0)
        g[:r] -= 2 * w.w2 * c * (Z[:, :r].T @ v)
        return Condensed(H, g, mu_map, mu_0, u_map, u_0)


def row_space(J: np.ndarray) -> np.ndarray:
    """Orthonormal rows (r, n) that span range(Jᵀ), r the numerical rank of J (3, n)."""
    _, values, rows = np.linalg.svd(J, full_matrices=False)
    return rows[values > RANK_TOLERANCE * max(values[0], np.finfo(float).tiny)]


def factor(B: np.ndarray) -> InputFactors:
    """Factors of the input matrix B (n, m), its rank judged at `RANK_TOLERANCE`."""
    left, values, right = np.linalg.svd(B, full_matrices=len(B) < len(B.T))
    rank = int((values > RANK_TOLERANCE * max(values[0], np.finfo(float).tiny)).sum())
    return InputFactors(left[:, :rank].T, right[:rank].T / values[:rank], right[rank:].T)
