"""Planted defects: a changed number of a URDF or an MJCF, and its kind of cause.

A size is in m, in rad, or relative. A reversed axis or gear has no size.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from lxml import etree

Root = etree._Element
ASIDE = np.array([0.6, 0.0, -0.8])  # direction in which a centre moves
AWAY = np.array([2.0, 1.0, -2.0]) / 3  # direction in which a joint moves


def numbers(node: Root, attribute: str, default: str = "0 0 0") -> np.ndarray:
    return np.array([float(word) for word in node.get(attribute, default).split()])


def put(node: Root, attribute: str, values: np.ndarray | list[float]) -> None:
    node.set(attribute, " ".join(repr(float(value)) for value in np.atleast_1d(values)))


def child(node: Root, tag: str) -> Root:
    found = node.find(tag)
    return etree.SubElement(node, tag) if found is None else found


def turned(tensor: np.ndarray, angle: float) -> np.ndarray:
    axis = np.array([0.6, -0.48, 0.64])
    cross = np.cross(np.eye(3), axis)
    R = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return R @ tensor @ R.T


# -- URDF: `k` counts the joints that move --------------------------------------------------------


def joints(root: Root) -> list[Root]:
    return [j for j in root.findall("joint") if j.get("type") not in ("fixed", "floating")]


def moved_link(root: Root, k: int) -> Root:
    name = joints(root)[k].find("child").get("link")
    return next(link for link in root.findall("link") if link.get("name") == name)


def axis_of(joint: Root) -> np.ndarray:
    node = joint.find("axis")
    return np.array([1.0, 0.0, 0.0]) if node is None else numbers(node, "xyz")


def urdf_mass(root: Root, k: int, size: float = 0.03) -> None:
    mass = moved_link(root, k).find("inertial/mass")
    put(mass, "value", (1 + size) * float(mass.get("value")))


def urdf_centre(root: Root, k: int, size: float = 0.002) -> None:
    origin = child(moved_link(root, k).find("inertial"), "origin")
    put(origin, "xyz", numbers(origin, "xyz") + size * ASIDE)


def urdf_inertia(root: Root, k: int, size: float = np.pi / 6) -> None:
    node = moved_link(root, k).find("inertial/inertia")
    names = [["ixx", "ixy", "ixz"], ["ixy", "iyy", "iyz"], ["ixz", "iyz", "izz"]]
    tensor = turned(np.array([[float(node.get(n)) for n in row] for row in names]), size)
    for i in range(3):
        for j in range(i, 3):
            put(node, names[i][j], tensor[i, j])


def urdf_axis(root: Root, k: int, _size: float = 0.0) -> None:
    axis = child(joints(root)[k], "axis")
    put(axis, "xyz", -numbers(axis, "xyz", "1 0 0"))


def urdf_tilt(root: Root, k: int, size: float = 0.01) -> None:
    axis = child(joints(root)[k], "axis")
    put(axis, "xyz", tilted(numbers(axis, "xyz", "1 0 0"), size))


def tilted(axis: np.ndarray, angle: float) -> np.ndarray:
    """An axis turned towards its smallest coordinate."""
    axis = axis / np.linalg.norm(axis)
    aside = np.eye(3)[np.argmin(np.abs(axis))]
    aside = aside - (aside @ axis) * axis
    return np.cos(angle) * axis + np.sin(angle) * aside / np.linalg.norm(aside)


def urdf_armature(root: Root, k: int, size: float = 0.01) -> None:
    block = child(root, "softdyn")
    block.set("version", "1")
    name = joints(root)[k].get("name")
    node = next((j for j in block.findall("joint") if j.get("name") == name), None)
    if node is None:
        node = etree.Element("joint", name=name)
        block.insert(0, node)
    put(node, "armature", size + float(node.get("armature", "0")))


def urdf_friction(root: Root, k: int, size: float = 0.2) -> None:
    dynamics = child(joints(root)[k], "dynamics")
    put(dynamics, "friction", size + float(dynamics.get("friction", "0")))


def urdf_damping(root: Root, k: int, size: float = 0.2) -> None:
    dynamics = child(joints(root)[k], "dynamics")
    put(dynamics, "damping", size + float(dynamics.get("damping", "0")))


def urdf_pose(root: Root, k: int, size: float = 0.003) -> None:
    origin = child(joints(root)[k], "origin")
    put(origin, "xyz", numbers(origin, "xyz") + size * AWAY)


def urdf_turn(root: Root, k: int, size: float = 0.1) -> None:
    """Turn the joint's origin about an axis normal to its own."""
    joint = joints(root)[k]
    axis = axis_of(joint)
    across = tilted(axis, np.pi / 2)
    turn_origin(child(joint, "origin"), across, size)


