"""Robots with a rig: slack tendons, winches and sensors of every kind."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

import softdyn
from softdyn import SetPoint, SoftModel
from softdyn.description.rig import CommandKind, Sensor
from softdyn.description.rig import SensorKind as KIND
from softdyn.description.robot import PathEnd
from softdyn.validation import Log, Rig, simulate

KINDS = (CommandKind.LENGTH, CommandKind.VELOCITY, CommandKind.FORCE)


def slackened(model: SoftModel, seed: int = 0, slack: bool = True) -> SoftModel:
    """The same robot with elastic, damped tendons, of which about half are taut."""
    rng = np.random.default_rng(seed)
    lengths = model.tendon_lengths(model.q0)
    tendons = tuple(
        replace(
            tendon, slack=slack, stiffness=rng.uniform(2, 9), damping=rng.uniform(0.1, 0.5),
            rest=float(length * rng.uniform(0.95, 1.05)),
        )
        for tendon, length in zip(model.robot.tendons, lengths, strict=True)
    )  # fmt: skip
    return _rebuilt(model, tendons=tendons)


def wound(model: SoftModel, **changed: float) -> SoftModel:
    """The same robot with winches in place of two of three motors, and gears of both signs."""
    rng = np.random.default_rng(0)
    actuators = []
    for i, actuator in enumerate(model.robot.actuators):
        kind = KINDS[i % 3]
        if kind is CommandKind.FORCE:
            actuators.append(actuator)
            continue
        gear = rng.uniform(0.5, 2.0) * (-1) ** (i + 1)
        ends = sorted((0.0, -9.0 / gear))
        rig = {"stiffness": rng.uniform(20, 50), "damping": rng.uniform(0.5, 2), **changed}
        actuators.append(
            replace(actuator, gear=gear, lower=ends[0], upper=ends[1], command=kind, **rig)
        )
    return _rebuilt(model, actuators=tuple(actuators))


def random_rig(model: SoftModel, seed: int) -> SoftModel:
    """The robot of `measured` with rubbing cables and random motors that only pull.

    The motors have random kinds, lags, delays and rates.
    """
    rng, actuators = np.random.default_rng(seed), []
    for actuator in model.robot.actuators:
        kind = KINDS[rng.integers(3)]
        lag, delay = float(rng.choice([0.0, 0.01, 0.03])), float(rng.choice([0.0, 0.002, 0.0051]))
        changes = {"gear": -abs(actuator.gear), "lower": 0.0, "upper": 9.0, "delay": delay}
        changes |= {"lag": lag, "rate": float(rng.choice([np.inf, 5.0, 50.0]))}
        if kind is not CommandKind.FORCE:
            changes |= {"stiffness": rng.uniform(20, 50), "damping": rng.uniform(0.5, 2)}
        if kind is CommandKind.LENGTH:
            changes["offset"] = 0.01 * (-1) ** seed
        actuators.append(replace(actuator, command=kind, **changes))
    found = measured(model)
    rubbing = (
        replace(tendon, friction=0.1 * k, driven=PathEnd.LAST if k % 2 else None)
        for k, tendon in enumerate(found.robot.tendons, 1)
    )
    return _rebuilt(found, actuators=tuple(actuators), tendons=tuple(rubbing))


def measured(model: SoftModel) -> SoftModel:
    """The same robot with every kind of sensor, some tendons elastic, damped and slack."""
    rng = np.random.default_rng(0)
    robot = getattr(model, "full", model).robot
    lengths = model.tendon_lengths(model.q0)
    tendons = tuple(
        replace(tendon, slack=bool(t % 2), stiffness=20.0, damping=3.0 * (t % 3 != 1),
                rest=float(length * rng.uniform(0.9, 1.0)))
        for t, (tendon, length) in enumerate(zip(robot.tendons, lengths, strict=True))
    )  # fmt: skip
    links = [robot.links[0].name, *rng.permutation([link.name for link in robot.links])[:3]]
    places = [
        {"link": str(link), "xyz": tuple(rng.normal(scale=0.1, size=3)),
         "rpy": tuple(rng.uniform(-3, 3, 3))}
        for link in links
    ]  # fmt: skip
    joints = [joint.name for joint in robot.moving_joints]
    sensors = [
        Sensor(f"{kind.value} {tendon.name}", kind, tendon=tendon.name)
        for tendon in tendons
        for kind in (KIND.LENGTH, KIND.TENSION)
    ]
    sensors += [Sensor(f"encoder {name}", KIND.JOINT, joint=name) for name in joints[-3:]]
    sensors += [
        Sensor(f"{kind.value} {k}", kind, **place)
        for kind in (KIND.POSE, KIND.GYRO, KIND.ACCELEROMETER, KIND.POSITION)
        for k, place in enumerate(places)
    ]
    sensors += [
        Sensor(f"bend {k}", KIND.BEND, link=one["link"], to=other["link"], rpy=one["rpy"])
        for k, (one, other) in enumerate(pairwise(places))
        if one["link"] != other["link"]
    ]
    sensors = [sensors[k] for k in rng.permutation(len(sensors))]
    return _rebuilt(model, tendons=tendons, sensors=tuple(sensors))


def turns(model: SoftModel) -> Log:
    """A run in which the two motors pull in turn."""

    def law(state: object, reference: object) -> np.ndarray:
        calls.append(1)
        return np.array([20.0, 0.0] if len(calls) % 100 < 50 else [0.0, 15.0])

    calls: list[int] = []
    return simulate(model, law, SetPoint(np.zeros(3)), duration=0.4, rig=Rig(latency=0.002))


def sensors(model, **camera):
    """The length of each driven tendon, and the tip from a camera."""
    names = dict.fromkeys(actuator.tendon for actuator in model.robot.actuators)
    lengths = [Sensor(name, KIND.LENGTH, tendon=name, noise=(5e-4,)) for name in names]
    return *lengths, Sensor("camera", KIND.POSITION, link=model.robot.task, noise=(1e-3,), **camera)


def sensed(name: str, **camera) -> SoftModel:
    """A bundled robot with these sensors in its description."""
    model = softdyn.load(name)
    return softdyn.build(replace(model.robot, sensors=sensors(model, **camera)), model.bundled)


def _rebuilt(model: SoftModel, **parts: object) -> SoftModel:
    """The model of the changed robot, reduced if the model is."""
    built = softdyn.build(replace(getattr(model, "full", model).robot, **parts))
    return softdyn.reduce(built, model.basis) if hasattr(model, "basis") else built
