"""Soft ID-CLF-QP with a horizon, for `softdyn run ROBOT docs/examples/hold_law.py:OverHold`.

With ``--gains FILE``, fields of `Gains` in TOML replace the published ones, but not in
the horizon.
"""

from dataclasses import replace
from typing import Any

from softdyn import SoftModel
from softdyn.controllers import SoftIdClfQp


class OverHold(SoftIdClfQp):
    """The paper's gains, a horizon of their ε: see docs/hold.md."""

    name = "soft-id-clf-qp"

    def __init__(self, model: SoftModel, table: dict[str, Any] | None = None) -> None:
        published = SoftIdClfQp(model).gains
        gains = replace(published, **(table or {}))
        super().__init__(model, gains, horizon=published.eps)
