"""The rows of sensors' readings in one array, and the times of a sensor's readings."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from softdyn.checks import number
from softdyn.description.rig import LONGEST_DELAY, PASCAL, Sensor
from softdyn.description.robot import Robot, sums_angles

MOST_RATE = 1e9  # Hz; a number of samples stays a whole number
SAME = 1e-3  # of a sampling interval; a sum of rounded steps is the same time
UNITS = {
    "length": "m", "angle": "rad", "force": "N", "angular speed": "rad/s", "acceleration": "m/s²",
    "pressure": PASCAL,
}  # fmt: skip
TURNING = UNITS | {"length": "rad", "force": "N m"}


@dataclass(frozen=True)
class ReadingLayout:
    """The readings (k,) of sensors, one sensor after the other.

    Attributes
    ----------
    sensors : tuple of Sensor
        The sensors, in their order.
    """

    sensors: tuple[Sensor, ...]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The name (k,) of each reading, such as ``camera.x``."""
        return tuple(name for sensor in self.sensors for name in sensor.reading_names)

    @property
    def size(self) -> int:
        """The number k of readings."""
        return len(self.names)

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """The rows of each sensor."""
        ends = np.cumsum([0, *(sensor.kind.size for sensor in self.sensors)]).tolist()
        return tuple(map(slice, ends, ends[1:]))

    @cached_property
    def rows(self) -> dict[str, slice]:
        """The rows of a sensor by its name."""
        return dict(zip((sensor.name for sensor in self.sensors), self.slices, strict=True))

    @cached_property
    def owners(self) -> np.ndarray:
        """The number (k,) of the sensor of each reading."""
        return self.spread(range(len(self.sensors))).astype(int)

    @cached_property
    def rotations(self) -> tuple[int, ...]:
        """The first row of each rotation vector."""
        return tuple(
            rows.start + first
            for sensor, rows in zip(self.sensors, self.slices, strict=True)
            if (first := sensor.kind.form.rotation) is not None
        )

    def spread(self, values: Iterable[Any]) -> np.ndarray:
        """One number, or one per component, of each sensor as an array (k,)."""
        found = [
            np.broadcast_to(value, sensor.kind.size)
            for sensor, value in zip(self.sensors, values, strict=True)
        ]
        return np.concatenate(found or [np.zeros(0)])

    def field(self, name: str) -> np.ndarray:
        """A field of each sensor as an array (k,), such as ``noise``, ``bias`` or ``rate``."""
        return self.spread(getattr(sensor, name) for sensor in self.sensors)

    def units(self, robot: Robot) -> tuple[str, ...]:
        """The unit (k,) of each reading on a robot."""
        sums = {tendon.name for tendon in robot.tendons if sums_angles(robot, tendon)}
        turns = {joint.name for joint in robot.joints if joint.kind != "prismatic"}
        return tuple(
            (TURNING if sensor.tendon in sums or sensor.joint in turns else UNITS)[quantity]
            for sensor in self.sensors for quantity in sensor.kind.form.quantities
        )  # fmt: skip


@dataclass(frozen=True)
class SampledSensor:
    """The times of a sensor's readings.

    Sample number k is taken at k / rate and arrives `latency` later. Without a rate there is a new
    reading at every time.

    Attributes
    ----------
    rate : float
        Readings per second (Hz), or 0.
    latency : float
        Age of a reading when it arrives (s).
    """

    rate: float = 0.0
    latency: float = 0.0

    @classmethod
    def of(cls, sensor: Sensor) -> SampledSensor:
        """The times of a sensor.

        Raises
        ------
        InputError
            A rate or a latency out of range.
        """
        rate, latency = f"sensor {sensor.name!r}: rate", f"sensor {sensor.name!r}: latency"
        return cls(
            number(rate, sensor.rate, lower=0.0, upper=MOST_RATE),
            number(latency, sensor.latency, lower=0.0, upper=LONGEST_DELAY),
        )

    @property
    def period(self) -> float:
        """Time between two readings (s); 0 without a rate."""
        return 1 / self.rate if self.rate > 0 else 0.0

    @property
    def oldest(self) -> float:
        """The greatest age of the newest reading (s)."""
        return self.latency + self.period

    def holds(self, step: float) -> bool:
        """Whether a reading is held over more than one step of so many seconds."""
        return self.rate > 0 and self.rate * step < 1 - SAME

    def number(self, t: float) -> int:
        """The number of the newest sample that has arrived at t (s); only with a rate."""
        return math.floor((t - self.latency) * self.rate + SAME)

    def own_time(self, t: float) -> float:
        """The time (s) at which the newest reading at t (s) was taken."""
        return t - self.latency if self.rate == 0 else self.number(t) / self.rate
