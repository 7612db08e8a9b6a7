"""The own times of sensors' readings, and the readings that arrive.

A reading that arrives at t belongs to its own time: t - latency, or with a rate the newest multiple
of 1 / rate that is as old. At its own time the filter appends the predicted reading to the errors
that it estimates; when the reading arrives, it is of this value. For a linear system this is the
optimal use of a late reading: the estimate is that of a filter that waited for it.

Readings with stamps belong to the times that these say. The filter then appends a prediction in
every step. A reading between two predictions is expected to have the value between them, and its
Jacobian; one that nothing waits for has the value of the nearest time, changed at the present rate.

A step costs the square of the number of errors. So at most some `MOST_ROWS` of them are late
readings: where more would wait, the filter expects only readings that are farther apart.

While the state is poorly known, a reading has a part that its Jacobian does not show. With the
covariance P of q and the second derivatives H of a reading, the second-order filter (Bar-Shalom,
Li and Kirubarajan 2001, section 10.3) expects the reading ½ tr(H P) away from h(q), and adds
½ tr(H P H P) to its variance. Without this a first reading of the tip leaves a filter that is sure
of a wrong shape.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from softdyn.description.readings import SAME, ReadingLayout, SampledSensor
from softdyn.description.rig import Sensor
from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.winches import Winches
from softdyn.estimation.covariance import submatrix
from softdyn.sensing import Sensors

MATCH = 2e-6  # s, between the own times of a reading and of its prediction
LEAST = 1e-6  # m, rad, …: noise below this is taken as this
MOST_ROWS = 150  # late readings that wait, of all channels
SHARP = 30.0  # times its own variance; a reading that is known as well as this is as good as linear


class Prediction(NamedTuple):
    """Predicted readings of one channel.

    Attributes
    ----------
    values : ndarray, (k,)
        The readings.
    rows : ndarray, (k, w)
        Their Jacobian by the first w errors of the filter.
    change : ndarray, (k,)
        The known error, the shift of `second_order`, and for readings of a time before now the
        corrections of their errors since: to be subtracted from the error.
    variance : ndarray, (k,)
        See `second_order`.
    """

    values: np.ndarray
    rows: np.ndarray
    change: np.ndarray
    variance: np.ndarray


@dataclass(eq=False)
class SensorChannel:
    """Sensors that sample at the same times.

    Attributes
    ----------
    sensors : Sensors
        They evaluate the readings and their Jacobians.
    rows : ndarray of int, (k,)
        Their numbers among all readings.
    bias, variance : ndarray, (k,)
        The known error, and the variance of the noise and of the rounding.
    times : SampledSensor
        The times of their readings; without a rate there is one in each step.
    linear : bool
        Whether no reading bends with q: joints, and tendons with constant moment arms.
    straight : bool
        Whether no reading is a rotation or an angle.
    apart : float
        The least time (s) between the own times of two readings that wait.
    last, newest : float
        The number of the last sample that has arrived, and the newest own time (s) of a reading
        that waits or has waited; -∞ for none.
    where : slice or ndarray of int
        The rows, as a slice of neighbours if they are.
    error : ndarray, (k,)
        The result of `errors`.
    """

    sensors: Sensors
    rows: np.ndarray
    bias: np.ndarray
    variance: np.ndarray
    times: SampledSensor
    linear: bool
    straight: bool
    apart: float
    last: float = -math.inf
    newest: float = -math.inf
    where: Any = field(init=False)
    error: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        first, end = int(self.rows[0]), int(self.rows[-1]) + 1
        self.where = slice(first, end) if end - first == len(self.rows) else self.rows
        self.error = np.empty(len(self.rows))

    def forget(self) -> None:
        """No reading has arrived, none waits."""
        self.last = self.newest = -math.inf

    def arrives(self, t: float) -> bool:
        """Whether a new reading is there at time t (s); it counts as taken."""
        if self.times.rate == 0:
            return True
        number = self.times.number(t)
        new, self.last = number > self.last, max(number, self.last)
        return new

    def expect(
        self, q: np.ndarray, v: np.ndarray, u: np.ndarray, P: np.ndarray,
        winches: Winches | None = None,
    ) -> Prediction:  # fmt: skip
        """The readings at (q, v, u), with the nonlinear parts of `second_order` for P (s, s).

        With `winches` u are their commands. The next call overwrites the arrays.
        """
        values, rows = self.sensors.predict(q, v, u, winches)
        if self.linear or sharp(rows, P, self.variance):
            return Prediction(values, rows, self.bias, self.variance)
        shift, variance = second_order(self.sensors, (q, v, u, winches), P, self.variance)
        return Prediction(values, rows, self.bias + shift, variance)

    def errors(self, predicted: np.ndarray, given: np.ndarray) -> np.ndarray:
        """Readings (k,) minus their prediction, NaN where a reading is NaN.

        The next call overwrites the array.
        """
        if self.straight:
            return np.subtract(given, predicted, out=self.error)
        good = np.isfinite(given)
        error = self.sensors.components.errors(predicted, np.where(good, given, predicted))
        self.error[:] = np.where(good, error, np.nan)
        return self.error

    def pending_times(self, begin: float, end: float, stamped: bool = False) -> Iterator[float]:
        """Own times in (begin, end] of readings that arrive later than that, in steps so long.

        Stamped readings may belong to any time, so that one prediction in each step waits: that of
        its end, because it needs no step of its own.
        """
        at_end = (end,) if self.times.latency > 0 and end > begin else ()
        for own in at_end if stamped else self._late(begin, end):
            if own >= self.newest + self.apart:
                self.newest = own
                yield own

    def _late(self, begin: float, end: float) -> Iterator[float]:
        """The same for readings without stamps that are any time apart."""
        step, rate, latency = end - begin, self.times.rate, self.times.latency
        if step == 0:  # the length of the next step is not known
            number = round(end * rate)
            if latency > 0 and rate > 0 and abs(number - end * rate) <= SAME:
                yield number / rate
            return
        # a reading of this span arrives with one of two steps
        arrival = end + step * math.floor(latency / step + SAME)
        if rate == 0:
            if latency > 0:
                yield arrival - latency
            return
        for number in sorted({self.times.number(arrival), self.times.number(arrival + step)}):
            own = number / rate
            within = begin * rate + SAME < number <= end * rate + SAME
            direct = latency == 0 and abs(number - end * rate) <= SAME
            if within and not direct:
                yield own


@dataclass(eq=False)
class LateReading:
    """A prediction of readings that waits for their arrival.

    Attributes
    ----------
    channel : SensorChannel
        Its sensors.
    time : float
        Its own time (s).
    values, change, variance : ndarray, (k,)
        Those of `Prediction`.
    done : bool
        Whether it has arrived, or never will.
    """

    channel: SensorChannel
    time: float
    values: np.ndarray
    change: np.ndarray
    variance: np.ndarray
    done: bool = False


class LateReadings:
    """The late readings that wait, those of a channel in the order of their times.

    Their predictions are the last errors of the filter.

    Parameters
    ----------
    first : int
        The first of these errors.
    """

    def __init__(self, first: int) -> None:
        self._first = first
        self._waiting: list[LateReading] = []

    def add(self, channel: SensorChannel, own: float, found: Prediction) -> None:
        """Another one, with its own time (s)."""
        values, change = found.values.copy(), found.change.copy()
        self._waiting.append(LateReading(channel, own, values, change, found.variance))

    def expire(self, channel: SensorChannel, time: float) -> None:
        """Readings of this channel from before a time (s) are done."""
        for one in self._waiting:
            one.done |= one.channel is channel and one.time < time

    def arrive(self, channel: SensorChannel, own: float) -> LateReading | None:
        """The reading of this channel and own time (s); it and older ones are done."""
        self.expire(channel, own + MATCH)
        mine = (one for one in self._waiting if one.channel is channel)
        return next((one for one in mine if abs(one.time - own) <= MATCH), None)

    def around(
        self, channel: SensorChannel, own: float
    ) -> tuple[LateReading | None, LateReading | None]:
        """The readings of this channel that wait before and after an own time (s), maybe neither.

        Those older than the first of the two are done.
        """
        mine = [one for one in self._waiting if one.channel is channel]
        before = next((one for one in reversed(mine) if one.time <= own), None)
        if before is not None:
            self.expire(channel, before.time)
        return before, next((one for one in mine if one.time > own), None)

    def prediction(self, late: LateReading, size: int) -> Prediction:
        """The prediction of a late reading, with its rows (k, size)."""
        first = next(rows.start for one, rows in self._rows() if one is late)
        rows = np.eye(len(late.change), size, first)
        return Prediction(late.values, rows, late.change, late.variance)

    def correct(self, change: np.ndarray) -> None:
        """Add the corrections of the errors (s,)."""
        for one, rows in self._rows():
            one.change += change[rows]

    def forget(self, P: np.ndarray) -> np.ndarray:
        """The covariance (s, s) without those that are done."""
        left = [one for one in self._waiting if not one.done]
        if len(left) == len(self._waiting):
            return P
        keep = np.ones(len(P), np.bool_)
        for one, rows in self._rows():
            keep[rows] = not one.done
        self._waiting = left
        return submatrix(P, keep)

    def _rows(self) -> Iterator[tuple[LateReading, slice]]:
        first = self._first
        for one in self._waiting:
            yield one, slice(first, first := first + len(one.change))


def sensor_channels(model: SoftModel, sensors: tuple[Sensor, ...]) -> list[SensorChannel]:
    """The channels of sensors, in the order of the first sensor of each.

    Raises
    ------
    InputError
        A rate or a latency out of range.
    """
    layout = ReadingLayout(sensors)
    chosen: dict[SampledSensor, list[int]] = {}
    for k, sensor in enumerate(sensors):
        chosen.setdefault(SampledSensor.of(sensor), []).append(k)
    late = int(np.count_nonzero(layout.field("latency")))
    waiting = max(MOST_ROWS // max(late, 1), 1)
    spatial = {tendon.name for tendon in model.robot.tendons if tendon.sites}
    found = []
    for times, members in chosen.items():
        own = ReadingLayout(tuple(sensors[k] for k in members))
        variance = np.maximum(own.field("noise") ** 2 + own.field("resolution") ** 2 / 12, LEAST**2)
        read = Sensors(model, own.sensors)
        linear = all(s.kind.form.linear and s.tendon not in spatial for s in own.sensors)
        rows, parts = np.flatnonzero(np.isin(layout.owners, members)), read.components
        straight = not (parts.rotations or parts.angles)
        apart = times.latency / waiting * (1 - SAME)
        found.append(
            SensorChannel(read, rows, own.field("bias"), variance, times, linear, straight, apart)
        )
    return found


def second_order(
    sensors: Sensors,
    state: tuple[np.ndarray, np.ndarray, np.ndarray, Winches | None],
    P: np.ndarray,
    variance: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """The shift of the expected readings (k,), and their variances (k,) with the nonlinear part.

    Parameters
    ----------
    sensors : Sensors
        They evaluate the readings.
    state : (ndarray, ndarray, ndarray, Winches or None)
        The arguments of `Sensors.predict`.
    P : ndarray, (s, s)
        Covariance of the errors, those of q first.
    variance : ndarray, (k,)
        The readings' own variances.
    """
    n = len(state[1])
    products = sensors.hessians(*state) @ P[:n, :n]
    shift = 0.5 * np.trace(products, axis1=1, axis2=2)
    return shift, variance + 0.5 * np.einsum("kij,kji->k", products, products)


def sharp(rows, P, variance):
    """Whether readings with these Jacobians (k, w) are as good as linear."""
    width = rows.shape[1]
    known = np.sum(rows @ P[:width, :width] * rows, axis=1)
    return bool((known < SHARP * variance).all())
