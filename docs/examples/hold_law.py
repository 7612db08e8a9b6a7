"""Soft ID-CLF-QP over the hold, for `scripts/run.py ROBOT docs/examples/hold_law.py:OverHold`."""

from controllers import Gains, SoftIdClfQp
from controllers.hold import horizon
from softdyn import SoftModel


class OverHold(SoftIdClfQp):
    """The paper's gains, the dynamics at the end of a horizon of ε: see docs/hold.md."""

    name = "soft-id-clf-qp"

    def __init__(self, model: SoftModel, gains: Gains | None = None) -> None:
        super().__init__(model, gains, hold=horizon(SoftIdClfQp(model, gains).gains))
