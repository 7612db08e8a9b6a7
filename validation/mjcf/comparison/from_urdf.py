"""The neutral form of a URDF, from the strict parse."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields
from itertools import pairwise
from typing import Any

import numpy as np

from softdyn.description.inertia import Inertia
from softdyn.description.rig import Actuator
from softdyn.description.robot import (
    Ball,
    Fluid,
    Joint,
    Robot,
    Site,
    Tendon,
    Wrap,
    children,
    moving_link_of,
    poses,
)
from softdyn.dynamics.wraps import RoundBodies, body_of, courses
from softdyn.validation.mjcf.comparison.neutral import (
    RELAXATION,
    WORLD,
    Coupling,
    Frame,
    Motor,
    Neutral,
    NeutralTendon,
    Numbers,
    Part,
    Point,
    shape_points,
)
from softdyn.validation.mjcf.compiled_rig import NeutralSensor
from softdyn.validation.mjcf.transform import Transform
from softdyn.validation.twin.drives import sensor_frames

FREE = "floating base"
SENSED = ("rate", "latency", "noise", "bias", "resolution")


def from_urdf(robot: Robot) -> Neutral:
    """The neutral form of a parsed URDF."""
    placed = {name: Transform(*pose) for name, pose in poses(robot).items()}
    carrier, below = moving_link_of(robot), children(robot.joints)
    pieces: dict[str, tuple[tuple[str, Inertia], ...]] = {}
    for link in robot.links:
        if link.inertia.mass or link.inertia.tensor.any():
            pose = placed[link.name]
            piece = link.inertia.moved(pose.rotation, pose.translation)
            mates = pieces.get(carrier[link.name], ())
            pieces[carrier[link.name]] = (*mates, (link.name, piece))
    shares: dict[str, dict[str, float]] = {}
    for link in robot.buoyant:
        shares.setdefault(carrier[link.name], {})[link.name] = link.gravcomp
    efforts = _efforts(robot)
    balls = {ball.joints[2]: ball for ball in robot.balls}
    before = {joint for ball in robot.balls for joint in ball.joints[:2]}
    parts: list[Part] = []
    index = {robot.root: WORLD}
    if robot.floating:
        index[robot.root] = 0
        zero = np.zeros(3)
        own = pieces.get(robot.root, ())
        lifted = shares.get(robot.root, {})
        parts.append(Part(FREE, robot.root, "free", WORLD, zero, zero, own, Transform(),
            gravcomp=lifted))  # fmt: skip
    walked: list[str] = []
    lumped: dict[str, list[str]] = {}  # carrier → links that its joints move
    front = [robot.root]
    above = {joint.child: joint for joint in robot.joints}
    while front:
        name = front.pop()
        front += [joint.child for joint in reversed(below.get(name, ()))]
        lumped.setdefault(carrier[name], [])
        lumped[carrier[name]] += [joint.child for joint in below.get(name, ()) if joint.moves]
        if name not in above or not above[name].moves:
            continue
        joint, pose = above[name], placed[name]
        index[name] = len(parts)  # a link inside a ball gets the number of its body
        if joint.name in before:
            continue
        if joint.name in balls:
            parts.append(_ball(balls[joint.name], above, name, index, carrier, pieces, pose))
            walked.append(joint.name)
            continue
        kind = "slide" if joint.kind == "prismatic" else "hinge"
        parts.append(
            Part(
                joint.name, name, kind, index[carrier[joint.parent]],
                pose.rotation @ joint.axis, pose.translation, pieces.get(name, ()), pose,
                joint.lower, joint.upper, efforts.get(joint.name, math.inf),
                joint.armature, joint.damping, joint.friction, joint.stiffness, joint.rest,
                joint.stiffness_poly, joint.damping_poly,
                shares.get(name, {}), more=_branches(joint),
            )
        )  # fmt: skip
        walked.append(joint.name)

    def on(link: str) -> int:
        return index[carrier[link]]

    frames = {
        link.name: Frame(on(link.name), placed[link.name])
        for link in robot.links
        if carrier[link.name] != link.name or index[link.name] == WORLD
    }
    cables = []
    for tendon in robot.tendons:
        path: list[Point] = []
        for part in tendon.path:
            if isinstance(part, Site):
                path.append(Point(on(part.link), placed[part.link].at(np.array(part.xyz))))
            elif isinstance(part, Wrap):
                path += _around(part, on(part.link), placed[part.link])
        rest = _length(tendon, placed) if tendon.rest is None else tendon.rest
        terms = {term.joint: term.coef for term in tendon.terms}
        cables.append(
            NeutralTendon(
                tendon.name, terms, tuple(path), tendon.stiffness, tendon.damping, (rest, rest),
                tendon.armature,
                slack=tendon.slack and (tendon.stiffness or tendon.damping) > 0,
                friction=(tendon.friction, tendon.driven),
                stiffness_curve=tendon.stiffness_poly, damping_curve=tendon.damping_poly,
            )
        )  # fmt: skip
    motors = tuple(
        Motor(a.name, f"tendon:{a.tendon}", a.gear, a.lower, a.upper, rig=_rig(a))
        for a in robot.actuators
    )
    couplings = tuple(
        Coupling(j.name, j.mimic.leader, j.mimic.multiplier, j.mimic.offset)
        for j in robot.joints
        if j.moves and j.mimic is not None
    )
    document = tuple(joint.name for joint in robot.moving_joints)
    by_bodies = tuple(above[link].name for link in _depth_first(robot.root, lumped))
    orders = tuple(
        tuple(balls[name].name if name in balls else name for name in order if name not in before)
        for order in (document, tuple(walked), by_bodies, _by_name(robot))
    )
    sensors = {}
    for sensor in robot.sensors:
        more = {name: np.atleast_1d(getattr(sensor, name)) for name in SENSED}
        errors = {name: tuple(map(float, row)) for name, row in more.items() if row.any()}
        target = f"tendon:{sensor.tendon}" if sensor.tendon else f"joint:{sensor.joint}"
        sensors[sensor.name] = NeutralSensor(
            sensor.kind.value, "" if sensor.link else target, errors
        )
        for name, (body, origin) in sensor_frames(sensor).items():
            place = Transform(origin.rotation, origin.translation)
            frames[name] = Frame(on(body), placed[body] @ place)
    return Neutral(
        robot.path, "urdf", tuple(parts), frames, tuple(cables), motors, couplings, orders=orders,
        sensors=sensors, gravity=np.array(robot.gravity), features=_fluid(robot.fluid),
    )  # fmt: skip


def _ball(
    ball: Ball,
    above: dict[str, Joint],
    link: str,
    index: dict[str, int],
    carrier: dict[str, str],
    pieces: dict[str, tuple[tuple[str, Inertia], ...]],
    pose: Transform,
) -> Part:
    """The three hinges of a ball as one part."""
    second = above[above[link].parent]
    parent = above[second.parent].parent
    return Part(
        ball.name, link, "ball", index[carrier[parent]], np.zeros(3), pose.translation,
        pieces.get(link, ()), pose, damping=ball.damping, stiffness=ball.stiffness,
        stiffness_curve=ball.stiffness_poly,
    )  # fmt: skip


def _rig(actuator: Actuator) -> dict[str, Any]:
    """The fields that are not those of an ideal actuator."""
    values = ((f.name, getattr(actuator, f.name), f.default) for f in fields(actuator))
    found = {name: value for name, value, ideal in values if ideal not in (MISSING, value)}
    if "unit" in found:  # of the input; the name means a winch's command in MJCF
        found["input_unit"] = found.pop("unit")
    return found | ({"command": actuator.command.value} if actuator.is_winch else {})


def _depth_first(root: str, below: dict[str, list[str]]) -> list[str]:
    """The links of the tree `below`, parents first."""
    found: list[str] = []
    stack = list(reversed(below.get(root, ())))
    while stack:
        found.append(stack.pop())
        stack += reversed(below.get(found[-1], ()))
    return found


def _by_name(robot: Robot) -> tuple[str, ...]:
    """Joints depth first, siblings by name: Pinocchio's order."""
    above = {joint.child: joint for joint in robot.joints}
    below = {
        link: [joint.child for joint in sorted(joints, key=lambda joint: joint.name)]
        for link, joints in children(robot.joints).items()
    }
    walked = [above[link] for link in _depth_first(robot.root, below)]
    return tuple(joint.name for joint in walked if joint.moves)


