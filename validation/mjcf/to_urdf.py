"""An MJCF as an annotated URDF, as far as the format can say it, with a list of what it cannot.

All frames have the axes of the root and stand on their joints; a body with several joints becomes
a chain of massless links.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from lxml import etree

from softdyn.validation.mjcf.comparison.neutral import (
    WORLD,
    Coupling,
    Motor,
    Neutral,
    NeutralTendon,
)
from softdyn.validation.mjcf.xml_text import Names, add, text

UNLIMITED = 1e4  # m, rad: where URDF demands limits of a joint that has none
MOMENTS = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
Element = etree._Element


@dataclass(frozen=True)
class Written:
    """A URDF, and what was lost on the way."""

    text: str
    lost: tuple[str, ...]


def to_urdf(robot: Neutral, name: str) -> Written:
    """A robot in the neutral form as an annotated URDF.

    Parameters
    ----------
    robot : Neutral
        What `softdyn.validation.mjcf.comparison.comparison.neutral` reads.
    name : str
        Of the robot.

    Returns
    -------
    Written
        With a floating base the URDF is to be loaded with ``floating=True``, which no URDF can say.
    """
    lost = [f"not written: {note}" for note in robot.notes]
    root = etree.Element("robot", name=name)
    names = Names()
    free = [k for k in robot.children(WORLD) if robot.parts[k].kind == "free"]
    base = free[0] if len(free) == 1 and len(robot.children(WORLD)) == 1 else None
    links: dict[int, str] = {}
    if base is None:
        links[WORLD] = names.new("world")
        add(root, "link", name=links[WORLD])
    else:
        lost.append("that the base floats: load the file with floating=True")
    for k, part in enumerate(robot.parts):
        if part.kind == "ball" or (part.kind == "free" and k != base):
            lost.append(f"{part.kind} joint {part.name!r}: welded")
    for k, part in enumerate(robot.parts):
        links[k] = names.new(part.link or f"{part.name}_link")
        _link(root, links[k], robot, k)
        if k != base:
            _joint(root, robot, k, links, lost)
    for label, frame in robot.frames.items():
        if frame.part in links:
            child = names.new(label)
            add(root, "link", name=child)
            joint = add(root, "joint", name=f"{child}_weld", type="fixed")
            origin = frame.pose.translation - _origin(robot, frame.part)
            add(joint, "origin", xyz=origin, rpy=_angles(frame.pose.rotation))
            add(joint, "parent", link=links[frame.part])
            add(joint, "child", link=child)
    _block(root, robot, links, lost)
    if float(np.linalg.norm(robot.gravity - [0, 0, -9.81])) > 1e-9:
        lost.append(f"gravity {robot.gravity}: a URDF has 0 0 -9.81")
    return Written(text(root, f"{name}, written by softdyn from {robot.path.name}"), tuple(lost))


def _origin(robot: Neutral, k: int) -> np.ndarray:
    """Where the frame of a part's link stands: on its joint."""
    return np.zeros(3) if k == WORLD else robot.parts[k].point


def _link(root: Element, name: str, robot: Neutral, k: int) -> None:
    link = add(root, "link", name=name)
    body = robot.parts[k].inertia
    if body.mass or body.tensor.any():
        inertial = add(link, "inertial")
        add(inertial, "origin", xyz=body.com - _origin(robot, k) if body.mass else np.zeros(3))
        add(inertial, "mass", value=body.mass)
        moments = {key: body.tensor[place] for key, place in MOMENTS.items()}
        add(inertial, "inertia", **moments)


def _joint(
    root: Element, robot: Neutral, k: int, links: dict[int, str], lost: list[str]
) -> None:  # fmt: skip
    part = robot.parts[k]
    welded = part.kind in ("ball", "free")
    limited = math.isfinite(part.lower) or math.isfinite(part.upper)
    kind = "prismatic" if part.kind == "slide" else "revolute"
    led = any(part.name in (c.joint, c.leader) for c in robot.couplings)
    if part.kind == "hinge" and not limited and not part.stiffness and not led:
        kind = "continuous"
    joint = add(root, "joint", name=part.name, type="fixed" if welded else kind)
    add(joint, "origin", xyz=part.point - _origin(robot, part.parent))
    add(joint, "parent", link=links[part.parent])
    add(joint, "child", link=links[k])
    if welded:
        return
    add(joint, "axis", xyz=part.axis)
    effort = part.effort if math.isfinite(part.effort) else 0.0
    lower, upper = (
        value if math.isfinite(value) else math.copysign(UNLIMITED, value)
        for value in (part.lower, part.upper)
    )
    if kind == "continuous":
        add(joint, "limit", effort=effort, velocity=0)
    else:
        add(joint, "limit", lower=lower, upper=upper, effort=effort, velocity=0)
        if not limited and part.name not in {tie.joint for tie in robot.couplings}:
            lost.append(f"joint {part.name!r} has no limits: written as ±{UNLIMITED:g}")
    if part.damping or part.friction:
        add(joint, "dynamics", damping=part.damping, friction=part.friction)
    for tie in robot.couplings:
        if tie.joint == part.name:
            _mimic(joint, tie, robot, lost)
    if part.stiffness:
        gazebo = add(root, "gazebo", reference=part.name)
        add(gazebo, "springStiffness").text = repr(part.stiffness)
        add(gazebo, "springReference").text = repr(part.rest)


