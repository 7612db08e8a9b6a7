"""The zeros of a rig: the offsets of its winches and the biases of its encoders, by pulling.

One cable after the other is wound up until its tension rises, and paid out again. All others are
slack meanwhile. At rest under the tension T of this cable alone, the model gives the length ℓ(T) of
its tendon. The free length is ℓ(T) - T / k, which is the command plus the offset z. So the tension
that a sensor reads is a known function f of the free length, zero where the cable is slack:

    T(c) = t₀ + s f(c + z).

Each pull, and each paying out, is fitted for z, for the sensor's zero t₀, and for a factor s. The
factor takes up the friction of the cable, which has other signs in both directions, and an error of
the arm's stiffness. The bend of the curve, where the cable tightens, gives z. An encoder's bias is
its reading less ℓ, on the line through the taut readings where the tension is zero.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from softdyn import InputError, SoftModel
from softdyn.actuation import CommandKind, Winches
from softdyn.checks import number, whole
from softdyn.description.rig import Sensor, SensorKind
from softdyn.description.robot import Robot
from softdyn.dynamics.model import check_model
from softdyn.statics import StaticsError, settle
from softdyn.validation.bench.drive import Drive
from softdyn.validation.bench.driver import Driver
from softdyn.validation.bench.fail_safe import RigLimits, Stop, StopCause
from softdyn.validation.loop.arguments import nowhere

SPEED = 0.002  # m/s at which cables are wound up and paid out; slow beside the arm's own motion
APPROACH = 5.0  # times faster, a slack cable is wound up until it is taut for the first time
SPREAD = 5e-4  # m; a zero that varies more between pulls is refused
BACK = 3e-3  # m that a cable is paid out beyond the length at which it was slack
MORE = 5e-3  # m beyond three times the model's travel, in which the tension must rise
TRAVEL = 3.0
SETTLING = 1.0  # s after all cables are paid out
SHARE = 0.05  # of the largest tension that a motor may give, for a pull
DEVIATIONS = 6.0  # of a tension sensor's noise, at which a cable counts as taut
PULL = 20.0  # of these deviations, the least pull
TENSIONS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0)  # of a pull, in the model's curve
FEWEST = 20  # samples of a fit

Commands = Generator[np.ndarray, None, None]


@dataclass(frozen=True)
class ZeroSettings:
    """The way in which zeros are searched.

    Attributes
    ----------
    repeats : int
        The number of pulls of each cable.
    reach : float
        Largest distance (m) of a zero from that of the file.
    pull : float, optional
        Tension (N) to which a cable is pulled; by default 5 % of the largest that its motor may
        give, or more if its sensor is noisy.
    speed : float
        Rate (m/s) of a cable's free length in a pull.

    Raises
    ------
    InputError
        A number out of range.
    """

    repeats: int = 3
    reach: float = 0.05
    pull: float | None = None
    speed: float = SPEED

    def __post_init__(self) -> None:
        whole("repeats", self.repeats, lower=1)
        for name in ("reach", "speed"):
            number(name, getattr(self, name), above=0.0)
        if self.pull is not None:
            number("pull", self.pull, above=0.0)


@dataclass(frozen=True)
class CableZero:
    """The zero of one cable.

    Attributes
    ----------
    actuator : str
        Its winch.
    offset : float
        The offset (m): the mean of both directions.
    spread : float
        Largest difference (m) of an offset from another of the same direction.
    hysteresis : float
        Mean offset (m) while the cable is paid out, less that while it is wound up.
    biases : dict of str to float
        Bias (m) of each encoder of the cable.
    """

    actuator: str
    offset: float
    spread: float
    hysteresis: float
    biases: dict[str, float]


class Cable:
    """One winch with its sensors, and the model's curve of its tension.

    Parameters
    ----------
    model : SoftModel
        The robot with its rig.
    k : int
        The number of the winch.
    settings : ZeroSettings
        How it is pulled.

    Raises
    ------
    InputError
        A motor that does not command a length, a cable without a tension sensor, a pull beyond the
        motor's bound, an arm without an equilibrium.
    """

    def __init__(self, model: SoftModel, k: int, settings: ZeroSettings) -> None:
        motor = model.robot.actuators[k]
        self.name, self.k = motor.name, k
        if motor.command is not CommandKind.LENGTH:
            expected = f'command="length" of {motor.name!r}, whose zero is a length'
            raise InputError("zero", expected, f'command="{motor.command.value}"')
        rows = dict(_rows(model.robot.sensors))
        own = [s for s in model.robot.sensors if s.tendon == motor.tendon]
        loads = [s for s in own if s.kind is SensorKind.TENSION]
        if not loads:
            expected = f'a <sensor type="tension"> on tendon {motor.tendon!r}'
            raise InputError("zero", expected, "none")
        self.load, noise = rows[loads[0].name], max(loads[0].noise)
        self.encoders = {s.name: rows[s.name] for s in own if s.kind is SensorKind.LENGTH}
        most = max(abs(motor.gear * motor.lower), abs(motor.gear * motor.upper))
        least = PULL * noise
        self.pull = max(SHARE * most, least) if settings.pull is None else settings.pull
        if not least <= self.pull <= most:
            expected = (
                f"{least:g} N (its sensor's noise) to {most:g} N (its bound) for {self.name!r}"
            )
            raise InputError("pull", expected, f"{self.pull:g} N")
        self.taut = max(DEVIATIONS * noise, 0.02 * self.pull)
        self._curve(model, motor.gear, motor.stiffness, loads[0])

    def _curve(self, model: SoftModel, gear: float, stiffness: float, load: Sensor) -> None:
        """The equilibria under a pull at this cable alone."""
        relaxed = np.clip(np.zeros(model.nu), model.u_min, model.u_max)
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

    def fit(self, rows: np.ndarray) -> float:
        """The offset (m) from rows of command (m) and tension (N).

        Raises
        ------
        Stop
            Rows that do not have the shape of the model's curve.
        """
        c, read = rows.T
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
            raise Stop(StopCause.CABLE, f"{self.name!r}: its tension does not rise as the model's")
        return float(offset)


@dataclass
class _Sweep:
    """The readings while a cable is wound up, or paid out: command, tension, its encoders."""

    rows: list[list[float]]
    winding: bool


class Zeroing:
    """The procedure: what it commands, and what it reads.

    A `Drive` has it as its controller and as its observer. The arm counts as at rest.

    Parameters
    ----------
    model : SoftModel
        The robot with its rig.
    settings : ZeroSettings
        How zeros are searched.

    Attributes
    ----------
    zeros : list of CableZero
        What was found, in the order of the winches.
    u : ndarray, (nu,)
        The relaxed input.
    longest : float
        The longest time (s) that it takes.

    Raises
    ------
    InputError
        A robot without winches, and as for `Cable`.
    """

    name = "zero"

    def __init__(self, model: SoftModel, settings: ZeroSettings | None = None) -> None:
        self._model = check_model(model)
        self.settings = ZeroSettings() if settings is None else settings
        if not model.nu:
            raise InputError("zero", "a robot with winches", "one without motors")
        self._cables = [Cable(model, k, self.settings) for k in range(model.nu)]
        winches, reach = Winches(model), self.settings.reach
        rest = np.array([cable.rest for cable in self._cables]) - winches.offset
        self._slack = np.minimum(rest + reach, winches.upper)
        self._least = np.maximum(rest - reach, winches.lower)
        self.u = np.clip(np.zeros(model.nu), model.u_min, model.u_max)
        self._readings = np.full(sum(s.kind.size for s in model.robot.sensors), np.nan)
        self._new, self.zeros = self._readings, list[CableZero]()
        self._q, self._period = model.q0, 0.005
        self._steps: Commands | None = None
        self.asked = self._slack
        span = float(np.max(self._slack - self._least)) + BACK
        pulls = 2 * self.settings.repeats + 2
        self.longest = 2 * SETTLING + model.nu * pulls * span / self.settings.speed

    # -- what a `Drive` calls --------------------------------------------------------------------

    def reset(self, period: float | None = None, q: np.ndarray | None = None) -> None:
        """Begin: as a controller with its period (s), as an observer with the pose at rest."""
        self._period = self._period if period is None else period
        self._q = self._q if q is None else q

    def step(self, t: float, measurements: np.ndarray, u: np.ndarray) -> SimpleNamespace:
        """Take the new readings (k,); the estimate is the pose at rest."""
        self._new = np.asarray(measurements, float)
        self._readings = np.where(np.isnan(self._new), self._readings, self._new)
        return SimpleNamespace(q=self._q, v=np.zeros(self._model.nv))

    def __call__(self, state: Any, reference: Any) -> Zeroing:
        """Decide on the next commands, `asked`.

        Raises
        ------
        Stop
            At the end, and at a cable that is refused.
        """
        if self._steps is None:
            self._steps = self._all()
        try:
            self.asked = next(self._steps)
        except StopIteration:
            raise Stop(StopCause.END, "") from None
        return self

    def commands(self) -> np.ndarray:
        """The commands (nu,) to send now."""
        return self.asked

    # -- the procedure -----------------------------------------------------------------------------

    def _all(self) -> Commands:
        """All cables in turn."""
        for _ in range(round(SETTLING / self._period)):
            yield self._slack
        self._tare = self._readings.copy()
        self._check_others(None)
        for cable in self._cables:
            sweeps: list[_Sweep] = []
            c = yield from self._approach(cable)
            c = yield from self._pay_out(cable, c, _Sweep([], False))
            for _ in range(self.settings.repeats):
                winding, out = _Sweep([], True), _Sweep([], False)
                c = yield from self._wind(cable, c, winding)
                c = yield from self._pay_out(cable, c, out)
                sweeps += [winding, out]
            yield from self._to(cable, c, float(self._slack[cable.k]))
            self.zeros.append(self._judged(cable, sweeps))

    def _to(self, cable: Cable, c: float, end: float) -> Commands:
        """Wind up or pay out from one command to another."""
        step = APPROACH * self.settings.speed * self._period
        while c != end:
            c += float(np.clip(end - c, -step, step))
            yield self._with(cable, c)
            self._check_others(cable)

    def _approach(self, cable: Cable) -> Generator[np.ndarray, None, float]:
        """Wind up a slack cable until it is taut; return the command."""
        begin, least = float(self._slack[cable.k]), float(self._least[cable.k])
        c, step = begin, APPROACH * self.settings.speed * self._period
        while self._tension(cable) <= cable.taut:
            c -= step
            if c < least:
                text = f"it does not tighten from {begin:.4g} to {least:.4g} m"
                raise self._refusal(cable, f"{text}: it is slack or cut, or its winch jams")
            yield self._with(cable, c)
            self._check_others(cable)
        return c

    def _wind(self, cable: Cable, c: float, sweep: _Sweep) -> Generator[np.ndarray, None, float]:
        """Wind up until the tension is that of a pull; return the command."""
        begin, step = c, self.settings.speed * self._period
        while (tension := self._tension(cable)) < cable.pull:
            c -= step
            if begin - c > TRAVEL * cable.travel + MORE + BACK:
                text = f"its tension stays at {tension:.3g} N while it is wound up"
                text = f"{text} by {1e3 * (begin - c):.0f} mm: it is cut, or it jams"
                raise self._refusal(cable, text)
            yield self._with(cable, c)
            self._note(cable, c, sweep)
            self._check_others(cable)
        return c

    def _pay_out(self, cable: Cable, c: float, sweep: _Sweep) -> Generator[np.ndarray, None, float]:
        """Pay out until the cable is slack; return the command."""
        step, begin = self.settings.speed * self._period, c
        end = min(c + TRAVEL * cable.travel + MORE, float(self._slack[cable.k]))
        slack = np.nan
        while c < end:
            if self._tension(cable) <= cable.taut and np.isnan(slack):
                slack = c
                end = min(end, c + BACK)
            c = min(c + step, end)
            yield self._with(cable, c)
            self._note(cable, c, sweep)
            self._check_others(cable)
        if np.isnan(slack):
            text = f"its tension stays at {self._tension(cable):.3g} N while it is paid out"
            raise self._refusal(cable, f"{text} by {1e3 * (c - begin):.0f} mm: it jams")
        return c

    def _with(self, cable: Cable, c: float) -> np.ndarray:
        """The commands that leave all cables slack but one."""
        found = self._slack.copy()
        found[cable.k] = c
        return found

    def _tension(self, cable: Cable) -> float:
        return float(self._readings[cable.load] - self._tare[cable.load])

    def _note(self, cable: Cable, c: float, sweep: _Sweep) -> None:
        """Add the readings, if the tension is new. They are of the command before."""
        if not np.isnan(self._new[cable.load]):
            encoders = (self._new[row] for row in cable.encoders.values())
            sweep.rows.append([c, self._new[cable.load], *encoders])

    def _check_others(self, pulled: Cable | None) -> None:
        """Refuse a cable that is tight although it is paid out."""
        for cable in self._cables:
            bias = self._tare[cable.load] if pulled else self._expected(cable)
            tension = float(self._readings[cable.load] - bias)
            if cable is not pulled and tension > cable.taut:
                at = f"{self._slack[cable.k]:.4g} m"
                text = f"it is tight ({tension:.3g} N) although it is paid out to {at}"
                text = f"{text}: it jams, its zero is farther away"
                raise self._refusal(cable, f"{text}, or its sensor's bias is not that of the file")

    def _expected(self, cable: Cable) -> float:
        """The reading (N) of a slack cable's tension."""
        state = self._model.state(self._q, np.zeros(self._model.nv))
        return float(np.asarray(self._model.measure(state, self.u))[cable.load])

    def _refusal(self, cable: Cable, text: str) -> Stop:
        return Stop(StopCause.CABLE, f"cable of {cable.name!r}: {text}")

    def _judged(self, cable: Cable, sweeps: list[_Sweep]) -> CableZero:
        """The zero from all pulls of a cable."""
        found: list[list[float]] = [[], []]
        biases: list[list[float]] = []
        for sweep in sweeps:
            rows = np.array(sweep.rows)
            if len(rows) < FEWEST:
                raise self._refusal(cable, f"{len(rows)} readings of its tension in a pull")
            offset = cable.fit(rows[:, :2])
            found[sweep.winding].append(offset)
            biases.append(self._biases(cable, rows, offset))
        spread = max(float(np.ptp(values)) for values in found)
        if spread > SPREAD:
            text = f"its zero scatters by {1e3 * spread:.2f} mm, more than {1e3 * SPREAD:g} mm"
            raise self._refusal(cable, text)
        out, winding = (float(np.mean(values)) for values in found)
        means = np.mean(biases, axis=0).tolist()
        return CableZero(
            cable.name, 0.5 * (out + winding), spread, out - winding,
            dict(zip(cable.encoders, means, strict=True)),
        )  # fmt: skip

    def _biases(self, cable: Cable, rows: np.ndarray, offset: float) -> list[float]:
        """The bias (m) of each encoder, from the taut readings of a sweep."""
        free, found = rows[:, 0] + offset, []
        tension = cable.tension(free)
        for column in rows.T[2:]:
            used = (tension > 0) & ~np.isnan(column)
            if used.sum() < FEWEST:
                raise self._refusal(cable, f"{used.sum()} readings of an encoder in a pull")
            error = column[used] - cable.length(free[used])
            found.append(float(np.polyfit(tension[used], error, 1)[1]))
        return found

    # -- what is written -------------------------------------------------------------------------

    def robot(self, robot: Robot) -> Robot:
        """The robot with the offsets and biases that were found, to a nanometre."""
        offsets = {zero.actuator: zero.offset for zero in self.zeros}
        biases = {name: bias for zero in self.zeros for name, bias in zero.biases.items()}
        return replace(
            robot,
            actuators=tuple(
                replace(a, offset=round(offsets.get(a.name, a.offset), 9)) for a in robot.actuators
            ),
            sensors=tuple(
                replace(s, bias=(round(biases[s.name], 9),)) if s.name in biases else s
                for s in robot.sensors
            ),
        )  # fmt: skip

    def text(self) -> str:
        """A table of the zeros."""
        lines = [
            f"{'winch':18}{'offset mm':>11}{'spread':>9}{'hysteresis':>12}   encoder biases mm"
        ]
        for zero in self.zeros:
            biases = ", ".join(f"{name} {1e3 * bias:.2f}" for name, bias in zero.biases.items())
            lines.append(
                f"{zero.actuator:18}{1e3 * zero.offset:11.2f}{1e3 * zero.spread:9.2f}"
                f"{1e3 * zero.hysteresis:12.2f}   {biases or 'none'}"
            )
        return "\n".join(lines)


