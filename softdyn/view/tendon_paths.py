"""The drawn path of a fixed tendon, which has a length but no path of its own.

It is drawn along the joints that it spans, on the side where a real cable with that moment arm
would run. Take a revolute joint with the axis a, and its link in the direction d. A cable at
r (a × d) from the joint that pulls with the force f gives the joint the torque +f·r. If joints meet
in one point, as in a rod that bends both ways, the cable lies at the sum of these vectors. Its
distance from the joint is the moment arm, as for a cable in a channel. A tendon that sums angles
has no moment arm; it is drawn where it clears the link's shapes.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np

from softdyn.description.robot import Joint, Robot, Tendon, levels, poses, sums_angles
from softdyn.description.visuals import Visual, triangles

Path = list[tuple[str, np.ndarray]]
CLEARANCE = 1.2


def fixed_path(robot: Robot, tendon: Tendon, shapes: Sequence[Visual], side: int) -> list[Path]:
    """Polylines of (link, point (3,) in its frame), one for each chain of joints that it spans.

    Parameters
    ----------
    side : int
        1 for the cable that pulls with a positive force, -1 for its antagonist.
    """
    placed = poses(robot)
    coefs = {term.joint: term.coef for term in tendon.terms}
    depth = {name: len(robot.chain(name)) for name in placed}
    spanned = sorted((j for j in robot.joints if j.name in coefs), key=lambda j: depth[j.child])
    spans: list[list[Joint]] = []
    for joint in spanned:
        above = robot.chain(joint.parent)
        for span in spans:
            if span[-1] in above:
                span.append(joint)
                break
        else:
            spans.append([joint])
    led = any(j.kind != "prismatic" for j in spanned) and not sums_angles(robot, tendon)
    clear = None if led else shapes
    return [_along(robot, span, coefs, clear, side, placed) for span in spans]


def _along(
    robot: Robot,
    span: list[Joint],
    coefs: dict[str, float],
    shapes: Sequence[Visual] | None,
    side: int,
    placed: dict[str, tuple[np.ndarray, np.ndarray]],
) -> Path:
    """The path over one chain of joints: at the moment arm, or with `shapes` clear of them."""
    path: Path = []

    def add(link: str, point: np.ndarray) -> None:
        rotation, translation = placed[link]
        path.append((link, rotation.T @ (point - translation)))

    beside = []
    for joints in _meeting(span, placed):
        along, length = _direction(robot, joints[-1], placed)
        turning = [joint for joint in joints if joint.kind != "prismatic"]
        normal = np.zeros(3)
        for joint in turning:
            normal += (
                side * coefs[joint.name] * np.cross(placed[joint.child][0] @ joint.axis, along)
            )
        norm = float(np.linalg.norm(normal))
        least = 1e-6 * max(abs(coefs[joint.name]) for joint in joints)
        if shapes is not None:
            across = normal / norm if norm > least else _diagonal(along)
            normal = across if turning else _diagonal(along) * side
        beside.append((joints, along, length, normal))
    scale = 1.0
    if shapes is not None:
        scale = max(_distance(robot, joints[-1], n, shapes, placed) for joints, _, _, n in beside)
    before = beside[0][2]
    for joints, along, length, normal in beside:
        # straight from one link to the next, so that it visibly shortens when the joint turns
        point = placed[joints[-1].child][1] + normal * scale
        distance = scale * float(np.linalg.norm(normal))
        add(joints[0].parent, point - min(distance, 0.4 * before) * along)
        add(joints[-1].child, point + min(distance, 0.4 * length) * along)
        before = length
    add(span[-1].child, point + 0.6 * length * along)
    return path


def _meeting(
    span: list[Joint], placed: dict[str, tuple[np.ndarray, np.ndarray]]
) -> list[list[Joint]]:
    """The joints of a span, in groups that meet in one point."""
    groups: list[list[Joint]] = []
    for joint in span:
        here = placed[joint.child][1]
        if groups and np.linalg.norm(here - placed[groups[-1][-1].child][1]) < 1e-9:
            groups[-1].append(joint)
        else:
            groups.append([joint])
    return groups


def _direction(
    robot: Robot, joint: Joint, placed: dict[str, tuple[np.ndarray, np.ndarray]]
) -> tuple[np.ndarray, float]:
    """Unit vector (3,) and distance (m) from the joint to the next one at another point."""
    origin = placed[joint.child][1]
    for link in chain(*levels(joint.child, robot.joints)):
        step = placed[link][1] - origin
        length = float(np.linalg.norm(step))
        if length > 1e-9:
            return step / length, length
    length = max(robot.length, 1e-3) / 4  # the last link of a chain without a tip frame
    return placed[joint.child][0] @ _diagonal(joint.axis), length


def _diagonal(direction: np.ndarray) -> np.ndarray:
    """A unit vector normal to `direction`, between the two coordinate axes most normal to it."""
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
    """Distance from the joint at which the cable clears the next link that has shapes."""
    origin = placed[joint.child][1]
    for link in chain(*levels(joint.child, robot.joints)):
        rotation, translation = placed[link]
        reach = [
            float(((triangles(shape) @ rotation.T + translation - origin) @ normal).max())
            for shape in shapes
            if shape.link == link
        ]
        if reach:
            return max(CLEARANCE * max(reach), 0.01 * robot.length)
    return 0.03 * max(robot.length, 1e-3)
