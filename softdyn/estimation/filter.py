"""The filter at one time: the estimate x, its covariance P, a prediction and a correction.

x is q, q̇, the disturbances and their rates. The errors of x and of the late readings that wait have
the covariance P. A filter that begins anew is a new one.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from softdyn.dynamics.balance import Disturbance, ForceBalance
from softdyn.dynamics.implicit_step import ImplicitStep
from softdyn.dynamics.model import SoftModel, State
from softdyn.dynamics.winches import Winches
from softdyn.estimation.arrivals import MATCH, LateReadings, Prediction, SensorChannel
from softdyn.estimation.covariance import append, onto_stops, predict, symmetrised, update
from softdyn.estimation.creeping import CreepingBalance
from softdyn.estimation.drift import DisturbanceDrift
from softdyn.estimation.parameters import EkfParameters
from softdyn.estimation.timeline import LONGEST_AGE, SHORTEST, Reading

HALVINGS = 4  # of a step without a solution
WINDOW = 0.1  # s, of the readings that judge the process noise: some pictures of a camera
GATE = 20.0  # deviations; readings further from their prediction count less and less
SHAKEN = 0.02  # s, in which the variance of joints at stops falls to 1/e after one has met a stop
LEAST_SPAN = 1e-9  # rad, m; a joint may have no range
KEPT = 1.5  # latencies for which predictions of stamped readings wait


class FilteredModel:
    """A robot's motion, its disturbances and their noise, as filters take them.

    Parameters
    ----------
    model : SoftModel
        The robot.
    disturbances : tuple of Disturbance
        Those that are estimated.
    parameters : EkfParameters
        The deviations.

    Attributes
    ----------
    balance, step, drift : ForceBalance, ImplicitStep, DisturbanceDrift
        The prediction. The step begins on the linear model of the last one.
    creep : CreepingBalance or None
        The balance with the torques of Maxwell branches, if they are estimated.
    parts : dict of str to slice
        The components of each disturbance, by its name.
    disturbed : int
        The number nd of the disturbances' components.
    winches : Winches or None
        Those of the robot, if it has any.
    first, force_noise : ndarray, (2 nv,), (nv,)
        Variances of a known start, and of the joint forces, each for a second.
    quietest : float
        `EkfParameters.quietest`.
    span : ndarray, (nv,)
        The joints' ranges, of which `EkfParameters` has shares.
    stops : float
        `EkfParameters.stops`.
    """

    def __init__(
        self, model: SoftModel, disturbances: tuple[Disturbance, ...], parameters: EkfParameters
    ) -> None:
        self.model = model
        self.balance = ForceBalance(model, disturbances)
        self.step = ImplicitStep(model, self.balance)
        ends = np.cumsum([0, *(one.size(model) for one in disturbances)])
        self.parts = {
            one.value: slice(int(a), int(b))
            for one, a, b in zip(disturbances, ends, ends[1:], strict=False)
        }
        self.creep: CreepingBalance | None = None
        if (torques := self.parts.get(Disturbance.RELAXATION.value)) is not None:
            self.creep = CreepingBalance(model, self.balance, torques)
            self.step = ImplicitStep(model, self.creep)
        wound = any(actuator.is_winch for actuator in model.robot.actuators)
        self.winches = Winches(model) if wound else None
        self.first, self.force_noise, variances = parameters.variances(model, disturbances)
        self.drift = DisturbanceDrift(model, disturbances, variances, parameters.memory)
        self.disturbed, self.quietest = len(variances), parameters.quietest
        self.span = np.maximum(parameters.span(model), LEAST_SPAN)
        self.stops = parameters.stops


@dataclass(eq=False)
class Fused:
    """The result of one correction.

    Attributes
    ----------
    residuals : ndarray, (2, k)
        `residuals` and `normalised` of `softdyn.estimation.StateEstimate`.
    nis : float
        Its `nis`.
    used, doubted, unmatched : int
        Readings, as `EkfCounts` has them.
    """

    residuals: np.ndarray
    nis: float = 0.0
    used: int = 0
    doubted: int = 0
    unmatched: int = 0

    @classmethod
    def none(cls, components: int) -> Fused:
        """No reading was used."""
        return cls(np.full((2, components), np.nan))


class Filter:
    """An estimate with its covariance, which steps and readings change.

    Parameters
    ----------
    filtered : FilteredModel
        The motion and its noise.
    q, v, u : ndarray, (nq,), (nv,), (nu,)
        The state in which it begins, and the inputs that act there.
    scale : float
        Factor of the first variances of q and v.

    Attributes
    ----------
    q, v : ndarray, (nq,), (nv,)
        The estimated state.
    d : ndarray, (nd + nr,)
        The estimated disturbances and their rates.
    P : ndarray, (s, s)
        Covariance of the errors: of q, v, d and the late readings that wait.
    held : ndarray of int, (nv,)
        The stops that hold joints, as in `ImplicitStepResult`.
    inputs : ndarray, (nu,)
        The inputs at the end of the last step.
    late : LateReadings
        The late readings that wait.
    adapted : float
        The logarithm of the factor of the process noise's variance.
    shaken : float
        Variance of the positions of the joints that stops hold, as shares of their ranges.
    """

    def __init__(
        self,
        filtered: FilteredModel,
        q: np.ndarray,
        v: np.ndarray,
        u: np.ndarray,
        scale: float = 1.0,
    ) -> None:
        self._filtered, self._plain = filtered, filtered.model.nq == filtered.model.nv
        self.q, self.v, self.inputs = q.copy(), v.copy(), u.copy()
        self.d, self.held = np.zeros(len(filtered.drift.variances)), np.zeros(len(v), np.int64)
        filtered.step.forget()
        self._spread(scale)

    def _spread(self, scale: float) -> None:
        variances = scale * self._filtered.first, self._filtered.drift.variances
        self.P = np.diag(np.concatenate(variances))
        self.late = LateReadings(len(self.P))
        self.adapted = self._information = self.shaken = 0.0
        self._corrected, self._change = -math.inf, np.empty(0)

    def widened(self, scale: float) -> Filter:
        """A new filter that begins at this estimate, with the first variances times a factor."""
        other = copy.copy(self)
        other._spread(scale)
        return other

    @property
    def forces(self) -> np.ndarray:
        """The disturbances (nd,), a view: a copied filter would not move an array of its own."""
        return self.d[: self._filtered.disturbed]

    @property
    def state(self) -> State:
        """The estimated state."""
        return self._filtered.model.state(self.q, self.v)

    # -- prediction ----------------------------------------------------------------------------

    def predict(self, commands: np.ndarray, step: float, halvings: int = HALVINGS) -> bool:
        """A step (s) under constant commands, or two of half its length if it has no solution.

        The result is False if these have none either.
        """
        known = self._filtered
        if known.creep is not None:
            known.creep.hold(step)
        found = known.step(self.q, self.v, commands, self.forces, step, self.held)
        if found is None:
            return halvings > 0 and all(
                self.predict(commands, step / 2, halvings - 1) for _ in range(2)
            )
        if self.shaken or found.held.any():
            self._shake(found.held, step)
        noise = math.exp(self.adapted) * known.force_noise
        predict(
            self.P, found.by_state, found.by_force, noise, found.held,
            self.shaken, known.span, step, known.drift.moving, *known.drift.over(step),
        )  # fmt: skip
        self.q[:], self.v[:], self.held[:] = found.q, found.v, found.held
        if len(self.d):
            known.drift.move(self.d, step)
        if known.creep is not None:
            known.creep.follow(self.d, self.P, found.v)
        self.inputs[:] = found.inputs
        return True

    def _shake(self, held: np.ndarray, step: float) -> None:
        """A joint that meets its stop shakes all joints that stops hold, for a while.

        It met the stop at some time of the step (s), and throws others off theirs. The deviation is
        that of its way until then, as a share of its range: of T v / √12.
        """
        self.shaken *= math.exp(-step / SHAKEN)
        met = (held != 0) & (held != self.held)
        if met.any():
            known = self._filtered
            way = step * float(np.abs(self.v[met] / known.span[met]).max())
            self.shaken = max(self.shaken, min(way**2 / 12, known.stops**2))

    def expect(self, channel: SensorChannel, commands: np.ndarray) -> Prediction:
        """The present answer of `SensorChannel.expect`.

        Tensions and accelerations are those at the commands (m,) that act now. The mean inputs of a
        step are not enough: a motor with a lag is elsewhere at its end.
        """
        feels, winches = channel.sensors.feels_inputs, self._filtered.winches
        u = commands if feels else self.inputs
        return channel.expect(self.q, self.v, u, self.P, winches if feels else None)

    def wait(self, channel: SensorChannel, own: float, commands: np.ndarray) -> None:
        """Append the predicted readings at their own time (s), which is now, to the errors."""
        found = self.expect(channel, commands)
        self.late.add(channel, own, found)
        self.P = append(self.P, found.rows)

    # -- correction ----------------------------------------------------------------------------

    def correct(
        self, t: float, readings: Sequence[Reading], commands: np.ndarray, fused: Fused
    ) -> bool:
        """Fuse readings that arrive at t (s) under commands (m,); False without a finite result.

        The figures are added to `fused`.
        """
        predicted = []
        for one in readings:
            found = (self._between if one.stamped else self._matched)(one, t, commands)
            if found is None:
                fused.unmatched += one.good
            elif one.good:
                predicted.append((one, found))
        self._information *= math.exp((self._corrected - t) / WINDOW)
        self._corrected = t
        if predicted and not self._fuse(predicted, fused):
            return False
        self.P = self.late.forget(self.P)
        return math.isfinite(symmetrised(self.P))

    def _matched(self, reading: Reading, t: float, commands: np.ndarray) -> Prediction | None:
        """The prediction for a reading of its own time; None if nothing waits for it."""
        late = self.late.arrive(reading.channel, reading.time)
        if late is not None:
            return self.late.prediction(late, len(self.P))
        if reading.good == 0 or abs(reading.time - t) > MATCH:
            return None
        return self.expect(reading.channel, commands)

    def _between(self, reading: Reading, t: float, commands: np.ndarray) -> Prediction | None:
        """The same for a reading with stamps, which is between two predictions."""
        channel, own, late, size = reading.channel, reading.time, self.late, len(self.P)
        late.expire(channel, t - KEPT * channel.times.latency - LONGEST_AGE)
        if reading.good == 0:
            return None
        before, after = late.around(channel, own)
        if own > t:  # the step began late; the prediction of now is nearer than all that wait
            before = None
        if before is None and (t if after is None else after.time) - own > LONGEST_AGE:
            return None
        if after is None:
            values, by_state, change, variance = self.expect(channel, commands)
            rows, time, n = np.zeros((len(values), size)), t, len(self.v)
            rows[:, : 2 * n] = by_state
            if before is None:  # y(own) = y(t) - (t - own) H v
                values = values - (t - own) * (by_state[:, :n] @ self.v)
                rows[:, n : 2 * n] -= (t - own) * by_state[:, :n]
            found = Prediction(values, rows, change, variance)
        else:
            found, time = late.prediction(after, size), after.time
        if before is None:
            return found
        share = (own - before.time) / max(time - before.time, SHORTEST)
        pairs = zip(late.prediction(before, size), found, strict=True)
        mixed = Prediction(*(old + share * (new - old) for old, new in pairs))
        return mixed._replace(variance=found.variance)

    def _fuse(self, predicted: list[tuple[Reading, Prediction]], fused: Fused) -> bool:
        """Correct x and P, and adapt the process noise; False without a finite result."""
        if len(self._change) != len(self.P):
            self._change = np.empty(len(self.P))
        change, slope = self._change, 0.0
        change[:] = 0.0
        for (channel, _, given, *_), found in predicted:
            error = channel.errors(found.values, given)
            error -= found.change
            fused.residuals[0, channel.where] = error
            nis, used, doubted, excess, known = update(
                self.P, found.rows, error, found.variance, change, GATE
            )
            fused.residuals[1, channel.where] = error
            fused.nis, fused.used = fused.nis + nis, fused.used + used
            fused.doubted += doubted
            slope, self._information = slope + excess, self._information + known
        # the 1 is a reading that would be all prediction: no step on almost no information
        adapted = self.adapted + slope / (1.0 + self._information)
        self.adapted = min(max(adapted, self._filtered.quietest), 0.0)
        if not math.isfinite(change @ change):
            return False
        with suppress(np.linalg.LinAlgError):  # a covariance without an inverse
            self._move(change)
            return True
        return False

    def _move(self, change: np.ndarray) -> None:
        """Correct the estimate, and move it onto the stops that it is beyond."""
        model, n, plain = self._filtered.model, len(self.v), self._plain
        at = self.q if plain else model.coordinates(self.q)
        there = at + change[:n]
        if not ((model.lower <= there) & (there <= model.upper)).all():
            change = onto_stops(model, at, change, self.P)
        self.q[:] = at + change[:n] if plain else model.integrate(self.q, change[:n])
        self.v += change[n : 2 * n]
        self.d += change[2 * n : 2 * n + len(self.d)]
        self.late.correct(change)
