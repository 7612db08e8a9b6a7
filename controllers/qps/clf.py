"""The rapidly exponentially stabilising control Lyapunov function of the task error.

Paper, section "CLF-QP Controller", eqs. (6) to (10), after Ames et al. 2014: η = (e, ė),
η̇ = F η + G μ, V = ηᵀ P_ε η with P from the Riccati equation (9) and P_ε = diag(I/ε, I) P
diag(I/ε, I).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_continuous_are

from softdyn import InputError

F = np.block([[np.zeros((3, 3)), np.eye(3)], [np.zeros((3, 6))]])
G = np.vstack([np.zeros((3, 3)), np.eye(3)])


@dataclass(frozen=True, eq=False)
class Clf:
    """V and its decrease condition V̇ ≤ -V/ε + δ, linear in μ; paper, eqs. (8) and (10).

    Attributes
    ----------
    eps : float
        ε (s); γ = 1/ε is the rate of decrease.
    P_eps : ndarray, (6, 6)
        P_ε.
    """

    eps: float
    P_eps: np.ndarray

    def decrease(self, eta: np.ndarray) -> tuple[float, np.ndarray, float]:
        """V, and the row `a` and bound `b` of the condition a·μ - δ ≤ b.

        V̇ = ηᵀ(FᵀP_ε + P_ε F)η + 2 ηᵀ P_ε G μ, eq. (10), so a = 2 Gᵀ P_ε η and
        b = -V/ε - 2 ηᵀ P_ε F η.

        Parameters
        ----------
        eta : ndarray, (6,)
            η = (e, ė) in m and m/s.

        Returns
        -------
        V : float
        a : ndarray, (3,)
        b : float
        """
        gradient = 2.0 * (self.P_eps @ eta)
        V = float(eta @ gradient) / 2
        return V, gradient[3:], -V / self.eps - float(gradient[:3] @ eta[3:])


def make_clf(eps: float, Q: np.ndarray | None = None, R: np.ndarray | None = None) -> Clf:
    """P_ε from the Riccati equation FᵀP + PF - P G R⁻¹ GᵀP + Q = 0; paper, eq. (9).

    Parameters
    ----------
    eps : float
        ε > 0 (s).
    Q : ndarray, (6, 6), optional
        Weight on η, identity by default (the reference's choice).
    R : ndarray, (3, 3), optional
        Weight on μ, identity by default.

    Raises
    ------
    InputError
        For an ε whose inverse square is not finite.
    """
    P = solve_continuous_are(F, G, np.eye(6) if Q is None else Q, np.eye(3) if R is None else R)
    scale = np.array([1 / eps] * 3 + [1.0] * 3)
    with np.errstate(over="ignore"):
        P_eps = scale[:, None] * P * scale
    if not np.isfinite(P_eps).all():
        raise InputError("gains.eps", "a number whose inverse square is finite", eps)
    return Clf(eps, P_eps)
