"""Tendons, inputs and sensors of a robot in MuJoCo's terms.

A slack tendon, and a winch that commands a free length c, have the tension

    T = max(0, k (ℓ - c) + d ℓ̇),

with c the tendon's rest length if it is slack, and the command plus the offset of a winch. Both
are MuJoCo actuators with an affine bias along the tendon, whose clamped force is T. MuJoCo's own
tendon springs and dampers cannot do this: a damper there acts on a slack tendon too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import mujoco
import numpy as np

from softdyn.description.inertia import Origin
from softdyn.description.rig import Actuator, CommandKind, Sensor, SensorKind
from softdyn.description.robot import Robot, Tendon, Wrap
from softdyn.exceptions import InputError

LARGEST_FORCE = 1e15  # stands for no bound
UNBOUNDED = 1e10  # m, N: a larger bound counts as none
EARLY = 1e-9  # of a sensor's interval; sums of plant steps may be rounded down
MOST_STEPS = 200_000  # in a delay: 10 s in steps of 0.05 ms
SPARE = 2  # entries of a history beyond those that its delay spans

_SENSOR, _OBJECT = mujoco.mjtSensor, mujoco.mjtObj
FIRST_PARTS = {
    SensorKind.LENGTH: (_SENSOR.mjSENS_TENDONPOS,),
    SensorKind.TENSION: (_SENSOR.mjSENS_TENDONPOS, _SENSOR.mjSENS_TENDONVEL),
    SensorKind.JOINT: (_SENSOR.mjSENS_JOINTPOS,),
    SensorKind.POSITION: (_SENSOR.mjSENS_FRAMEPOS,),
    SensorKind.POSE: (_SENSOR.mjSENS_FRAMEPOS, _SENSOR.mjSENS_FRAMEQUAT),
    SensorKind.GYRO: (_SENSOR.mjSENS_GYRO,),
    SensorKind.ACCELEROMETER: (_SENSOR.mjSENS_ACCELEROMETER,),
    SensorKind.BEND: (_SENSOR.mjSENS_FRAMEXAXIS,),
    SensorKind.PRESSURE: (),
}
"""MuJoCo's sensors of each kind; a tension also has the force of each actuator. A pressure is that
of its chamber, whose gear is the area."""
COMPOSED = {
    SensorKind.TENSION: "its sum; the length, rate and forces are written",
    SensorKind.BEND: "its angle, atan2(y, x) of the axis that is written",
}
"""The kinds that no file of MuJoCo's states, with the parts that it does."""


class SensorPart(NamedTuple):
    """A sensor of MuJoCo's: its type, its object's type and name, and a site that it refers to."""

    kind: mujoco.mjtSensor
    objtype: mujoco.mjtObj
    name: str
    reference: str = ""

    @property
    def tag(self) -> str:
        """The name of its element in a file."""
        return tag_of(self.kind)


def tag_of(kind: mujoco.mjtSensor) -> str:
    """The name of an element in MuJoCo's files."""
    return str(kind.name).removeprefix("mjSENS_").lower()


def parts(robot: Robot, sensor: Sensor) -> list[SensorPart]:
    """MuJoCo's sensors from which a reading is composed.

    A tension is composed of the tendon's length and rate and of the force of each actuator on it.
    """
    objtype, name = _OBJECT.mjOBJ_SITE, frame_name(sensor)
    if sensor.joint:
        objtype, name = _OBJECT.mjOBJ_JOINT, sensor.joint
    elif sensor.tendon:
        objtype, name = _OBJECT.mjOBJ_TENDON, sensor.tendon
    if sensor.to:  # the axis of its end, in the frame where it begins
        return [
            SensorPart(kind, objtype, end_name(sensor), name) for kind in FIRST_PARTS[sensor.kind]
        ]
    found = [SensorPart(kind, objtype, name) for kind in FIRST_PARTS[sensor.kind]]
    if sensor.kind is SensorKind.TENSION:
        found += [
            SensorPart(_SENSOR.mjSENS_ACTUATORFRC, _OBJECT.mjOBJ_ACTUATOR, motor)
            for motor in pulling(robot, sensor.tendon)
        ]
    if sensor.kind is SensorKind.PRESSURE:
        found += [
            SensorPart(_SENSOR.mjSENS_ACTUATORFRC, _OBJECT.mjOBJ_ACTUATOR, one.name)
            for one in robot.actuators
            if one.is_chamber and one.tendon == sensor.tendon
        ]
    return found


