"""Soft ID-CLF-QP, the paper's controller exactly as published, and its hard ancestor."""

from __future__ import annotations

import numpy as np

from controllers.controller import Command, guarded
from controllers.gains import Gains, resolve
from controllers.linear_algebra import row_space
from controllers.soft_inverse_dynamics import SoftInverseDynamics
from controllers.task import Task
from controllers.task_qp import Condensed, TaskQp
from softdyn import Reference, SetPoint, SoftModel, State
from softdyn.compiled import compiled


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

    @guarded
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

    @guarded
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
        w = self.gains
        return Condensed(
            *_hard(
                state.M, state.h, state.v, state.B, state.J, state.Jdot, task.mu_ref, task.yddot,
                w.w1, w.w2, w.w3, w.w4, w.null_damping,
            )
        )  # fmt: skip


@compiled
def _hard(M, h, v, B, J, Jdot, mu_ref, yddot, w1, w2, w3, w4, null_damping):
    m = B.shape[1]
    X, drift = np.linalg.solve(M, B), -np.linalg.solve(M, h)  # q̈ = drift + X u
    reach = row_space(J)
    NX = X - reach.T @ (reach @ X)
    damped = drift + null_damping * v
    N_damped = damped - reach.T @ (reach @ damped)
    mu_map, mu_0 = J @ X, J @ drift + Jdot @ v - yddot
    H = 2 * (w1 * mu_map.T @ mu_map + w2 * X.T @ X + w4 * NX.T @ NX + w3 * np.eye(m))
    g = 2 * (w1 * mu_map.T @ (mu_0 - mu_ref) + w2 * X.T @ drift + w4 * NX.T @ N_damped)
    return H, g, mu_map, mu_0, np.eye(m), np.zeros(m)
