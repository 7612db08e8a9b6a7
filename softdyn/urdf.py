"""The annotated URDF, format version 1: one strict parse into frozen data.

What reaches an engine is judged here first: a file that two parsers could read differently is
refused. The format, with the error for each misuse, is described in ``docs/format.md``.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from lxml import etree

from softdyn.annotations import check_paths, read_block, read_springs
from softdyn.exceptions import UrdfError
from softdyn.inertia import Inertia, rotation_rpy
from softdyn.robot import (
    MOVING,
    Actuator,
    Joint,
    JointTerm,
    Link,
    Robot,
    Site,
    Tendon,
    deepest_leaf,
    levels,
    moving_bodies,
    poses,
)
from softdyn.xml import Element, read

# Pinocchio's Data grows with nv³ (1.7 GB at nv = 300) and its URDF parser recurses over the tree.
MAX_DOF = 256
MAX_LINKS = 1024
RESERVED = "universe"  # Pinocchio's own joint: a fixed one of that name loses its link there
# Tags, attributes and children of `Robot.xml`: all that has been judged below.
JUDGED: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "robot": (("name",), ("link", "joint")),
    "link": (("name",), ("inertial",)),
    "inertial": ((), ("origin", "mass", "inertia")),
    "mass": (("value",), ()),
    "inertia": (("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), ()),
    "joint": (("name", "type"), ("origin", "parent", "child", "axis", "limit")),
    "origin": (("xyz", "rpy"), ()),
    "parent": (("link",), ()),
    "child": (("link",), ()),
    "axis": (("xyz",), ()),
    "limit": (("lower", "upper", "effort", "velocity"), ()),
}


def parse(path: str | Path) -> Robot:
    """Read an annotated URDF.

    Parameters
    ----------
    path : the URDF file.

    Raises
    ------
    UrdfError
        For every misuse of the format, naming file, line, element, expected and got.
    """
    path = Path(path)
    root = read(path)
    if root.tag != "robot":
        raise root.error("the root element <robot>", f"<{root.tag}>")
    name = root.text("name")
    links = root.unique("link", _link)
    if not 0 < len(links) <= MAX_LINKS:
        raise root.error(f"1 to {MAX_LINKS} links", len(links))
    joints = root.unique("joint", lambda element: _joint(element, links))
    freedoms = sum(joint.moves for joint in joints.values())
    if freedoms > MAX_DOF:
        raise root.error(f"at most {MAX_DOF} degrees of freedom", freedoms)
    _check_tree(root, links, joints)
    read_springs(root, joints)
    block = read_block(root, links, joints)
    robot = Robot(
        name,
        path,
        tuple(links.values()),
        tuple(joints.values()),
        block.tendons,
        block.actuators,
        block.task or "",
        (),
        etree.tostring(_judged(root.node), encoding="unicode"),
    )
    if block.task is None:
        robot = replace(robot, task=deepest_leaf(robot))
    check_paths(root, robot)
    return replace(robot, warnings=_check_bodies(root, robot))


def _judged(node: etree._Element) -> etree._Element:
    """A copy of the tree that holds nothing but what was judged, numbers verbatim."""
    attributes, children = JUDGED[node.tag]
    if node.get("type") == "fixed":
        children = ("origin", "parent", "child")
    copy = etree.Element(node.tag)
    for attribute in attributes:
        if (value := node.get(attribute)) is not None:
            copy.set(attribute, value)
    copy.extend(_judged(child) for child in node if child.tag in children)
    return copy


def _origin(element: Element) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and translation (3,) of an element's optional ``<origin>``."""
    origin = element.child("origin")
    if origin is None:
        return np.eye(3), np.zeros(3)
    # Not even an unknown attribute: URDF 1.1's quat_xyzw overrides rpy in some engines only.
    origin.allow("xyz", "rpy")
    zero = (0.0, 0.0, 0.0)
    return rotation_rpy(origin.vector("rpy", zero)), origin.vector("xyz", zero)


def _link(element: Element) -> Link:
    inertial = element.child("inertial")
    if inertial is None:
        return Link(element.text("name"), Inertia.zero())
    mass, tensor = inertial.child("mass"), inertial.child("inertia")
    if mass is None or tensor is None:
        raise inertial.error(
            "<mass> and <inertia>", "no <mass>" if mass is None else "no <inertia>"
        )
    xx, xy, xz, yy, yz, zz = (tensor.number("i" + a) for a in ("xx", "xy", "xz", "yy", "yz", "zz"))
    local = Inertia(
        mass.non_negative("value", None),
        np.zeros(3),
        np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]),
    )
    return Link(element.text("name"), local.moved(*_origin(inertial)))


