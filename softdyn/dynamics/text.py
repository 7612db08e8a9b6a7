"""The text of a model or a State, which ``print`` shows. It solves no equation."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from softdyn.description.rig import Actuator, CommandKind
from softdyn.description.robot import Robot, sliding

if TYPE_CHECKING:
    from softdyn.dynamics.model import SoftModel, State

LISTED = 12  # most joints or inputs that get a line each


def model_text(model: SoftModel) -> str:
    """A few lines: sizes, file, joints, inputs, rig."""
    robot = model.robot
    return "\n".join((
        head(model),
        f"  file    {robot.path}{' (bundled)' if model.bundled else ''}",
        *(f"  {line}" for line in joint_lines(robot)),
        *(f"  {line}" for line in (*_input_lines(robot), *rig_lines(robot))),
    ))  # fmt: skip


def head(model: SoftModel) -> str:
    """Name and sizes on one line."""
    robot = model.robot
    mass = sum(link.inertia.mass for link in robot.links)
    return (
        f"{model.name}: {len(robot.links)} links, {model.nv} degrees of freedom, "
        f"{model.nu} inputs, {mass:.4g} kg, "
        f"{robot.length:.4g} m from base to tip {robot.task!r}"
    )


def joint_lines(robot: Robot) -> Iterator[str]:
    """The number of joints of each kind, springs and dampers; a line for each joint if few."""
    joints = robot.moving_joints
    kinds = [f"{n} {kind}" for kind, n in Counter(joint.kind for joint in joints).items()]
    if robot.followers:
        kinds.append(f"{len(robot.followers)} of them follow another")
    if robot.floating:
        kinds.insert(0, "a floating base")
    yield f"joints: {', '.join(kinds)}"
    for part, key in (("spring", "stiffness"), ("damper", "damping")):
        values = [value for joint in joints if (value := getattr(joint, key)) > 0]
        yield f"  {len(values)} with a {part}{_range(values)}"
    for j in joints if len(joints) <= LISTED else ():
        span = f"[{j.lower:.4g}, {j.upper:.4g}]"
        if (mimic := j.mimic) is not None:
            span = f"= {mimic.multiplier:g} {mimic.leader} {mimic.offset:+g}"
        yield (
            f"  {j.name:<22} {j.kind:<11}{span}  "
            f"stiffness {j.stiffness:g} at {j.rest:g}, damping {j.damping:g}"
        )


def state_text(state: State) -> str:
    """Joints, tip and tendons at a State."""
    model = state.model
    q, speed = model.coordinates(state.q), float(np.linalg.norm(state.ydot))
    lines = [
        f"State of {model.name}: tip at {numbers(state.y)} m, "
        + (f"moving at {speed:.4g} m/s" if state.v.any() else "at rest"),
    ]
    units = _units(model)
    rows = range(model.nv) if model.nv <= LISTED else [int(np.argmax(np.abs(q)))]
    if len(rows) < model.nv:
        lines.append(f"  {model.nv} joints, the farthest from 0:")
    for j in rows:
        degrees = f" ({math.degrees(q[j]):.4g}°)" if units[j] == "rad" else ""
        lines.append(
            f"  {model.joint_names[j]:<22} {q[j]:.4g} {units[j]}{degrees}, "
            f"{state.v[j]:.4g} {units[j]}/s"
        )
    if len(rows) < model.nv:
        j = int(np.argmax(np.abs(state.v)))
        lines.append(f"  fastest: {model.joint_names[j]}, {state.v[j]:.4g} {units[j]}/s")
    tendons = zip(model.robot.tendons, state.lengths, strict=True)
    shown = [f"{tendon.name} {length:.4g}" for tendon, length in tendons]
    if shown:
        lines.append(f"  tendon lengths: {short(shown)}")
    return "\n".join(lines)


def numbers(values: np.ndarray) -> str:
    """Numbers with four decimals, separated by spaces; zero has no minus sign."""
    return " ".join(f"{x:.4f}" for x in np.round(values, 4) + 0.0)


def short(texts: Sequence[str]) -> str:
    """All texts if they are few, else the first ones and the last."""
    return ", ".join(texts if len(texts) <= LISTED else [*texts[:3], "…", texts[-1]])


def _units(model: SoftModel) -> list[str]:
    units = ["m" if slides else "rad" for slides in sliding(model.robot, model.joint_names)]
    return ["m"] * 3 + units[3:] if model.robot.floating else units


def _input_lines(robot: Robot) -> Iterator[str]:
    actuators = robot.actuators
    if not actuators:
        yield "inputs: none"
        return
    yield f"inputs: {len(actuators)}"
    shown = [
        f"{a.name:<22} [{a.lower:g}, {a.upper:g}] times {a.gear:g} on tendon {a.tendon}"
        for a in actuators
    ]
    if len(shown) > LISTED:
        shown = [*shown[:3], "…", shown[-1]]
    yield from (f"  {line}" for line in shown)


def rig_lines(robot: Robot) -> Iterator[str]:
    """Motors that are not ideal, equal ones on one line, and the number of sensors of each kind."""
    motors: dict[str, list[str]] = {}
    for actuator in robot.actuators:
        if not actuator.is_ideal:
            motors.setdefault(_motor(actuator), []).append(actuator.name)
    yield from (f"motors {short(names)}: {text}" for text, names in motors.items())
    kinds = Counter(sensor.kind.value for sensor in robot.sensors)
    if kinds:
        yield f"sensors: {', '.join(f'{count} {kind}' for kind, count in kinds.items())}"


def _motor(actuator: Actuator) -> str:
    unit = {CommandKind.FORCE: "1", CommandKind.LENGTH: "m", CommandKind.VELOCITY: "m/s"}
    parts = [f"command a {actuator.command.value}"]
    if actuator.is_winch:
        parts.append(f"through a cable of {actuator.stiffness:g} N/m, {actuator.damping:g} N s/m")
    if actuator.lag:
        parts.append(f"lag {actuator.lag:g} s")
    if actuator.rate < math.inf:
        parts.append(f"rate {actuator.rate:g} {unit[actuator.command]}/s")
    if actuator.delay:
        parts.append(f"delay {actuator.delay:g} s")
    if actuator.zero:
        parts.append(f"offset {1e3 * actuator.zero:g} mm")
    return ", ".join(parts)


def _range(values: list[float]) -> str:
    if not values:
        return ""
    low, high = min(values), max(values)
    return f": {low:g}" if low == high else f": {low:g} to {high:g}"
