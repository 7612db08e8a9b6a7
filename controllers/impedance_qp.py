"""IC-QP: impedance control with the soft inverse-dynamics QP."""

from __future__ import annotations

from types import MappingProxyType

from softdyn import SoftModel
from softdyn.controllers.gains import Gains
from softdyn.controllers.law import InputRule, TaskLaw
from softdyn.controllers.qps.level_qp import make_qp
from softdyn.controllers.qps.soft_inverse_dynamics import SoftInverseDynamics
from softdyn.controllers.qps.stacked_error import TaskRows


class ImpedanceQp(TaskLaw):
    """Paper, "IC-QP": the Soft ID-CLF-QP without its Lyapunov condition.

    Its arguments and errors are those of `TaskLaw`.
    """

    name = "ic-qp"
    label = "IC-QP"
    order = 6
    published = MappingProxyType(
        {
            "finger": Gains(1500, 0.03, 1, 0.02, 0.2, 0.0),
            "helix": Gains(500, 0.05, 1, 0.1, 0.2, 0.1),
            "spirob": Gains(2000, 0.01, 1, 0.2, 0.5, 0.1),
            "spirob48": Gains(2000, 0.01, 1, 0.2, 0.5, 0.1),
        }
    )

    def _make_rule(self, model: SoftModel, gains: Gains, error: TaskRows) -> InputRule:
        """The QP in u, without the decrease condition."""
        return make_qp(
            model,
            gains,
            lambda gains: SoftInverseDynamics(gains, model.nu, rows=error.rows),
            error,
            decrease=False,
        )
