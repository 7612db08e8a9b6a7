"""The annotated URDF, format version 1: one strict parse into frozen data.

Every file is checked here before an engine reads it. A file that two parsers could read differently
is refused. ``docs/format.md`` describes the format and the error for each misuse.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from lxml import etree

from softdyn.checks import array, flag
from softdyn.description.annotations import (
    BLOCK,
    AnnotationBlock,
    check_placement,
    read_block,
    read_springs,
)
from softdyn.description.inertia import MOMENTS, written_in_another_order
from softdyn.description.mimics import compose_mimics, read_mimic
from softdyn.description.motors import read_motors
from softdyn.description.origins import VERSIONS, in_rpy, read_origin, set_rpy, version
from softdyn.description.other_tools import check_other_tools
from softdyn.description.robot import (
    EARTH,
    MOVING,
    Joint,
    Link,
    Robot,
    Vector,
    deepest_leaf,
    levels,
    moving_bodies,
    moving_link_of,
)  # fmt: skip
from softdyn.description.strict_xml import Element, read, read_bytes
from softdyn.description.unknown_names import check_known_names
from softdyn.description.visuals import check_shapes
from softdyn.files import as_path, existing_folder

# Pinocchio's Data grows with nv³ (1.7 GB at nv = 300) and its URDF parser recurses over the tree.
MAX_DOF = 256
MAX_LINKS = 1024
RESERVED = "universe"  # Pinocchio's own joint; it drops the link of a fixed joint of that name
# Tags, attributes and children of `Robot.xml`: exactly those that the code below checks.
JUDGED: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "robot": (("name",), ("link", "joint")),
    "link": (("name",), ("inertial",)),
    "inertial": ((), ("origin", "mass", "inertia")),
    "mass": (("value",), ()),
    "inertia": (MOMENTS, ()),
    "joint": (("name", "type"), ("origin", "parent", "child", "axis", "limit")),
    "origin": (("xyz", "rpy"), ()),
    "parent": (("link",), ()),
    "child": (("link",), ()),
    "axis": (("xyz",), ()),
    "limit": (("lower", "upper", "effort", "velocity"), ()),
}
# Limits that URDF 1.2 may omit and nothing here uses, as Pinocchio's parser demands them.
UNUSED = {"effort": "1e50", "velocity": "1e50"}


def parse(
    path: str | Path,
    *,
    content: bytes | None = None,
    annotations: str | Path | None = None,
    floating: bool = False,
    repair_inertia: bool = False,
    gravity: Sequence[float] | None = None,
    root: str | Path | None = None,
) -> Robot:
    """Read an annotated URDF.

    Parameters
    ----------
    path : str or Path
        The URDF file.
    content : bytes, optional
        The file's bytes; if omitted, the file is read.
    annotations : str or Path, optional
        A file that holds the ``<softdyn>`` block, for a URDF without one.
    floating : bool
        Let the root link move freely.
    repair_inertia : bool
        If a moving body's inertia is impossible, replace each impossible inertia of its links by
        the nearest possible one, and warn.
    gravity : array_like, (3,), optional
        Acceleration of gravity in the world's axes (m/s²); by default the file's, or 0 0 -9.81.
    root : str or Path, optional
        A folder below which meshes may lie, too.

    Raises
    ------
    InputError
        For a gravity of another shape or one that is not finite, and if `root` is no folder.
    UrdfError
        For every misuse of the format; it names file, line, element, expected and got. Also for a
        gravity that contradicts the one that the file states.
    """
    path = as_path("path", path)
    above = None if root is None else existing_folder("root", root)
    for name, value in (("floating", floating), ("repair_inertia", repair_inertia)):
        flag(name, value)
    overlay = None
    if annotations is not None:
        overlay = partial(read, as_path("annotations", annotations), "annotations")
    tree = read(path) if content is None else read_bytes(path, content)
    robot = _robot(tree, overlay, floating, repair_inertia, gravity)
    robot = replace(robot, root_folder=above)
    return robot if annotations is None else replace(robot, overlay=Path(annotations))


def parse_text(
    text: str,
    annotations: str = "",
    *,
    path: Path,
    floating: bool = False,
    gravity: Sequence[float] | None = None,
) -> Robot:
    """Read a robot from `Robot.text` and `Robot.annotations`; their file was `path`.

    Raises
    ------
    UrdfError
        As in `parse`.
    """
    overlay = partial(read_bytes, path, annotations.encode()) if annotations else None
    robot = _robot(read_bytes(path, text.encode()), overlay, floating, False, gravity)
    return replace(robot, mended=True)  # the file may have changed since


def _robot(
    root: Element,
    overlay: partial[Element] | None,
    floating: bool,
    repair_inertia: bool,
    gravity: Sequence[float] | None,
) -> Robot:
    path, block_text = root.file, ""
    if root.tag != "robot":
        mjcf = ", an MJCF: `softdyn export` writes it as a URDF" if root.tag == "mujoco" else ""
        raise root.error("the root element <robot>", f"<{root.tag}>{mjcf}")
    check_known_names(root)
    ignored, left_out = check_other_tools(root)
    version(root)
    check_shapes(root)
    name = root.text("name")
    links = root.unique("link", _link)
    if not 0 < len(links) <= MAX_LINKS:
        raise root.error(f"1 to {MAX_LINKS} links", len(links))
    joints = root.unique("joint", lambda element: _joint(element, links))
    freedoms = sum(joint.moves for joint in joints.values()) + (6 if floating else 0)
    if freedoms > MAX_DOF:
        raise root.error(f"at most {MAX_DOF} degrees of freedom", freedoms)
    compose_mimics(root, joints)
    _check_tree(root, links, joints)
    read_springs(root, joints)
    adopted = read_motors(root, joints)
    comments = [str(c.text) for c in root.node.itersiblings(etree.Comment, preceding=True)]
    robot = Robot(
        name, tuple(links.values()), tuple(joints.values()), others=_others(root),
        floating=floating, comment="\n".join(comments[::-1]), path=path, ignored=ignored,
        adopted=adopted,
    )  # fmt: skip
    repairs = _repair(root, robot) if repair_inertia else ()
    if repairs:
        links = root.unique("link", _link)
    element = root.child(BLOCK)
    if overlay is not None:
        if element is not None:
            expected = f"no <{BLOCK}> in a URDF that is annotated by a file"
            raise element.error(expected, f"a block here and another in {overlay.args[0]}")
        element = overlay()
        block_text = etree.tostring(element.node, encoding="unicode")
        if element.tag != BLOCK:
            raise element.error(f"the root element <{BLOCK}>", f"<{element.tag}>")
    block = AnnotationBlock()
    if element is not None:
        block = read_block(element, links, joints, overlay=overlay is not None)
    robot = replace(
        robot,
        links=tuple(links.values()),
        joints=tuple(joints.values()),
        tendons=block.tendons,
        actuators=block.actuators,
        sensors=block.sensors,
        task=block.task or deepest_leaf(robot),
        tasks=block.tasks,
        gravity=_gravity(root if element is None else element, block.gravity, gravity),
        fluid=block.fluid,
        balls=block.balls,
        xml=etree.tostring(_judged(root), encoding="unicode"),
        text=etree.tostring(root.node, encoding="unicode"),
        annotations=block_text,
        mended=bool(repairs),
    )
    if element is not None:
        check_placement(element, robot)
        _check_buoyancy(element, robot)
    return replace(robot, warnings=(*left_out, *repairs, *_check_bodies(root, robot)))


def _judged(element: Element) -> etree._Element:
    """A copy of the tree with checked elements and attributes only, numbers verbatim."""
    node = element.node
    attributes, children = JUDGED[element.tag]
    if node.get("type") == "fixed":
        children = ("origin", "parent", "child")
    copy = etree.Element(element.tag)
    defaults = UNUSED if element.tag == "limit" else {}
    for attribute in attributes:
        if (value := node.get(attribute, defaults.get(attribute))) is not None:
            copy.set(attribute, value)
    copy.extend(_judged(child) for child in element.children() if child.tag in children)
    origin = copy.find("origin")
    if origin is not None:
        set_rpy(origin, element)
    return copy


def _others(root: Element) -> tuple[str, ...]:
    """The elements that `Robot` does not hold as data, as the file spells them."""
    found = []
    for child in root.children():
        if child.tag == "gazebo":
            node = deepcopy(child.node)
            for spring in (*node.iterfind("springStiffness"), *node.iterfind("springReference")):
                node.remove(spring)
            if len(node):
                found.append(_spelled(node))
        elif child.tag not in ("link", "joint", BLOCK):
            found.append(_spelled(child.node))
    return tuple(found)


def _spelled(node: etree._Element) -> str:
    return etree.tostring(node, encoding="unicode", with_tail=False)


def _link(element: Element) -> Link:
    inertial = element.child("inertial")
    looks = (in_rpy(c) for c in element.children() if c.tag in ("visual", "collision"))
    link = Link(element.text("name"), looks=tuple(map(_spelled, looks)))
    if inertial is None:
        return link
    mass, tensor = inertial.child("mass"), inertial.child("inertia")
    if mass is None or tensor is None:
        raise inertial.error(
            "<mass> and <inertia>", "no <mass>" if mass is None else "no <inertia>"
        )
    moments = tuple(tensor.number(attribute) for attribute in MOMENTS)
    mass_value = mass.non_negative("value", None)
    return replace(link, mass=mass_value, moments=moments, origin=read_origin(inertial))


def _joint(element: Element, links: dict[str, Link]) -> Joint:
    name, kind = element.text("name"), element.text("type")
    if name == RESERVED:
        raise element.error("another name, this one being Pinocchio's own", repr(name))
    if kind not in (*MOVING, "fixed"):
        raise element.error(f"type {', '.join(MOVING)} or fixed", repr(kind))
    parent, child = (_end(element, tag, links) for tag in ("parent", "child"))
    joint = Joint(name, kind, parent, child, read_origin(element))
    if not joint.moves:
        return joint
    (lower, upper, effort, velocity), dynamics = _limits(element, kind), element.child("dynamics")
    return replace(
        joint,
        lower=lower,
        upper=upper,
        effort=effort,
        velocity=velocity,
        direction=_direction(element),
        damping=dynamics.non_negative("damping") if dynamics else 0.0,
        friction=dynamics.non_negative("friction") if dynamics else 0.0,
        mimic=read_mimic(element),
    )


def _end(element: Element, tag: str, links: dict[str, Link]) -> str:
    end = element.child(tag)
    if end is None:
        raise element.error(f"<{tag}>", "none")
    if end.text("link") not in links:
        raise end.error("the name of a link", repr(end.text("link")))
    return end.text("link")


def _direction(element: Element) -> Vector:
    axis = element.child("axis")
    if axis is None:
        return 1.0, 0.0, 0.0
    vector = axis.vector("xyz")
    if not 1e-6 < np.linalg.norm(vector) < 1e6:
        raise axis.error("a non-zero vector", repr(axis.text("xyz")))
    return vector


def _limits(element: Element, kind: str) -> tuple[float, float, float, float]:
    """Lower, upper, effort and velocity; URDF demands them of revolute and prismatic joints."""
    limit = element.child("limit")
    if limit is None:
        if kind != "continuous":
            raise element.error('<limit lower="…" upper="…" effort="…" velocity="…"/>', "none")
        return -math.inf, math.inf, math.inf, math.inf
    newest = version(element) == VERSIONS[-1]
    unbounded = math.inf if newest else None
    effort, velocity = (limit.non_negative(name, unbounded) for name in ("effort", "velocity"))
    for name in ("acceleration", "deceleration", "jerk"):
        limit.non_negative(name)
    held = None if newest and kind != "continuous" else 0.0
    lower, upper = limit.number("lower", held), limit.number("upper", held)
    if lower > upper:
        raise limit.error("lower <= upper", f"lower={lower} upper={upper}")
    span = (-math.inf, math.inf) if kind == "continuous" else (lower, upper)
    return *span, effort, velocity


def _check_tree(root: Element, links: dict[str, Link], joints: dict[str, Joint]) -> None:
    """Refuse a second root, a second parent of a link, and a cycle."""
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


def _gravity(element: Element, stated: Vector | None, given: Sequence[float] | None) -> Vector:
    """The acceleration of gravity, of which all statements must agree.

    Of other tools' elements `check_other_tools` accepts no other than 0 0 -9.81.
    """
    x, y, z = EARTH if stated is None else stated
    if given is not None:
        x, y, z = array("gravity", given, (3,)).tolist()
        if stated is not None and stated != (x, y, z):
            raise element.error("one gravity", f"{stated} here, and {(x, y, z)} as an argument")
    others = element.node.getroottree().xpath(
        "//option/@gravity | //gazebo//gravity[contains(., ' ')]"
    )
    if others and (x, y, z) != EARTH:
        raise element.error("one gravity", f"{(x, y, z)}, and 0 0 -9.81 for another tool")
    return x, y, z


def _check_buoyancy(block: Element, robot: Robot) -> None:
    """Refuse different shares of links that are fixed to one another, which are one body."""
    carrier, shares = moving_link_of(robot), dict[str, float]()
    for link in robot.links if robot.buoyant else ():
        body = carrier[link.name]
        moves = body != robot.root or robot.floating
        if moves and link.mass and shares.setdefault(body, link.gravcomp) != link.gravcomp:
            expected = f"one gravcomp for all links with mass that are fixed to {body!r}"
            raise block.error(expected, f"{shares[body]:g} and {link.gravcomp:g}")


def _repair(root: Element, robot: Robot) -> tuple[str, ...]:
    """Repair the inertias of impossible moving bodies in the XML, link by link; report each.

    A sum of physical inertias is physical, so repaired links make a physical body.
    """
    defective = {link for link, body in moving_bodies(robot).items() if body.defect()}
    carrier = moving_link_of(robot)
    elements = {element.text("name"): element for element in root.children("link")}
    records = []
    for link in robot.links:
        inertial = elements[link.name].child("inertial")
        if carrier[link.name] not in defective or not link.inertia.defect() or inertial is None:
            continue
        tensor = inertial.child("inertia")
        assert tensor is not None  # _link has read it
        mended = link.about_com.nearest_physical()
        for attribute, moment in zip(MOMENTS, mended.moments, strict=True):
            tensor.node.set(attribute, repr(moment))
        before, after = (
            ", ".join(f"{moment:.6g}" for moment in np.linalg.eigvalsh(inertia.tensor))
            for inertia in (link.inertia, mended)
        )
        records.append(
            f"{robot.path}: {elements[link.name].label}: inertia repaired: "
            f"principal moments {before} -> {after} kg m^2"
        )
    return tuple(records)


def _check_bodies(root: Element, robot: Robot) -> tuple[str, ...]:
    """Check the inertia of each moving body, its fixed links lumped in; return warnings.

    The dynamics use the lumped body only, so the defect of a single link is only a warning.
    """
    elements = {element.text("name"): element for element in root.children("link")}
    bodies, carrier = moving_bodies(robot), moving_link_of(robot)
    defects = {link.name: defect for link in robot.links if (defect := link.inertia.defect())}
    for name, body in bodies.items():
        defect = body.defect()
        if defect:
            culprits = [link for link in defects if carrier[link] == name]
            expected = "a physical inertia, with its fixed links"
            if culprits and name not in culprits:
                expected += f" such as {culprits[0]!r}"
            wrong = [link for link in robot.links if link.name in culprits]
            hint = written_in_another_order(wrong[0].moments) if wrong else ""
            raise elements[name].error(expected, hint + defect)
    massive = _massive(robot, {name for name, body in bodies.items() if body.mass > 0})
    for joint in robot.joints:
        driven = [joint.child]
        if joint.moves and joint.mimic is None:
            driven += [f.child for f in robot.followers if f.mimic and f.mimic.leader == joint.name]
            if massive.isdisjoint(driven):
                got = f"none on or beyond joint {joint.name!r}"
                raise elements[joint.child].error("a positive mass that the joint moves", got)
    if robot.floating and robot.root not in massive:
        raise root.error("a positive mass on a floating base", "none")
    return tuple(f"{robot.path}: {elements[link].label}: {defects[link]}" for link in defects)


def _massive(robot: Robot, bodies: set[str]) -> set[str]:
    """The links of `bodies`, and all links between them and the root."""
    above = {joint.child: joint.parent for joint in robot.joints}
    massive: set[str] = set()
    for name in bodies:
        link: str | None = name
        while link is not None and link not in massive:
            massive.add(link)
            link = above.get(link)
    return massive
