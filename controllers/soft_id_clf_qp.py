"""Soft ID-CLF-QP, the paper's controller, by default exactly as published."""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType

import numpy as np

from softdyn import SoftModel
from softdyn.checks import array, number
from softdyn.controllers.barriers import LOOKAHEAD, BarrierRows, ControlBarrier
from softdyn.controllers.gains import Gains, resolve
from softdyn.controllers.law import InputRule, TaskLaw
from softdyn.controllers.qps.horizon import Horizon
from softdyn.controllers.qps.level_qp import make_qp
from softdyn.controllers.qps.soft_inverse_dynamics import SoftInverseDynamics
from softdyn.controllers.qps.stacked_error import TaskRows
from softdyn.tasks.task import Task


class SoftIdClfQp(TaskLaw):
    """Paper, "Soft ID-CLF-QP": the actuated dynamics are constraints, the unactuated ones costs.

    Parameters
    ----------
    model, gains, tasks
        As in `TaskLaw`.
    horizon : float
        τ (s) of the dynamics, see `qps.horizon`; 0 gives the published controller.
    u_ref : float or ndarray, (nu,)
        The input that has no cost: w3 ‖u - u_ref‖². A tension in all cables keeps co-contracted
        shapes from relaxing, see `docs/beyond.md`; 0 in the paper.
    barriers : sequence of ControlBarrier
        Obstacles and limits, see `barriers`. Their rows hold over a control period, and over the
        horizon, or 20 ms without one. Where no row acts, the input is the one without barriers.

    Attributes
    ----------
    barrier_rows : BarrierRows or None
        The barriers' rows and counts.

    Raises
    ------
    InputError
        If there are no gains for this robot, the robot has no inputs, the horizon is negative, or
        u_ref has another shape.
    """

    name = "soft-id-clf-qp"
    label = "Soft ID-CLF-QP"
    order = 2
    published = MappingProxyType(
        {
            "finger": Gains(500, 0.03, 1, 0.2, 0.2, 0.1),
            "helix": Gains(500, 0.05, 1, 0.1, 0.2, 0.1),
            "spirob": Gains(500, 0.01, 1, 0.2, 0.5, 0.1),
            "spirob48": Gains(500, 0.01, 1, 0.2, 0.5, 0.1),
        }
    )
    options = ("horizon", "u_ref")
    takes_barriers = True

    def __init__(
        self,
        model: SoftModel,
        gains: Gains | None = None,
        *,
        horizon: float = 0.0,
        u_ref: np.ndarray | float = 0.0,
        barriers: Sequence[ControlBarrier] = (),
        tasks: Sequence[Task] | None = None,
    ) -> None:
        gains = resolve(model, self.published, gains)
        self.horizon = number("horizon", horizon, lower=0.0)
        given = [u_ref] * model.nu if np.ndim(u_ref) == 0 else u_ref
        self.u_ref = array("u_ref", given, (model.nu,))
        over = self.horizon or LOOKAHEAD
        self.barrier_rows = BarrierRows(model, barriers, over) if barriers else None
        super().__init__(model, gains, tasks=tasks)

    def _make_rule(self, model: SoftModel, gains: Gains, error: TaskRows) -> InputRule:
        """The QP with the decrease condition, and with the barriers' rows."""
        return make_qp(
            model,
            gains,
            lambda gains: SoftInverseDynamics(gains, model.nu, self.u_ref, error.rows),
            error,
            decrease=True,
            horizon=Horizon(model, self.horizon),
            barriers=self.barrier_rows,
        )

    def reset(self, period: float) -> None:
        """Begin a run; barriers then have rows over its control period (s) too."""
        super().reset(period)
        if self.barrier_rows is not None:
            self.barrier_rows.reset(period)