def _joint(element: Element, links: dict[str, Link]) -> Joint:
    name, kind = element.text("name"), element.text("type")
    if name == RESERVED:
        raise element.error("another name, this one being Pinocchio's own", repr(name))
    if kind not in (*MOVING, "fixed"):
        raise element.error(f"type {', '.join(MOVING)} or fixed", repr(kind))
    parent, child = (_end(element, tag, links) for tag in ("parent", "child"))
    rotation, translation = _origin(element)
    joint = Joint(name, kind, parent, child, rotation, translation, np.zeros(3))
    if not joint.moves:
        return joint
    if element.child("mimic") is not None:
        raise element.error("an independent joint (mimic joints are not supported)", "<mimic>")
    lower, upper = _limits(element, kind)
    dynamics = element.child("dynamics")
    return replace(
        joint,
        axis=_axis(element),
        lower=lower,
        upper=upper,
        damping=dynamics.non_negative("damping") if dynamics else 0.0,
        friction=dynamics.non_negative("friction") if dynamics else 0.0,
    )


def _end(element: Element, tag: str, links: dict[str, Link]) -> str:
    end = element.child(tag)
    if end is None:
        raise element.error(f"<{tag}>", "none")
    if end.text("link") not in links:
        raise end.error("the name of a link", repr(end.text("link")))
    return end.text("link")


def _axis(element: Element) -> np.ndarray:
    axis = element.child("axis")
    if axis is None:
        return np.array([1.0, 0.0, 0.0])
    vector = axis.vector("xyz")
    norm = float(np.linalg.norm(vector))
    if not 1e-6 < norm < 1e6:
        raise axis.error("a non-zero vector", repr(axis.text("xyz")))
    return vector / norm


def _limits(element: Element, kind: str) -> tuple[float, float]:
    """Position limits; URDF demands a <limit> of revolute and prismatic joints."""
    limit = element.child("limit")
    if limit is None:
        if kind != "continuous":
            raise element.error('<limit lower="…" upper="…" effort="…" velocity="…"/>', "none")
        return -math.inf, math.inf
    for attribute in ("effort", "velocity"):
        limit.non_negative(attribute, None)
    lower, upper = limit.number("lower", 0.0), limit.number("upper", 0.0)
    if lower > upper:
        raise limit.error("lower <= upper", f"lower={lower} upper={upper}")
    return (-math.inf, math.inf) if kind == "continuous" else (lower, upper)


def _check_tree(root: Element, links: dict[str, Link], joints: dict[str, Joint]) -> None:
    """One root, one parent a link, no cycle."""
    above: dict[str, str] = {}
    for element in root.children("joint"):
        joint = joints[element.text("name")]
        if joint.child in above:
            got = f"joints {above[joint.child]!r} and {joint.name!r}"
            raise element.error(f"one parent of link {joint.child!r}", got)
        above[joint.child] = joint.name
    roots = [name for name in links if name not in above]
    if len(roots) != 1:
        got = f"{len(roots)}: {', '.join(roots)}" if roots else "a cycle"
        raise root.error("one root link, every other one joined to it", got)
    reached = sum(len(level) for level in levels(roots[0], joints.values()))
    if reached != len(links):
        raise root.error("a tree", f"a cycle: {len(links) - reached} links out of the root's reach")


def _check_bodies(root: Element, robot: Robot) -> tuple[str, ...]:
    """Judge the inertia of each moving body, its fixed links lumped in; return warnings.

    That lump is what the dynamics see: the defect of one link inside it is only a warning.
    """
    elements = {element.text("name"): element for element in root.children("link")}
    bodies = moving_bodies(robot)
    warnings = []
    for link in robot.links:
        defect = link.inertia.defect()
        if defect:
            warnings.append(f"{robot.path}: {elements[link.name].label}: {defect}")
    above = {joint.child: joint.parent for joint in robot.joints}
    massive: set[str] = set()
    for link_name in reversed(list(poses(robot))):  # leaves before what carries them
        if link_name in massive or (link_name in bodies and bodies[link_name].mass > 0):
            massive.update((link_name, above.get(link_name, "")))
    for joint in robot.joints:
        if not joint.moves:
            continue
        defect = bodies[joint.child].defect()
        if defect:
            raise elements[joint.child].error("a physical inertia, with its fixed links", defect)
        if joint.child not in massive:
            got = f"none on or beyond joint {joint.name!r}"
            raise elements[joint.child].error("a positive mass that the joint moves", got)
    return tuple(warnings)


__all__ = [
    "Actuator", "Joint", "JointTerm", "Link", "Robot", "Site", "Tendon", "UrdfError",
    "moving_bodies", "parse",
]  # fmt: skip
