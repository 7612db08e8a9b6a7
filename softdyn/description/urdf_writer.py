"""Annotated URDF from a robot: the inverse of `softdyn.description.urdf`."""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import fields
from enum import Enum
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from softdyn.description.annotations import BLOCK, VERSION
from softdyn.description.inertia import MOMENTS
from softdyn.description.origins import VERSIONS
from softdyn.description.rig import Actuator, Sensor
from softdyn.description.robot import (
    EARTH,
    Joint,
    JointTerm,
    Link,
    Origin,
    Robot,
    Site,
    Tendon,
    Wrap,
)
from softdyn.description.stated_task import StatedTask


def write(robot: Robot) -> str:
    """Return URDF text that `softdyn.parse` reads back as an equal robot.

    Every number is written with all its digits. Springs and tendons are written into the same file,
    also if they came from another one. Looks and other tools' elements are copied as they were
    spelled, so paths of meshes stay relative to the file. Comments inside the robot are lost, and
    so are other tools' elements inside links and joints. A URDF cannot say that its base floats:
    parse such a robot with ``floating=True``.

    Parameters
    ----------
    robot : Robot
        A robot read from a file, changed by `dataclasses.replace`, or made from its parts.
    """
    head = ['<?xml version="1.0" encoding="utf-8"?>']
    if robot.comment:
        legal = re.sub(r"-(?=-|\Z)", "- ", robot.comment)  # XML forbids "--" in a comment
        head.append(f"<!--{legal}-->")
    content = [*robot.others, *_tree(robot), *_block(robot)]
    # before URDF 1.2 a limit must state effort and velocity
    newest = any(
        math.isinf(j.effort + j.velocity) and math.isfinite(min(j.upper, j.effort, j.velocity))
        for j in robot.joints
    )
    version = VERSIONS[-1] if newest else None
    return "\n".join([*head, *_nested("robot", content, name=robot.name, version=version), ""])


def tag(element: str, /, *inside: str, **attributes: object) -> str:
    """Return an element; numbers have all their digits, attributes that are None are left out."""
    words = (
        f" {key}={quoteattr(value if isinstance(value, str) else _words(value))}"
        for key, value in attributes.items()
        if value is not None
    )
    opening = f"<{element}{''.join(words)}"
    return f"{opening}>{''.join(inside)}</{element}>" if inside else f"{opening}/>"


def origin(pose: Origin) -> str:
    """Return an ``<origin>``; nothing for the identity."""
    if pose == Origin():
        return ""
    return tag("origin", xyz=pose.xyz, rpy=pose.rpy if any(pose.rpy) else None)


def _words(value: object) -> str:
    """A number or several, with the fewest digits that read back as the same floats."""
    numbers = np.atleast_1d(np.asarray(value, float)).tolist()
    return " ".join(repr(number).removesuffix(".0") for number in numbers)


def _nested(element: str, lines: Iterable[str], /, **attributes: object) -> list[str]:
    """An element with a line for each part of its content; one line if there is none."""
    content = [f"  {line}" for line in lines]
    empty = tag(element, **attributes)
    return [f"{empty[:-2]}>", *content, f"</{element}>"] if content else [empty]


def _tree(robot: Robot) -> Iterator[str]:
    """Links and joints in their own orders; a joint follows as soon as both links are written."""
    joints, known = deque(robot.joints), set()
    for link in robot.links:
        yield from _link(link)
        known.add(link.name)
        while joints and {joints[0].parent, joints[0].child} <= known:
            yield from _joint(joints.popleft())


def _link(link: Link) -> list[str]:
    parts = list(link.looks)
    if link != Link(link.name, looks=link.looks):
        moments = {name: repr(float(x)) for name, x in zip(MOMENTS, link.moments, strict=True)}
        body = (origin(link.origin), tag("mass", value=link.mass), tag("inertia", **moments))
        parts.insert(0, tag("inertial", *body))
    return _nested("link", parts, name=link.name)


def _joint(joint: Joint) -> list[str]:
    place = origin(joint.origin) + tag("parent", link=joint.parent) + tag("child", link=joint.child)
    if not joint.moves:
        return [tag("joint", place, name=joint.name, type=joint.kind)]
    inner = tag("dynamics", damping=joint.damping, friction=joint.friction or None)
    lines = [place, tag("axis", xyz=joint.direction) + inner]
    span = {} if joint.kind == "continuous" else {"lower": joint.lower, "upper": joint.upper}
    for name in ("effort", "velocity"):
        if math.isfinite(bound := getattr(joint, name)):
            span[name] = bound
    if span:
        lines.append(tag("limit", **span))
    if (mimic := joint.mimic) is not None:
        multiplier, offset = mimic.multiplier, mimic.offset
        lines.append(tag("mimic", joint=mimic.leader, multiplier=multiplier, offset=offset))
    found = _nested("joint", lines, name=joint.name, type=joint.kind)
    if joint.stiffness or joint.rest:
        spring = {"springStiffness": joint.stiffness, "springReference": joint.rest}
        inside = (tag(name, _words(value)) for name, value in spring.items())
        found.append(tag("gazebo", *inside, reference=joint.name))
    return found