def urdf_tendon(root: Root, _k: int, size: float = 0.001) -> None:
    site = root.findall("softdyn/tendon/site")[1]
    put(site, "xyz", numbers(site, "xyz") + size * np.array([0.0, 0.8, 0.6]))


def urdf_actuator(root: Root, _k: int, _size: float = 0.0) -> None:
    actuator = root.find("softdyn/actuator")
    put(actuator, "gear", -float(actuator.get("gear", "1")))


def urdf_zero(root: Root, k: int, size: float = 0.1) -> None:
    """Turn the joint's origin about its axis, or move it along the axis."""
    joint = joints(root)[k]
    axis = axis_of(joint)
    axis /= np.linalg.norm(axis)
    origin = child(joint, "origin")
    R = rpy(numbers(origin, "rpy"))
    if joint.get("type") == "prismatic":
        put(origin, "xyz", numbers(origin, "xyz") + size * R @ axis)
        return
    turn_origin(origin, axis, size)


def turn_origin(origin: Root, axis: np.ndarray, angle: float) -> None:
    """Turn an <origin> about an axis of its own frame."""
    cross = np.cross(np.eye(3), axis).T
    turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    R = rpy(numbers(origin, "rpy")) @ turn
    pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    put(origin, "rpy", [np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])


def rpy(angles: np.ndarray) -> np.ndarray:
    (sr, sp, sy), (cr, cp, cy) = np.sin(angles), np.cos(angles)
    return np.array([[cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                     [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                     [-sp, cp * sr, cp * cr]])  # fmt: skip


URDF: dict[str, Callable[..., None]] = {
    "mass": urdf_mass, "centre": urdf_centre, "inertia": urdf_inertia, "axis": urdf_axis,
    "tilt": urdf_tilt, "zero": urdf_zero, "pose": urdf_pose, "turn": urdf_turn,
    "armature": urdf_armature, "friction": urdf_friction, "damping": urdf_damping,
    "tendon": urdf_tendon, "actuator": urdf_actuator,
}  # fmt: skip


# -- MJCF: `k` counts the bodies that hinges or slides move ---------------------------------------


def bodies(root: Root) -> list[Root]:
    return [
        b
        for b in root.iter("body")
        if b.find("joint") is not None and b.find("joint").get("type") not in ("free", "ball")
    ]


def mjcf_mass(root: Root, k: int, size: float = 0.03) -> None:
    inertial = bodies(root)[k].find("inertial")
    put(inertial, "mass", (1 + size) * float(inertial.get("mass")))


def mjcf_centre(root: Root, k: int, size: float = 0.002) -> None:
    inertial = bodies(root)[k].find("inertial")
    put(inertial, "pos", numbers(inertial, "pos") + size * ASIDE)


def mjcf_inertia(root: Root, k: int, size: float = np.pi / 6) -> None:
    inertial = bodies(root)[k].find("inertial")
    if inertial.get("fullinertia") is not None:
        xx, yy, zz, xy, xz, yz = numbers(inertial, "fullinertia")
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        tensor = np.diag(numbers(inertial, "diaginertia"))
        quat = numbers(inertial, "quat", "1 0 0 0")
        R = from_quat(quat)
        tensor = R @ tensor @ R.T
        for name in ("diaginertia", "quat"):
            inertial.attrib.pop(name, None)
    t = turned(tensor, size)
    put(inertial, "fullinertia", [t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[0, 2], t[1, 2]])


def from_quat(quat: np.ndarray) -> np.ndarray:
    w, v = quat[0], quat[1:]
    cross = np.cross(np.eye(3), v)
    return np.eye(3) - 2 * (w * cross - cross @ cross) / (quat @ quat)


def mjcf_axis(root: Root, k: int, _size: float = 0.0) -> None:
    joint = bodies(root)[k].find("joint")
    put(joint, "axis", -numbers(joint, "axis", "0 0 1"))


def mjcf_tilt(root: Root, k: int, size: float = 0.01) -> None:
    joint = bodies(root)[k].find("joint")
    put(joint, "axis", tilted(numbers(joint, "axis", "0 0 1"), size))


def mjcf_zero(root: Root, k: int, size: float = 0.1) -> None:
    """Set MuJoCo's `ref`: the position in the file has another coordinate."""
    joint = bodies(root)[k].find("joint")
    put(joint, "ref", size + float(joint.get("ref", "0")))


def mjcf_pose(root: Root, k: int, size: float = 0.003) -> None:
    body = bodies(root)[k]
    put(body, "pos", numbers(body, "pos") + size * AWAY)


def mjcf_displaced(root: Root, k: int, size: float = 0.003) -> None:
    joint = bodies(root)[k].find("joint")
    put(joint, "pos", numbers(joint, "pos") + size * AWAY)


def mjcf_armature(root: Root, k: int, size: float = 0.013) -> None:
    joint = bodies(root)[k].find("joint")
    put(joint, "armature", size + float(joint.get("armature", "0")))


def mjcf_friction(root: Root, k: int, size: float = 0.23) -> None:
    joint = bodies(root)[k].find("joint")
    put(joint, "frictionloss", size + float(joint.get("frictionloss", "0")))


def mjcf_damping(root: Root, k: int, size: float = 0.2) -> None:
    joint = bodies(root)[k].find("joint")
    put(joint, "damping", size + float(joint.get("damping", "0")))


def mjcf_base(root: Root, _k: int, size: float = 1.0) -> None:
    """Turn everything in the world about an oblique axis."""
    world = root.find("worldbody")
    frame = etree.Element("frame", axisangle=f"0.6 -0.48 0.64 {size!r}")
    frame.extend(list(world))
    world.append(frame)


def mjcf_order(root: Root, _k: int, _size: float = 0.0) -> None:
    """Move the last of several siblings to the first place."""
    for body in [root.find("worldbody"), *root.iter("body")]:
        beside = [b for b in body.findall("body") if next(b.iter("joint"), None) is not None]
        if len(beside) > 1:
            body.insert(body.index(beside[0]), beside[-1])
            return
    raise IndexError("a chain has one order")


def mjcf_tendon(root: Root, _k: int, size: float = 0.001) -> None:
    name = root.findall("tendon/spatial/site")[1].get("site")
    site = next(s for s in root.iter("site") if s.get("name") == name)
    put(site, "pos", numbers(site, "pos") + size * np.array([0.0, 0.8, 0.6]))


def mjcf_actuator(root: Root, _k: int, _size: float = 0.0) -> None:
    actuator = root.find("actuator/*")
    put(actuator, "gear", -numbers(actuator, "gear", "1"))


MJCF: dict[str, Callable[..., None]] = {
    "mass": mjcf_mass, "centre": mjcf_centre, "inertia": mjcf_inertia, "axis": mjcf_axis,
    "tilt": mjcf_tilt, "displaced": mjcf_displaced, "zero": mjcf_zero, "pose": mjcf_pose,
    "armature": mjcf_armature, "friction": mjcf_friction, "damping": mjcf_damping,
    "base": mjcf_base, "order": mjcf_order, "tendon": mjcf_tendon, "actuator": mjcf_actuator,
}  # fmt: skip
