"""The lines that ``print`` shows of a model or a State. They solve no equation."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from softdyn.description.rig import Actuator, CommandKind
from softdyn.description.robot import Joint, Robot, sliding

LISTED = 12  # most joints or inputs that get a line each


def head(name: str, robot: Robot, nv: int) -> str:
    """Name and sizes of a model with nv degrees of freedom, on one line."""
    mass = sum(link.inertia.mass for link in robot.links)
    return (
        f"{name}: {len(robot.links)} links, {nv} degrees of freedom, "
        f"{len(robot.actuators)} inputs, {mass:.4g} kg, "
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
    if creeping := [joint for joint in joints if joint.relaxation]:
        branches = short([f"{joint.name} {branches_text(joint)}" for joint in creeping])
        yield f"  {len(creeping)} that creep: {branches}"
    for j in joints if len(joints) <= LISTED else ():
        span = f"[{j.lower:.4g}, {j.upper:.4g}]"
        if (mimic := j.mimic) is not None:
            span = f"= {mimic.multiplier:g} {mimic.leader} {mimic.offset:+g}"
        yield (
            f"  {j.name:<22} {j.kind:<11}{span}  "
            f"stiffness {j.stiffness:g} at {j.rest:g}, damping {j.damping:g}"
        )


def branches_text(joint: Joint) -> str:
    """The Maxwell branches of a joint: stiffness and time of each."""
    unit = "N/m" if joint.kind == "prismatic" else "N m/rad"
    return " and ".join(f"{k:.4g} {unit} over {time:g} s" for k, time in joint.relaxation)


def coordinate_lines(
    robot: Robot, names: Sequence[str], coordinates: np.ndarray, v: np.ndarray
) -> Iterator[str]:
    """Coordinates (n,) and velocities (n,) of the joints of these names; of many, two extremes."""
    units = _units(robot, names)
    few = len(names) <= LISTED
    if not few:
        yield f"{len(names)} joints, the farthest from 0:"
    for j in range(len(names)) if few else [int(np.argmax(np.abs(coordinates)))]:
        q = coordinates[j]
        degrees = f" ({math.degrees(q):.4g}°)" if units[j] == "rad" else ""
        yield f"{names[j]:<22} {q:.4g} {units[j]}{degrees}, {v[j]:.4g} {units[j]}/s"
    if not few:
        j = int(np.argmax(np.abs(v)))
        yield f"fastest: {names[j]}, {v[j]:.4g} {units[j]}/s"


def length_lines(robot: Robot, lengths: np.ndarray) -> Iterator[str]:
    """The lengths (tendons,) of the tendons on one line, if there are any."""
    pairs = zip(robot.tendons, lengths, strict=True)
    shown = [f"{tendon.name} {length:.4g}" for tendon, length in pairs]
    if shown:
        yield f"tendon lengths: {short(shown)}"


def numbers(values: np.ndarray) -> str:
    """Numbers with four decimals, separated by spaces; zero has no minus sign."""
    return " ".join(f"{x:.4f}" for x in np.round(values, 4) + 0.0)


def short(texts: Sequence[str]) -> str:
    """All texts if they are few, else the first ones and the last."""
    return ", ".join(texts if len(texts) <= LISTED else [*texts[:3], "…", texts[-1]])


def _units(robot: Robot, names: Sequence[str]) -> list[str]:
    units = ["m" if slides else "rad" for slides in sliding(robot, names)]
    return ["m"] * 3 + units[3:] if robot.floating else units


def input_lines(robot: Robot) -> Iterator[str]:
    """The number of inputs, and a line for each, or for some if there are many."""
    actuators = robot.actuators
    if not actuators:
        yield "inputs: none"
        return
    yield f"inputs: {len(actuators)}"
    shown = [
        f"{a.name:<22} [{a.lower:g}, {a.upper:g}] "
        + (f"Pa on {a.gear:g} m²" if a.is_chamber else f"times {a.gear:g} on")
        + " at the stretch 1" * bool(a.area_growth)
        + f"{' along' * a.is_chamber} tendon {a.tendon}"
        for a in actuators
    ]
    if len(shown) > LISTED:
        shown = [*shown[:3], "…", shown[-1]]
    yield from (f"  {line}" for line in shown)


def rig_lines(robot: Robot) -> Iterator[str]:
    """Motors that are not ideal, equal ones on one line; sensors of each kind; own forces."""
    motors: dict[str, list[str]] = {}
    for actuator in robot.actuators:
        if not actuator.is_ideal:
            motors.setdefault(_motor(actuator), []).append(actuator.name)
    yield from (f"motors {short(names)}: {text}" for text, names in motors.items())
    rotors = [f"{one.name} {one.armature:g} kg" for one in robot.tendons if one.armature]
    if rotors:
        yield f"armatures of tendons: {short(rotors)}"
    kinds = Counter(sensor.kind.value for sensor in robot.sensors)
    if kinds:
        yield f"sensors: {', '.join(f'{count} {kind}' for kind, count in kinds.items())}"
    if robot.balls:
        yield f"ball joints: {short([ball.name for ball in robot.balls])}"
    if fluid := robot.fluid:
        yield f"fluid: density {fluid.density:g} kg/m³, viscosity {fluid.viscosity:g} Pa s"
    if robot.buoyant:
        weight = sum(link.mass for link in robot.links)
        share = sum(link.gravcomp * link.mass for link in robot.buoyant) / weight
        yield f"buoyancy: {share:.3g} of the weight"
    if robot.forces:
        yield f"forces of one's own: {short([force.name for force in robot.forces])}"


def _motor(actuator: Actuator) -> str:
    own = actuator.unit or "1"
    unit = {CommandKind.FORCE: own, CommandKind.LENGTH: "m", CommandKind.VELOCITY: "m/s"}
    parts = [f"command a {'pressure' if actuator.is_chamber else actuator.command.value}"]
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
