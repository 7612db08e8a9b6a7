"""CLF-QP: input-output linearisation under bounds, the paper's first controller."""

from __future__ import annotations

import numpy as np

from softdyn import SoftModel, State
from softdyn.compiled import compiled
from softdyn.controllers.gains import Gains, resolve
from softdyn.controllers.law import TaskLaw
from softdyn.controllers.programmes.linear_algebra import add_squares, cholesky, dot, inner
from softdyn.controllers.programmes.task import Task
from softdyn.controllers.programmes.task_qp import Condensed, TaskQp

# Weight on ‖u‖², relative to the task's own curvature, that picks the least-norm minimiser.
LEAST_NORM = 1e-8
TINY = float(np.finfo(float).tiny)


class ClfQp(TaskLaw):
    """Paper, "CLF-QP": min w1 ‖μ - μ_ref‖² + ρ δ² with L_g L_f y u = -L_f² y + μ + ÿ_ref.

    Parameters
    ----------
    model : SoftModel
        The robot.
    gains : Gains, optional
        The paper's for a bundled robot by default; required for any other.

    Raises
    ------
    InputError
        No gains for this robot, or a robot without inputs.
    """

    name = "clf-qp"

    def __init__(self, model: SoftModel, gains: Gains | None = None) -> None:
        gains = resolve(model, self.name, gains)
        objective = Linearisation(gains, model.nu)
        super().__init__(model, gains, TaskQp(model, gains, objective, decrease=True))


class Linearisation:
    """The objective in u alone: L_g L_f y = J M⁻¹ B (3, m), L_f² y = J̇ q̇ - J M⁻¹ h.

    With m > 3, or where J M⁻¹ B loses rank, u is not determined by μ and the published objective
    has no term to choose: the least-norm minimiser is taken, in the limit of a vanishing weight.
    """

    def __init__(self, gains: Gains, nu: int) -> None:
        self.size = nu
        self._w1 = float(gains.w1)
        self._condensed = Condensed.empty(nu)

    def condense(self, state: State, M: np.ndarray, h: np.ndarray, task: Task) -> Condensed:
        """The programme at this state."""
        _condense(
            M, h, state.v, state.B.T, state.J, state.Jdot,
            task.mu_ref, task.yddot, self._w1, *self._condensed,
        )  # fmt: skip
        return self._condensed


@compiled
def _condense(M, h, v, Bt, J, Jdot, mu_ref, yddot, w1, H, g, mu_map, mu_0):
    m, n = Bt.shape
    rows, short = np.empty((m + 4, n)), np.empty(3)
    rows[:3], rows[3 : 3 + m], rows[3 + m] = J, Bt, h
    half = cholesky(M, rows)[1]
    products = inner(half[:3], half[3:])  # J M⁻¹ [B h]
    for x in range(3):
        for j in range(m):
            mu_map[x, j] = products[x, j]
        mu_0[x] = dot(Jdot[x], v) - products[x, m] - yddot[x]
        short[x] = mu_0[x] - mu_ref[x]
    H[:], g[:] = 0.0, 0.0
    add_squares(H, g, w1, mu_map, short)
    ridge = LEAST_NORM * np.trace(H) + TINY
    for i in range(m):
        H[i, i] += ridge
