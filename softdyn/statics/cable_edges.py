"""Joint angles at which a cable's site enters a round body, or a cable flips to its other side.

There the length or the moment arms of the cable jump, so that no controller can pass smoothly.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.projection import Projection, underlying_tree
from softdyn.dynamics.wrapped_paths import PlacedPiece
from softdyn.dynamics.wraps import Contact

STEPS = 120  # of a joint's way from 0 to a limit
HALVINGS = 30
JUMP = 0.02  # of a unit vector along the cable; a smooth turn is far less after the halvings
SEEN = 0.05  # of such a vector within one step


def cable_edges(model: SoftModel) -> tuple[str, ...]:
    """A line for each such place, each joint moved alone from q = 0 to its limits, at most π.

    Parameters
    ----------
    model : SoftModel
        The robot's model.
    """
    tree, _ = underlying_tree(model)
    if not tree.tendons.wraps:
        return ()
    return tuple(dict.fromkeys(line for k in range(model.nv) for line in _of_joint(model, k)))


def _of_joint(model: SoftModel, k: int) -> Iterator[str]:
    """The lines of one joint."""
    for end in (max(model.lower[k], -np.pi), min(model.upper[k], np.pi)):
        places = np.linspace(0.0, end, STEPS + 1) if end else np.zeros(1)
        before = _pieces(model, k, 0.0)
        told: set[int] = set()
        for low, high in pairwise(places.tolist()):
            behind = _pieces(model, k, high)
            for i, (one, other) in enumerate(zip(before, behind, strict=True)):
                if i not in told and (found := _edge(model, k, i, (low, high), one, other)):
                    told.add(i)
                    yield found
            before = behind


def _edge(
    model: SoftModel, k: int, i: int, span: tuple[float, float], one: PlacedPiece,
    other: PlacedPiece,
) -> str:  # fmt: skip
    """The line of a piece between two places of a joint; empty if nothing jumps there."""
    if _gap(one, other) < SEEN:
        return ""
    low, high = span
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        between = _pieces(model, k, middle)[i]
        if _gap(one, between) > _gap(between, other):
            high, other = middle, between
        else:
            low, one = middle, between
    if _gap(one, other) < JUMP:
        return ""
    entered = Contact.ENTERED in (one.course.contact, other.course.contact)
    robot, piece = model.robot, one.piece
    tendon = robot.tendons[piece.tendon]
    wrap = next(wrap for wrap in tendon.wraps if wrap.after == piece.after)
    does = "has a site inside" if entered else "flips to the other side of"
    kind = "sphere" if wrap.axis is None else "cylinder"
    return (
        f"tendon {tendon.name!r} {does} the {kind} of link {wrap.link!r} at "
        f"{model.joint_names[k]!r} = {high:.3g}, the other joints at 0"
    )


def _gap(one: PlacedPiece, other: PlacedPiece) -> float:
    """The largest difference of two courses' directions; 3 if only one has an end inside."""
    inside = [piece.course.contact is Contact.ENTERED for piece in (one, other)]
    if inside[0] != inside[1]:
        return 3.0
    return float(np.abs(one.course.gradient - other.course.gradient).max())


def _pieces(model: SoftModel, k: int, value: float) -> list[PlacedPiece]:
    """All pieces with one joint at a value and the others at 0."""
    tree, _ = underlying_tree(model)
    coordinates = np.zeros(model.nv)
    coordinates[k] = value
    q = model.configuration(coordinates)
    kinematics = tree.kinematics(model.expand(q) if isinstance(model, Projection) else q)
    return list(tree.tendons.wraps.at(*kinematics[1:]))
