"""An MJCF written as an annotated URDF, with a list of the properties that a URDF cannot state.

All links that move have the axes of the root and lie on their joints. A body with several joints
becomes a chain of massless links, and so does one with a ball joint: it has three hinges, whose
spring and damper are a ``<ball>``. A body whose frame does not lie on its joint, and each named
site, becomes a link that is fixed there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from softdyn.description.annotations import ON_RADIUS
from softdyn.description.rig import CommandKind
from softdyn.description.robot import (
    ZERO,
    Actuator,
    Ball,
    Fluid,
    Joint,
    JointTerm,
    Link,
    Mimic,
    Origin,
    Pair,
    Robot,
    Site,
    Tendon,
    Vector,
    Wrap,
    deepest_leaf,
)
from softdyn.exceptions import UrdfError
from softdyn.validation.mjcf.comparison.neutral import (
    FLUID,
    RELAXATION,
    WORLD,
    Frame,
    Neutral,
    NeutralTendon,
    Part,
    Point,
)
from softdyn.validation.mjcf.transform import angles
from softdyn.validation.mjcf.xml_text import Names

SAME_PLACE = 1e-9  # m between two frames that count as one
UNLIMITED = 1e4  # m, rad: limits for a joint without any, because URDF requires them


class Converted(NamedTuple):
    """A robot, and the properties that were lost."""

    robot: Robot
    lost: tuple[str, ...]


def to_urdf(
    source: Neutral, name: str, looks: Mapping[int, Sequence[str]] = MappingProxyType({})
) -> Converted:
    """Convert a robot in the neutral form to one that an annotated URDF can state.

    Parameters
    ----------
    source : Neutral
        As `softdyn.validation.mjcf.comparison.side.neutral` reads it.
    name : str
        The robot's name.
    looks : mapping of int to sequence of str
        Shapes of the parts, and of the root, as `softdyn.validation.mjcf.urdf_shapes` makes them.

    Returns
    -------
    Converted
        The robot and the losses. A URDF cannot state a floating base: load such a robot with
        ``floating=True``.
    """
    lost = [f"not written: {note}" for note in source.notes]
    source, looks = _without_objects(source, looks, lost)
    names = Names()
    links: list[Link] = []
    joints: list[Joint] = []
    link_of: dict[int, str] = {}
    roots = source.children(WORLD)
    floating = len(roots) == 1 and source.parts[roots[0]].kind == "free"
    if floating:
        lost.append("that the base floats: load the file with floating=True")
        if looks.get(WORLD):
            lost.append("the shapes around the robot")
    else:
        link_of[WORLD] = names.new("world")
        links.append(Link(link_of[WORLD], looks=tuple(looks.get(WORLD, ()))))
    welded = () if floating else ("free",)
    balls: list[Ball] = []
    joint_names = Names(*(part.name for part in source.parts))
    for part in source.parts:
        if part.kind in welded:
            lost.append(f"{part.kind} joint {part.name!r}: welded")
    apart: dict[str, Frame] = {}  # bodies whose frame does not lie on their joint
    for k, part in enumerate(source.parts):
        off = float(np.linalg.norm(part.pose.translation - part.point)) > SAME_PLACE
        if part.link and off and part.kind != "free":
            apart[part.link] = Frame(k, part.pose)
        on_joint = not part.link or part.link in apart
        link_of[k] = names.new(f"{part.name}_link" if on_joint else part.link)
        com = Origin(_place(source, k, part.inertia.com) if part.inertia.mass else ZERO)
        shown = tuple(looks.get(k, ()))
        links.append(Link(link_of[k], part.inertia.mass, part.inertia.moments, com, shown,
                          part.buoyancy or 0.0))  # fmt: skip
        if floating and part.kind == "free":
            continue
        place = Origin(_place(source, part.parent, part.point))
        joint = Joint(part.name, "fixed", link_of[part.parent], link_of[k], place)
        if part.kind == "ball":
            own, between = _hinges(joint, part, (names, joint_names))
            joints += own
            links[-1:-1] = [Link(name) for name in between]
            balls.append(_ball(source, part, own, lost))
            continue
        joints.append(joint if part.kind in welded else _moving(joint, source, part, lost))
    # a site may have the name of a body
    frames = (*apart.items(), *source.cable_sites.items(), *source.frames.items())
    for label, frame in frames:
        if frame.part in link_of:
            child = names.new(label)
            links.append(Link(child))
            xyz = _place(source, frame.part, frame.pose.translation)
            place = Origin(xyz, angles(frame.pose.rotation))
            joints.append(Joint(f"{child}_weld", "fixed", link_of[frame.part], child, place))
    tendons = list(_tendons(source, link_of, lost))
    actuators = tuple(_actuators(source, tendons, lost))
    x, y, z = source.gravity.tolist()
    fluid = Fluid(*(source.features.get(name, (0.0,))[0] for name in FLUID))
    robot = Robot(
        name, tuple(links), tuple(joints), tuple(tendons), actuators, floating=floating,
        gravity=(x, y, z), fluid=fluid, balls=tuple(balls),
        comment=f" {name}, written by softdyn from {source.path.name} ",
    )  # fmt: skip
    return Converted(replace(robot, task=deepest_leaf(robot)), tuple(lost))


def _without_objects(
    source: Neutral, looks: Mapping[int, Sequence[str]], lost: list[str]
) -> tuple[Neutral, Mapping[int, Sequence[str]]]:
    """A floating robot and its shapes without the free bodies beside it: a URDF has one root."""
    roots = source.children(WORLD)
    free = [k for k in roots if source.parts[k].kind == "free"]
    objects = [k for k in free if len(source.subtree(k)) == 1]
    if not objects or len(roots) - len(objects) != 1 or len(free) != len(roots):
        return source, looks
    lost += [f"free body {source.parts[k].name!r} beside the robot: left out" for k in objects]
    kept = [k for k in range(len(source.parts)) if k not in objects]
    numbers = {k: number for number, k in enumerate(kept)} | {WORLD: WORLD}
    shown = {numbers[k]: shapes for k, shapes in looks.items() if k in numbers}
    return source.arranged(kept, set()), shown


def _place(source: Neutral, k: int, point: np.ndarray) -> Vector:
    """A point in the frame of a part's link; the frame's origin is the part's joint."""
    return tuple((point if k == WORLD else point - source.parts[k].point).tolist())


