"""One cause of a difference between two robots, with its repair; comparison of values."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

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
    "actuator", "coupling", "fluid", "feature",
)  # fmt: skip
SAME = 1e-6  # relative
SPEED = 1.0  # rad/s, m/s: dampers are compared up to here
GRID = np.array([1.0, -1.0, 0.75, -0.75, 0.5, -0.5, 0.25, -0.25])  # shares of a reach
LIMITS = 1e-4  # rad, m: limits are rounded in most files
# how soft a constraint is, which a URDF's rigid ones do not state; how exactly it is solved
SOFTNESS = ("_solref", "_solimp")
ACCURACY = (
    "opt.noslip_iterations", "opt.sleep_tolerance", "tree_sleep_policy", "mjENBL_SLEEP",
    "mjENBL_DIAGEXACT", "mjDSBL_REFSAFE", "actuator_ctrlspec", "actuator_lengthrange",
)  # fmt: skip
Turns = dict[str, tuple[float, float]]  # joint → sense and zero, q_A = sense · q_B + zero


@dataclass(frozen=True)
class Finding:
    """One difference.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    where : str
        A joint, link, tendon or actuator by its name in A; for a feature its field, too.
    values : tuple of two
        Values in A and B; None if a file states none.
    detail : str
        The difference in words.
    repair : callable
        Makes B's robot agree with A here, after the repairs of all earlier findings.
    size : float
        Relative difference of the values, for kinds that affect neither M nor g nor the tip.
    alone : bool
        Whether only one file, or only its format, states it.
    printed : float or None
        Relative difference of the numbers as files print them: lengths relative to the part's
        extent, angles to 1 rad. None if it is `size`.
    force : np.ndarray or None, (samples, nv)
        The generalized force at the sampled states by which springs, dampers or dry friction
        differ.
    acts : bool
        Whether what only one file states changes the motion by something else than a force at the
        sampled states: a stop, a constraint, dry friction of a cable, dynamics of an actuator.
    """

    kind: str
    where: str
    values: tuple[Any, Any]
    detail: str
    repair: Repair = field(repr=False)
    size: float = 0.0
    alone: bool = False
    printed: float | None = None
    force: np.ndarray | None = field(default=None, repr=False)
    acts: bool = False


def with_urdf(a: Neutral, b: Neutral) -> bool:
    """Whether one of the files is a URDF, which cannot state MuJoCo's fields."""
    return "urdf" in (a.format, b.format)


def differ(a: float, b: float) -> float:
    """Relative difference of two values, 0 for equal ones."""
    if a == b:
        return 0.0
    size = max(abs(a), abs(b))
    return abs(a - b) / size if math.isfinite(size) else 1.0


def share(gap: float, extent: float) -> float:
    """A distance relative to an extent; infinite where the extent is zero."""
    return gap / extent if extent > 0 else math.inf if gap else 0.0


def apart(ours: Numbers, theirs: Numbers) -> float:
    """The largest relative difference of two rows of numbers; 1 for different lengths."""
    if len(ours) != len(theirs):
        return 1.0
    return max((differ(p, q) for p, q in zip(ours, theirs, strict=True)), default=0.0)


def told_apart(
    ours: dict[str, Numbers], theirs: dict[str, Numbers], *, urdf: bool
) -> Iterator[tuple[str, tuple[Any, Any], float]]:
    """Fields that differ: name, both values (None for the default), and relative difference."""
    if urdf:
        ours, theirs = beyond_urdf(ours), beyond_urdf(theirs)
    for name in {**ours, **theirs}:
        p, q = ours.get(name), theirs.get(name)
        size = 1.0 if p is None or q is None else apart(p, q)
        if size > SAME:
            yield name, (shown(p), shown(q)), size


def beyond_urdf(fields: dict[str, Numbers]) -> dict[str, Numbers]:
    """The fields of a joint or tendon that a URDF cannot state.

    A URDF's stops and couplings are rigid, so those as stiff as the twin's are left out.
    """
    return {
        name: value
        for name, value in fields.items()
        if not ("_solref" in name and value == STIFF_SOLREF)
        and not ("_solimp" in name and value == STIFF_SOLIMP)
    }


