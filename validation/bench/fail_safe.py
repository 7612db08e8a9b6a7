"""The one place that decides why a run on a rig stops."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from scipy.special import chdtri

from softdyn import InputError, SoftModel
from softdyn.checks import number, whole
from softdyn.description.readings import ReadingLayout, SampledSensor
from softdyn.description.rig import Sensor, SensorKind
from softdyn.validation.bench.driver import NewestReadings

SURE = 1e-6  # chance that a consistent filter counts as lost
DEVIATIONS = 6.0  # of a tension sensor's noise beyond the bound of its motors
MARGIN = 0.05  # of that bound


class StopCause(Enum):
    """The cause for which a run on a rig stops."""

    END = "planned end"
    CTRL_C = "Ctrl-C"
    TERMINATED = "SIGTERM"
    HUNG_UP = "SIGHUP"
    CONTROLLER = "controller"
    OBSERVER = "observer"
    DRIVER = "driver"
    STALE = "stale reading"
    LIMIT = "reading outside its limits"
    TENSION = "tension beyond its bound"
    COMMAND = "command"
    MISSED = "missed deadlines"
    LOST = "lost estimate"
    CABLE = "cable"
    DIVERGED = "tip far from its reference"
    WATCHDOG = "watchdog"


class Stop(Exception):
    """The run stops.

    Attributes
    ----------
    cause : StopCause
        The cause.
    reason : str
        The same in a sentence.
    """

    def __init__(self, cause: StopCause, reason: str) -> None:
        self.cause, self.reason = cause, reason
        super().__init__(reason)

    def __reduce__(self) -> tuple[Any, ...]:
        return Stop, (self.cause, self.reason)


@dataclass(frozen=True)
class RigLimits:
    """The limits of a run on a rig.

    Attributes
    ----------
    stale : float
        Largest age of a reading (s), from its measurement, and the longest time in which the
        observer may use no reading of a component.
    missed : int
        Number of missed deadlines in a row at which the run stops.
    lost : float
        The estimate is lost if its innovations over this time (s) are beyond the 1 - 1e-6 quantile
        of χ². This is judged from `ramp` to the planned end. An observer may begin far from the
        robot's pose. While the commands fall no controller acts on the estimate, and an arm that
        falls onto its stops moves in another way than the readings before have taught an `Ekf`.
    ramp : float
        Time (s) in which the commands rise at the beginning and fall at the end.
    late : float
        The watchdog relaxes the rig if the loop is late by this time (s) and a whole period, or by
        two whole periods if this is longer.

    Raises
    ------
    InputError
        A number out of range.
    """

    stale: float = 0.1
    missed: int = 5
    lost: float = 0.2
    ramp: float = 0.5
    late: float = 0.05  # the end of a killed process alone takes some 20 to 40 ms

    def __post_init__(self) -> None:
        number("stale", self.stale, above=0.0)
        whole("missed", self.missed, lower=1)
        number("lost", self.lost, above=0.0)
        number("ramp", self.ramp, lower=0.0)
        number("late", self.late, above=0.0)


class FailSafe:
    """The checks of a run; each raises `Stop` with its cause.

    Parameters
    ----------
    model : SoftModel
        The robot with its rig.
    limits : RigLimits
        The limits.
    period : float
        Control period (s).

    Raises
    ------
    InputError
        A sensor whose readings are always older than `RigLimits.stale`.

    Attributes
    ----------
    falling : bool
        Whether the commands fall after the planned end, so that no estimate is judged.
    """

    def __init__(self, model: SoftModel, limits: RigLimits, period: float) -> None:
        self.limits, self.falling, sensors = limits, False, model.robot.sensors
        layout = ReadingLayout(sensors)
        self.names = layout.names
        for sensor in sensors:
            oldest = SampledSensor.of(sensor).oldest
            if oldest >= limits.stale:
                expected = (
                    f"more than {oldest:g} s, the latency and the interval of {sensor.name!r}"
                )
                raise InputError("stale", expected, limits.stale)
        self._lower, self._upper = layout.field("lower"), layout.field("upper")
        self._pull = layout.spread(_most(model, sensor) for sensor in sensors)
        self._innovations: deque[tuple[float, int]] = deque(
            maxlen=max(round(limits.lost / period), 1)
        )
        self.clear()

    def clear(self) -> None:
        """Forget all innovations, and which readings were used."""
        self._innovations.clear()
        self._used_at: np.ndarray | None = None

    def readings(self, read: NewestReadings, now: float) -> None:
        """Stop at a reading that is too old at the time `now` (s), or out of its limits."""
        age = now - read.stamps
        old = ~(age <= self.limits.stale)
        if old.any():
            k = int(np.argmax(old))
            given = f"{1e3 * age[k]:.0f} ms old" if np.isfinite(age[k]) else "never came"
            raise Stop(
                StopCause.STALE, f"the reading {self.names[k]} {'is ' * (given[0] != 'n')}{given}"
            )
        with np.errstate(invalid="ignore"):
            outside = (read.new < self._lower) | (read.new > self._upper)
            slack = read.new > self._pull
        for found, cause in ((outside, StopCause.LIMIT), (slack, StopCause.TENSION)):
            if found.any():
                k = int(np.argmax(found))
                bound = (
                    self._pull[k]
                    if cause is StopCause.TENSION
                    else (self._lower[k] if read.new[k] < self._lower[k] else self._upper[k])
                )
                text = f"the reading {self.names[k]} is {read.new[k]:.6g}, beyond {bound:.6g}"
                raise Stop(cause, text)

    def estimate(self, estimate: Any, t: float) -> None:
        """At t (s), stop if the innovations of the last `RigLimits.lost` seconds are too large."""
        nis, used = getattr(estimate, "nis", None), getattr(estimate, "used", 0)
        if nis is None or t < self.limits.ramp or self.falling:
            return
        self._innovations.append((float(nis), int(used)))
        if len(self._innovations) < (self._innovations.maxlen or 0):
            return
        total, count = (sum(column) for column in zip(*self._innovations, strict=True))
        if count and not total <= chdtri(count, SURE):
            text = f"innovations of {total:.3g} in {count} readings: the estimate is lost"
            raise Stop(StopCause.LOST, text)

    def used(self, estimate: Any, values: np.ndarray, t: float) -> None:
        """At t (s), stop if the observer has long used no reading of a component.

        An observer says by finite `residuals` (k,) which readings it has used; others are not
        judged. `values` (k,) are the newest readings.
        """
        residuals = np.asarray(getattr(estimate, "residuals", ()))
        if residuals.shape != (len(self.names),) or self.falling:
            return
        before = np.full(len(self.names), t) if self._used_at is None else self._used_at
        self._used_at = np.where(np.isfinite(residuals), t, before)
        blind = t - self._used_at > self.limits.stale
        if blind.any():
            k = int(np.argmax(blind))
            text = f"the observer has used no reading {self.names[k]}"
            text = f"{text} for {1e3 * (t - self._used_at[k]):.0f} ms; the last is {values[k]:.6g}"
            raise Stop(StopCause.STALE, text)

    def deadlines(self, in_a_row: int) -> None:
        """Stop after too many missed deadlines in a row."""
        if in_a_row >= self.limits.missed:
            raise Stop(StopCause.MISSED, f"{in_a_row} deadlines missed in a row")

    def commands(self, commands: np.ndarray) -> None:
        """Stop before a command that is not finite."""
        if not np.isfinite(commands).all():
            raise Stop(StopCause.COMMAND, f"commands {commands.tolist()}")


def _most(model: SoftModel, sensor: Sensor) -> float:
    """The largest tension (N) that a sensor may read, by the bounds of its tendon's motors."""
    if sensor.kind is not SensorKind.TENSION:
        return np.inf
    robot = model.robot
    tendon = next(one for one in robot.tendons if one.name == sensor.tendon)
    if tendon.stiffness or tendon.damping:  # its own spring adds what the motors do not bound
        return np.inf
    motors = [one for one in robot.actuators if one.tendon == sensor.tendon]
    if any(one.area_growth for one in motors):
        return np.inf
    bound = sum(max(abs(one.gear * one.lower), abs(one.gear * one.upper)) for one in motors)
    return bound * (1 + MARGIN) + DEVIATIONS * max(sensor.noise) + float(sensor.bias[0])
