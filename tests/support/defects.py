"""Planted defects: one number of a URDF or an MJCF changed, and the kind of cause that it is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from lxml import etree

Root = etree._Element


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


def urdf_mass(root: Root, k: int) -> None:
    mass = moved_link(root, k).find("inertial/mass")
    put(mass, "value", 1.03 * float(mass.get("value")))


def urdf_centre(root: Root, k: int) -> None:
    origin = child(moved_link(root, k).find("inertial"), "origin")
    put(origin, "xyz", numbers(origin, "xyz") + np.array([0.0012, 0.0, -0.0016]))


def urdf_inertia(root: Root, k: int) -> None:
    node = moved_link(root, k).find("inertial/inertia")
    names = [["ixx", "ixy", "ixz"], ["ixy", "iyy", "iyz"], ["ixz", "iyz", "izz"]]
    tensor = turned(np.array([[float(node.get(n)) for n in row] for row in names]), np.pi / 6)
    for i in range(3):
        for j in range(i, 3):
            put(node, names[i][j], tensor[i, j])


def urdf_axis(root: Root, k: int) -> None:
    axis = child(joints(root)[k], "axis")
    put(axis, "xyz", -numbers(axis, "xyz", "1 0 0"))


def urdf_armature(root: Root, k: int) -> None:
    block = child(root, "softdyn")
    block.set("version", "1")
    name = joints(root)[k].get("name")
    node = next((j for j in block.findall("joint") if j.get("name") == name), None)
    if node is None:
        node = etree.Element("joint", name=name)
        block.insert(0, node)
    put(node, "armature", 0.01 + float(node.get("armature", "0")))


def urdf_friction(root: Root, k: int) -> None:
    dynamics = child(joints(root)[k], "dynamics")
    put(dynamics, "friction", 0.2 + float(dynamics.get("friction", "0")))


def urdf_pose(root: Root, k: int) -> None:
    origin = child(joints(root)[k], "origin")
    put(origin, "xyz", numbers(origin, "xyz") + np.array([0.002, 0.001, -0.002]))


def urdf_tendon(root: Root, _k: int) -> None:
    site = root.findall("softdyn/tendon/site")[1]
    put(site, "xyz", numbers(site, "xyz") + np.array([0.0, 0.0008, 0.0006]))


def urdf_actuator(root: Root, _k: int) -> None:
    actuator = root.find("softdyn/actuator")
    put(actuator, "gear", -float(actuator.get("gear", "1")))


def urdf_zero(root: Root, k: int) -> None:
    """The joint's origin turned by 0.1 rad about its axis, or moved 0.1 m along it."""
    joint = joints(root)[k]
    axis = numbers(child(joint, "axis"), "xyz", "1 0 0")
    axis /= np.linalg.norm(axis)
    origin = child(joint, "origin")
    R = rpy(numbers(origin, "rpy"))
    if joint.get("type") == "prismatic":
        put(origin, "xyz", numbers(origin, "xyz") + 0.1 * R @ axis)
        return
    cross = np.cross(np.eye(3), axis).T
    R = R @ (np.eye(3) + np.sin(0.1) * cross + (1 - np.cos(0.1)) * cross @ cross)
    pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    put(origin, "rpy", [np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])