def changes_motion(field: str) -> bool:
    """Whether a field of MuJoCo's that is not at its default changes the motion by itself."""
    return field not in ACCURACY and not any(word in field for word in SOFTNESS)


def shown(values: Numbers | None) -> Any:
    """A single number as a number, several as a list, None as None."""
    return values if values is None else values[0] if len(values) == 1 else list(values)


@dataclass(frozen=True)
class CurveGap:
    """Springs or dampers that differ.

    Attributes
    ----------
    name : str
        ``stiffness`` or ``damping``.
    values : tuple of two
        Coefficients of the powers, or a number if all are linear.
    size : float
        Largest difference of the forces, relative to the largest force.
    words : str
        The forces where they differ most; empty if both are linear.
    alone : bool
        Whether only one file states the force.
    change : tuple of float
        The differences of the coefficients.
    """

    name: str
    values: tuple[Any, Any]
    size: float
    words: str
    alone: bool
    change: Numbers

    def acting(self, x: np.ndarray) -> np.ndarray:
        """The difference of the forces at displacements or speeds `x`."""
        return np.asarray(force(self.name, self.change, x))


def curves(
    one: Part | NeutralTendon,
    other: Part | NeutralTendon,
    reach: float,
    units: tuple[str, str],
    *,
    urdf: bool,
    sense: float = 1.0,
) -> Iterator[CurveGap]:
    """Differing springs and dampers, compared by their forces.

    If a joint has the other sense, the even power of a spring's force changes its sign. Both
    readings count as agreement. Between two MJCFs, a force of higher powers is stated by both.

    Parameters
    ----------
    one, other : Part or NeutralTendon
    reach : float
        Displacement up to which springs are compared (rad, m); dampers up to `SPEED`.
    units : tuple[str, str]
        Units of force and displacement.
    urdf : bool
        Whether one of the files is a URDF.
    sense : float
        -1 for a joint with the other sense.
    """
    for name in ("damping", "stiffness"):
        ours, theirs = coefficients(one, name), coefficients(other, name)
        turned = theirs if name == "damping" else (theirs[0], sense * theirs[1], theirs[2])
        far, unit = (SPEED, f"{units[1]}/s") if name == "damping" else (reach, units[1])
        (size, at), nearest = min(
            (_forces_apart(name, ours, row, far), row) for row in (theirs, turned)
        )
        change = tuple(p - q for p, q in zip(ours, nearest, strict=True))
        if size <= SAME:
            continue
        alone = not (any(ours) and any(theirs))
        if not any((*ours[1:], *theirs[1:])):
            yield CurveGap(name, (ours[0], theirs[0]), size, "", alone, change)
            continue
        first, second = (force(name, row, at) for row in (ours, theirs))
        words = f"{first:.4g} against {second:.4g} {units[0]} at {at:.4g} {unit}"
        yield CurveGap(name, (list(ours), list(theirs)), size, words, alone and urdf, change)


def force(name: str, coefficients: Numbers, x: Any) -> Any:
    """Force of a spring at a displacement, or of a damper at a speed (MuJoCo's polynomials).

    A spring's is k₁ x + k₂ x² + k₃ x³; a damper's, which always brakes, d₁ x + d₂ x |x| + d₃ x³.
    """
    first, second, third = coefficients
    return x * (first + second * (abs(x) if name == "damping" else x) + third * x**2)


def _forces_apart(name: str, ours: Numbers, theirs: Numbers, far: float) -> tuple[float, float]:
    """The largest difference of two forces, relative to the largest, and its displacement."""
    at = far * GRID
    first, second = (force(name, row, at) for row in (ours, theirs))
    gaps, largest = np.abs(first - second), float(np.abs([first, second]).max())
    worst = int(np.argmax(gaps))
    return (float(gaps[worst]) / largest if largest else 0.0), float(at[worst])


def coefficients(item: Part | NeutralTendon, name: str) -> Numbers:
    """The coefficients of the powers of a spring's or a damper's force; see `force`."""
    return (getattr(item, name), *getattr(item, f"{name}_curve"))
