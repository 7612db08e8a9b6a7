"""What makes two robots differ, one cause each, with the repair that removes it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from softdyn.validation.mjcf.comparison.neutral import Repair

KINDS = (
    "base", "pose", "zero", "axis", "mass", "centre", "inertia", "armature", "order", "frame",
    "gravity", "damping", "friction", "stiffness", "rest", "limit", "effort", "tendon",
    "actuator", "coupling",
)  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """One difference.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    where : str
        A joint, link, tendon or actuator by its name in A.
    values : tuple of two
        What A and B say; None where one says nothing.
    detail : str
        The difference in words.
    repair : callable
        Makes B's robot agree with A here, all findings before it repaired.
    size : float
        Relative difference of the values, for what enters neither M nor g nor the tip.
    one_sided : bool
        Whether only one file, or only its format, states it.
    """

    kind: str
    where: str
    values: tuple[Any, Any]
    detail: str
    repair: Repair = field(repr=False)
    size: float = 0.0
    one_sided: bool = False
