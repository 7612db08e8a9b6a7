"""Joint angles at which a cable's site enters a round body, or a cable flips to its other side.

There the length or the moment arms of the cable jump, so that no controller can pass smoothly.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.projection import Projection, underlying_tree
from softdyn.dynamics.wraps import Contact, Courses

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
        before = _courses(model, k, 0.0)
        told: set[int] = set()
        for low, high in pairwise(places.tolist()):
            behind = _courses(model, k, high)
            for i in np.flatnonzero(_gaps(before, behind) >= SEEN).tolist():
                if i not in told and (found := _edge(model, k, i, (low, high), before, behind)):
                    told.add(i)
                    yield found
            before = behind


def _edge(
    model: SoftModel, k: int, i: int, span: tuple[float, float], one: Courses, other: Courses
) -> str:
    """The line of piece i between two places of a joint; empty if nothing jumps there."""
    low, high = span
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        between = _courses(model, k, middle)
        if _gaps(one, between)[i] > _gaps(between, other)[i]:
            high, other = middle, between
        else:
            low, one = middle, between
    if _gaps(one, other)[i] < JUMP:
        return ""
    entered = Contact.ENTERED in (one.contact[i], other.contact[i])
    paths = underlying_tree(model)[0].tendons.wraps
    tendon = model.robot.tendons[paths.tendon[i]]
    wrap = next(wrap for wrap in tendon.wraps if wrap.after == paths.after[i])
    does = "has a site inside" if entered else "flips to the other side of"
    kind = "sphere" if wrap.axis is None else "cylinder"
    return (
        f"tendon {tendon.name!r} {does} the {kind} of link {wrap.link!r} at "
        f"{model.joint_names[k]!r} = {high:.3g}, the other joints at 0"
    )


def _gaps(one: Courses, other: Courses) -> np.ndarray:
    """The largest differences of courses' directions; 3 if only one has an end inside."""
    inside = [courses.contact == Contact.ENTERED for courses in (one, other)]
    apart = np.abs(one.gradient - other.gradient).max(axis=(1, 2))
    return np.where(inside[0] != inside[1], 3.0, apart)


def _courses(model: SoftModel, k: int, value: float) -> Courses:
    """The courses of all pieces with one joint at a value and the others at 0."""
    tree, _ = underlying_tree(model)
    coordinates = np.zeros(model.nv)
    coordinates[k] = value
    q = model.configuration(coordinates)
    q = model.expand(q) if isinstance(model, Projection) else q
    return tree.tendon_geometry(q).around.courses