def pulling(robot: Robot, tendon: str) -> list[str]:
    """Names of the actuators along a tendon."""
    slack = [slack_name(t.name) for t in robot.tendons if t.slack and t.name == tendon]
    return [a.name for a in robot.actuators if a.tendon == tendon] + slack


def site_name(tendon: Tendon, k: int) -> str:
    """Name of the site at a tendon's k-th point."""
    return f"{tendon.name}:{k}"


def wrap_name(tendon: Tendon, wrap: Wrap) -> str:
    """Name of the geom of a round body of a tendon, and of its side site."""
    return f"{tendon.name}:{wrap.after}:around"


def anchor_name(tendon: Tendon, wrap: Wrap) -> str:
    """Name of the site where a cable that rubs leaves a round body."""
    return f"{wrap_name(tendon, wrap)}:leaves"


def frame_name(sensor: Sensor) -> str:
    """Name of the site at a sensor's frame."""
    return f"sensor:{sensor.name}"


def end_name(sensor: Sensor) -> str:
    """Name of the site on a sensor's second link."""
    return f"{frame_name(sensor)}:end"


def sensor_frames(sensor: Sensor) -> dict[str, tuple[str, Origin]]:
    """The sites of a sensor by name: the link of each, and its frame there."""
    names = {frame_name(sensor): sensor.link, end_name(sensor): sensor.to}
    return {name: (link, sensor.origin) for name, link in names.items() if link}


def part_name(sensor: Sensor, k: int) -> str:
    """Name of MuJoCo's sensor for the k-th part of a reading."""
    return f"{sensor.name}:{k}"


def add_tendon(spec: mujoco.MjSpec, tendon: Tendon) -> None:
    """A tendon with its path, and with its spring and damper unless it can be slack."""
    added = spec.add_tendon()
    added.name = tendon.name
    acts = 0.0 if tendon.slack else 1.0
    added.stiffness = [acts * tendon.stiffness, *tendon.stiffness_poly]
    added.damping = [acts * tendon.damping, *tendon.damping_poly]
    # explicit, because MuJoCo's default is the length at springref
    added.springlength = (0.0, 0.0)
    added.limited, added.frictionloss, added.armature = 0, 0.0, tendon.armature
    for term in tendon.terms:
        added.wrap_joint(term.joint, term.coef)
    between = {wrap.after: wrap for wrap in tendon.wraps}
    for k in range(len(tendon.sites)):
        added.wrap_site(site_name(tendon, k))
        if k in between:
            name = wrap_name(tendon, between[k])
            added.wrap_geom(name, "" if between[k].side is None else name)


def add_inputs(spec: mujoco.MjSpec, robot: Robot, timestep: float | None) -> None:
    """The robot's inputs in their order, then one actuator for each slack tendon.

    Parameters
    ----------
    spec : mujoco.MjSpec
        The specification, with the tendons.
    robot : Robot
        The description.
    timestep : float or None
        Integration step (s) of a plant with the file's rig. None makes every input a force that
        acts at once.
    """
    for actuator in robot.actuators:
        motor = _add_actuator(spec, actuator.name, actuator.tendon, actuator.gear)
        if timestep is not None:
            _rig(motor, actuator, timestep)
    for tendon in robot.tendons:
        if tendon.slack:
            _add_actuator(spec, slack_name(tendon.name), tendon.name, -1.0)


def slack_name(tendon: str) -> str:
    """Name of the actuator that is a slack tendon's spring and damper."""
    return f"slack:{tendon}"


def _add_actuator(spec: mujoco.MjSpec, name: str, tendon: str, gear: float) -> mujoco.MjsActuator:
    motor = spec.add_actuator()
    motor.name, motor.target = name, tendon
    motor.trntype = mujoco.mjtTrn.mjTRN_TENDON
    motor.set_to_motor()
    motor.gear = (gear, 0.0, 0.0, 0.0, 0.0, 0.0)
    motor.ctrllimited, motor.forcelimited = 1, 0
    motor.ctrlrange = (-1.0, 1.0)  # the exact numbers follow in `finish`
    return motor


