"""Soft ID-CLF-QP, the paper's controller exactly as published, and its hard ancestor."""

from __future__ import annotations

import numpy as np

from controllers.controller import Command
from controllers.gains import Gains, resolve
from controllers.linear_algebra import row_space
from controllers.soft_inverse_dynamics import SoftInverseDynamics
from controllers.task import Task
from controllers.task_qp import Condensed, TaskQp
from softdyn import Reference, SetPoint, SoftModel, State


class SoftIdClfQp:
    """Paper, "Soft ID-CLF-QP": hard on the actuated dynamics, soft on the unactuated ones.

    Parameters
    ----------
    model : the robot.
    gains : the paper's for a bundled robot by default; required for any other.

    Raises
    ------
    InputError
        No gains for this robot, or a robot without inputs.
    """

    name = "soft-id-clf-qp"

    def __init__(self, model: SoftModel, gains: Gains | None = None) -> None:
        self.gains = resolve(model, self.name, gains)
        self._qp = TaskQp(
            model, self.gains, SoftInverseDynamics(self.gains, model.nu), decrease=True
        )
        self.guard = self._qp.guard

    def __call__(self, state: State, reference: Reference | SetPoint) -> Command:
        """The input at this state; see `Command`."""
        return self._qp.command(state, reference)


class IdClfQp:
    """ID-CLF-QP after Reher et al. 2019: the whole dynamics M q̈ + h = B u as the constraint.

    The paper's Discussion reports that it does not converge on highly underactuated robots.
    Parameters and errors as for `SoftIdClfQp`.
    """

    name = "id-clf-qp"

    def __init__(self, model: SoftModel, gains: Gains | None = None) -> None:
        self.gains = resolve(model, self.name, gains)
        self._qp = TaskQp(
            model, self.gains, HardInverseDynamics(self.gains, model.nu), decrease=True
        )
        self.guard = self._qp.guard

    def __call__(self, state: State, reference: Reference | SetPoint) -> Command:
        """The input at this state; see `Command`."""
        return self._qp.command(state, reference)


class HardInverseDynamics:
    """The published objective with q̈ = M⁻¹(B u - h) substituted: the unknowns are u.

    w1 ‖μ - μ_ref‖² + w2 ‖q̈‖² + w3 ‖u‖² + w4 ‖N (q̈ + D q̇)‖².
    """

    def __init__(self, gains: Gains, nu: int) -> None:
        self.gains = gains
        self.size = nu

    def condense(self, state: State, task: Task) -> Condensed:
        """The programme at this state."""
        w, v = self.gains, state.v
        columns = np.linalg.solve(state.M, np.column_stack((state.B, state.h)))
        X, drift = columns[:, :-1], -columns[:, -1]  # q̈ = drift + X u
        reach = row_space(state.J)

        def null(a: np.ndarray) -> np.ndarray:
            return a - reach.T @ (reach @ a)

        mu_map, mu_0 = state.J @ X, state.J @ drift + state.Jdot @ v - task.yddot
        NX, N_drift = null(X), null(drift + w.null_damping * v)
        H = 2 * (w.w1 * mu_map.T @ mu_map + w.w2 * X.T @ X + w.w4 * NX.T @ NX)
        H += 2 * w.w3 * np.eye(self.size)
        g = 2 * (w.w1 * mu_map.T @ (mu_0 - task.mu_ref) + w.w2 * X.T @ drift)
        g += 2 * w.w4 * NX.T @ N_drift
        return Condensed(H, g, mu_map, mu_0, np.eye(self.size), np.zeros(self.size))