def _mimic(joint: Element, tie: Coupling, robot: Neutral, lost: list[str]) -> None:
    if any(other.joint == tie.leader for other in robot.couplings):
        lost.append(f"that {tie.joint!r} follows {tie.leader!r}, which follows another joint")
        return
    add(joint, "mimic", joint=tie.leader, multiplier=tie.multiplier, offset=tie.offset)


def _block(root: Element, robot: Neutral, links: dict[int, str], lost: list[str]) -> None:
    """Armature, tendons and actuators."""
    block = etree.Element("softdyn", version="1")
    for part in robot.parts:
        if part.armature and part.kind in ("hinge", "slide"):
            add(block, "joint", name=part.name, armature=part.armature)
    written = [cable.name for cable in robot.cables if _cable(block, robot, cable, links, lost)]
    pulled = Names(*written)
    for motor in robot.motors:
        _motor(block, robot, motor, written, pulled, lost)
    if len(block):
        # tendons stand before the actuators that pull them
        for actuator in block.findall("actuator"):
            block.append(actuator)
        root.append(block)


def _cable(
    block: Element, robot: Neutral, cable: NeutralTendon, links: dict[int, str], lost: list[str]
) -> bool:
    """Write a tendon, if the format has a word for it."""
    if any(point.around for point in cable.path):
        lost.append(f"tendon {cable.name!r}: pulleys, or shapes that it wraps")
        return False
    slack = cable.rest[0] != cable.rest[1]
    if slack and cable.stiffness:
        lost.append(f"tendon {cable.name!r}: that its spring is slack between two lengths")
    elastic = bool(cable.stiffness)
    node = add(block, "tendon", name=cable.name, stiffness=cable.stiffness or None,
               damping=cable.damping or None, rest=cable.rest[1] if elastic else None)  # fmt: skip
    for joint, coefficient in cable.terms.items():
        add(node, "joint", name=joint, coef=coefficient)
    for point in cable.path:
        add(node, "site", link=links[point.part], xyz=point.xyz - _origin(robot, point.part))
    return True


def _motor(
    block: Element, robot: Neutral, motor: Motor, written: list[str], names: Names, lost: list[str]
) -> None:
    """Write an actuator; one on a joint pulls a tendon that is the joint's coordinate."""
    kind, _, target = motor.target.partition(":")
    scalar = {part.name for part in robot.parts if part.kind in ("hinge", "slide")}
    if motor.law or not (
        target in written if kind == "tendon" else kind == "joint" and target in scalar
    ):
        lost.append(
            f"actuator {motor.name!r} on {motor.target}" + f" ({motor.law})" * bool(motor.law)
        )
        return
    if not (math.isfinite(motor.lower) and math.isfinite(motor.upper)):
        lost.append(f"actuator {motor.name!r}: an input without bounds")
        return
    if kind == "joint":
        tendon = names.new(f"{target}_drive")
        add(add(block, "tendon", name=tendon), "joint", name=target, coef=1)
        target = tendon
    add(block, "actuator", name=motor.name, tendon=target, gear=motor.gear, lower=motor.lower,
        upper=motor.upper)  # fmt: skip


def _angles(rotation: np.ndarray) -> tuple[float, float, float]:
    """Roll, pitch, yaw (rad) of a rotation matrix."""
    pitch = math.atan2(-rotation[2, 0], math.hypot(rotation[0, 0], rotation[1, 0]))
    if math.hypot(rotation[0, 0], rotation[1, 0]) < 1e-9:  # gimbal lock: the yaw is free
        sign = math.copysign(1.0, pitch)
        return math.atan2(sign * rotation[0, 1], rotation[1, 1]), pitch, 0.0
    return (
        math.atan2(rotation[2, 1], rotation[2, 2]),
        pitch,
        math.atan2(rotation[1, 0], rotation[0, 0]),
    )
