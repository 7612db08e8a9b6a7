"""Where to draw a fixed tendon, which has a length but no path.

It is drawn along the joints that it spans, beside them on the side where a real cable with that
moment arm would run: one that pulls with force f on a revolute joint with the axis a, on a link in
the direction d, turns it by +f·r when it lies at r (a × d) from the joint. The distance is the one
at which it clears the link's shapes, not the moment arm.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softdyn.description.robot import Joint, Robot, Tendon, children, poses
from softdyn.description.visuals import Visual, triangles

Path = list[tuple[str, np.ndarray]]
CLEARANCE = 1.2


def fixed_path(robot: Robot, tendon: Tendon, shapes: Sequence[Visual], side: int) -> list[Path]:
    """Polylines over (link, point (3,) in its frame), one for each chain of joints it spans.

    Parameters
    ----------
    side : 1 for the cable that pulls with a positive force, -1 for its antagonist.
    """
    placed = poses(robot)
    coefs = {term.joint: term.coef for term in tendon.terms}
    depth = {name: len(robot.chain(name)) for name in placed}
    spanned = sorted((j for j in robot.joints if j.name in coefs), key=lambda j: depth[j.child])
    chains: list[list[Joint]] = []
    for joint in spanned:
        above = robot.chain(joint.parent)
        for chain in chains:
            if chain[-1] in above:
                chain.append(joint)
                break
        else:
            chains.append([joint])
    return [_along(robot, chain, coefs, shapes, side, placed) for chain in chains]


def _along(
    robot: Robot,
    chain: list[Joint],
    coefs: dict[str, float],
    shapes: Sequence[Visual],
    side: int,
    placed: dict[str, tuple[np.ndarray, np.ndarray]],
) -> Path:
    path: Path = []

    def add(link: str, point: np.ndarray) -> None:
        rotation, translation = placed[link]
        path.append((link, rotation.T @ (point - translation)))

    beside = []
    for joint in chain:
        rotation, _ = placed[joint.child]
        along, length = _direction(robot, joint, placed)
        if joint.kind == "prismatic":
            normal = _diagonal(along) * side
        else:
            normal = np.cross(rotation @ joint.axis, along) * np.sign(coefs[joint.name]) * side
            norm = float(np.linalg.norm(normal))
            normal = normal / norm if norm > 1e-6 else _diagonal(along)
        beside.append((joint, along, length, normal))
    distance = max(_distance(robot, joint, n, shapes, placed) for joint, _, _, n in beside)
    before = beside[0][2]
    for joint, along, length, normal in beside:
        # straight from one link to the next, so that it shortens as the joint gives way to it
        point = placed[joint.child][1] + normal * distance
        add(joint.parent, point - min(distance, 0.4 * before) * along)
        add(joint.child, point + min(distance, 0.4 * length) * along)
        before = length
    add(chain[-1].child, point + 0.6 * length * along)
    return path


def _direction(
    robot: Robot, joint: Joint, placed: dict[str, tuple[np.ndarray, np.ndarray]]
) -> tuple[np.ndarray, float]:
    """From the joint to the next one that lies elsewhere: unit vector (3,) and distance (m)."""
    origin = placed[joint.child][1]
    below = children(robot.joints)
    front = [joint.child]
    while front:
        link = front.pop(0)
        step = placed[link][1] - origin
        length = float(np.linalg.norm(step))
        if length > 1e-9:
            return step / length, length
        front += [other.child for other in below.get(link, ())]
    length = max(robot.length, 1e-3) / 4  # the last link of a chain without a tip frame
    return placed[joint.child][0] @ _diagonal(joint.axis), length


def _diagonal(direction: np.ndarray) -> np.ndarray:
    """A unit vector across `direction`, between the two coordinate axes most across it."""
    a, b = np.eye(3)[np.argsort(np.abs(direction), kind="stable")[:2]]
    across = -(a + b)
    across = across - (across @ direction) * direction
    return across / np.linalg.norm(across)


def _distance(
    robot: Robot,
    joint: Joint,
    normal: np.ndarray,
    shapes: Sequence[Visual],
    placed: dict[str, tuple[np.ndarray, np.ndarray]],
) -> float:
    """How far beside the joint the cable clears the shapes of the first link below with any."""
    below = children(robot.joints)
    front, origin = [joint.child], placed[joint.child][1]
    while front:
        link = front.pop(0)
        rotation, translation = placed[link]
        reach = [
            (points @ rotation.T + translation - origin) @ normal
            for shape in shapes
            if shape.link == link
            for points in [triangles(shape).reshape(-1, 3)]
        ]
        if reach:
            return max(CLEARANCE * float(np.concatenate(reach).max()), 0.01 * robot.length)
        front += [other.child for other in below.get(link, ())]
    return 0.03 * max(robot.length, 1e-3)
