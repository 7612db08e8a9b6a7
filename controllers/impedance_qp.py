"""IC-QP: impedance control wrapped in the soft inverse-dynamics programme."""

from __future__ import annotations

from softdyn import Reference, SetPoint, SoftModel, State
from softdyn.controllers.controller import Command, guarded
from softdyn.controllers.gains import Gains, resolve
from softdyn.controllers.programmes.soft_inverse_dynamics import SoftInverseDynamics
from softdyn.controllers.programmes.task_qp import TaskQp


class ImpedanceQp:
    """Paper, "IC-QP": the Soft ID-CLF-QP without its Lyapunov condition.

    Parameters and errors as for `SoftIdClfQp`.
    """

    name = "ic-qp"

    def __init__(self, model: SoftModel, gains: Gains | None = None) -> None:
        self.gains = resolve(model, self.name, gains)
        self._qp = TaskQp(
            model, self.gains, SoftInverseDynamics(self.gains, model.nu), decrease=False
        )
        self.guard, self.solvers = self._qp.guard, (self._qp.solver,)

    def reset(self, period: float) -> None:
        """Begin a run; no law of its own depends on the control period (s)."""
        self.guard.reset()

    @guarded
    def __call__(self, state: State, reference: Reference | SetPoint) -> Command:
        """The input at this state; see `Command`."""
        return self._qp.command(state, reference)
