"""softdyn's additions to a URDF: springs and the ``<softdyn>`` block, format version 1."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from softdyn.checks import did_you_mean
from softdyn.description.rig import Actuator, Sensor
from softdyn.description.rig_block import (
    A_LINK,
    SPRING,
    check_position,
    moving_joint,
    read_actuator,
    read_sensor,
)
from softdyn.description.robot import (
    MOST_BRANCHES,
    MOST_FRICTION,
    NO_FLUID,
    Ball,
    Fluid,
    Joint,
    JointTerm,
    Link,
    Pair,
    PathEnd,
    Robot,
    Site,
    Tendon,
    Vector,
    Wrap,
    children,
    moving_link_of,
    poses,
)
from softdyn.description.stated_task import StatedTask, only_the_tip, read_tasks
from softdyn.description.strict_xml import Element

BLOCK, VERSION = "softdyn", "1"
CHILDREN = ("link", "joint", "tendon", "actuator", "sensor", "task", "fluid", "ball")
CURVES = ("stiffness_poly", "damping_poly")
SPRINGS = (*CURVES, "relaxation")
TENDON = ("stiffness", "damping", "rest", "slack", "friction", "driven", "armature", *CURVES)
ENDS = tuple(end.value for end in PathEnd)
COINCIDENT = 1e-9  # metres between two sites that count as one point
WRAPS = ("cylinder", "sphere")
ON_RADIUS = 1e-9  # share of a radius by which a site on the surface may lie inside by rounding
ORTHOGONAL = 1e-6  # rad, and cosine: rounding of axes and limits of a ball's hinges
IN_LINE = 1e-9  # sine of an angle that counts as zero


@dataclass(frozen=True, eq=False)
class AnnotationBlock:
    """The content of ``<softdyn>``; every part is optional."""

    tendons: tuple[Tendon, ...] = ()
    actuators: tuple[Actuator, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    task: str | None = None
    tasks: tuple[StatedTask, ...] = ()
    gravity: Vector | None = None
    fluid: Fluid = NO_FLUID
    balls: tuple[Ball, ...] = ()


def read_block(
    block: Element, links: dict[str, Link], joints: dict[str, Joint], *, overlay: bool
) -> AnnotationBlock:
    """Read the block, and write buoyancy into `links` and armatures into `joints`.

    An `overlay` is a block in a separate file. There a joint may have a spring and a damper too;
    they replace those of the URDF.
    """
    if block.text("version") != VERSION:
        raise block.error(f'version="{VERSION}"', repr(block.text("version")))
    block.allow("version", "gravity", children=CHILDREN)
    links.update(block.unique("link", lambda element: _buoyant(element, links)))
    compliance = _compliance if overlay else _armature
    joints.update(block.unique("joint", lambda element: compliance(element, joints)))
    tendons = block.unique("tendon", lambda element: _tendon(element, links, joints))
    actuators = block.unique("actuator", lambda element: read_actuator(element, tendons, joints))
    sensors = block.unique(
        "sensor", lambda element: read_sensor(element, links, joints, tendons, actuators)
    )
    tasks = read_tasks(block, links, A_LINK)
    return AnnotationBlock(
        tuple(tendons.values()),
        tuple(actuators.values()),
        tuple(sensors.values()),
        tasks[0].frame if tasks else None,
        () if only_the_tip(tasks) else tasks,
        None if block.node.get("gravity") is None else block.vector("gravity"),
        _fluid(block.child("fluid")),
        tuple(block.unique("ball", lambda element: _ball(element, joints)).values()),
    )


def _fluid(element: Element | None) -> Fluid:
    if element is None:
        return NO_FLUID
    element.allow("density", "viscosity")
    return Fluid(element.non_negative("density"), element.non_negative("viscosity"))


def _ball(element: Element, joints: dict[str, Joint]) -> Ball:
    """The spring and damper of three hinges, which have no others."""
    element.allow("name", "joints", "stiffness", "damping", "stiffness_poly")
    names = element.text("joints").split()
    if len(set(names)) != 3:
        raise element.error("three joints", repr(element.text("joints")))
    for name in names:
        if name not in joints:
            raise element.error("the name of a joint", did_you_mean(name, joints))
    first, second, third = (joints[name] for name in names)
    plain = ("stiffness", "damping", "armature", "friction", "rest", "mimic")
    for joint in (first, second, third):
        if joint.kind not in ("revolute", "continuous"):
            raise element.error("hinges", f"{joint.name!r}, which is {joint.kind}")
        for field in plain:
            if getattr(joint, field):
                raise element.error(f"hinges without {field}", f"that of {joint.name!r}")
        if any((*joint.stiffness_poly, *joint.damping_poly)):
            raise element.error("hinges without a spring and a damper", f"those of {joint.name!r}")
        if any(other.mimic and other.mimic.leader == joint.name for other in joints.values()):
            raise element.error("hinges that no joint follows", repr(joint.name))
    for above, below in ((first, second), (second, third)):
        if below.parent != above.child or any((*below.origin.xyz, *below.origin.rpy)):
            expected = "three hinges of one place and orientation, parents first"
            raise element.error(expected, f"{above.name!r} and {below.name!r}")
    axes = np.array([joint.axis for joint in (first, second, third)])
    if np.abs(axes @ axes.T - np.eye(3)).max() > ORTHOGONAL:
        raise element.error("orthogonal axes", f"those of {', '.join(names)}")
    for joint, most in ((first, math.pi), (second, math.pi / 2), (third, math.pi)):
        narrow = joint.upper < most - ORTHOGONAL or joint.lower > ORTHOGONAL - most
        if joint.kind == "revolute" and narrow:
            expected = f"limits of ±{most:.6g} rad of {joint.name!r}"
            raise element.error(expected, f"{joint.lower:g} to {joint.upper:g}")
    if max(-second.lower, second.upper) > math.pi / 2 + ORTHOGONAL:
        expected = f"limits of ±{math.pi / 2:.6g} rad of {second.name!r}, the middle hinge"
        raise element.error(expected, f"{second.lower:g} to {second.upper:g}")
    return Ball(
        element.text("name"),
        (first.name, second.name, third.name),
        element.non_negative("stiffness"),
        element.non_negative("damping"),
        element.pair("stiffness_poly", (0.0, 0.0)),
    )


def read_springs(root: Element, joints: dict[str, Joint]) -> None:
    """Write the joints' springs into `joints`; all statements about one joint must agree."""
    found: dict[tuple[str, str], float] = {}
    for element, name, field, value in _spring_statements(root, joints):
        if found.setdefault((name, field), value) != value:
            got = f"{found[name, field]} and {value}"
            raise element.error(f"one {field} of joint {name!r}", got)
        if field == "stiffness" and value > 0:
            check_position(element, joints[name], SPRING)
    for name, joint in joints.items():
        stiffness, rest = (found.get((name, field), 0.0) for field in ("stiffness", "rest"))
        joints[name] = replace(joint, stiffness=stiffness, rest=rest)


