"""One cable that a winch pulls alone: the model's curve of its tension, and its fits.

At rest under the tension T of this cable alone, the model gives the length ℓ(T) of its tendon. The
free length is ℓ(T) - T / k, which is the command c plus the offset z. So the tension that a sensor
reads is a known function f of the free length, zero where the cable is slack:

    T(c) = t₀ + s f(c + z).

A fit finds z, the sensor's zero t₀, and a factor s. The factor takes up the friction of the cable,
which has other signs in both directions, and an error of the arm's stiffness. The bend of the
curve, where the cable tightens, gives z. An encoder's bias is its reading less ℓ, on the line
through the taut readings where the tension is zero. A reading that does not follow ℓ is refused: an
encoder of another cable, one that stands still, one in millimetres.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from softdyn import InputError, SoftModel
from softdyn.actuation import CommandKind, Winches
from softdyn.description.readings import ReadingLayout
from softdyn.description.rig import Sensor, SensorKind
from softdyn.statics import StaticsError, settle
from softdyn.validation.bench.fail_safe import Stop, StopCause

SHARE = 0.05  # of the largest tension that a motor may give, for a pull
DEVIATIONS = 6.0  # of a tension sensor's noise, at which a cable counts as taut
TAUT = 0.02  # of a pull, the least tension of a taut cable
PULL = 12.0  # of these deviations, the least pull
TENSIONS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0)  # of a pull, in the model's curve
FEWEST = 20  # readings of a fit
SLOPE = 0.5  # a reading that follows its model by less than this, or twice as much, is another's
FACTOR = 5.0  # of the tension; friction makes some tens of per cent, a wrong unit 9.81 or 1000


class PulledCable:
    """One winch with its sensors, and the model's curve of its tension.

    Parameters
    ----------
    model : SoftModel
        The robot with its rig.
    k : int
        The number of the winch.
    pull : float, optional
        Tension (N) of a pull; by default 5 % of the largest that the motor may give, or more if the
        sensor is noisy.

    Attributes
    ----------
    name, k : str, int
        Name and number of the winch.
    load : int
        The row of its tension among the readings.
    bias : float
        The stated error (N) of this reading.
    encoders : dict of str to int
        The row of each of its encoders, by its name.
    pull, taut : float
        Tensions (N) of a pull, and of a cable that counts as taut.
    rest, travel : float
        Free length (m) at which it is just slack, and that which a pull winds up.

    Raises
    ------
    InputError
        A motor that does not command a length, a cable without a tension sensor, a pull beyond the
        motor's bound, an arm without an equilibrium.
    """

    def __init__(self, model: SoftModel, k: int, pull: float | None = None) -> None:
        motor = model.robot.actuators[k]
        self.name, self.k = motor.name, k
        if motor.command is not CommandKind.LENGTH:
            expected = f'command="length" of {motor.name!r}, whose zero is a length'
            raise InputError("zero", expected, f'command="{motor.command.value}"')
        rows = ReadingLayout(model.robot.sensors).rows
        own = [s for s in model.robot.sensors if s.tendon == motor.tendon]
        loads = [s for s in own if s.kind is SensorKind.TENSION]
        if not loads:
            expected = f'a <sensor type="tension"> on tendon {motor.tendon!r}'
            raise InputError("zero", expected, "none")
        self.load, noise = rows[loads[0].name].start, max(loads[0].noise)
        self.bias = loads[0].bias[0]
        encoders = [s for s in own if s.kind is SensorKind.LENGTH]
        self.encoders = {s.name: rows[s.name].start for s in encoders}
        self._errors = [(s.name, max(s.noise), max(s.resolution)) for s in encoders]
        most = max(abs(motor.gear * motor.lower), abs(motor.gear * motor.upper))
        least = PULL * noise
        self.pull = max(SHARE * most, least) if pull is None else pull
        if not least <= self.pull <= most:
            expected = (
                f"{least:g} N (its sensor's noise) to {most:g} N (its bound) for {self.name!r}"
            )
            raise InputError("pull", expected, f"{self.pull:g} N")
        self.taut = max(DEVIATIONS * noise, TAUT * self.pull)
        self._curve(model, motor.gear, motor.stiffness, loads[0])

    def _curve(self, model: SoftModel, gear: float, stiffness: float, load: Sensor) -> None:
        """The equilibria under a pull at this cable alone."""
        relaxed = model.relaxed
        tendon, q, rows = Winches(model).tendon[self.k], None, []
        for tension in self.pull * np.array(TENSIONS):
            u = relaxed.copy()
            u[self.k] = -tension / gear
            try:
                q = settle(model, u, q).q
            except StaticsError as error:
                raise InputError("zero", f"an equilibrium at {tension:g} N", error) from None
            state = model.state(q, np.zeros(model.nv))
            length = float(state.lengths[tendon])
            read = float(np.asarray(model.measure(state, u))[self.load])
            rows.append((length - tension / stiffness, read, length))
        free, read, length = np.array(rows).T
        if not (np.diff(free) < 0).all():
            expected = f"a cable {self.name!r} that is wound up the more, the higher its tension"
            raise InputError("zero", expected, "one that is not")
        self.rest, self.travel = float(free[0]), float(free[0] - free[TENSIONS.index(1.0)])
        self._free, self._read, self._lengths = free[::-1], (read - read[0])[::-1], length[::-1]

    def tension(self, free: np.ndarray) -> np.ndarray:
        """The tension (N) that its sensor reads at free lengths (m), less that of a slack cable."""
        return _extended(free, self._free, self._read)

    def length(self, free: np.ndarray) -> np.ndarray:
        """The length (m) of its tendon at free lengths (m)."""
        return _extended(free, self._free, self._lengths)

    def refusal(self, text: str) -> Stop:
        """The end of the run, for this cable."""
        return Stop(StopCause.CABLE, f"cable of {self.name!r}: {text}")

    def fit(self, rows: np.ndarray) -> float:
        """The offset (m) from rows of command (m), tension (N) and the encoders' readings (m).

        Raises
        ------
        Stop
            Too few rows, or rows that do not have the shape of the model's curve.
        """
        if len(rows) < FEWEST:
            raise self.refusal(f"{len(rows)} readings of its tension in a pull")
        c, read = rows[:, 0], rows[:, 1]
        taut = read > read.min() + 0.5 * np.ptp(read)
        begin = self._free[np.searchsorted(-self._read, -0.5 * self.pull)] - np.median(c[taut])
        scale = np.array([1e-3, 1.0, max(0.01 * self.pull, 1e-9)])

        def residual(x: np.ndarray) -> np.ndarray:
            z, s, zero = x * scale
            found: np.ndarray = zero + s * self.tension(c + z) - read
            return found

        start = np.array([begin, 1.0, float(np.min(read))]) / scale
        offset, factor, _ = least_squares(residual, start).x * scale
        if not (np.isfinite(offset) and factor > 0):
            raise self.refusal("its tension does not rise as the model's")
        if not 1 / FACTOR <= factor <= FACTOR:
            raise self.refusal(f"its tension rises {factor:.3g} times as much as the model's")
        return float(offset)

    def biases(self, rows: np.ndarray, offset: float) -> list[float]:
        """The bias (m) of each encoder, from the same rows and their offset (m).

        Raises
        ------
        Stop
            Too few readings of an encoder while the cable is taut.
        """
        free, found = rows[:, 0] + offset, []
        tension = self.tension(free)
        for column in rows.T[2:]:
            used = (tension > 0) & ~np.isnan(column)
            if used.sum() < FEWEST:
                raise self.refusal(f"{used.sum()} readings of an encoder in a pull")
            error = column[used] - self.length(free[used])
            found.append(float(np.polyfit(tension[used], error, 1)[1]))
        return found

    def check_encoders(self, rows: np.ndarray, offset: float) -> None:
        """Refuse an encoder that does not follow the model's length, from the rows of all pulls.

        Raises
        ------
        Stop
            The readings change by far less or more than the length, beyond noise and resolution.
        """
        free = rows[:, 0] + offset
        taut = self.tension(free) > 0
        for column, (name, noise, resolution) in zip(rows.T[2:], self._errors, strict=True):
            used = taut & ~np.isnan(column)
            length = self.length(free[used])
            away = length - length.mean()
            slope = float(away @ column[used] / (away @ away))
            unsure = DEVIATIONS * noise / float(np.linalg.norm(away))
            unsure += resolution / float(np.ptp(length))
            if not SLOPE - unsure <= slope <= 1 / SLOPE + unsure:
                text = f"its encoder {name!r} changes by {slope:.3g} of the model's length"
                raise self.refusal(f"{text}: it stands still, is another's, or has another unit")


def _extended(x: np.ndarray, xs: np.ndarray, ys: np.ndarray) -> np.ndarray:
    """Linear interpolation; below the first point along the first line, constant above the last."""
    slope = (ys[1] - ys[0]) / (xs[1] - xs[0])
    found: np.ndarray = np.interp(x, xs, ys) + slope * np.minimum(x - xs[0], 0.0)
    return found
