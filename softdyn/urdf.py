"""The annotated URDF, format version 1: one strict parse into frozen data.

Every engine reads the same file; what is judged here is judged before any of them sees it.
The format, with the error for each misuse, is described in ``docs/format.md``.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from softdyn.exceptions import UrdfError
from softdyn.inertia import Inertia, rotation_rpy
from softdyn.xml import Element, read

T = TypeVar("T")
VERSION = "1"
# Pinocchio's Data grows with nv³ (1.7 GB at nv = 300) and its URDF parser recurses over the tree.
MAX_DOF = 256
MAX_LINKS = 1024
MOVING = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid link and its inertia, expressed in the link frame."""

    name: str
    inertia: Inertia


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint with its compliance; SI units, radians or metres.

    `rotation` (3, 3) and `translation` (3,) place the joint in the parent link's frame; `axis` (3,)
    is a unit vector in the joint's own; dry `friction` is the plant's only.
    """

    name: str
    kind: str
    parent: str
    child: str
    rotation: np.ndarray
    translation: np.ndarray
    axis: np.ndarray
    lower: float = -math.inf
    upper: float = math.inf
    stiffness: float = 0.0
    rest: float = 0.0
    damping: float = 0.0
    armature: float = 0.0
    friction: float = 0.0

    @property
    def moves(self) -> bool:
        return self.kind in MOVING


@dataclass(frozen=True)
class JointTerm:
    """One term ``coef · q_joint`` of a fixed tendon's length."""

    joint: str
    coef: float


@dataclass(frozen=True, eq=False)
class Site:
    """A point of a spatial tendon's path, `xyz` (m) in the frame of `link`."""

    link: str
    xyz: np.ndarray


@dataclass(frozen=True, eq=False)
class Tendon:
    """A cable or coupling: fixed (`terms`) or spatial (`sites`), never both.

    The force ``stiffness · (ℓ - rest) + damping · ℓ̇`` acts both ways; `rest` None is ℓ at q = 0.
    """

    name: str
    terms: tuple[JointTerm, ...] = ()
    sites: tuple[Site, ...] = ()
    stiffness: float = 0.0
    damping: float = 0.0
    rest: float | None = None


@dataclass(frozen=True)
class Actuator:
    """An input u in [lower, upper] that acts with force ``gear · u`` along a tendon."""

    name: str
    tendon: str
    gear: float
    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class Robot:
    """One parsed file: the tree, its compliance and its annotations."""

    name: str
    path: Path
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    tendons: tuple[Tendon, ...]
    actuators: tuple[Actuator, ...]
    task: str
    warnings: tuple[str, ...]

    @property
    def moving_joints(self) -> tuple[Joint, ...]:
        """Joints with a degree of freedom, in the file's order."""
        return tuple(joint for joint in self.joints if joint.moves)

    def chain(self, link: str) -> tuple[Joint, ...]:
        """The joints from the root to `link`, root first."""
        above = {joint.child: joint for joint in self.joints}
        path: deque[Joint] = deque()
        while link in above:
            path.appendleft(above[link])
            link = path[0].parent
        return tuple(path)

    @property
    def length(self) -> float:
        """Summed joint offsets from the base to the tip (m), the robot's size."""
        return float(sum(np.linalg.norm(joint.translation) for joint in self.chain(self.task)))


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
    links = _unique(root, "link", _link)
    if not 0 < len(links) <= MAX_LINKS:
        raise root.error(f"1 to {MAX_LINKS} links", len(links))
    joints = _unique(root, "joint", lambda e: _joint(e, links))
    if sum(joint.moves for joint in joints.values()) > MAX_DOF:
        raise root.error(
            f"at most {MAX_DOF} degrees of freedom", sum(j.moves for j in joints.values())
        )
    _check_tree(root, links, joints)
    _read_springs(root, joints)
    block = root.child("softdyn")
    tendons: dict[str, Tendon] = {}
    actuators: dict[str, Actuator] = {}
    task = None
    if block is not None:
        block.allow("version")
        if block.text("version") != VERSION:
            raise block.error(f'version="{VERSION}"', block.text("version"))
        _read_armatures(block, joints)
        tendons = _unique(block, "tendon", lambda e: _tendon(e, links, joints))
        actuators = _unique(block, "actuator", lambda e: _actuator(e, tendons))
        task = _read_task(block, links)
        for element in block.children():
            if element.tag not in ("joint", "tendon", "actuator", "task"):
                raise element.error("<joint>, <tendon>, <actuator> or <task>", f"<{element.tag}>")
    robot = Robot(
        name,
        path,
        tuple(links.values()),
        tuple(joints.values()),
        tuple(tendons.values()),
        tuple(actuators.values()),
        task or "",
        (),
    )
    if task is None:
        robot = replace(robot, task=_deepest_leaf(robot))
    if block is not None:
        _check_paths(robot, block)
    return replace(robot, warnings=_check_bodies(root, robot))


def _unique(parent: Element, tag: str, convert: Callable[[Element], T]) -> dict[str, T]:
    """Children named `tag`, converted and keyed by their name, which must not repeat."""
    found: dict[str, T] = {}
    for element in parent.children(tag):
        name = element.text("name")
        if name in found:
            raise element.error(f"a unique {tag} name", f"a second {name!r}")
        found[name] = convert(element)
    return found


