"""IC-QP: impedance control with the soft inverse-dynamics QP."""

from __future__ import annotations

from softdyn import SoftModel
from softdyn.controllers.gains import Gains, resolve
from softdyn.controllers.law import TaskLaw
from softdyn.controllers.qps.soft_inverse_dynamics import SoftInverseDynamics
from softdyn.controllers.qps.task_qp import TaskQp


class ImpedanceQp(TaskLaw):
    """Paper, "IC-QP": the Soft ID-CLF-QP without its Lyapunov condition.

    Parameters
    ----------
    model : SoftModel
        The robot.
    gains : Gains, optional
        By default the paper's, for a bundled robot; required for any other.

    Raises
    ------
    InputError
        If there are no gains for this robot, or the robot has no inputs.
    """

    name = "ic-qp"

    def __init__(self, model: SoftModel, gains: Gains | None = None) -> None:
        gains = resolve(model, self.name, gains)
        objective = SoftInverseDynamics(gains, model.nu)
        super().__init__(model, gains, TaskQp(model, gains, objective, decrease=False))