def steps_in(name: str, delay: float, timestep: float) -> int:
    """The steps (s) that a delay (s) of this name spans, which MuJoCo's history has to hold.

    Raises
    ------
    InputError
        If there are too many.
    """
    if not delay / timestep <= MOST_STEPS:
        expected = f"at most {MOST_STEPS} plant steps, {MOST_STEPS * timestep:g} s"
        raise InputError(name, expected, f"{delay:g} s")
    return math.ceil(delay / timestep - 1e-9)


def _rig(motor: mujoco.MjsActuator, actuator: Actuator, timestep: float) -> None:
    """The kind of command, lag and delay; MuJoCo rounds a delay up to whole steps."""
    if actuator.delay > 0:
        # half a step less, because a delay of whole steps may round up to one more
        steps = steps_in("delay", actuator.delay, timestep)
        motor.delay, motor.nsample = (steps - 0.5) * timestep, steps + SPARE
    if actuator.is_speed:
        motor.dyntype = mujoco.mjtDyn.mjDYN_INTEGRATOR
        bounded = np.isfinite((actuator.length_lower, actuator.length_upper)).any()
        motor.actlimited, motor.actrange = int(bounded), (-1.0, 1.0)
    elif actuator.lag > 0:
        motor.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
        motor.dynprm[0] = actuator.lag
    if actuator.is_winch:
        motor.ctrllimited, motor.forcelimited = 0, 1
        motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        motor.forcerange = (-1.0, 1.0)


def add_sensor(spec: mujoco.MjSpec, robot: Robot, sensor: Sensor, timestep: float) -> None:
    """The parts of a sensor, with its rate and latency; a latency is rounded up to whole steps."""
    steps = steps_in("latency", sensor.latency, timestep)
    for k, (kind, objtype, name, reference) in enumerate(parts(robot, sensor)):
        part = spec.add_sensor()
        part.name, part.type = part_name(sensor, k), kind
        part.objtype, part.objname = objtype, name
        if reference:
            part.reftype, part.refname = _OBJECT.mjOBJ_SITE, reference
        if sensor.latency > 0 or sensor.rate > 0:
            part.delay = max(steps - 0.5, 0.0) * timestep
            part.interval = ((1.0 - EARLY) / sensor.rate if sensor.rate > 0 else 0.0, 0.0)
            part.nsample = steps + SPARE


def finish(model: mujoco.MjModel, robot: Robot, lengths: np.ndarray, rigged: bool) -> None:
    """Write the numbers of tendons and inputs.

    Parameters
    ----------
    model : mujoco.MjModel
        The compiled model.
    robot : Robot
        The description.
    lengths : np.ndarray, (tendons,)
        Lengths at q = 0, which are the rest lengths that the file omits.
    rigged : bool
        Whether the inputs are those of the file's rig.
    """
    for actuator in robot.actuators:
        index = model.actuator(actuator.name).id
        if not (rigged and actuator.is_winch):
            model.actuator_ctrlrange[index] = actuator.lower, actuator.upper
            continue
        k, d, gear = actuator.stiffness, actuator.damping, actuator.gear
        zero = actuator.offset if actuator.command is CommandKind.LENGTH else 0.0
        model.actuator_gainprm[index, 0] = k / gear
        model.actuator_biasprm[index, :3] = k * zero / gear, -k / gear**2, -d / gear**2
        model.actuator_forcerange[index] = actuator.lower, actuator.upper
        model.actuator_actrange[index] = actuator.length_lower, actuator.length_upper
    for tendon in robot.tendons:
        index = model.tendon(tendon.name).id
        rest = lengths[index] if tendon.rest is None else tendon.rest
        model.tendon_lengthspring[index] = rest
        if tendon.slack:
            index = model.actuator(slack_name(tendon.name)).id
            k, d = tendon.stiffness, tendon.damping
            model.actuator_gainprm[index, 0] = 0.0
            model.actuator_biastype[index] = mujoco.mjtBias.mjBIAS_AFFINE
            model.actuator_biasprm[index, :3] = -k * rest, -k, -d
            model.actuator_forcelimited[index] = 1
            model.actuator_forcerange[index] = 0.0, LARGEST_FORCE
