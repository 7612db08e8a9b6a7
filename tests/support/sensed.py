"""Robots with length sensors and a camera."""

from __future__ import annotations

from dataclasses import replace

import softdyn
from softdyn import SoftModel
from softdyn.description.rig import Sensor
from softdyn.description.rig import SensorKind as KIND


def sensors(model, **camera):
    """The length of each driven tendon, and the tip from a camera."""
    names = dict.fromkeys(actuator.tendon for actuator in model.robot.actuators)
    lengths = [Sensor(name, KIND.LENGTH, tendon=name, noise=(5e-4,)) for name in names]
    return *lengths, Sensor("camera", KIND.POSITION, link=model.robot.task, noise=(1e-3,), **camera)


def sensed(name: str, **camera) -> SoftModel:
    """A bundled robot with these sensors in its description."""
    model = softdyn.load(name)
    return softdyn.build(replace(model.robot, sensors=sensors(model, **camera)), model.bundled)