def _curves(part: Joint | Tendon) -> dict[str, Any]:
    """The attributes of a spring and a damper that are not linear."""
    return {
        "stiffness_poly": part.stiffness_poly if any(part.stiffness_poly) else None,
        "damping_poly": part.damping_poly if any(part.damping_poly) else None,
    }


def _branches(joint: Joint) -> dict[str, Any]:
    """The attribute of a joint's Maxwell branches."""
    numbers = [number for branch in joint.relaxation for number in branch]
    return {"relaxation": numbers or None}


def _block(robot: Robot) -> list[str]:
    """The ``<softdyn>`` block: armatures, tendons, the rig, the tasks."""
    lines = [tag("link", name=one.name, gravcomp=one.gravcomp) for one in robot.buoyant]
    lines += [
        tag("joint", name=j.name, armature=j.armature or None, **_curves(j), **_branches(j))
        for j in robot.joints
        if j.armature or any(_curves(j).values()) or j.relaxation
    ]
    for tendon in robot.tendons:
        path = [_path_element(part) for part in tendon.path]
        springs = {"stiffness": tendon.stiffness or None, "damping": tendon.damping or None}
        rest = {"rest": tendon.rest, "slack": "true" if tendon.slack else None}
        driven = None if tendon.driven is None else tendon.driven.value
        rubs = {"friction": tendon.friction or None, "driven": driven}
        springs |= {"armature": tendon.armature or None, **_curves(tendon)}
        lines += _nested("tendon", path, name=tendon.name, **springs, **rest, **rubs)
    lines += [tag("actuator", **_stated(actuator)) for actuator in robot.actuators]
    lines += [tag("sensor", **_stated(sensor)) for sensor in robot.sensors]
    if robot.tasks:
        lines += [tag("task", **_task(task)) for task in robot.tasks]
    elif robot.task:
        lines.append(tag("task", frame=robot.task))
    for ball in robot.balls:
        lines.append(
            tag(
                "ball", name=ball.name, joints=" ".join(ball.joints),
                stiffness=ball.stiffness or None, damping=ball.damping or None,
                stiffness_poly=ball.stiffness_poly if any(ball.stiffness_poly) else None,
            )
        )  # fmt: skip
    if fluid := robot.fluid:
        lines.append(tag("fluid", density=fluid.density or None, viscosity=fluid.viscosity or None))
    gravity = None if robot.gravity == EARTH else robot.gravity
    return _nested(BLOCK, lines, version=VERSION, gravity=gravity)


def _path_element(part: JointTerm | Site | Wrap) -> str:
    """An element of a tendon's path."""
    if isinstance(part, JointTerm):
        return tag("joint", name=part.joint, coef=part.coef)
    if isinstance(part, Site):
        return tag("site", link=part.link, xyz=part.xyz)
    name = "sphere" if part.axis is None else "cylinder"
    return tag(
        name, link=part.link, xyz=part.xyz, axis=part.axis, radius=part.radius, side=part.side,
        friction=part.friction, length=part.length,
    )  # fmt: skip


def _task(task: StatedTask) -> dict[str, object]:
    """The attributes of a task; those with a default only if they have another value."""
    usual = StatedTask(task.frame, task.name)
    rest = {
        name: getattr(task, name) if getattr(task, name) != getattr(usual, name) else None
        for name in ("weight", "Kp", "level")
    }
    return {
        "name": task.name, "frame": task.frame, "kind": task.kind.value,
        "axes": " ".join(task.axes) or None,
        "direction": task.direction if any(task.direction) else None, **rest,
    }  # fmt: skip


def _stated(part: Actuator | Sensor) -> dict[str, object]:
    """The fields of an actuator or a sensor that have no default or another value."""
    values = {field.name: (getattr(part, field.name), field.default) for field in fields(part)}
    kind = values.pop("kind", None)
    found = {} if kind is None else {"type": kind[0].value}
    for name, (value, default) in values.items():
        if value != default:
            found[name] = value.value if isinstance(value, Enum) else value
    return {"name": found.pop("name"), **found}