def _origin(element: Element) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and translation (3,) of an element's optional ``<origin>``."""
    origin = element.child("origin")
    if origin is None:
        return np.eye(3), np.zeros(3)
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
    kind = element.text("type")
    if kind not in (*MOVING, "fixed"):
        raise element.error(f"type {', '.join(MOVING)} or fixed", kind)
    parent, child = (_end(element, tag, links) for tag in ("parent", "child"))
    rotation, translation = _origin(element)
    joint = Joint(element.text("name"), kind, parent, child, rotation, translation, np.zeros(3))
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
        raise end.error("the name of a link", end.text("link"))
    return end.text("link")


def _axis(element: Element) -> np.ndarray:
    axis = element.child("axis")
    if axis is None:
        return np.array([1.0, 0.0, 0.0])
    vector = axis.vector("xyz")
    norm = float(np.linalg.norm(vector))
    if not 1e-6 < norm < 1e6:
        raise axis.error("a non-zero vector", axis.text("xyz"))
    return vector / norm


def _limits(element: Element, kind: str) -> tuple[float, float]:
    """Position limits; URDF demands a complete <limit> of revolute and prismatic joints."""
    limit = element.child("limit")
    if limit is None:
        if kind != "continuous":
            raise element.error('<limit lower upper effort="…" velocity="…"/>', "none")
        return -math.inf, math.inf
    for attribute in ("effort", "velocity"):
        limit.non_negative(attribute, None)
    if kind == "continuous":
        return -math.inf, math.inf
    lower, upper = limit.number("lower", 0.0), limit.number("upper", 0.0)
    if lower > upper:
        raise limit.error("lower <= upper", f"lower={lower:g} upper={upper:g}")
    return lower, upper


def _children(joints: Iterable[Joint]) -> dict[str, list[Joint]]:
    """The joints that leave each link."""
    below: dict[str, list[Joint]] = {}
    for joint in joints:
        below.setdefault(joint.parent, []).append(joint)
    return below


def _levels(root: str, joints: Iterable[Joint]) -> Iterator[list[str]]:
    """Links by their number of joints from the root, the root first; never leaves a tree."""
    below = _children(joints)
    level = [root]
    while level:
        yield level
        level = [joint.child for link in level for joint in below.get(link, ())]


def _root(robot: Robot) -> str:
    children = {joint.child for joint in robot.joints}
    return next(link.name for link in robot.links if link.name not in children)


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
    reached = sum(len(level) for level in _levels(roots[0], joints.values()))
    if reached != len(links):
        raise root.error("a tree", f"a cycle: {len(links) - reached} links out of the root's reach")


def _read_springs(root: Element, joints: dict[str, Joint]) -> None:
    """Springs from <gazebo reference> and from the aliases on <dynamics>; sources must agree."""
    sources: dict[tuple[str, str], float] = {}

    def add(element: Element, joint: str, field: str, value: float) -> None:
        if sources.setdefault((joint, field), value) != value:
            got = f"{sources[joint, field]:g} and {value:g}"
            raise element.error(f"one {field} of joint {joint!r}", got)

    for element in root.children("joint"):
        dynamics = element.child("dynamics")
        for alias in ("stiffness", "spring_stiffness"):
            if dynamics is not None and dynamics.node.get(alias) is not None:
                add(dynamics, element.text("name"), "stiffness", dynamics.non_negative(alias))
    for element in root.children("gazebo"):
        for tag, field in (("springStiffness", "stiffness"), ("springReference", "rest")):
            for child in element.children(tag):
                joint = element.text("reference")
                if joint not in joints:
                    raise element.error("reference to a joint", joint)
                value = child.to_number(child.node.text or "", tag)
                if field == "stiffness" and value < 0:
                    raise child.error("stiffness >= 0", value)
                add(child, joint, field, value)
        for child in element.children("springStiffness"):
            _check_springy(child, joints[element.text("reference")])
    for element in root.children("joint"):
        name = element.text("name")
        if sources.get((name, "stiffness"), 0.0) > 0:
            _check_springy(element, joints[name])
            joints[name] = replace(
                joints[name],
                stiffness=sources[name, "stiffness"],
                rest=sources.get((name, "rest"), 0.0),
            )


def _check_springy(element: Element, joint: Joint) -> None:
    """A spring needs a position with a unique value: not that of a continuous or fixed joint."""
    if joint.kind not in ("revolute", "prismatic"):
        raise element.error(
            "a spring on a revolute or prismatic joint", f"{joint.kind} joint {joint.name!r}"
        )


def _named_joint(element: Element, name: str, joints: dict[str, Joint]) -> Joint:
    if name not in joints:
        raise element.error("the name of a joint", name)
    if not joints[name].moves:
        raise element.error("a joint that moves", f"fixed joint {name!r}")
    return joints[name]