def _hinges(joint: Joint, part: Part, names: tuple[Names, Names]) -> tuple[list[Joint], list[str]]:
    """Three hinges in the place of a ball, and the names of the links between them.

    The hinges are singular where the middle one is at ±90°. Its axis is that of the root's nearest
    to the way from the joint to the body's centre of mass: a long body rarely twists so far.
    """
    along = part.inertia.com - part.point if part.inertia.mass else np.array([0.0, 1.0, 0.0])
    middle = int(np.argmax(np.abs(along)))
    axes = [(middle + k) % 3 for k in (-1, 0, 1)]
    links, joints = names
    between = [links.new(f"{part.name}_{'xyz'[axis]}_link") for axis in axes[:2]]
    found = []
    chain = [joint.parent, *between, joint.child]
    sprung = bool(part.stiffness) or any(part.stiffness_curve)
    for k, axis in enumerate(axes):
        most = math.pi / 2 if axis == middle else math.pi if sprung else math.inf
        found.append(
            Joint(
                joints.new(f"{part.name}_{'xyz'[axis]}"),
                "revolute" if math.isfinite(most) else "continuous", chain[k], chain[k + 1],
                joint.origin if k == 0 else Origin(), tuple(np.eye(3)[axis].tolist()), -most, most,
            )
        )  # fmt: skip
    return found, between


def _ball(source: Neutral, part: Part, hinges: Sequence[Joint], lost: list[str]) -> Ball:
    """The spring and the damper of a ball.

    Raises
    ------
    UrdfError
        For a ball with an armature, which would be another mass matrix.
    """
    where = f"ball joint {part.name!r}"
    if part.armature:
        raise UrdfError(
            source.path, f"<joint name={part.name!r}>", "a ball joint without armature",
            f"{part.armature:g}",
        )  # fmt: skip
    others = ", the others to ±180°" if math.isfinite(hinges[0].upper) else ""
    lost.append(f"{where}: three hinges, of which {hinges[1].name!r} is limited to ±90°{others}")
    if any(part.damping_curve):
        lost.append(f"{where}: its damper of higher powers")
    if part.friction:
        lost.append(f"{where}: its friction")
    if math.isfinite(part.upper):
        lost.append(f"{where}: its largest angle, {part.upper:g} rad")
    first, second, third = (hinge.name for hinge in hinges)
    x, y = part.stiffness_curve
    return Ball(part.name, (first, second, third), part.stiffness, part.damping, (x, y))


