"""An extended Kalman filter on the analytic model: state and slow disturbances from sensors."""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import fields

import numpy as np

from softdyn.actuation.capstan import Capstan
from softdyn.actuation.drives import Drives
from softdyn.checks import array, fill, instances, real, vector
from softdyn.copies import KeepsMaking, Separate
from softdyn.description.readings import SAME, ReadingLayout
from softdyn.description.rig import Sensor
from softdyn.dynamics.balance import Disturbance, ForceBalance
from softdyn.dynamics.implicit_step import ImplicitStep
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.dynamics.winches import Winches
from softdyn.estimation.arrivals import (
    MATCH,
    LateReading,
    LateReadings,
    SensorChannel,
    sensor_channels,
)
from softdyn.estimation.consistency import chi_squared_bounds
from softdyn.estimation.covariance import (
    append,
    moved,
    onto_stops,
    predict,
    symmetrised,
    update,
    usable,
)
from softdyn.estimation.creeping import CreepingBalance
from softdyn.estimation.drift import DisturbanceDrift
from softdyn.estimation.estimate import StateEstimate
from softdyn.estimation.parameters import EkfCounts, EkfParameters, disturbances_of
from softdyn.estimation.rubbing import rubbing_covariance, rubbing_forces
from softdyn.exceptions import InputError

FROM_FILE = "file"
LATEST = 1e10  # s; a double resolves microseconds up to here
SHORTEST = 1e-9  # s; a step that is shorter is none
LONGEST_GAP = 0.5  # s without a step; after it the covariance begins anew
SURE = 1 - 1e-6  # the level at which first readings refute the start
HALVINGS = 4  # of a step without a solution
LARGEST = 1e6  # no reading is larger (rad, m, N, …)
WINDOW = 0.1  # s, of the readings that judge the process noise: some pictures of a camera
GATE = 20.0  # deviations; readings further from their prediction count less and less
LONGEST_AGE = 0.02  # s; a stamped reading that nothing waits for may be so old
KEPT = 1.5  # latencies for which predictions of stamped readings wait
SET_BACK = 10  # refused steps with rising times; the clock is taken to be set back then