def _spring_statements(
    root: Element, joints: dict[str, Joint]
) -> Iterator[tuple[Element, str, str, float]]:
    """(element, joint, ``stiffness`` or ``rest``, value) from <dynamics> and from <gazebo>."""
    for element in root.children("joint"):
        dynamics = element.child("dynamics")
        for alias in ("stiffness", "spring_stiffness"):
            if dynamics is not None and dynamics.node.get(alias) is not None:
                yield dynamics, element.text("name"), "stiffness", dynamics.non_negative(alias)
    for element in root.children("gazebo"):
        for tag, field in (("springStiffness", "stiffness"), ("springReference", "rest")):
            for child in element.children(tag):
                name = element.text("reference")
                if name not in joints:
                    raise element.error("reference to a joint", did_you_mean(name, joints))
                text = child.node.get("value", child.node.xpath("string()"))  # Gazebo reads both
                value = child.to_number(str(text).strip(), tag)
                if field == "stiffness" and value < 0:
                    raise child.error("springStiffness >= 0", value)
                yield child, name, field, value


def _buoyant(element: Element, links: dict[str, Link]) -> Link:
    element.allow("name", "gravcomp")
    link = links.get(name := element.text("name"))
    if link is None:
        raise element.error(A_LINK, did_you_mean(name, links))
    if not link.mass:
        raise element.error("a link with mass", f"{name!r} without any")
    return replace(link, gravcomp=element.non_negative("gravcomp"))


def _armature(element: Element, joints: dict[str, Joint]) -> Joint:
    element.allow("name", "armature", *SPRINGS)
    joint = moving_joint(element, joints)
    spring, damper = _curves(element, joint)
    joint = replace(
        joint,
        armature=element.non_negative("armature"),
        stiffness_poly=spring,
        damping_poly=damper,
        relaxation=_branches(element, joint),
    )
    if any(joint.stiffness_poly):
        check_position(element, joint, SPRING)
    return joint


def _branches(element: Element, given: Joint) -> tuple[Pair, ...]:
    """Stiffness and time of each Maxwell branch of a joint; by default those given."""
    values = element.numbers("relaxation", 2 * MOST_BRANCHES)
    if not values:
        return given.relaxation
    if len(values) % 2 or min(values) <= 0:
        got = repr(element.node.get("relaxation"))
        raise element.error("a stiffness and a time > 0 of each branch as relaxation", got)
    return tuple(zip(values[::2], values[1::2], strict=True))


