"""Gains: the paper's table (tab:controller_params) as data, keyed by bundled file."""

from __future__ import annotations

import math
import sys
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from softdyn import InputError, SoftModel


@dataclass(frozen=True)
class Gains:
    """Parameters of the task-space laws; a law ignores what it does not use.

    Attributes
    ----------
    Kp : float
        Stiffness of the task error (1/s²); the damping is K_d = 2 √K_p (1/s).
    eps : float
        ε of the Lyapunov function (s).
    w1, w2, w3, w4 : float
        Weights on ‖μ - μ_ref‖², ‖q̈‖², ‖u‖² and ‖q̈_null - q̈_null_ref‖².
    rho : float
        Weight on the slack, ρ δ².
    null_damping : float
        D of q̈_null_ref = -D N q̇ (1/s); 50 in the reference code, not in the paper.
    """

    Kp: float
    eps: float = 0.05
    w1: float = 1.0
    w2: float = 0.2
    w3: float = 0.2
    w4: float = 0.1
    rho: float = 1000.0
    null_damping: float = 50.0

    def __post_init__(self) -> None:
        check_fields(self, "gains", positive=("Kp", "eps", "rho"))

    @property
    def Kd(self) -> float:
        """Critical damping 2 √K_p (1/s)."""
        return 2.0 * math.sqrt(self.Kp)


def check_fields(table: Any, name: str, positive: Collection[str]) -> None:
    """Raise `InputError` for a field that is no finite number, negative, or 0 in `positive`."""
    for key, value in vars(table).items():
        number = isinstance(value, int | float) and not isinstance(value, bool)
        above = key in positive
        if not (
            number and abs(value) <= sys.float_info.max and (value > 0 if above else value >= 0)
        ):
            kind = "a positive number" if above else "a number >= 0"
            raise InputError(f"{name}.{key}", kind, value)


_SPIROB = {
    "clf-qp": Gains(500, 0.01),
    "soft-id-clf-qp": Gains(500, 0.01, 1, 0.2, 0.5, 0.1),
    "id-clf-qp": Gains(500, 0.01, 1, 0.2, 0.5, 0.1),
    "ic": Gains(500, 0.01),
    "uic": Gains(500, 0.01),
    "ic-qp": Gains(2000, 0.01, 1, 0.2, 0.5, 0.1),
}
# w4 of IC-QP is not in the paper's table; the values are the reference code's. The hard ID-CLF-QP
# is not in it either: it takes the soft one's row.
PUBLISHED: dict[str, dict[str, Gains]] = {
    "finger": {
        "clf-qp": Gains(500, 0.05),
        "soft-id-clf-qp": Gains(500, 0.03, 1, 0.2, 0.2, 0.1),
        "id-clf-qp": Gains(500, 0.03, 1, 0.2, 0.2, 0.1),
        "ic": Gains(500, 0.03),
        "uic": Gains(500, 0.03),
        "ic-qp": Gains(1500, 0.03, 1, 0.02, 0.2, 0.0),
    },
    "helix": {
        "clf-qp": Gains(500, 0.05),
        "soft-id-clf-qp": Gains(500, 0.05, 1, 0.1, 0.2, 0.1),
        "id-clf-qp": Gains(500, 0.05, 1, 0.1, 0.2, 0.1),
        "ic": Gains(2000, 0.05),
        "uic": Gains(1000, 0.05),
        "ic-qp": Gains(500, 0.05, 1, 0.1, 0.2, 0.1),
    },
    "spirob": _SPIROB,
    "spirob48": _SPIROB,
}


def resolve(model: SoftModel, controller: str, gains: Gains | None) -> Gains:
    """`gains`, or the published ones of a bundled robot.

    Published gains belong to the bundled file, never to a robot that shares its name.

    Raises
    ------
    InputError
        A robot without inputs or with crossed bounds, or one without published gains given none.
    """
    if model.nu == 0:
        raise InputError("model", f"an <actuator> in {model.robot.path}", "none")
    if not (np.isfinite(model.u_max - model.u_min) & (model.u_min <= model.u_max)).all():
        bounds = f"u_min {model.u_min}, u_max {model.u_max}"
        raise InputError("model", "finite input bounds, lower <= upper", bounds)
    if gains is None:
        table = PUBLISHED.get(model.bundled or "", {})
        if controller not in table:
            kind = "softdyn.controllers.Gains(Kp=…, …)"
            expected = f"{kind} for {model.robot.path}, which has no published ones"
            raise InputError("gains", expected, None)
        return table[controller]
    if not isinstance(gains, Gains):
        raise InputError("gains", "softdyn.controllers.Gains(Kp=…, …)", gains)
    return gains
