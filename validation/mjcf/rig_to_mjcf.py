"""The rig of a URDF written as MJCF: actuators and sensors, and what MJCF cannot state of them.

They are those of the twin: position and integrating velocity actuators for winches, an activation
for a lag, MuJoCo's own delays.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from lxml import etree

from softdyn.description.rig import CommandKind
from softdyn.description.robot import Robot
from softdyn.validation.mjcf.comparison.neutral import Motor
from softdyn.validation.mjcf.xml_text import add
from softdyn.validation.twin.drives import (
    COMPOSED,
    SPARE,
    UNBOUNDED,
    part_name,
    parts,
    slack_name,
    steps_in,
)

HAIR = 1e-9  # s; a delay of whole steps must not be rounded up to one more
ERRORS = ("noise", "bias", "resolution")
OBJECTS = {"mjOBJ_TENDON": "tendon", "mjOBJ_ACTUATOR": "actuator", "mjOBJ_JOINT": "joint"}


def add_motor(parent: etree._Element, motor: Motor, timestep: float) -> None:
    """An actuator of the neutral form, as the twin has it.

    Parameters
    ----------
    parent : etree._Element
        The element ``<actuator>``.
    motor : Motor
        An actuator on a tendon.
    timestep : float
        Integration step (s) of the file.
    """
    _, _, tendon = motor.target.partition(":")
    rig, bounds = motor.rig, (motor.lower, _above(motor.lower, motor.upper))
    late = _late(rig.get("delay", 0.0), timestep) if "delay" in rig else {}
    lag = {"dyntype": "filterexact", "dynprm": rig["lag"]} if "lag" in rig else {}
    common = {"name": motor.name, "tendon": tendon, "gear": motor.gear}
    if motor.takes_force:
        tag = "general" if lag else "motor"
        add(parent, tag, **common, ctrllimited="true", ctrlrange=bounds, **lag, **late)
        return
    lengths = [rig.get(f"length_{end}", sign * math.inf) for end, sign in _ENDS]
    limits, span = "false", None
    zero = rig.get("offset", 0.0)
    if any(map(math.isfinite, lengths)):
        limits, span = "true", [min(max(x - zero, -UNBOUNDED), UNBOUNDED) for x in lengths]
    if rig["command"] == CommandKind.VELOCITY.value:
        bounded = {"ctrllimited": "false", "actlimited": limits, "actrange": span}
        lag = {"dyntype": "integrator"}
    else:
        bounded = {"ctrllimited": limits, "ctrlrange": span}
    k, d, gear = rig["stiffness"], rig.get("damping", 0.0), motor.gear
    add(parent, "general", **common, **bounded, forcelimited="true", forcerange=bounds,
        gainprm=k / gear, biastype="affine", biasprm=(k * zero / gear, -k / gear**2, -d / gear**2),
        **lag, **late)  # fmt: skip


_ENDS = (("lower", -1.0), ("upper", 1.0))


def _above(lower: float, upper: float) -> float:
    """The upper bound, above the lower one by a rounding error: MuJoCo refuses equal ones."""
    return max(upper, math.nextafter(lower, math.inf))


def _late(delay: float, timestep: float) -> dict[str, object]:
    """Attributes of a delay (s), and of the samples that it spans."""
    return {
        "delay": max(delay - HAIR, 0.0),
        "nsample": str(steps_in("delay", delay, timestep) + SPARE),
    }


def add_sensors(root: etree._Element, robot: Robot, timestep: float) -> None:
    """The parts of all sensors, with rates and latencies.

    A slack tendon without damping is a spring of MuJoCo's, which no sensor reads.
    """
    if not robot.sensors:
        return
    parent = add(root, "sensor")
    springs = [slack_name(t.name) for t in robot.tendons if t.slack and not t.damping]
    for sensor in robot.sensors:
        late: dict[str, object] = {}
        if sensor.latency > 0 or sensor.rate > 0:
            late = _late(sensor.latency, timestep)
            late["interval"] = (1.0 / sensor.rate, 0.0) if sensor.rate > 0 else None
        for k, part in enumerate(parts(robot, sensor)):
            if part.name in springs:
                continue
            end: dict[str, object] = {OBJECTS.get(part.objtype.name, "site"): part.name}
            if part.tag.startswith("frame"):
                end = {"objtype": "site", "objname": part.name}
            if part.reference:
                end |= {"reftype": "site", "refname": part.reference}
            add(parent, part.tag, name=part_name(sensor, k), **end, **late)


def lost_rig(robot: Robot) -> Iterator[str]:
    """The parts of the rig that MJCF does not state."""
    for tendon in robot.tendons:
        if tendon.friction:
            yield f"tendon {tendon.name!r}: its friction of {tendon.friction:g}"
        for wrap in tendon.wraps:
            if wrap.friction:
                yield f"tendon {tendon.name!r}: the friction {wrap.friction:g} of a round body"
    for actuator in robot.actuators:
        if actuator.is_chamber:
            yield f"actuator {actuator.name!r}: that its input is a pressure in {actuator.unit}"
        if actuator.area_growth:
            yield f"actuator {actuator.name!r}: that its area changes with its stretch"
        if math.isfinite(actuator.rate):
            yield f"actuator {actuator.name!r}: the bound {actuator.rate:g}/s of its command's rate"
        if actuator.is_speed and actuator.lag:
            yield f"actuator {actuator.name!r}: its lag of {actuator.lag:g} s before an integrator"
    for sensor in robot.sensors:
        if lost := [name for name in ERRORS if any(getattr(sensor, name))]:
            yield f"sensor {sensor.name!r}: its {', '.join(lost)}"
        if sensor.kind in COMPOSED:
            yield f"sensor {sensor.name!r}: {COMPOSED[sensor.kind]}"