def _curves(element: Element, given: Joint | Tendon) -> tuple[Pair, Pair]:
    """The coefficients of a spring and a damper that are not linear; by default those given."""
    spring, damper = (element.pair(name, getattr(given, name)) for name in CURVES)
    if min(damper) < 0:
        raise element.error("numbers >= 0 as damping_poly", f"{damper[0]:g} {damper[1]:g}")
    return spring, damper


def _compliance(element: Element, joints: dict[str, Joint]) -> Joint:
    """A joint of an overlay: an attribute that is not given keeps the URDF's value."""
    element.allow("name", "armature", "stiffness", "damping", "rest", *SPRINGS)
    joint = moving_joint(element, joints)
    spring, damper = _curves(element, joint)
    joint = replace(
        joint,
        armature=element.non_negative("armature", joint.armature),
        stiffness=element.non_negative("stiffness", joint.stiffness),
        damping=element.non_negative("damping", joint.damping),
        rest=element.number("rest", joint.rest),
        stiffness_poly=spring,
        damping_poly=damper,
        relaxation=_branches(element, joint),
    )
    if joint.stiffness > 0 or any(joint.stiffness_poly):
        check_position(element, joint, SPRING)
    return joint


def _tendon(element: Element, links: dict[str, Link], joints: dict[str, Joint]) -> Tendon:
    element.allow("name", *TENDON, children=("joint", "site", *WRAPS))
    terms = element.unique("joint", lambda part: _term(part, joints))
    sites, wraps = _path(element, links)
    if terms and (sites or wraps):
        raise element.error("a path of <joint> or of <site> elements", "both")
    if not terms and not sites:
        raise element.error("at least one <joint> or two <site> elements", "an empty tendon")
    if len(sites) == 1:
        raise element.error("at least two <site> elements", "one")
    tendon = Tendon(
        element.text("name"),
        tuple(terms.values()),
        sites,
        element.non_negative("stiffness"),
        element.non_negative("damping"),
        None if element.node.get("rest") is None else element.number("rest"),
        element.flag("slack"),
        element.non_negative("friction"),
        None if element.node.get("driven") is None else PathEnd(element.choice("driven", ENDS)),
        wraps,
    )
    spring, damper = _curves(element, tendon)
    armature = element.non_negative("armature")
    tendon = replace(tendon, stiffness_poly=spring, damping_poly=damper, armature=armature)
    if armature > 0 and wraps:
        raise element.error("no armature of a tendon around a round body", f"{armature:g}")
    if tendon.friction > MOST_FRICTION:
        raise element.error(f"friction <= {MOST_FRICTION:g}", tendon.friction)
    if tendon.driven is not None and not tendon.rubs:
        raise element.error("friction > 0 beside driven", tendon.friction)
    if tendon.slack and tendon.stiffness == 0:
        raise element.error("stiffness > 0 of a slack tendon", tendon.stiffness)
    if tendon.slack and any((*tendon.stiffness_poly, *tendon.damping_poly)):
        raise element.error("a linear spring and damper of a slack tendon", "others")
    if tendon.stiffness > 0 or any(tendon.stiffness_poly):
        for term in tendon.terms:
            check_position(element, joints[term.joint], SPRING)
    if tendon.friction > 0:
        for term in tendon.terms:
            check_position(element, joints[term.joint], "friction of a cable")
    if tendon.sites and tendon.rest is not None and tendon.rest < 0:
        raise element.error("rest >= 0, the length of a path", tendon.rest)
    return tendon


def _term(element: Element, joints: dict[str, Joint]) -> JointTerm:
    element.allow("name", "coef")
    return JointTerm(moving_joint(element, joints).name, element.number("coef"))


def _site(element: Element, links: dict[str, Link]) -> Site:
    element.allow("link", "xyz")
    return Site(element.one_of("link", links, A_LINK), element.vector("xyz"))


def _path(element: Element, links: dict[str, Link]) -> tuple[tuple[Site, ...], tuple[Wrap, ...]]:
    """The sites of a path, and the round bodies between them."""
    sites: list[Site] = []
    wraps: list[Wrap] = []
    between = "a <site> before and behind it"
    last: Element | None = None  # the round body that has no site behind it yet
    for part in element.children():
        if part.tag == "site":
            sites.append(_site(part, links))
            last = None
        elif part.tag in WRAPS:
            wraps.append(_wrap(part, links, len(sites) - 1))
            if last is not None:
                raise part.error(between, f"<{last.tag}> before it")
            if not sites:
                raise part.error(between, "none before it")
            last = part
    if last is not None:
        raise last.error(between, "none behind it")
    return tuple(sites), tuple(wraps)