def zero_drive(
    model: SoftModel, driver: Driver, settings: ZeroSettings | None = None, **options: Any
) -> tuple[Drive, Zeroing]:
    """A run on a rig that measures its zeros, and the procedure, which has them after the run.

    Parameters
    ----------
    model : SoftModel
        The robot with its rig.
    driver : Driver
        The rig's driver.
    settings : ZeroSettings, optional
        How zeros are searched.
    **options : Any
        Those of `Drive`. The ramp is left out, because it begins at the file's zeros.

    Raises
    ------
    InputError
        As for `Drive` and `Zeroing`.
    """
    zeroing = Zeroing(model, settings)
    limits = replace(options.pop("limits", None) or RigLimits(), ramp=0.0)
    options = {"period": 0.005, "name": Zeroing.name} | options
    duration = max(zeroing.longest, 2 * options["period"])
    drive = Drive(
        model, zeroing, nowhere, driver, zeroing, duration=duration, limits=limits,
        hold=zeroing.commands, **options,
    )  # fmt: skip
    return drive, zeroing


def _rows(sensors: tuple[Sensor, ...]) -> list[tuple[str, int]]:
    """The first component of each sensor among the readings."""
    ends = np.cumsum([0, *(sensor.kind.size for sensor in sensors)]).tolist()
    return [(sensor.name, row) for sensor, row in zip(sensors, ends, strict=False)]


def _extended(x: np.ndarray, xs: np.ndarray, ys: np.ndarray) -> np.ndarray:
    """Linear interpolation; below the first point along the first line, constant above the last."""
    slope = (ys[1] - ys[0]) / (xs[1] - xs[0])
    found: np.ndarray = np.interp(x, xs, ys) + slope * np.minimum(x - xs[0], 0.0)
    return found
