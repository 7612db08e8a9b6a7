"""The readings of a twin's sensors: MuJoCo's numbers, composed, then noisy and rounded."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import mujoco
import numpy as np

from softdyn.description.readings import ReadingLayout
from softdyn.description.rig import CommandKind, Sensor, SensorKind
from softdyn.description.robot import Robot, input_units, sums_angles
from softdyn.validation.twin.drives import part_name, parts, pulling
from softdyn.validation.twin.twin import Twin


def command_units(robot: Robot) -> tuple[str, ...]:
    """The unit of every input's command: that of u, or of a winch's free length or its rate."""
    angular = {tendon.name: sums_angles(robot, tendon) for tendon in robot.tendons}
    units = []
    for actuator, force in zip(robot.actuators, input_units(robot), strict=True):
        length = "rad" if angular[actuator.tendon] else "m"
        units.append({
            CommandKind.FORCE: force, CommandKind.LENGTH: length,
            CommandKind.VELOCITY: f"{length}/s",
        }[actuator.command])  # fmt: skip
    return tuple(units)


class NoisyReadings(ABC):
    """Readings of a plant's sensors: bias and noise on each new one, which is then rounded.

    Parameters
    ----------
    sensors : sequence of Sensor
        The sensors.
    seed : int or sequence of int
        Seed of the noise.

    Attributes
    ----------
    layout : ReadingLayout
        Names and rows of the readings.
    """

    def __init__(self, sensors: Sequence[Sensor], seed: int | Sequence[int]) -> None:
        self.sensors = tuple(sensors)
        layout = self.layout = ReadingLayout(self.sensors)
        self.names = layout.names
        self._random = np.random.default_rng(seed)
        self._noise, self._bias, self._step = (
            layout.field(name) for name in ("noise", "bias", "resolution")
        )
        self._sampled = layout.field("rate") > 0
        self._begins = [rows.start for rows in layout.slices]
        self._before = self._true = np.full(len(self.names), np.nan)

    def __call__(self) -> tuple[np.ndarray, np.ndarray]:
        """The readings (k,) at the present instant, and the values (k,) without errors."""
        true = self.ideal()
        fresh = ~self._sampled | self._changed(true != self._true)
        errors = self._random.normal(size=len(true)) * self._noise + self._bias
        measured = true + errors
        for k in self.layout.rotations:
            measured[k : k + 3] = _turned(true[k : k + 3], errors[k : k + 3])
        rounded = np.round(measured / np.where(self._step > 0, self._step, 1.0)) * self._step
        measured = np.where(self._step > 0, rounded, measured)
        self._before = np.where(fresh, measured, self._before)
        self._true = true
        return self._before.copy(), true

    def _changed(self, components: np.ndarray) -> np.ndarray:
        """Whether (k,) some component of the same sensor changed."""
        if not self.sensors:
            return components
        return np.logical_or.reduceat(components, self._begins)[self.layout.owners]

    @abstractmethod
    def ideal(self) -> np.ndarray:
        """The readings (k,) without noise, bias and rounding."""


class Readings(NoisyReadings):
    """Readings of the sensors of a twin with a rig.

    MuJoCo evaluates a sensor at its rate and delays it. A reading is then composed: the tension is
    that of the inputs, and of the tendon's own spring and damper; a pose is a position and a
    rotation vector.

    Parameters
    ----------
    twin : Twin
        A twin made with ``rig=True``.
    seed : int or sequence of int
        Seed of the noise.
    """

    def __init__(self, twin: Twin, seed: int | Sequence[int]) -> None:
        super().__init__(twin.robot.sensors, seed)
        self._twin, model = twin, twin.model
        self._parts = [
            [
                int(model.sensor(part_name(sensor, k)).adr[0])
                for k in range(len(parts(twin.robot, sensor)))
            ]
            for sensor in self.sensors
        ]

    def ideal(self) -> np.ndarray:
        """The readings (k,) without noise, bias and rounding, after `mj_forward`."""
        parts = [
            self._compose(sensor, adr)
            for sensor, adr in zip(self.sensors, self._parts, strict=True)
        ]
        return np.concatenate(parts or [np.zeros(0)])

    def _compose(self, sensor: Sensor, adr: list[int]) -> np.ndarray:
        data, model = self._twin.data.sensordata, self._twin.model
        if sensor.kind is SensorKind.TENSION:
            length, rate, *forces = data[adr]
            gears = [
                model.actuator(name).gear[0] for name in pulling(self._twin.robot, sensor.tendon)
            ]
            t = model.tendon(sensor.tendon).id
            stretch = length - model.tendon_lengthspring[t, 0]
            (k1, k2), (b1, b2) = model.tendon_stiffnesspoly[t], model.tendon_dampingpoly[t]
            spring = (model.tendon_stiffness[t] + (k1 + k2 * stretch) * stretch) * stretch
            spring += (model.tendon_damping[t] + (b1 + b2 * abs(rate)) * abs(rate)) * rate
            return np.array([spring - np.dot(gears, forces)])
        if sensor.kind is SensorKind.POSE:
            turned = np.zeros(3)
            mujoco.mju_quat2Vel(turned, data[adr[1] : adr[1] + 4], 1.0)
            return np.concatenate((data[adr[0] : adr[0] + 3], turned))
        if sensor.kind is SensorKind.BEND:
            x, y = data[adr[0] : adr[0] + 2]
            return np.array([np.arctan2(y, x)])
        return np.array(data[adr[0] : adr[0] + sensor.kind.size])


def _turned(rotation: np.ndarray, error: np.ndarray) -> np.ndarray:
    """The rotation vector (3,) of a rotation followed by an error in the turned frame."""
    quaternions, product, found = np.empty((2, 4)), np.empty(4), np.empty(3)
    for quaternion, vector in zip(quaternions, (rotation, error), strict=True):
        angle = float(np.linalg.norm(vector))
        axis = vector / angle if angle > 0 else np.array([1.0, 0.0, 0.0])
        mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
    mujoco.mju_mulQuat(product, *quaternions)
    mujoco.mju_quat2Vel(found, product, 1.0)
    return found