def _wrap(element: Element, links: dict[str, Link], after: int) -> Wrap:
    own = ("axis", "length") if element.tag == "cylinder" else ()
    element.allow("link", "xyz", "radius", "side", "friction", *own)
    numbers = {name: element.number(name) for name in ("radius", "length", "friction")
               if name == "radius" or element.node.get(name) is not None}  # fmt: skip
    for name in ("radius", "length"):
        if not numbers.get(name, 1.0) > 0:
            raise element.error(f"{name} > 0", numbers[name])
    if not 0 <= numbers.get("friction", 0.0) <= MOST_FRICTION:
        raise element.error(f"friction from 0 to {MOST_FRICTION:g}", numbers["friction"])
    axis = element.vector("axis") if element.tag == "cylinder" else None
    if axis is not None and not any(axis):
        raise element.error("an axis that is not zero", "0 0 0")
    side = None if element.node.get("side") is None else element.vector("side")
    link = element.one_of("link", links, A_LINK)
    return Wrap(link, element.vector("xyz"), after=after, axis=axis, side=side, **numbers)


def check_placement(block: Element, robot: Robot) -> None:
    """Refuse cables without a direction somewhere, and tasks of links that cannot move.

    Raises
    ------
    UrdfError
        It names the element.
    """
    _check_paths(block, robot)
    _check_balls(block, robot)
    carriers = moving_link_of(robot)
    for element in block.children("task"):
        frame = element.text("frame")
        if robot.moving_joints and carriers[frame] == robot.root and not robot.floating:
            raise element.error("a link that a joint moves", repr(frame))


def _check_balls(block: Element, robot: Robot) -> None:
    """Refuse a ball whose inner links carry something, or whose hinges something else reads."""
    held = {site.link for tendon in robot.tendons for site in tendon.sites}
    held |= {wrap.link for tendon in robot.tendons for wrap in tendon.wraps}
    held |= {sensor.link for sensor in robot.sensors} | {task.frame for task in robot.tasks}
    held |= {robot.task} | {link.name for link in robot.links if link.looks or link.mass}
    used = {term.joint for tendon in robot.tendons for term in tendon.terms}
    used |= {sensor.joint for sensor in robot.sensors}
    below = children(robot.joints)
    taken: set[str] = set()
    for element, ball in zip(block.children("ball"), robot.balls, strict=True):
        for link in ball.inner_links(robot.joints):
            if link in held or len(below[link]) > 1:
                raise element.error("links between its hinges that carry nothing", repr(link))
        for joint in ball.joints:
            if joint in used | taken:
                raise element.error("hinges that nothing else uses", repr(joint))
        taken |= set(ball.joints)


def _check_paths(block: Element, robot: Robot) -> None:
    """Refuse consecutive sites at one point, where the cable has no direction.

    On one link it needs none, unless it rubs there.
    """
    placed = poses(robot)
    tendons = {tendon.name: tendon for tendon in robot.tendons}
    for element in block.children("tendon"):
        tendon = tendons[element.text("name")]
        for a, b in pairwise(tendon.sites):
            ends = [placed[s.link][0] @ s.xyz + placed[s.link][1] for s in (a, b)]
            at_one = np.linalg.norm(ends[1] - ends[0]) < COINCIDENT
            if at_one and (a.link != b.link or tendon.rubs):
                where = "with friction" if a.link == b.link else "on different links"
                got = f"sites of {a.link!r} and {b.link!r} at the same point"
                raise element.error(f"consecutive sites {where} apart at q = 0", got)
        parts = (part for part in element.children() if part.tag in WRAPS)
        for part, wrap in zip(parts, tendon.wraps, strict=True):
            _check_wrap(part, wrap, tendon, placed)


def _check_wrap(
    element: Element,
    wrap: Wrap,
    tendon: Tendon,
    placed: dict[str, tuple[np.ndarray, np.ndarray]],
) -> None:
    """Refuse a site inside the body at q = 0, and a cable that could run on either side."""
    rotation, translation = placed[wrap.link]
    across = []
    for site in tendon.sites[wrap.after : wrap.after + 2]:
        point = placed[site.link][0] @ site.xyz + placed[site.link][1]
        across.append(wrap.across(rotation.T @ (point - translation)))
        distance = float(np.linalg.norm(across[-1]))
        if distance < wrap.radius * (1.0 - ON_RADIUS):
            got = f"the site of {site.link!r} at {distance:g} m"
            raise element.error(f"sites at least {wrap.radius:g} m from it at q = 0", got)
    a, b = (one / np.linalg.norm(one) for one in across)
    opposite = np.linalg.norm(np.cross(a, b)) < IN_LINE and a @ b < 0
    centre = "its centre" if wrap.axis is None else "its axis"
    if wrap.side is None:
        if opposite:
            raise element.error('side="…"', f"two sites and {centre} in one line, and no side")
        return
    side = wrap.across(wrap.side)
    beside = np.linalg.norm(np.cross(a, side)) >= IN_LINE * wrap.radius
    if opposite and not wrap.inside and not beside:
        raise element.error(f"a side beside the line of the sites through {centre}", "one on it")
