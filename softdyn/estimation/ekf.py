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
from softdyn.description.readings import ReadingLayout
from softdyn.description.rig import Sensor
from softdyn.dynamics.balance import Disturbance
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.estimation.arrivals import sensor_channels
from softdyn.estimation.consistency import chi_squared_bounds
from softdyn.estimation.estimate import StateEstimate
from softdyn.estimation.filter import WINDOW, Filter, FilteredModel, Fused
from softdyn.estimation.parameters import EkfCounts, EkfParameters, disturbances_of
from softdyn.estimation.rubbing import rubbing_covariance, rubbing_forces
from softdyn.estimation.timeline import LONGEST_GAP, Expected, Reading, Span, StepTime, Timeline
from softdyn.exceptions import InputError

FROM_FILE = "file"
SURE = 1 - 1e-6  # the level at which first readings refute the start
# s, over which errors of readings have a mean. 20 g on an arm are then 11 deviations; with 0.1 s
# they are at most 5, and with 10 s what was long ago still counts
MEAN = 1.0


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
        self._filtered = FilteredModel(model, self.disturbances, self.parameters)
        capstan = Capstan(model)
        self._capstan = capstan if len(capstan.tendon) and self.disturbances else None
        self._drives = Drives.of(model)
        q, v = (model.q0, np.zeros(model.nv)) if start is None else start
        self._start = array("start[0]", q, (model.nq,)), array("start[1]", v, (model.nv,))
        self._readings, self._commands = np.empty(self.components), np.empty(model.nu)
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
        q = vector("q", self._start[0] if q is None else q, model.nq)
        v = vector("v", self._start[1] if v is None else v, model.nv)
        u = model.relaxed if u is None else vector("u", u, model.nu)
        self._begin(q, v, np.asarray(u, float))
        self._timeline = Timeline(self._drives, self._channels, self.parameters.longest)
        if counts:
            self._counted = dict.fromkeys((field.name for field in fields(EkfCounts)), 0)

    def _begin(self, q: np.ndarray, v: np.ndarray, u: np.ndarray, scale: float = 1.0) -> None:
        """Go on with a new filter; the arguments are those of `Filter`."""
        self._filter, self._fused = (
            Filter(self._filtered, q, v, u, scale),
            Fused.none(self.components),
        )
        self._rubbed, self._rubbed_at = np.zeros(2 * (self._filtered.disturbed,)), -math.inf
        # sums of the readings' errors in deviations, and of their variances
        self._sums, self._weights = np.zeros(self.components), np.full(self.components, 1e-9)

    @property
    def counts(self) -> EkfCounts:
        """Counts of the filter's data."""
        return EkfCounts(**self._counted)

    @property
    def process(self) -> float:
        """The process noise that the readings ask for; see `EkfParameters.process`."""
        return self.parameters.process * math.exp(0.5 * self._filter.adapted)

    @property
    def biases(self) -> np.ndarray:
        """Means (k,) of the readings' errors over about a second, in deviations of such a mean.

        The errors of a consistent filter are white, so these are standard normal numbers
        (Bar-Shalom, Li and Kirubarajan 2001, section 5.4). A larger one is a bias of a sensor, or a
        force that stays and that the model lacks.
        """
        found: np.ndarray = self._sums / np.sqrt(self._weights)
        return found

    def covariance_of(self, name: str) -> np.ndarray:
        """Covariance of the components of a disturbance that is estimated."""
        own, first = self._filtered.parts[name], 2 * self.model.nv
        rows = slice(first + own.start, first + own.stop)
        found: np.ndarray = self._filter.P[rows, rows] + self._rubbed[own, own]
        return found

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
        t, timeline = real("t", t), self._timeline
        if stamps is not None:
            stamps = fill("stamps", stamps, np.empty(self.components))
        clock = timeline.accept(t)
        if clock in (StepTime.REFUSED, StepTime.SET_BACK):
            self._count("refused")
            if clock is StepTime.REFUSED:
                return self._estimate()
        self._fused = Fused.none(self.components)
        if clock in (StepTime.FIRST, StepTime.SET_BACK):
            begin = t if clock is StepTime.FIRST else t - LONGEST_GAP
            timeline.begin(begin, self._filter.state, self._filter.inputs)
        if clock is StepTime.FIRST:  # nothing was sent before
            pass
        elif math.isfinite(commands.dot(commands)):
            timeline.send(t, commands, sent)
        else:
            self._count("held")
        if clock in (StepTime.GAP, StepTime.SET_BACK):
            self._count("gaps")
            self._filter = self._filter.widened(self.parameters.widening)
            timeline.skip(t)
        begin, sound = timeline.time, True
        for event in timeline.until(t, readings, stamps):
            if isinstance(event, Span):
                sound = self._filter.predict(*event)
            elif isinstance(event, Expected):
                self._filter.wait(event.channel, event.time, timeline.commands)
            else:
                sound = self._correct(t, event, refutable=clock is StepTime.FIRST)
            if not sound:
                self._count("restarts")
                self._begin(*self._start, self.model.relaxed, self.parameters.widening)
                timeline.begin(t, self._filter.state, self._filter.inputs)
                break
        if t > begin:
            self._average(t - begin)
        if sound and self._capstan is not None and t - self._rubbed_at >= WINDOW and t > begin:
            self._rubbed_at = t
            self._consider(self._capstan, 1 / (t - begin))
        return self._estimate()

    def _average(self, step: float) -> None:
        """Add the errors of a step (s) to the sums of `biases`."""
        kept, errors = math.exp(-step / MEAN), self._fused.residuals[1]
        given = errors == errors
        self._sums *= kept
        self._sums += np.where(given, errors, 0.0)
        self._weights *= kept * kept
        self._weights += given

    def _count(self, name: str, more: int = 1) -> None:
        self._counted[name] += more

    def _estimate(self) -> StateEstimate:
        n, now, fused = self.model.nv, self._filter, self._fused
        variances = now.P.diagonal()[2 * n : 2 * n + len(now.forces)]
        deviations = np.sqrt(variances + self._rubbed.diagonal())
        return StateEstimate(
            now.q.copy(), now.v.copy(), now.P[: 2 * n, : 2 * n].copy(),
            {name: now.forces[part].copy() for name, part in self._filtered.parts.items()},
            {name: deviations[part].copy() for name, part in self._filtered.parts.items()},
            fused.nis, fused.used, *fused.residuals,
        )  # fmt: skip

    def _correct(self, t: float, readings: list[Reading], refutable: bool) -> bool:
        """The correction at t (s); a start that its first readings refute is taken as unknown."""
        commands, start = self._timeline.commands, (self._filter.q, self._filter.v)
        start = (start[0].copy(), start[1].copy()) if refutable else start
        sound = self._filter.correct(t, readings, commands, self._fused)
        if refutable and sound and refuted(self._fused):
            self._count("refuted")
            self._begin(*start, self._filter.inputs, self.parameters.widening)
            sound = self._filter.correct(t, readings, commands, self._fused)
        for name in ("used", "doubted", "unmatched"):
            self._count(name, getattr(self._fused, name))
        self._count("skipped", sum(len(r.given) - r.good for r in readings if not r.stamped))
        return sound

    def _consider(self, capstan: Capstan, steps: float) -> None:
        """The error that friction of cables makes now, for so many steps a second."""
        now, known, commands = self._filter, self._filtered, self._timeline.commands
        n, free = self.model.nv, now.held == 0
        still, memory = np.zeros(n), self.parameters.memory
        here = known.balance.trusted(now.q, still, still, commands, now.forces)
        rubbing = rubbing_forces(capstan, now.q, now.inputs)
        expected = [now.expect(one, commands) for one in self._channels]
        H = np.vstack([one.rows[:, :n][:, free] for one in expected])
        rates = [min(one.times.rate or steps, steps) for one in self._channels]
        information = np.concatenate(
            [memory * rate / one.variance for rate, one in zip(rates, expected, strict=True)]
        )
        with suppress(np.linalg.LinAlgError):  # a robot that nothing holds where it is
            self._rubbed = rubbing_covariance(
                here.by_q[np.ix_(free, free)], here.by_d[free], rubbing[free], H, information,
                known.drift.variances[: known.disturbed],
            )  # fmt: skip


def refuted(fused: Fused) -> bool:
    """Whether first readings say surely that the start is wrong."""
    return fused.used > 0 and fused.nis >= chi_squared_bounds(fused.used, level=SURE)[1]