def _read_armatures(block: Element, joints: dict[str, Joint]) -> None:
    def convert(element: Element) -> Joint:
        element.allow("name", "armature")
        joint = _named_joint(element, element.text("name"), joints)
        return replace(joint, armature=element.non_negative("armature"))

    joints.update(_unique(block, "joint", convert))


def _tendon(element: Element, links: dict[str, Link], joints: dict[str, Joint]) -> Tendon:
    element.allow("name", "stiffness", "damping", "rest")
    terms: dict[str, JointTerm] = {}
    sites: list[Site] = []
    for part in element.children():
        if part.tag == "joint":
            part.allow("name", "coef")
            joint = _named_joint(part, part.text("name"), joints)
            if joint.name in terms:
                raise part.error("each joint once in a tendon", f"a second {joint.name!r}")
            terms[joint.name] = JointTerm(joint.name, part.number("coef"))
        elif part.tag == "site":
            part.allow("link", "xyz")
            if part.text("link") not in links:
                raise part.error("the name of a link", part.text("link"))
            sites.append(Site(part.text("link"), part.vector("xyz")))
        else:
            raise part.error("<joint> or <site>", f"<{part.tag}>")
    if terms and sites:
        raise element.error("a path of <joint> or of <site> elements", "both")
    if not terms and len(sites) < 2:
        raise element.error("at least one <joint> or two <site> elements", f"{len(sites)} sites")
    tendon = Tendon(
        element.text("name"),
        tuple(terms.values()),
        tuple(sites),
        element.non_negative("stiffness"),
        element.non_negative("damping"),
        None if element.node.get("rest") is None else element.number("rest"),
    )
    if tendon.stiffness > 0:
        for term in tendon.terms:
            _check_springy(element, joints[term.joint])
    if tendon.sites and (tendon.rest or 0.0) < 0:
        raise element.error("rest >= 0, a length", tendon.rest)
    return tendon


def _actuator(element: Element, tendons: dict[str, Tendon]) -> Actuator:
    element.allow("name", "tendon", "gear", "lower", "upper")
    tendon = element.text("tendon")
    if tendon not in tendons:
        raise element.error("the name of a tendon", tendon)
    gear, lower, upper = (
        element.number("gear", 1.0),
        element.number("lower"),
        element.number("upper"),
    )
    if lower > upper:
        raise element.error("lower <= upper", f"lower={lower:g} upper={upper:g}")
    return Actuator(element.text("name"), tendon, gear, lower, upper)


def _read_task(block: Element, links: dict[str, Link]) -> str | None:
    task = block.child("task")
    if task is None:
        return None
    task.allow("frame")
    if task.text("frame") not in links:
        raise task.error("frame, the name of a link", task.text("frame"))
    return task.text("frame")


def _deepest_leaf(robot: Robot) -> str:
    """The link with the most joints between it and the root; the first in the file of equals."""
    *_, deepest = _levels(_root(robot), robot.joints)
    return next(link.name for link in robot.links if link.name in deepest)


def _poses(robot: Robot) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Pose (rotation, translation) of every link in the root's frame at q = 0."""
    below = _children(robot.joints)
    front = [_root(robot)]
    poses = {front[0]: (np.eye(3), np.zeros(3))}
    while front:
        link = front.pop()
        rotation, translation = poses[link]
        for joint in below.get(link, ()):
            poses[joint.child] = (
                rotation @ joint.rotation,
                rotation @ joint.translation + translation,
            )
            front.append(joint.child)
    return poses


def _check_paths(robot: Robot, block: Element) -> None:
    """Consecutive sites on different links must be apart, or the cable has no direction there."""
    poses = _poses(robot)
    tendons = {tendon.name: tendon for tendon in robot.tendons}
    for element in block.children("tendon"):
        sites = tendons[element.text("name")].sites
        for a, b in zip(sites, sites[1:], strict=False):
            ends = [poses[s.link][0] @ s.xyz + poses[s.link][1] for s in (a, b)]
            if a.link != b.link and np.linalg.norm(ends[1] - ends[0]) < 1e-9:
                got = f"sites of {a.link!r} and {b.link!r} at the same point"
                raise element.error("consecutive sites on different links apart at q = 0", got)


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
    for link_name in reversed(list(_poses(robot))):  # leaves before what carries them
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


def moving_bodies(robot: Robot) -> dict[str, Inertia]:
    """Inertia of every moving body in its own frame, keyed by the link its joint moves.

    Links fixed to a moving one are lumped into it; what is fixed to the base is left out.
    """
    poses = _poses(robot)
    above = {joint.child: joint for joint in robot.joints}
    bodies = {joint.child: Inertia.zero() for joint in robot.joints if joint.moves}
    for link in robot.links:
        name = link.name
        while name in above and not above[name].moves:
            name = above[name].parent
        if name in bodies:
            (body_rotation, body_translation), (rotation, translation) = (
                poses[name],
                poses[link.name],
            )
            bodies[name] += link.inertia.moved(
                body_rotation.T @ rotation, body_rotation.T @ (translation - body_translation)
            )
    return bodies


__all__ = [
    "Actuator", "Joint", "JointTerm", "Link", "Robot", "Site", "Tendon", "UrdfError",
    "moving_bodies", "parse",
]  # fmt: skip