def rpy(angles: np.ndarray) -> np.ndarray:
    (sr, sp, sy), (cr, cp, cy) = np.sin(angles), np.cos(angles)
    return np.array([[cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                     [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                     [-sp, cp * sr, cp * cr]])  # fmt: skip


URDF: dict[str, Callable[[Root, int], None]] = {
    "mass": urdf_mass, "centre": urdf_centre, "inertia": urdf_inertia, "axis": urdf_axis,
    "zero": urdf_zero, "pose": urdf_pose, "armature": urdf_armature, "friction": urdf_friction,
    "tendon": urdf_tendon, "actuator": urdf_actuator,
}  # fmt: skip


# -- MJCF: `k` counts the bodies that hinges or slides move ---------------------------------------


def bodies(root: Root) -> list[Root]:
    return [
        b
        for b in root.iter("body")
        if b.find("joint") is not None and b.find("joint").get("type") not in ("free", "ball")
    ]


def mjcf_mass(root: Root, k: int) -> None:
    inertial = bodies(root)[k].find("inertial")
    put(inertial, "mass", 1.03 * float(inertial.get("mass")))


def mjcf_centre(root: Root, k: int) -> None:
    inertial = bodies(root)[k].find("inertial")
    put(inertial, "pos", numbers(inertial, "pos") + np.array([0.0012, 0.0, -0.0016]))


def mjcf_inertia(root: Root, k: int) -> None:
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
    t = turned(tensor, np.pi / 6)
    put(inertial, "fullinertia", [t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[0, 2], t[1, 2]])


def from_quat(quat: np.ndarray) -> np.ndarray:
    w, v = quat[0], quat[1:]
    cross = np.cross(np.eye(3), v)
    return np.eye(3) - 2 * (w * cross - cross @ cross) / (quat @ quat)


def mjcf_axis(root: Root, k: int) -> None:
    joint = bodies(root)[k].find("joint")
    put(joint, "axis", -numbers(joint, "axis", "0 0 1"))


def mjcf_zero(root: Root, k: int) -> None:
    """MuJoCo's own word for it: the position in the file is called 0.1."""
    joint = bodies(root)[k].find("joint")
    put(joint, "ref", 0.1 + float(joint.get("ref", "0")))


def mjcf_pose(root: Root, k: int) -> None:
    body = bodies(root)[k]
    put(body, "pos", numbers(body, "pos") + np.array([0.002, 0.001, -0.002]))


def mjcf_displaced(root: Root, k: int) -> None:
    joint = bodies(root)[k].find("joint")
    put(joint, "pos", numbers(joint, "pos") + np.array([0.002, 0.001, -0.002]))


def mjcf_armature(root: Root, k: int) -> None:
    joint = bodies(root)[k].find("joint")
    put(joint, "armature", 0.013 + float(joint.get("armature", "0")))


def mjcf_friction(root: Root, k: int) -> None:
    joint = bodies(root)[k].find("joint")
    put(joint, "frictionloss", 0.23 + float(joint.get("frictionloss", "0")))


def mjcf_base(root: Root, _k: int) -> None:
    """Everything in the world turned by 1 rad about an axis along none."""
    world = root.find("worldbody")
    frame = etree.Element("frame", axisangle="0.6 -0.48 0.64 1")
    frame.extend(list(world))
    world.append(frame)


def mjcf_order(root: Root, _k: int) -> None:
    """The last of the bodies that stand beside each other, first."""
    for body in [root.find("worldbody"), *root.iter("body")]:
        beside = [b for b in body.findall("body") if next(b.iter("joint"), None) is not None]
        if len(beside) > 1:
            body.insert(body.index(beside[0]), beside[-1])
            return
    raise IndexError("a chain has one order")


def mjcf_tendon(root: Root, _k: int) -> None:
    name = root.findall("tendon/spatial/site")[1].get("site")
    site = next(s for s in root.iter("site") if s.get("name") == name)
    put(site, "pos", numbers(site, "pos") + np.array([0.0, 0.0008, 0.0006]))


def mjcf_actuator(root: Root, _k: int) -> None:
    actuator = root.find("actuator/*")
    put(actuator, "gear", -numbers(actuator, "gear", "1"))


MJCF: dict[str, Callable[[Root, int], None]] = {
    "mass": mjcf_mass, "centre": mjcf_centre, "inertia": mjcf_inertia, "axis": mjcf_axis,
    "zero": mjcf_zero, "pose": mjcf_pose, "armature": mjcf_armature, "friction": mjcf_friction,
    "base": mjcf_base, "order": mjcf_order, "tendon": mjcf_tendon, "actuator": mjcf_actuator,
}  # fmt: skip
