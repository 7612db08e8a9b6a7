"""A rig behind its driver, as the plant of a loop, and the observer that sees it."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from softdyn import SoftModel, State
from softdyn.actuation import Winches
from softdyn.controllers.channels import LogChannel
from softdyn.description.readings import ReadingLayout
from softdyn.estimation import Observer
from softdyn.exceptions import one_line
from softdyn.statics import StaticsError, rest
from softdyn.validation.bench.clock import MONOTONIC, TimeSource
from softdyn.validation.bench.driver import Driver, NewestReadings
from softdyn.validation.bench.fail_safe import FailSafe, Stop, StopCause
from softdyn.validation.channels import inputs, positions, rates
from softdyn.validation.loop.arguments import starting_pose
from softdyn.validation.twin.readings import command_units

FIRST_READINGS = 3.0  # s for every sensor's first reading after `start`
SOONEST = 1e-6  # s between two estimates
PAUSE = 0.002  # s between two looks for them


@contextmanager
def blamed(cause: StopCause, what: str) -> Iterator[None]:
    """Turn an exception of the block into a `Stop` with this cause."""
    try:
        yield
    except Stop:
        raise
    except Exception as error:
        reason = one_line(f"{what}: {type(error).__name__}: {error}", 300)
        raise Stop(cause, reason) from error


def rest_pose(model: SoftModel) -> np.ndarray:
    """The configuration (nq,) in which a relaxed arm rests, or else a run's default start."""
    try:
        found = rest(model).q
    except StaticsError:
        found = None
    return starting_pose(model, found)[0]


class RealRig:
    """A rig behind a driver; it is a `softdyn.validation.loop.plants.Plant`.

    Only an observer knows its state. The controller's forces become commands as the file's motors
    take them. In the first `RigLimits.ramp` seconds they rise from the relaxed input.

    Parameters
    ----------
    model : SoftModel
        The robot with its rig.
    driver : Driver
        Its driver.
    safe : FailSafe
        It stops the run.
    period : float
        Control period (s).
    controller : Any, optional
        Its `applied` hears of inputs that the ramp has changed.
    hold : ndarray, (nu,), or Callable[[], ndarray], optional
        Commands that are sent instead of the controller's: constant, or those of each period.
    source : TimeSource
        The clock.

    Attributes
    ----------
    read : NewestReadings
        The readings.
    sent : ndarray, (nu,)
        The last commands.
    sent_at : float
        When they were sent (s).
    pose : ndarray, (nq,)
        The configuration at which the run begins.
    relaxed : ndarray, (nu,)
        The input nearest to zero within its bounds.
    begin : float
        The time of the first period on the clock of `time.monotonic` (s).
    late, missed : float, int
        Lateness (s) of the present period, and deadlines missed before it.
    """

    real_time, alters_states = True, False

    def __init__(
        self,
        model: SoftModel,
        driver: Driver,
        safe: FailSafe,
        period: float,
        controller: Any = None,
        hold: np.ndarray | Callable[[], np.ndarray] | None = None,
        source: TimeSource = MONOTONIC,
    ) -> None:
        robot = model.robot
        self._model, self._driver, self._safe, self._period = model, driver, safe, period
        self._winches, self._hold, self._source = Winches(model), hold, source
        self._speeds = robot.speeds
        self._told: Callable[[np.ndarray], None] | None = getattr(controller, "applied", None)
        readings = ReadingLayout(robot.sensors)
        self.read = NewestReadings(readings.size)
        self.relaxed = model.relaxed
        self.begin, self.late, self.missed, self._steps = 0.0, 0.0, 0, 0
        self.sent_at = 0.0
        self.settings: Mapping[str, Any] = {"contacts": True, "plant": type(driver).__name__}
        motors = [actuator.name for actuator in robot.actuators]
        self.channels = (
            LogChannel.of("command", zip(motors, command_units(robot), strict=True), held=True),
            LogChannel.of("acting", inputs(model)),
            LogChannel.of("measured", zip(readings.names, readings.units(robot), strict=True)),
            LogChannel.of("q_seen", positions(model), held=True),
            LogChannel.of("v_seen", rates(model), held=True),
            LogChannel("clock", units=("s",)),
            LogChannel.of("stamps", [(name, "s") for name in readings.names], "stamp"),
            LogChannel("missed"),
        )
        self.start(model.q0, np.zeros(model.nv))

    def start(
        self, q: np.ndarray, v: np.ndarray, t: float = 0.0, u: np.ndarray | None = None
    ) -> None:
        """Take the motors as relaxed at the pose q (nq,); the driver is not touched."""
        self.pose = q
        self._free = self._winches.commands(self._model.state(q, v), self.relaxed)
        self._first = self.sent = np.where(self._speeds, 0.0, self._free)
        self.acting, self._steps = self.relaxed, 0

    def open(self, check: Callable[[], None] = lambda: None) -> None:
        """Start the driver, and wait for every sensor's first reading.

        Parameters
        ----------
        check : Callable[[], None]
            Called meanwhile; it stops the run by an exception.

        Raises
        ------
        Stop
            An exception of the driver, or a sensor that stays silent.
        """
        with blamed(StopCause.DRIVER, "start()"):
            self._driver.start()
        check()
        patience = self._source.now() + FIRST_READINGS
        while np.isnan(self.read.stamps).any() and self._source.now() < patience:
            self._take()
            check()
            self._source.sleep(PAUSE)
        self._take()
        self._safe.readings(self.read, self._source.now())

    def _take(self) -> float:
        """Read the driver; return the time (s)."""
        with blamed(StopCause.DRIVER, "read()"):
            values, stamps = self._driver.read()
            now = self._source.now()
            self.read.take(values, stamps, now)
        return now

    def state(self) -> None:
        """None: only an observer knows the state."""

    def sample(self) -> dict[str, Any]:
        """The newest readings (k,), their times, and the time of this reading of the clock.

        Raises
        ------
        Stop
            The run must not go on.
        """
        now = self._take()
        self._safe.readings(self.read, now)
        return {
            "acting": self.acting, "measured": self.read.values.copy(),
            "clock": self.begin + self.time + self.late,
            "stamps": self.read.stamps - self.begin, "missed": self.missed,
        }  # fmt: skip

    def see(self, state: State) -> State:
        """The state itself."""
        return state

    @property
    def time(self) -> float:
        """The beginning of the present period (s), from that of the first one."""
        return self._steps * self._period

    def leave_out(self, periods: int) -> None:
        """Periods pass without a control step; the last commands act on."""
        self._steps += periods
        self._wind(periods)

    def _wind(self, periods: int) -> None:
        """Winches turn at their commanded speeds."""
        moved = self._free + np.where(self._speeds, self.sent * self._period * periods, 0.0)
        self._free = np.clip(moved, self._winches.lower, self._winches.upper)

    def advance(self, u: np.ndarray, steps: int, seen: State) -> dict[str, np.ndarray]:
        """Send the commands for the input u (nu,), computed at the state `seen`."""
        ramp = self._safe.limits.ramp
        share = min(self.time / ramp, 1.0) if ramp > 0 else 1.0
        self.send(u, share, seen)
        if share < 1.0 and self._told is not None:
            self._told(self.acting)
        return {"command": self.sent}

    def send(self, u: np.ndarray, share: float, seen: State) -> None:
        """Send the commands of a period: a share of the way from the relaxed input to u (nu,)."""
        if self._hold is not None:
            held = self._hold() if callable(self._hold) else self._hold
            asked = self._first + share * (held - self._first)
            self.acting = u
        else:
            self.acting = self.relaxed + share * (u - self.relaxed)
            lengths = self._winches.commands(seen, self.acting)
            asked = np.where(self._speeds, (lengths - self._free) / self._period, lengths)
        self._safe.commands(asked)
        self.sent = asked
        self._wind(1)
        self._steps += 1
        self.sent_at = self._source.now()
        with blamed(StopCause.DRIVER, "send()"):
            self._driver.send(asked.copy())


