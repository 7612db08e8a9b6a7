"""Soft ID-CLF-QP over the hold, for `scripts/run.py ROBOT docs/examples/hold_law.py:OverHold`.

With ``--gains FILE`` a TOML file's fields of `controllers.Gains` replace the published ones.
"""

from dataclasses import replace
from typing import Any

from controllers import SoftIdClfQp
from controllers.hold import horizon
from softdyn import SoftModel


class OverHold(SoftIdClfQp):
    """The paper's gains, the dynamics at the end of a horizon of ε: see docs/hold.md."""

    name = "soft-id-clf-qp"

    def __init__(self, model: SoftModel, table: dict[str, Any] | None = None) -> None:
        gains = replace(SoftIdClfQp(model).gains, **(table or {}))
        super().__init__(model, gains, hold=horizon(gains))
