"""IC-QP: impedance control with the soft inverse-dynamics QP."""

from __future__ import annotations

from collections.abc import Sequence

from softdyn import SoftModel
from softdyn.controllers.gains import Gains, resolve
from softdyn.controllers.law import TaskLaw
from softdyn.controllers.qps.level_qp import make_qp
from softdyn.controllers.qps.soft_inverse_dynamics import SoftInverseDynamics
from softdyn.controllers.qps.stacked_error import task_error
from softdyn.tasks.task import Task


class ImpedanceQp(TaskLaw):
    """Paper, "IC-QP": the Soft ID-CLF-QP without its Lyapunov condition.

    Parameters
    ----------
    model : SoftModel
        The robot.
    gains : Gains, optional
        By default the paper's, for a bundled robot; required for any other.
    tasks : sequence of softdyn.tasks.Task, optional
        What to control; by default the position of the tip.

    Raises
    ------
    InputError
        If there are no gains for this robot, or the robot has no inputs.
    """

    name = "ic-qp"

    def __init__(
        self,
        model: SoftModel,
        gains: Gains | None = None,
        *,
        tasks: Sequence[Task] | None = None,
    ) -> None:
        gains = resolve(model, self.name, gains)
        error = task_error(model, gains, tasks)
        qp = make_qp(
            model,
            gains,
            lambda gains: SoftInverseDynamics(gains, model.nu, rows=error.rows),
            error,
            decrease=False,
        )
        super().__init__(model, gains, qp, error)