class SeeingObserver:
    """An observer that gets only new readings, with their times if it takes them.

    Its exceptions and a lost estimate stop the run. All other attributes are the observer's.

    Parameters
    ----------
    observer : Observer
        The observer.
    rig : RealRig
        The rig.
    safe : FailSafe
        It stops the run.
    """

    def __init__(self, observer: Observer, rig: RealRig, safe: FailSafe) -> None:
        self.observer, self._rig, self._safe = observer, rig, safe
        self._takes = {"stamps", "sent"} & set(inspect.signature(observer.step).parameters)
        self._time = -math.inf

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "observer":
            raise AttributeError(name)
        return getattr(self.observer, name)

    def reset(self) -> None:
        """Begin a run, where the rig begins if the observer's `reset` takes a ``q``."""
        resets = getattr(self.observer, "reset", None)
        if resets is not None:
            known = inspect.signature(resets).parameters
            resets(**({"q": self._rig.pose} if "q" in known else {}))
        self._time = -math.inf

    def step(self, t: float, measurements: np.ndarray, u: np.ndarray) -> Any:
        """The observer's estimate at t (s), or at the newest reading of a step that is late."""
        read, begin = self._rig.read, self._rig.begin
        newest = np.nanmax(read.stamps, initial=begin + t) - begin
        self._time = t = max(newest, self._rig.time, self._time + SOONEST)
        times = {"stamps": read.stamps - begin, "sent": self._rig.sent_at - begin}
        more = {name: times[name] for name in self._takes}
        with blamed(StopCause.OBSERVER, "observer"):
            estimate = self.observer.step(t, read.new, u, **more)
            if not (np.isfinite(estimate.q).all() and np.isfinite(estimate.v).all()):
                raise ValueError("an estimate that is not finite")
        self._safe.used(estimate, read.values, t)
        self._safe.estimate(estimate, t)
        return estimate
