"""The zeros of a rig: the offsets of its winches and the biases of its encoders, by pulling.

One cable after the other is wound up until its tension rises, and paid out again, a number of
times. All others are slack meanwhile. Each pull, and each paying out, gives a zero: see
`softdyn.validation.bench.pulled_cable`. Lags shift it in opposite directions, so their mean counts.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.actuation import Winches
from softdyn.checks import number, whole
from softdyn.description.readings import ReadingLayout
from softdyn.description.robot import Robot
from softdyn.dynamics.model import check_model
from softdyn.validation.bench.drive import Drive
from softdyn.validation.bench.driver import Driver
from softdyn.validation.bench.fail_safe import RigLimits, Stop, StopCause
from softdyn.validation.bench.kept_zeros import CableZero
from softdyn.validation.bench.pulled_cable import PulledCable
from softdyn.validation.loop.arguments import nowhere

SPEED = 0.002  # m/s at which cables are wound up and paid out; slow beside the arm's own motion
APPROACH = 5.0  # times faster, a slack cable is wound up until it is taut for the first time
SPREAD = 5e-4  # m; a zero that varies more between pulls is refused
BACK = 3e-3  # m that a cable is paid out beyond the length at which it was slack
MORE = 5e-3  # m beyond three times the model's travel, in which the tension must rise
TRAVEL = 3.0
PERIOD = 0.005  # s
SETTLING = 1.0  # s after all cables are paid out
SMOOTH = 0.05  # s, time constant of the tensions that decide when a pull ends

Commands = Generator[np.ndarray, None, None]


@dataclass(frozen=True)
class ZeroSettings:
    """The way in which zeros are searched.

    Attributes
    ----------
    repeats : int
        The number of pulls of each cable, at least 2, so that a zero that scatters shows.
    reach : float
        Largest distance (m) of a zero, and of an encoder's bias, from that of the file.
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
        whole("repeats", self.repeats, lower=2)
        for name in ("reach", "speed"):
            number(name, getattr(self, name), above=0.0)
        if self.pull is not None:
            number("pull", self.pull, above=0.0)


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
    found : sequence of CableZero
        Zeros that are known; their cables are not pulled.
    keep : Callable[[list of CableZero], None], optional
        Called with all zeros after each cable.

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
        A robot without winches, and as for `PulledCable`.
    """

    name = "zero"

    def __init__(
        self,
        model: SoftModel,
        settings: ZeroSettings | None = None,
        found: Sequence[CableZero] = (),
        keep: Callable[[list[CableZero]], None] | None = None,
    ) -> None:
        self._model = check_model(model)
        self.settings = ZeroSettings() if settings is None else settings
        if not model.nu:
            raise InputError("zero", "a robot with winches", "one without motors")
        self._cables = [PulledCable(model, k, self.settings.pull) for k in range(model.nu)]
        winches, reach = Winches(model), self.settings.reach
        rest = np.array([cable.rest for cable in self._cables]) - winches.offset
        self._slack = np.minimum(rest + reach, winches.upper)
        self._least = np.maximum(rest - reach, winches.lower)
        self.u = model.relaxed
        self._readings = np.full(ReadingLayout(model.robot.sensors).size, np.nan)
        self._new, self.zeros, self._keep = self._readings, list(found), keep
        self._q, self._period = model.q0, PERIOD
        self._steps: Commands | None = None
        self.asked = self._slack
        sweeps = (2 * self.settings.repeats + 1) * np.array([_most(c) for c in self._cables])
        ways = 2 * (self._slack - self._least + BACK) / APPROACH
        self.longest = 2 * SETTLING + float(np.sum(ways + sweeps)) / self.settings.speed

    # -- what a `Drive` calls --------------------------------------------------------------------

    def reset(self, period: float | None = None, q: np.ndarray | None = None) -> None:
        """Begin: as a controller with its period (s), as an observer with the pose at rest."""
        self._period = self._period if period is None else period
        self._q = self._q if q is None else q

    def step(self, t: float, measurements: np.ndarray, u: np.ndarray) -> SimpleNamespace:
        """Take the new readings (k,); the estimate is the pose at rest."""
        self._new = np.asarray(measurements, float)
        share = 1.0 - np.exp(-self._period / SMOOTH)
        smooth = self._readings + share * (self._new - self._readings)
        begun = ~np.isnan(self._readings)
        found = np.where(begun, smooth, self._new)
        self._readings = np.where(np.isnan(self._new), self._readings, found)
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
        known = {zero.actuator for zero in self.zeros}
        for cable in (c for c in self._cables if c.name not in known):
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
            if self._keep is not None:
                self._keep(self.zeros)

    def _to(self, cable: PulledCable, c: float, end: float) -> Commands:
        """Wind up or pay out from one command to another."""
        step = APPROACH * self.settings.speed * self._period
        while c != end:
            c += float(np.clip(end - c, -step, step))
            yield self._with(cable, c)
            self._check_others(cable)

    def _approach(self, cable: PulledCable) -> Generator[np.ndarray, None, float]:
        """Wind up a slack cable until it is taut; return the command."""
        begin, least = float(self._slack[cable.k]), float(self._least[cable.k])
        c, step = begin, APPROACH * self.settings.speed * self._period
        while self._tension(cable) <= cable.taut:
            c -= step
            if c < least:
                text = f"it does not tighten from {begin:.4g} to {least:.4g} m"
                raise cable.refusal(f"{text}: it is slack or cut, or its winch jams")
            yield self._with(cable, c)
            self._check_others(cable)
        return c

    def _wind(
        self, cable: PulledCable, c: float, sweep: _Sweep
    ) -> Generator[np.ndarray, None, float]:
        """Wind up until the tension is that of a pull; return the command."""
        begin, step = c, self.settings.speed * self._period
        while (tension := self._tension(cable)) < cable.pull:
            c -= step
            if begin - c > _most(cable):
                text = f"its tension stays at {tension:.3g} N while it is wound up"
                text = f"{text} by {1e3 * (begin - c):.0f} mm: it is cut, or it jams"
                raise cable.refusal(text)
            yield self._with(cable, c)
            self._note(cable, c, sweep)
            self._check_others(cable)
        return c

    def _pay_out(
        self, cable: PulledCable, c: float, sweep: _Sweep
    ) -> Generator[np.ndarray, None, float]:
        """Pay out until the cable is slack; return the command."""
        step, begin = self.settings.speed * self._period, c
        end = min(c + _most(cable), float(self._slack[cable.k]))
        slack = np.nan
        while c < end:
            if self._tension(cable) <= cable.taut and np.isnan(slack):
                slack = c
                end = min(end, c + cable.travel + BACK)
            c = min(c + step, end)
            yield self._with(cable, c)
            self._note(cable, c, sweep)
            self._check_others(cable)
        if np.isnan(slack):
            text = f"its tension stays at {self._tension(cable):.3g} N while it is paid out"
            raise cable.refusal(f"{text} by {1e3 * (c - begin):.0f} mm: it jams")
        return c

    def _with(self, cable: PulledCable, c: float) -> np.ndarray:
        """The commands that leave all cables slack but one."""
        found = self._slack.copy()
        found[cable.k] = c
        return found

    def _tension(self, cable: PulledCable) -> float:
        return float(self._readings[cable.load] - self._tare[cable.load])

    def _note(self, cable: PulledCable, c: float, sweep: _Sweep) -> None:
        """Add the readings, if the tension is new. They are of the command before."""
        if not np.isnan(self._new[cable.load]):
            encoders = (self._new[row] for row in cable.encoders.values())
            sweep.rows.append([c, self._new[cable.load], *encoders])

    def _check_others(self, pulled: PulledCable | None) -> None:
        """Refuse a cable that is tight although it is paid out."""
        for cable in self._cables:
            bias = self._tare[cable.load] if pulled else self._expected(cable)
            tension = float(self._readings[cable.load] - bias)
            if cable is not pulled and tension > cable.taut:
                at = f"{self._slack[cable.k]:.4g} m"
                text = f"it is tight ({tension:.3g} N) although it is paid out to {at}"
                text = f"{text}: it jams, its zero is farther away"
                raise cable.refusal(f"{text}, or its sensor's bias is not that of the file")

    def _expected(self, cable: PulledCable) -> float:
        """The reading (N) of a slack cable's tension."""
        state = self._model.state(self._q, np.zeros(self._model.nv))
        return float(np.asarray(self._model.measure(state, self.u))[cable.load]) + cable.bias

    def _judged(self, cable: PulledCable, sweeps: list[_Sweep]) -> CableZero:
        """The zero from all pulls of a cable."""
        found: list[list[float]] = [[], []]
        biases: list[list[float]] = []
        for sweep in sweeps:
            rows = np.array(sweep.rows)
            offset = cable.fit(rows[:, :2])
            found[sweep.winding].append(offset)
            biases.append(cable.biases(rows, offset))
        spread = max(float(np.ptp(values)) for values in found)
        if spread > SPREAD:
            text = f"its zero scatters by {1e3 * spread:.2f} mm, more than {1e3 * SPREAD:g} mm"
            raise cable.refusal(text)
        out, winding = (float(np.mean(values)) for values in found)
        offset = 0.5 * (out + winding)
        cable.check_encoders(np.vstack([sweep.rows for sweep in sweeps]), offset)
        means = np.mean(biases, axis=0).tolist()
        named = dict(zip(cable.encoders, means, strict=True))
        stated = {s.name: s.bias[0] for s in self._model.robot.sensors if s.name in named}
        for name, bias in named.items():
            if abs(bias - stated[name]) > self.settings.reach:
                text = f"its encoder {name!r} has a bias of {1e3 * bias:.4g} mm"
                reach = f"the reach of {1e3 * self.settings.reach:g} mm"
                raise cable.refusal(f"{text}, more than {reach} from that of the file")
        return CableZero(cable.name, offset, spread, out - winding, named)

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
    model: SoftModel,
    driver: Driver,
    settings: ZeroSettings | None = None,
    *,
    found: Sequence[CableZero] = (),
    keep: Callable[[list[CableZero]], None] | None = None,
    **options: Any,
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
    found, keep
        As for `Zeroing`.
    **options : Any
        Those of `Drive`. The ramp is left out, because it begins at the file's zeros.

    Raises
    ------
    InputError
        As for `Drive` and `Zeroing`.
    """
    zeroing = Zeroing(model, settings, found, keep)
    limits = replace(options.pop("limits", None) or RigLimits(), ramp=0.0)
    more: dict[str, Any] = {"period": PERIOD, "name": Zeroing.name} | options
    duration = max(zeroing.longest, 2 * more["period"])
    drive = Drive(
        model, zeroing, nowhere, driver, zeroing, duration=duration, limits=limits,
        hold=zeroing.commands, **more,
    )  # fmt: skip
    return drive, zeroing


def _most(cable: PulledCable) -> float:
    """The way (m) of the command within which a pull must end."""
    return TRAVEL * cable.travel + MORE + BACK