def _moving(joint: Joint, source: Neutral, part: Part, lost: list[str]) -> Joint:
    """The moving joint of a hinge or a slide, from a fixed one."""
    limited = math.isfinite(part.lower) or math.isfinite(part.upper)
    kind = "prismatic" if part.kind == "slide" else "revolute"
    led = any(part.name in (c.joint, c.leader) for c in source.couplings)
    led |= part.name in _sprung(source)
    spring, damper = _curves(part, f"joint {part.name!r}", lost)
    sprung = bool(part.stiffness) or any(spring)
    if part.kind == "hinge" and not limited and not sprung and not led:
        kind = "continuous"
    elif not limited and part.name not in {tie.joint for tie in source.couplings}:
        lost.append(f"joint {part.name!r} has no limits: written as ±{UNLIMITED:g}")
    lower, upper = (
        value if math.isfinite(value) or kind == "continuous" else math.copysign(UNLIMITED, value)
        for value in (part.lower, part.upper)
    )
    branches = part.more.get(RELAXATION, ())
    mimic = None
    for tie in source.couplings:
        if tie.joint == part.name:
            if any(other.joint == tie.leader for other in source.couplings):
                lost.append(
                    f"that {tie.joint!r} follows {tie.leader!r}, which follows another joint"
                )
            else:
                mimic = Mimic(tie.leader, tie.multiplier, tie.offset)
    return replace(
        joint, kind=kind, direction=tuple(part.axis.tolist()), lower=lower, upper=upper,
        effort=part.effort if math.isfinite(part.effort) else 0.0, stiffness=part.stiffness,
        rest=part.rest if sprung else 0.0, damping=part.damping, armature=part.armature,
        friction=part.friction, mimic=mimic, stiffness_poly=spring, damping_poly=damper,
        relaxation=tuple(zip(branches[::2], branches[1::2], strict=True)),
    )  # fmt: skip


def _sprung(source: Neutral) -> set[str]:
    """Joints of a tendon's spring or of a winch, which cannot be continuous."""
    winds = {motor.target for motor in source.motors if "command" in motor.rig}
    cables = (
        c
        for c in source.cables
        if c.stiffness or any(c.stiffness_curve) or f"tendon:{c.name}" in winds
    )
    found = {joint for cable in cables for joint in cable.terms}
    return found | {target.removeprefix("joint:") for target in winds}


def _tendons(source: Neutral, link_of: dict[int, str], lost: list[str]) -> Iterator[Tendon]:
    """The tendons that the format can state."""
    for cable in source.cables:
        if any(point.around.startswith("pulley") for point in cable.path):
            lost.append(f"tendon {cable.name!r}: pulleys that divide its length")
            continue
        if inside := _sites_inside(cable.path):
            lost.append(f"tendon {cable.name!r}: {inside}")
            continue
        slack, taut = cable.rest
        slackens = cable.slack and not _pushed(source, cable.name)
        if cable.slack and not slackens:
            lost.append(f"tendon {cable.name!r}: that it can be slack, as an actuator pushes on it")
        spring, damper = _curves(cable, f"tendon {cable.name!r}", lost)
        sprung = bool(cable.stiffness) or any(spring)
        if slack != taut and sprung:
            lost.append(f"tendon {cable.name!r}: that its spring is slack between two lengths")
        terms = [JointTerm(joint, coefficient) for joint, coefficient in cable.terms.items()]
        sites = [
            Site(link_of[p.part], _place(source, p.part, p.xyz)) for p in cable.path if not p.around
        ]
        wraps = tuple(_wraps(source, cable, link_of, lost))
        rest = taut if sprung else None
        armature = cable.armature
        wound = any("command" in m.rig for m in source.motors if m.target == f"tendon:{cable.name}")
        if armature and (wound or wraps):
            lost.append(f"tendon {cable.name!r}: its armature {armature:g}")
            armature = 0.0
        yield Tendon(
            cable.name, tuple(terms), tuple(sites), cable.stiffness, cable.damping, rest, slackens,
            *cable.friction, wraps, spring, damper, armature,
        )  # fmt: skip


def _curves(item: Part | NeutralTendon, name: str, lost: list[str]) -> tuple[Pair, Pair]:
    """The coefficients of higher powers of a spring and a damper."""
    (k1, k2), (b1, b2) = item.stiffness_curve, item.damping_curve
    if min(b1, b2) < 0:
        lost.append(f"{name}: a damper with a coefficient below zero of a higher power")
        b1 = b2 = 0.0
    return (k1, k2), (b1, b2)


