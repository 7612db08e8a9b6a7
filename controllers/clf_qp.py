"""CLF-QP: input-output linearisation under bounds, the paper's first controller."""

from __future__ import annotations

import numpy as np

from controllers.controller import Command
from controllers.gains import Gains, resolve
from controllers.task import Task
from controllers.task_qp import Condensed, TaskQp
from softdyn import Reference, SetPoint, SoftModel, State

# Weight on ‖u‖², relative to the task's own curvature, that picks the least-norm minimiser.
LEAST_NORM = 1e-8


class ClfQp:
    """Paper, "CLF-QP": min w1 ‖μ - μ_ref‖² + ρ δ² with L_g L_f y u = -L_f² y + μ + ÿ_ref.

    Parameters and errors as for `SoftIdClfQp`.
    """

    name = "clf-qp"

    def __init__(self, model: SoftModel, gains: Gains | None = None) -> None:
        self.gains = resolve(model, self.name, gains)
        self._qp = TaskQp(model, self.gains, Linearisation(self.gains, model.nu), decrease=True)
        self.guard = self._qp.guard

    def __call__(self, state: State, reference: Reference | SetPoint) -> Command:
        """The input at this state; see `Command`."""
        return self._qp.command(state, reference)


class Linearisation:
    """The objective in u alone: L_g L_f y = J M⁻¹ B (3, m), L_f² y = J̇ q̇ - J M⁻¹ h.

    With m > 3, or where J M⁻¹ B loses rank, u is not determined by μ and the published objective
    has no term to choose: the least-norm minimiser is taken, in the limit of a vanishing weight.
    """

    def __init__(self, gains: Gains, nu: int) -> None:
        self.gains = gains
        self.size = nu

    def condense(self, state: State, task: Task) -> Condensed:
        """The programme at this state."""
        w1 = self.gains.w1
        columns = np.linalg.solve(state.M, np.column_stack((state.B, state.h)))
        mu_map = state.J @ columns[:, :-1]
        mu_0 = state.Jdot @ state.v - state.J @ columns[:, -1] - task.yddot
        H = 2 * w1 * mu_map.T @ mu_map
        H += (LEAST_NORM * np.trace(H) + np.finfo(float).tiny) * np.eye(self.size)
        g = 2 * w1 * mu_map.T @ (mu_0 - task.mu_ref)
        return Condensed(H, g, mu_map, mu_0, np.eye(self.size), np.zeros(self.size))