def _around(wrap: Wrap, part: int, pose: Transform) -> Iterator[Point]:
    """The points that stand for a round body."""
    side = None if wrap.side is None else Point(part, pose.at(np.array(wrap.side)))
    axis = None if wrap.axis is None else pose.rotation @ wrap.direction
    return shape_points(part, pose.at(np.array(wrap.xyz)), wrap.radius, axis, side)


def _length(tendon: Tendon, placed: Mapping[str, Transform]) -> float:
    """Length of a path at q = 0."""
    between, total = {wrap.after: wrap for wrap in tendon.wraps}, 0.0
    for k, (a, b) in enumerate(pairwise(tendon.sites)):
        ends = [placed[site.link].at(np.array(site.xyz)) for site in (a, b)]
        wrap = between.get(k)
        if wrap is None:
            total += float(np.linalg.norm(ends[1] - ends[0]))
            continue
        (body, axes), pose = body_of(wrap), placed[wrap.link]
        here = [axes.T @ (pose.rotation.T @ (x - pose.translation) - wrap.xyz) for x in ends]
        total += float(courses(RoundBodies.of([body]), np.array([here])).length[0])
    return total


def _efforts(robot: Robot) -> dict[str, float]:
    """The smaller one of ``<limit effort>`` and the force of a motor at the joint, as in an MJCF.

    Zero means no limit, because generators write it so.
    """
    found = {joint.name: joint.effort for joint in robot.joints if 0 < joint.effort < math.inf}
    terms = {tendon.name: tendon.terms for tendon in robot.tendons}
    for motor in robot.actuators:
        if len(terms[motor.tendon]) != 1:
            continue
        (term,) = terms[motor.tendon]
        force = abs(motor.gear * term.coef) * max(abs(motor.lower), abs(motor.upper))
        if force > 0:
            found[term.joint] = min(found.get(term.joint, math.inf), force)
    return found


def _branches(joint: Joint) -> dict[str, Numbers]:
    """The Maxwell branches of a joint, a stiffness and a time each."""
    numbers = tuple(number for branch in joint.relaxation for number in branch)
    return {RELAXATION: numbers} if numbers else {}


def _fluid(fluid: Fluid) -> dict[str, Numbers]:
    """A fluid by MuJoCo's names of its numbers."""
    found = {"opt.density": (fluid.density,), "opt.viscosity": (fluid.viscosity,)}
    return {name: values for name, values in found.items() if values[0]}