def _shapes(path: Sequence[Point]) -> Iterator[tuple[Point, Point | None, Point | None, int]]:
    """The wrapped shapes of a path: centre, second point of the axis, side, site before it."""
    for k, centre in enumerate(path):
        if centre.radius:
            more = {p.around: p for p in path[k + 1 : k + 3] if p.around.startswith("its")}
            after = sum(not p.around for p in path[:k]) - 1
            yield centre, more.get("its axis"), more.get("its side"), after


def _across(centre: Point, axis: Point | None, point: np.ndarray) -> np.ndarray:
    """The vector (3,) from a shape's centre to a point, normal to a cylinder's axis."""
    offset = point - centre.xyz
    if axis is None:
        return offset
    along = (axis.xyz - centre.xyz) / np.linalg.norm(axis.xyz - centre.xyz)
    return offset - (offset @ along) * along


def _sites_inside(path: Sequence[Point]) -> str:
    """The reason why a path cannot be stated; empty if it can."""
    sites = [point for point in path if not point.around]
    for centre, axis, _, after in _shapes(path):
        for site in sites[after : after + 2]:
            if np.linalg.norm(_across(centre, axis, site.xyz)) < centre.radius * (1.0 - ON_RADIUS):
                return "a site inside the shape that it wraps"
    return ""


def _wraps(
    source: Neutral, cable: NeutralTendon, link_of: dict[int, str], lost: list[str]
) -> Iterator[Wrap]:
    """The shapes that a cable wraps."""
    for centre, axis, side, after in _shapes(cable.path):
        place = side
        if side is not None and side.part != centre.part:
            lost.append(f"tendon {cable.name!r}: a side site on another link")
            place = None
        if place is not None and axis is not None:
            across, offset = _across(centre, axis, place.xyz), place.xyz - centre.xyz
            outside = np.linalg.norm(offset) >= centre.radius
            if outside and 0 < (distance := float(np.linalg.norm(across))) < centre.radius:
                # MuJoCo counts the distance along the axis too, softdyn does not
                place = Point(place.part, centre.xyz + across * (2 * centre.radius / distance))
        yield Wrap(
            link_of[centre.part], _place(source, centre.part, centre.xyz), centre.radius, after,
            None if axis is None else tuple((axis.xyz - centre.xyz).tolist()),
            None if place is None else _place(source, place.part, place.xyz),
        )  # fmt: skip


def _pushed(source: Neutral, cable: str) -> bool:
    """Whether an actuator lengthens a tendon."""
    pulls = (m for m in source.motors if m.target == f"tendon:{cable}" and not m.law)
    return any(max(m.gear * m.lower, m.gear * m.upper) > 0 for m in pulls)


def _actuators(source: Neutral, tendons: list[Tendon], lost: list[str]) -> Iterator[Actuator]:
    """The actuators. One on a joint gets a new fixed tendon with the joint's coordinate."""
    names = Names(*(tendon.name for tendon in tendons))
    targets = {f"tendon:{tendon.name}" for tendon in tendons}
    targets |= {f"joint:{part.name}" for part in source.parts if part.kind in ("hinge", "slide")}
    for motor in source.motors:
        if motor.law or motor.target not in targets:
            law = f" ({motor.law})" * bool(motor.law)
            lost.append(f"actuator {motor.name!r} on {motor.target}{law}")
            continue
        if not (math.isfinite(motor.lower) and math.isfinite(motor.upper)):
            unbounded = "a servo" if "command" in motor.rig else "an input"
            lost.append(f"actuator {motor.name!r}: {unbounded} without bounds")
            continue
        kind, _, target = motor.target.partition(":")
        rig = dict(motor.rig)
        if (unit := rig.pop("unit", 1.0)) != 1.0:
            lost.append(f"actuator {motor.name!r}: that {unit:g} in its command is 1 m")
        rig["unit"] = rig.pop("input_unit", "")
        if "command" in rig:
            rig["command"] = CommandKind(rig["command"])
            if max(motor.gear * motor.lower, motor.gear * motor.upper) > 0:
                lost.append(f"actuator {motor.name!r}: a servo that pushes")
                continue
        if kind == "joint":
            tendons.append(Tendon(names.new(f"{target}_drive"), (JointTerm(target, 1.0),)))
            target = tendons[-1].name
        yield Actuator(motor.name, target, motor.gear, motor.lower, motor.upper, **rig)
