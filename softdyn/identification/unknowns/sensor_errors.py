"""Readings of the robot's sensors: columns ``measured.NAME``, with biases and latencies.

A reading of a sensor with latency L that arrives at a is h(q(a - L)) + bias. Between the samples
the model's h is a cubic spline. A run that begins at rest has rested before. Other runs say nothing
of readings that are older than their first sample.

A sensor with a rate holds its readings. Only the first row with a new one counts. Its arrivals are
1 / rate apart, so the row that comes soonest after one gives the phase of all arrivals.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.interpolate import make_interp_spline

from softdyn.description.readings import ReadingLayout, SampledSensor
from softdyn.description.rig import Sensor
from softdyn.description.robot import Robot
from softdyn.exceptions import InputError

READ = "measured."
BARELY = 1e-9  # s; times this close are one


def layout_of(robot: Robot) -> ReadingLayout:
    """The sensors whose readings depend on q alone."""
    return ReadingLayout(tuple(one for one in robot.sensors if one.kind.form.of_place))


def biases(robot: Robot) -> dict[str, float]:
    """The file's bias of each reading."""
    layout = layout_of(robot)
    return dict(zip(layout.names, layout.field("bias").tolist(), strict=True))


def noises(robot: Robot) -> dict[str, float]:
    """The file's standard deviation of each reading."""
    layout = layout_of(robot)
    return dict(zip(layout.names, layout.field("noise").tolist(), strict=True))


def with_biases(robot: Robot, values: dict[str, float]) -> Robot:
    """The robot with other biases, by reading."""
    now, changed = {**biases(robot), **values}, {}
    for sensor in layout_of(robot).sensors:
        names = sensor.reading_names
        if not values.keys().isdisjoint(names):
            changed[sensor.name] = replace(sensor, bias=tuple(now[name] for name in names))
    return replace(robot, sensors=tuple(changed.get(one.name, one) for one in robot.sensors))


def without_repeats(robot: Robot, names: tuple[str, ...], t: np.ndarray, outputs: np.ndarray
) -> np.ndarray:  # fmt: skip
    """The outputs (N, k) with NaN instead of the readings that a sensor only holds."""
    found = outputs.copy()
    for sensor, columns in _columns(robot, names):
        if SampledSensor.of(sensor).holds(float(np.median(np.diff(t)))):
            held = (outputs[1:, columns] == outputs[:-1, columns]).all(1)
            rows = np.flatnonzero(np.append(True, held))
            found[rows[:, None], columns] = np.nan
    return found


def read_late(
    robot: Robot,
    names: tuple[str, ...],
    t: np.ndarray,
    known: np.ndarray,
    at_rest: bool,
    out: np.ndarray,
    slope: np.ndarray,
) -> np.ndarray:
    """Replace readings at the samples by those that arrive there, in place.

    A latency of half the run is refused.

    Parameters
    ----------
    robot : Robot
        The robot with its sensors.
    names : tuple of str, (k,)
        Names of the outputs.
    t : ndarray, (N,)
        Times of a run.
    known : ndarray of bool, (N, k)
        Whether the data have this output.
    at_rest : bool
        Whether the run begins at rest.
    out, slope : ndarray, (N, k), (N, k, P)
        Outputs and their derivatives.

    Returns
    -------
    ndarray, (N, k)
        Derivatives of the readings by their sensor's latency.
    """
    by_latency = np.zeros_like(out)
    for sensor, columns in _columns(robot, names):
        if sensor.latency > (t[-1] - t[0]) / 2:
            length = f"less than half of {t[-1] - t[0]:.3g} s of data"
            raise InputError(f"sensor {sensor.name!r}: latency", length, f"{sensor.latency:.3g} s")
        at = _arrivals(sensor, t, np.all(known[:, columns], axis=1)) - sensor.latency
        width = slope.shape[2]
        both = np.concatenate((out[:, columns, None], slope[:, columns]), axis=2)
        spline = make_interp_spline(t, both, k=min(3, len(t) - 1))
        there = spline(np.maximum(at, t[0]))
        rates = spline.derivative()(np.maximum(at, t[0]))[:, :, 0]
        before = at < t[0] - BARELY
        rates[before] = 0
        if not at_rest:
            there[before] = np.nan
        if sensor.latency or (at != t).any():
            out[:, columns] = there[:, :, 0]
            slope[:, columns] = there[:, :, 1 : 1 + width]
        by_latency[:, columns] = -rates
    return by_latency


def _columns(robot: Robot, names: tuple[str, ...]) -> Iterator[tuple[Sensor, list[int]]]:
    """The sensors that the outputs have, and the numbers of their readings."""
    number = {name: k for k, name in enumerate(names)}
    for sensor in layout_of(robot).sensors:
        read = [READ + name for name in sensor.reading_names]
        columns = [number[name] for name in read if name in number]
        if columns:
            yield sensor, columns


def _arrivals(sensor: Sensor, t: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Times (N,) at which the readings of the rows `known` arrived; `t` in the other rows."""
    times, row = SampledSensor.of(sensor), float(np.median(np.diff(t)))
    if not times.holds(row) or not known.any():
        return t
    interval = times.period
    phases = np.sort(t[known] % interval)
    gaps = np.append(phases[1:], phases[0] + interval) - phases
    if gaps.max() < (interval - row) / 2:  # the sensor's clock runs at another rate
        return t
    soonest = phases[(int(gaps.argmax()) + 1) % len(phases)]
    late = (t - soonest + BARELY) % interval - BARELY
    return np.where(known, t - late, t)
