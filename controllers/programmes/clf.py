"""The rapidly exponentially stabilising control Lyapunov function of the task error.

Paper, section "CLF-QP Controller", after Ames et al. 2014: η = (e, ė), η̇ = F η + G μ,
V = ηᵀ P_ε η with P from the Riccati equation (eq:care) and P_ε = diag(I/ε, I) P diag(I/ε, I).
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
    """V and its decrease condition V̇ ≤ -V/ε + δ, linear in μ.

    Attributes
    ----------
    eps : ε (s), γ = 1/ε the rate of decrease.
    P_eps : (6, 6).
    """

    eps: float
    P_eps: np.ndarray

    def decrease(self, eta: np.ndarray) -> tuple[float, np.ndarray, float]:
        """V, and the row `a` (3,) and bound `b` of the condition a·μ - δ ≤ b.

        V̇ = ηᵀ(FᵀP_ε + P_ε F)η + 2 ηᵀ P_ε G μ, so a = 2 Gᵀ P_ε η and
        b = -V/ε - 2 ηᵀ P_ε F η. `eta` (6,) is (e, ė), in m and m/s.
        """
        gradient = 2.0 * (self.P_eps @ eta)
        V = float(eta @ gradient) / 2
        return V, gradient[3:], -V / self.eps - float(gradient[:3] @ eta[3:])


def make_clf(eps: float, Q: np.ndarray | None = None, R: np.ndarray | None = None) -> Clf:
    """P_ε from the Riccati equation FᵀP + PF - P G R⁻¹ GᵀP + Q = 0.

    Parameters
    ----------
    eps : ε > 0.
    Q, R : (6, 6), (3, 3) design weights, identity by default (the reference's choice).
    """
    P = solve_continuous_are(F, G, np.eye(6) if Q is None else Q, np.eye(3) if R is None else R)
    scale = np.array([1 / eps] * 3 + [1.0] * 3)
    with np.errstate(over="ignore"):
        P_eps = scale[:, None] * P * scale
    if not np.isfinite(P_eps).all():
        raise InputError("gains.eps", "a number whose inverse square is finite", eps)
    return Clf(eps, P_eps)
