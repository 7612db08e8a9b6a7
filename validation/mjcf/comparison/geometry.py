"""Causes in the geometry: base, poses, zeros, axes.

All displacements are found first, at once. Then they are repaired one by one from the root outward,
and the remaining differences of axes and bodies become findings.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from softdyn.validation.mjcf.comparison.bodies import find_body, vector
from softdyn.validation.mjcf.comparison.displacements import (
    GRAIN,
    find_displacements,
    line_error,
    split,
)
from softdyn.validation.mjcf.comparison.finding import Finding, share
from softdyn.validation.mjcf.comparison.matching import plain_name
from softdyn.validation.mjcf.comparison.neutral import WORLD, Neutral
from softdyn.validation.mjcf.transform import Transform

NOTHING = 1e-12  # m, rad
SMALL = 1e-2  # a rest this small relative to a joint's moved zero is a separate pose


def find_geometry(a: Neutral, b: Neutral) -> tuple[list[Finding], Neutral]:
    """Findings, and B with all of them repaired; the robots have the same joints in one order."""
    found: list[Finding] = []

    def take(finding: Finding) -> None:
        nonlocal b
        found.append(finding)
        b = finding.repair(b)

    places = find_displacements(a, b)
    if _is_some(base := places[WORLD]):
        take(_root(a, base))
    for k, part in enumerate(a.parts):
        carrier = places[part.parent]
        for finding in _displacement(a, b, k, carrier.inverse @ places[k]):
            take(finding)
        for finding in _axis(a, b, k):
            take(finding)
    for k in range(len(a.parts)):
        for finding in find_body(a, b, k):
            take(finding)
    return found, b


def _root(a: Neutral, step: Transform) -> Finding:
    """Findings on the fixed root; its frames move along if this brings them closer to A's."""
    ours = {plain_name(name): f.pose for name, f in a.frames.items() if f.part == WORLD}
    where = next((n for n, f in a.frames.items() if f.part == WORLD), "")
    found = _base(where, WORLD, step, a.size)

    def repair(robot: Neutral) -> Neutral:
        moved = found.repair(robot)
        frames = dict(moved.frames)
        for name, frame in robot.frames.items():
            pose = ours.get(plain_name(name)) if frame.part == WORLD else None
            if pose is not None and _apart(pose, frame.pose) < _apart(pose, frames[name].pose):
                frames[name] = frame
        return replace(moved, frames=frames)

    return replace(found, where=found.where or a.parts[a.children(WORLD)[0]].name, repair=repair)


def _apart(one: Transform, other: Transform) -> float:
    return float(np.linalg.norm(one.translation - other.translation))


def _base(where: str, k: int, step: Transform, extent: float) -> Finding:
    back = step.inverse
    return Finding(
        "base", where, (None, _numbers(step)), _described(step, np.zeros(3)),
        lambda robot: robot.displaced(k, back),
        printed=max(step.angle, share(float(np.linalg.norm(step.translation)), extent)),
    )  # fmt: skip


def _displacement(a: Neutral, b: Neutral, k: int, whole: Transform) -> Iterator[Finding]:
    """Findings on the displacement at zero of B's part k, with all that it carries."""
    one, other = a.parts[k], b.parts[k]
    if not _is_some(whole):
        return
    if one.kind == "free":
        yield _base(one.link or one.name, k, whole, a.size)
        return
    twist, amount, rest, along = split(one, other, whole)
    if rest.angle + np.linalg.norm(rest.at(one.point) - one.point) <= SMALL * abs(amount):
        unit, extent = ("m", a.extent(k)) if one.kind == "slide" else ("rad", 1.0)
        yield Finding(
            "zero", one.name, (0.0, float(amount)), f"moved {amount:+.6g} {unit}",
            lambda robot: robot.displaced(k, twist.inverse, joint=False),
            printed=share(abs(float(amount)), extent),
        )  # fmt: skip
        whole = rest
    if _is_some(whole):
        undone, moved = whole.inverse, float(np.linalg.norm(whole.at(one.point) - one.point))
        yield Finding(
            "pose", one.name, (vector(one.point), vector(other.point)),
            _described(whole, one.point),
            lambda robot: robot.displaced(k, undone, joint=bool(along)),
            printed=max(float(whole.angle), share(moved, a.extent(k))),
        )  # fmt: skip


def _axis(a: Neutral, b: Neutral, k: int) -> Iterator[Finding]:
    """Findings on the axis of part k."""
    one, other = a.parts[k], b.parts[k]
    if one.kind == "free":
        return
    angle, reversed_, gap = (value.item() for value in line_error(one, other))
    words = ["reversed"] * reversed_
    words += [f"tilted {angle:.6g} rad"] * (angle > GRAIN)
    words += [f"displaced {1e3 * gap:.6g} mm"] * (gap > GRAIN)
    if words or gap > NOTHING or angle > NOTHING:
        first, second = ([*vector(part.axis), *vector(part.point)] for part in (one, other))
        # a link whose origin lies on its joint moves with it, where it is no further apart
        tied = all(np.allclose(p.point, p.pose.translation, atol=GRAIN) for p in (one, other))
        tied = tied and _apart(one.pose, other.pose) <= gap + GRAIN
        yield Finding(
            "axis", one.name, (first, second), ", ".join(words),
            lambda robot: robot.with_part(
                k,
                replace(
                    robot.parts[k], axis=one.axis, point=one.point,
                    pose=one.pose if tied else robot.parts[k].pose,
                ),
            ),
            # a wheel with reversed axis changes neither M nor g, but it matters
            1.0 if reversed_ else 0.0,
            printed=math.inf if reversed_ else max(angle, share(gap, a.extent(k))),
        )  # fmt: skip


def _is_some(move: Transform) -> bool:
    return move.angle > NOTHING or float(np.linalg.norm(move.translation)) > NOTHING


def _described(move: Transform, point: np.ndarray) -> str:
    """A displacement in words: its angle, and the distance by which it moves a point."""
    shift = move.at(point) - point
    words = []
    if move.angle > GRAIN:
        words.append(f"turned {move.angle:.6g} rad")
    if (size := float(np.linalg.norm(shift))) > GRAIN:
        words.append(f"moved {1e3 * size:.6g} mm")
    return ", ".join(words)


def _numbers(move: Transform) -> list[float]:
    """Rotation, row by row, and translation."""
    return vector(np.concatenate((move.rotation.ravel(), move.translation)))
