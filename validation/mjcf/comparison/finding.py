"""What makes two robots differ, one cause each with its repair; how values are told apart."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from softdyn.validation.mjcf.comparison.neutral import (
    Neutral,
    NeutralTendon,
    Numbers,
    Part,
    Repair,
)
from softdyn.validation.twin.settings import STIFF_SOLIMP, STIFF_SOLREF

KINDS = (
    "base", "pose", "zero", "axis", "mass", "centre", "inertia", "armature", "order", "frame",
    "gravity", "damping", "friction", "stiffness", "rest", "limit", "effort", "tendon",
    "actuator", "coupling", "feature",
)  # fmt: skip
SAME = 1e-6  # relative
LIMITS = 1e-4  # rad, m: limits are rounded in most files
Turns = dict[str, tuple[float, float]]  # by joint: sense and zero, q_A = sense · q_B + zero


@dataclass(frozen=True)
class Finding:
    """One difference.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    where : str
        A joint, link, tendon or actuator by its name in A; of a feature its field too.
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


def with_urdf(a: Neutral, b: Neutral) -> bool:
    """Whether one of the files is a URDF, which has no word for MuJoCo's fields."""
    return "urdf" in (a.format, b.format)


def differ(a: float, b: float) -> float:
    """Relative difference of two values, 0 for two that are the same."""
    if a == b:
        return 0.0
    size = max(abs(a), abs(b))
    return abs(a - b) / size if math.isfinite(size) else 1.0


def apart(ours: Numbers, theirs: Numbers) -> float:
    """The largest relative difference of two rows of numbers; 1 for rows of another length."""
    if len(ours) != len(theirs):
        return 1.0
    return max((differ(p, q) for p, q in zip(ours, theirs, strict=True)), default=0.0)


def told_apart(
    ours: dict[str, Numbers], theirs: dict[str, Numbers], *, urdf: bool
) -> Iterator[tuple[str, tuple[Any, Any], float]]:
    """Fields that differ: name, both values (None for the default), and how far apart they are."""
    if urdf:
        ours, theirs = beyond_urdf(ours), beyond_urdf(theirs)
    for name in {**ours, **theirs}:
        p, q = ours.get(name), theirs.get(name)
        size = 1.0 if p is None or q is None else apart(p, q)
        if size > SAME:
            yield name, (shown(p), shown(q)), size


def beyond_urdf(fields: dict[str, Numbers]) -> dict[str, Numbers]:
    """What of a joint's or tendon's fields a URDF has no word for.

    Its stops and couplings are rigid: those that are as stiff as the twin's are no news.
    """
    return {
        name: value
        for name, value in fields.items()
        if not ("_solref" in name and value == STIFF_SOLREF)
        and not ("_solimp" in name and value == STIFF_SOLIMP)
    }


def shown(values: Numbers | None) -> Any:
    """One number as such, several as a list; None stays."""
    return values if values is None else values[0] if len(values) == 1 else list(values)


def curves(
    one: Part | NeutralTendon, other: Part | NeutralTendon, sense: float = 1.0
) -> Iterator[tuple[str, Numbers, Numbers, float]]:
    """Damping and stiffness that differ: coefficients of the powers, linear ones alone if they are.

    In the other sense of a joint the even power of a spring's force has the other sign; either
    reading agrees.
    """
    for name in ("damping", "stiffness"):
        ours, theirs = _coefficients(one, name), _coefficients(other, name)
        turned = theirs if name == "damping" else (theirs[0], sense * theirs[1], theirs[2])
        if (size := min(apart(ours, theirs), apart(ours, turned))) > SAME:
            keep = 3 if any((*ours[1:], *theirs[1:])) else 1
            yield name, ours[:keep], theirs[:keep], size


def _coefficients(item: Part | NeutralTendon, name: str) -> Numbers:
    return (getattr(item, name), *getattr(item, f"{name}_curve"))


def one_sided(ours: Numbers, theirs: Numbers, *, urdf: bool) -> bool:
    """Whether one file alone states the coefficients that differ (`urdf`: one file is a URDF).

    A linear one is not stated where it is zero; a URDF has no word for those of higher powers.
    """
    alone = not (any(ours) and any(theirs))
    return alone if len(ours) == 1 else urdf and (alone or differ(ours[0], theirs[0]) <= SAME)