class Ekf(KeepsMaking, Separate):
    """An extended Kalman filter of a robot's state and slow disturbances.

    The prediction is a backward Euler step with exact Jacobians and joint stops
    (`softdyn.dynamics.implicit_step`). Readings are fused one by one in Joseph's form. Late ones
    are fused at their own time (`softdyn.estimation.arrivals`). Motors have the lag, delay and rate
    of the robot's file (`softdyn.actuation.drives`). An estimate beyond a stop is moved onto it
    along the covariance (Simon and Chia 2002). A reading more than 20 deviations off counts as so
    uncertain that it is 20 deviations off (Chang 2014, with another bound): one wrong reading
    corrects little, and a filter that is wrong and sure of it still recovers.

    The process noise adapts to the readings, between `EkfParameters.process`, where it begins, and
    `EkfParameters.least_process`. With the errors e of the readings, their variances S and the
    share w of the prediction in S, the log-likelihood of S ∝ e^(w x) has the slope
    ½ Σ w (e² / S - 1) and the information ½ Σ w² by the logarithm x of the noise's variance. Each
    step moves x by their ratio, with the information of the readings in a window (Fisher's scoring;
    Mehra 1970; Bar-Shalom, Li and Kirubarajan 2001, section 11.6).

    Disturbances drift by `softdyn.estimation.drift`, with their deviations and the time `memory`.
    Accelerometers are read as without disturbances. Where the file states friction of cables, the
    deviations of the disturbances include the error that it makes (`softdyn.estimation.rubbing`).

    Parameters
    ----------
    model : SoftModel
        The robot's model, with the rig's motors in its file.
    sensors : str or sequence of Sensor
        ``"file"`` for the sensors of the robot's file, or others.
    disturbances : sequence of Disturbance or str
        The disturbances to estimate, e.g. ``("tip_force",)``.
    parameters : EkfParameters, optional
        The assumed deviations.
    start : (array_like, array_like), optional
        The first q (nq,) and v (nv,); rest at q = 0 by default.

    Attributes
    ----------
    model : SoftModel
        The robot's model.
    disturbances : tuple of Disturbance
        Those that are estimated.
    components : int
        The number of readings that a step takes.
    reading_names : tuple of str
        Their names, e.g. ``camera.x``.
    disturbance_units : dict of str to str
        Units of the disturbances' components by their names, e.g. ``tip_force.x`` in N.

    Raises
    ------
    InputError
        A robot with a floating base, no sensor, an unknown disturbance, or one without effect.
    """

    def __init__(
        self,
        model: SoftModel,
        sensors: str | Iterable[Sensor] = FROM_FILE,
        disturbances: Iterable[Disturbance | str] = (),
        *,
        parameters: EkfParameters | None = None,
        start: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> None:
        self.model = check_model(model)
        if model.robot.floating:
            raise InputError("model", "a robot on a fixed base", model.name)
        self.parameters = EkfParameters() if parameters is None else parameters
        chosen = model.robot.sensors if sensors == FROM_FILE else instances(
            "sensors", sensors, Sensor, "a Sensor"
        )  # fmt: skip
        if not chosen:
            raise InputError("sensors", "at least one <sensor> in the file, or a Sensor", "none")
        self.disturbances = disturbances_of(model, disturbances)
        layout = ReadingLayout(tuple(chosen))
        self.components, self.reading_names = layout.size, layout.names
        self.disturbance_units = {
            name: unit for one in self.disturbances for name, unit in one.units(model).items()
        }
        self._channels = sensor_channels(model, layout.sensors)
        self._balance = ForceBalance(model, self.disturbances)
        self._step = ImplicitStep(model, self._balance)
        self._creep: CreepingBalance | None = None
        capstan = Capstan(model)
        self._capstan = capstan if len(capstan.tendon) and self.disturbances else None
        self._drives = Drives.of(model)
        wound = any(actuator.is_winch for actuator in model.robot.actuators)
        self._winches = Winches(model) if wound else None
        q, v = (model.q0, np.zeros(model.nv)) if start is None else start
        self._plain = model.nq == model.nv
        self._start = array("start[0]", q, (model.nq,)), array("start[1]", v, (model.nv,))
        sizes = [one.size(model) for one in self.disturbances]
        ends = np.cumsum([0, *sizes])
        self._disturbed = int(ends[-1])
        self._slices = {
            one.value: slice(int(a), int(b))
            for one, a, b in zip(self.disturbances, ends, ends[1:], strict=False)
        }
        if (torques := self._slices.get(Disturbance.RELAXATION.value)) is not None:
            self._creep = CreepingBalance(model, self._balance, torques)
            self._step = ImplicitStep(model, self._creep)
        self._readings, self._commands = np.empty(self.components), np.empty(model.nu)
        self._quietest = self.parameters.quietest
        self._first, self._force_noise, variances = self.parameters.variances(
            model, self.disturbances
        )
        self._drift = DisturbanceDrift(model, self.disturbances, variances, self.parameters.memory)
        self.reset()

    def reset(
        self,
        q: np.ndarray | None = None,
        v: np.ndarray | None = None,
        u: np.ndarray | None = None,
        *,
        counts: bool = True,
    ) -> None:
        """Begin anew at q (nq,) and v (nv,), with inputs u (nu,) that have acted for long.

        By default it is the given start, and zero inputs or those nearest to zero in their bounds.

        Raises
        ------
        InputError
            For a wrong shape or a number that is not finite.
        """
        model = self.model
        self._q = vector("q", self._start[0] if q is None else q, model.nq)
        self._v = vector("v", self._start[1] if v is None else v, model.nv)
        self._drifting = np.zeros(len(self._drift.variances))
        self._rubbed, self._rubbed_at = np.zeros((self._disturbed, self._disturbed)), -math.inf
        self._late = LateReadings(2 * model.nv + len(self._drifting))
        self._step.forget()
        self._cover(1.0)
        self._held = np.zeros(model.nv, np.int64)
        self._time, self._refused, self._behind = math.nan, -math.inf, 0
        u = model.relaxed if u is None else vector("u", u, model.nu)
        self._inputs = np.asarray(u, float)
        if counts:
            self._counted = dict.fromkeys((field.name for field in fields(EkfCounts)), 0)
        self._nis, self._used = 0.0, 0
        self._residuals = np.full((2, self.components), np.nan)
        self._change = np.empty(0)

    def _cover(self, scale: float) -> None:
        """Set the covariance of the start, scaled for the state; readings are forgotten."""
        self._adapted, self._information = 0.0, 0.0
        self._P = np.diag(np.concatenate((scale * self._first, self._drift.variances)))
        self._late.clear()
        for channel in self._channels:
            channel.forget()

    @property
    def _d(self) -> np.ndarray:
        """The disturbances (nd,), a view: a copied filter would not move an array of its own."""
        return self._drifting[: self._disturbed]

    @property
    def counts(self) -> EkfCounts:
        """Counts of the filter's data."""
        return EkfCounts(**self._counted)

    @property
    def process(self) -> float:
        """The process noise that the readings ask for; see `EkfParameters.process`."""
        return self.parameters.process * math.exp(0.5 * self._adapted)

    def covariance_of(self, name: str) -> np.ndarray:
        """Covariance of the components of a disturbance that is estimated."""
        rows, own = self._rows_of(name), self._slices[name]
        found: np.ndarray = self._P[rows, rows] + self._rubbed[own, own]
        return found

    def _rows_of(self, name: str) -> slice:
        first, part = 2 * self.model.nv, self._slices[name]
        return slice(first + part.start, first + part.stop)

    def step(
        self,
        t: float,
        measurements: np.ndarray,
        u: np.ndarray,
        stamps: np.ndarray | None = None,
        sent: float | None = None,
    ) -> StateEstimate:
        """The estimate at time t, from the readings that are there at t.

        Parameters
        ----------
        t : float
            Time (s), at most ±1e10, and later than in the last step by a nanosecond or more.
        measurements : array_like, (k,)
            Readings in the sensors' order, NaN for one that is not there. A sensor with a rate
            is read at the multiples of its interval; the same value may be given in between.
        u : array_like, (nu,)
            The commands that were sent at the last step and have been held since: u, or for a
            winch the free length or its rate. The first step ignores them.
        stamps : array_like, (k,), optional
            The times (s) at which the readings were measured, which count instead of the file's
            rates and latencies. Each reading may be given once. Sensors of one rate and latency
            share the mean of their stamps. It may be later than t by 20 ms.
        sent : float, optional
            The time (s) at which `u` was sent, if that was later than the last step. The commands
            before it act until then.

        Raises
        ------
        InputError
            For a time that is no number, and arrays of another shape or text.
        """
        readings = fill("measurements", measurements, self._readings)
        commands = fill("u", u, self._commands)
        t = real("t", t)
        self._stamps = None if stamps is None else fill("stamps", stamps, np.empty(self.components))
        first = math.isnan(self._time)
        if not abs(t) <= LATEST or (not first and t < self._time + SHORTEST):
            self._count("refused")
            behind = self._refused < t <= self._time
            self._behind = self._behind + 1 if behind else 0
            self._refused = t
            if self._behind < SET_BACK:
                return self._estimate()
            self._drives.reset(self.model.state(self._q, self._v), self._inputs, t)
            self._time = -math.inf
        self._refused, self._behind = -math.inf, 0
        self._nis, self._used = 0.0, 0
        self._residuals = np.full((2, self.components), np.nan)
        if first:
            self._drives.reset(self.model.state(self._q, self._v), self._inputs, t)
        else:
            if math.isfinite(commands.dot(commands)):
                since = max(self._time, t - LONGEST_GAP)
                at = since if sent is None else real("sent", sent)
                self._drives.send(at if since < at < t else since, commands)
            else:
                self._count("held")
            if t - self._time > LONGEST_GAP:
                self._count("gaps")
                self._cover(self.parameters.widening)
                self._time = t
        begin = t if first else self._time
        self._information *= math.exp((begin - t) / WINDOW)
        stamped = stamps is not None
        waiting = [
            (own, one) for one in self._channels for own in one.pending_times(begin, t, stamped)
        ]
        waiting.sort(key=lambda pair: pair[0])
        # a camera's picture of this instant is expected once the other readings of it are known
        soon = [pair for pair in waiting if pair[0] < t - SAME * (t - begin)] if t > begin else []
        correct = self._begin if first else self._correct
        if self._predict(begin, t, soon) and correct(t, readings):
            for own, channel in waiting[len(soon) :]:
                self._append(channel, own)
            if self._capstan is not None and t - self._rubbed_at >= WINDOW and t > begin:
                self._rubbed_at = t
                self._consider(self._capstan, 1 / (t - begin))
        else:
            self._count("restarts")
            self.reset(counts=False)
            self._cover(self.parameters.widening)
            self._drives.reset(self.model.state(self._q, self._v), self._inputs, t)
        self._time = t
        return self._estimate()

    def _count(self, name: str, more: int = 1) -> None:
        self._counted[name] += more

    def _estimate(self) -> StateEstimate:
        n = self.model.nv
        variances = self._P.diagonal()[2 * n : 2 * n + len(self._d)]
        deviations = np.sqrt(variances + self._rubbed.diagonal())
        return StateEstimate(
            self._q.copy(), self._v.copy(), self._P[: 2 * n, : 2 * n].copy(),
            {name: self._d[part].copy() for name, part in self._slices.items()},
            {name: deviations[part].copy() for name, part in self._slices.items()},
            self._nis, self._used, *self._residuals,
        )  # fmt: skip

    # -- prediction ----------------------------------------------------------------------------

    def _predict(
        self, begin: float, end: float, waiting: list[tuple[float, SensorChannel]]
    ) -> bool:
        """Predict to `end`, and append the late readings on the way; False if it fails."""
        at = begin
        for own, channel in waiting:
            if own > at + SAME * (end - begin):
                if not self._advance(at, own):
                    return False
                at = own
            self._append(channel, own)
        return at == end or self._advance(at, end)

    def _advance(self, begin: float, end: float) -> bool:
        """Steps of equal length, none longer than `longest`."""
        count = max(math.ceil((end - begin) / self.parameters.longest - SAME), 1)
        step = (end - begin) / count
        for k in range(count):
            commands = self._drives.over(begin + k * step, begin + (k + 1) * step)
            if not self._hold(commands, step, HALVINGS):
                return False
        return True

    def _hold(self, commands: np.ndarray, step: float, halvings: int) -> bool:
        """A step under constant commands, or two of half its length if it has no solution."""
        if self._creep is not None:
            self._creep.hold(step)
        found = self._step(self._q, self._v, commands, self._d, step, self._held)
        if found is None:
            return halvings > 0 and all(
                self._hold(commands, step / 2, halvings - 1) for _ in range(2)
            )
        noise = math.exp(self._adapted) * self._force_noise
        predict(
            self._P, found.by_state, found.by_force, noise, found.held, step,
            self._drift.moving, *self._drift.over(step),
        )  # fmt: skip
        self._q[:], self._v[:], self._held[:] = found.q, found.v, found.held
        if len(self._drifting):
            self._drift.move(self._drifting, step)
        if self._creep is not None:
            self._creep.follow(self._d, self._P, found.v)
        self._inputs[:] = found.inputs
        return True

    def _expect(
        self, channel: SensorChannel
    ) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]:
        """The present answer of `SensorChannel.expect`.

        Tensions and accelerations under winches change with the state, at the commands that act
        now. The mean inputs of a step are not enough: stiff cables make much of little.
        """
        u, winches = self._inputs, None
        if self._winches is not None and channel.sensors.feels_inputs:
            u, winches = self._drives.commands, self._winches
        return channel.expect(self._q, self._v, u, self._P, winches)

    def _append(self, channel: SensorChannel, own: float) -> None:
        """Append the predicted readings at their own time to the errors."""
        (values, jacobian), change, variance = self._expect(channel)
        self._late.add(LateReading(channel, own, values.copy(), change.copy(), variance))
        self._P = append(self._P, jacobian)

    def _consider(self, capstan: Capstan, steps: float) -> None:
        """The error that friction of cables makes now, for so many steps a second."""
        n, free = self.model.nv, self._held == 0
        still, memory = np.zeros(n), self.parameters.memory
        here = self._balance.trusted(self._q, still, still, self._drives.commands, self._d)
        rubbing = rubbing_forces(capstan, self._q, self._inputs)
        expected = [(one, self._expect(one)) for one in self._channels]
        H = np.vstack([values[1][:, :n][:, free] for _, (values, *_) in expected])
        information = np.concatenate(
            [
                memory * min(one.times.rate or steps, steps) / variance
                for one, (*_, variance) in expected
            ]
        )
        with suppress(np.linalg.LinAlgError):  # a robot that nothing holds where it is
            self._rubbed = rubbing_covariance(
                here.by_q[np.ix_(free, free)], here.by_d[free], rubbing[free], H, information,
                self._drift.variances[: self._disturbed],
            )  # fmt: skip

    def _begin(self, t: float, readings: np.ndarray) -> bool:
        """The first correction; a start that its readings refute is taken as unknown."""
        start = self._q.copy(), self._v.copy(), self._counted.copy()
        if not self._correct(t, readings):
            return False
        if self._used == 0 or self._nis < chi_squared_bounds(self._used, level=SURE)[1]:
            return True
        self._q, self._v, self._counted = start
        self._drifting[:] = 0.0
        self._nis, self._used = 0.0, 0
        self._count("refuted")
        self._cover(self.parameters.widening)
        return self._correct(t, readings)

    # -- correction ----------------------------------------------------------------------------

    def _stamped(
        self, channel: SensorChannel, given: np.ndarray, t: float
    ) -> tuple[SensorChannel, np.ndarray, np.ndarray, np.ndarray] | None:
        """Rows, errors and variances of a channel's readings (k,) with stamps; None without any."""
        assert self._stamps is not None
        late, size, n = self._late, len(self._P), self.model.nv
        late.expire(channel, t - KEPT * channel.times.latency - LONGEST_AGE)
        good = usable(given, LARGEST)
        times = self._stamps[channel.where][np.isfinite(given)]
        if good == 0 or not np.isfinite(times).all():
            return None
        own = min(float(times.mean()), t + LONGEST_AGE)
        before, after = late.around(channel, own)
        if own > t:  # the step began late; the prediction of now is nearer than all that wait
            before = None
        if before is None and (t if after is None else after.time) - own > LONGEST_AGE:
            self._count("unmatched", good)
            return None
        if after is None:
            (values, jacobian), change, variance = self._expect(channel)
            values, time = values.copy(), t
            rows = np.zeros((len(values), size))
            rows[:, : 2 * n] = jacobian
            if before is None:  # y(own) = y(t) - (t - own) H v
                values -= (t - own) * (jacobian[:, :n] @ self._v)
                rows[:, n : 2 * n] -= (t - own) * jacobian[:, :n]
        else:
            values, change, variance = after.predicted, after.change, after.variance
            rows, time = late.row_of(after, size), after.time
        if before is not None:
            share = (own - before.time) / max(time - before.time, SHORTEST)
            values, change, rows = (
                old + share * (new - old)
                for old, new in (
                    (before.predicted, values),
                    (before.change, change),
                    (late.row_of(before, size), rows),
                )
            )
        error = channel.errors(values, given)
        error -= change
        return channel, rows, error, variance

    def _correct(self, t: float, readings: np.ndarray) -> bool:
        """Fuse the readings that are there at t; False if there is no finite result."""
        parts: list[tuple[SensorChannel, np.ndarray, np.ndarray, np.ndarray]] = []
        for channel in self._channels:
            given = readings[channel.where]
            if self._stamps is not None:
                part = self._stamped(channel, given, t)
                if part is not None:
                    parts.append(part)
                continue
            if not channel.arrives(t):
                continue
            own = channel.times.own_time(t)
            match = self._late.arrive(channel, own)
            good = usable(given, LARGEST)
            if good < len(given):
                self._count("skipped", len(given) - good)
                if good == 0:
                    continue
            if match is not None:
                rows, values = self._late.row_of(match, len(self._P)), match.predicted
                change, variance = match.change, match.variance
            elif abs(own - t) > MATCH:
                self._count("unmatched", good)
                continue
            else:
                (values, rows), change, variance = self._expect(channel)
            error = channel.errors(values, given)
            error -= change
            parts.append((channel, rows, error, variance))
        if parts:
            if len(self._change) != len(self._P):
                self._change = np.empty(len(self._P))
            change = self._change
            change[:] = 0.0
            slope = 0.0
            for channel, rows, error, variance in parts:
                self._residuals[0, channel.where] = error
                nis, used, doubted, excess, known = update(
                    self._P, rows, error, variance, change, GATE
                )
                self._residuals[1, channel.where] = error
                self._nis, self._used = self._nis + nis, self._used + used
                self._count("doubted", doubted)
                slope, self._information = slope + excess, self._information + known
            self._count("used", self._used)
            # the 1 is a reading that would be all prediction: no step on almost no information
            adapted = self._adapted + slope / (1.0 + self._information)
            self._adapted = min(max(adapted, self._quietest), 0.0)
            if not math.isfinite(change @ change):
                return False
            try:
                self._move(change)
            except np.linalg.LinAlgError:  # a covariance without an inverse
                return False
        self._P = self._late.forget(self._P)
        return math.isfinite(symmetrised(self._P))

    def _move(self, change: np.ndarray) -> None:
        """Correct the estimate, and move it onto the stops that it is beyond."""
        model, n = self.model, self.model.nv
        q, v, d = self._q, self._v, self._drifting
        if not (self._plain and moved(q, v, d, change, model.lower, model.upper)):
            change = onto_stops(model, model.coordinates(q), change, self._P)
            q[:] = model.integrate(q, change[:n])
            v += change[n : 2 * n]
            d += change[2 * n : 2 * n + len(d)]
        self._late.correct(change)
