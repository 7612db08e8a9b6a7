"""ID-CLF-QP: the hard ancestor of the Soft ID-CLF-QP."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np

from softdyn import SoftModel, State
from softdyn.compiled import compiled
from softdyn.controllers.gains import Gains
from softdyn.controllers.law import InputRule, TaskLaw
from softdyn.controllers.qps.level_qp import make_qp
from softdyn.controllers.qps.linear_algebra import (
    RANK_TOLERANCE,
    add_squares,
    cholesky,
    dot,
    row_space,
)
from softdyn.controllers.qps.stacked_error import TaskRows
from softdyn.controllers.qps.task_qp import Condensed


class IdClfQp(TaskLaw):
    """ID-CLF-QP after Reher et al. 2019: the whole dynamics M q̈ + h = B u as the constraint.

    The paper's Discussion reports that it does not converge on highly underactuated robots.

    Its arguments and errors are those of `TaskLaw`; the default gains are the Soft ID-CLF-QP's.
    """

    name = "id-clf-qp"
    label = "ID-CLF-QP (hard)"
    order = 3
    # the paper's table lacks it: those of the soft one
    published = MappingProxyType(
        {
            "finger": Gains(500, 0.03, 1, 0.2, 0.2, 0.1),
            "helix": Gains(500, 0.05, 1, 0.1, 0.2, 0.1),
            "spirob": Gains(500, 0.01, 1, 0.2, 0.5, 0.1),
            "spirob48": Gains(500, 0.01, 1, 0.2, 0.5, 0.1),
        }
    )

    def _make_rule(self, model: SoftModel, gains: Gains, error: TaskRows) -> InputRule:
        """The QP in u, with the decrease condition."""
        return make_qp(
            model,
            gains,
            lambda gains: HardInverseDynamics(gains, model.nu, error.rows),
            error,
            decrease=True,
        )


class HardInverseDynamics:
    """The published objective with q̈ = M⁻¹(B u - h) substituted; the only unknown is u.

    w1 ‖μ - μ_ref‖² + w2 ‖q̈‖² + w3 ‖u‖² + w4 ‖N (q̈ + D q̇)‖².
    """

    def __init__(self, gains: Gains, nu: int, rows: int = 3) -> None:
        self.size = nu
        self._weights = np.array(
            [gains.w1, gains.w2, gains.w3, gains.w4, gains.null_damping], float
        )
        self._condensed = Condensed.empty(nu, rows)

    def condense(self, state: State, M: np.ndarray, h: np.ndarray, tip: TaskRows) -> Condensed:
        """The QP at this state."""
        _condense(
            M, h, state.v, state.B.T, tip.J, tip.Jdot, tip.mu_ref, tip.yddot,
            self._weights, *self._condensed,
        )  # fmt: skip
        return self._condensed


@compiled
def _condense(M, h, v, Bt, J, Jdot, mu_ref, yddot, weights, H, g, mu_map, mu_0):
    w1, w2, w3, w4, damping = weights[0], weights[1], weights[2], weights[3], weights[4]
    m, n = Bt.shape
    # q̈ = M⁻¹B u + drift; the rows of X are the columns of M⁻¹B, and drift
    right = np.empty((m + 1, n))
    for x in range(n):
        for i in range(m):
            right[i, x] = Bt[i, x]
        right[m, x] = -h[x]
    R, X = cholesky(M, right)
    for i in range(n - 1, -1, -1):  # R X = the rows so far
        for x in range(m + 1):
            X[x, i] = (X[x, i] - dot(R[i, i + 1 : n], X[x, i + 1 :])) / R[i, i]
    drift, damped = X[m], np.empty(n)
    for x in range(n):
        damped[x] = drift[x] + damping * v[x]
    row_basis = row_space(J, RANK_TOLERANCE)
    r = len(row_basis)
    RX, Rd, short = np.empty((r, m)), np.empty(r), np.empty(len(J))
    for x in range(r):
        Rd[x] = dot(row_basis[x], damped)
        for i in range(m):
            RX[x, i] = dot(row_basis[x], X[i])
    for x in range(len(J)):
        for j in range(m):
            mu_map[x, j] = dot(J[x], X[j])
        mu_0[x] = dot(J[x], drift) + dot(Jdot[x], v) - yddot[x]
        short[x] = mu_0[x] - mu_ref[x]
    # N is a projector: (N X)ᵀ N X = XᵀX - (R X)ᵀ R X
    for i in range(m):
        g[i] = 2 * (w2 * dot(X[i], drift) + w4 * dot(X[i], damped))
        for j in range(i + 1):
            H[i, j] = H[j, i] = 2 * (w2 + w4) * dot(X[i], X[j])
    add_squares(H, g, w1, mu_map, short)
    add_squares(H, g, -w4, RX, Rd)
    for i in range(m):
        H[i, i] += 2 * w3
