"""The clock of a control loop: it starts the periods, and counts delays and missed periods."""

from __future__ import annotations

from dataclasses import dataclass, field
from time import perf_counter, sleep

import numpy as np

RATE = 40.0  # frames a second of a clock
IDLE = 0.02  # s between two reads of the messages
LATEST = 0.05  # s; with a larger delay the clock does not catch up, but runs slower
SPAN = 0.5  # s, the time over which the pace is measured


@dataclass(frozen=True)
class ClockStatistics:
    """Statistics of a clock: misses, delays, step times, pace.

    Attributes
    ----------
    periods, misses : int
        Number of control periods, and of those that ended after the next one was due.
    wake_us, step_us : dict of str to float
        Median, p99 and maximum of the delay of a period's start, and of the control step (µs).
    pace : float
        Simulated seconds per second.
    """

    periods: int
    misses: int
    wake_us: dict[str, float]
    step_us: dict[str, float]
    pace: float


@dataclass
class Clock:
    """Wakes a loop once a period, and records its delays.

    Parameters
    ----------
    period : float
        Control period (s, simulated).
    speed : float
        Simulated seconds per second.
    keep : int
        Number of periods whose times are stored for `statistics`.

    Attributes
    ----------
    periods, misses : int
        Number of finished periods, and of those that ended after the next one was due.
    pace : float
        Simulated seconds per second over the last half second.
    worst_wake, worst_step : float
        Largest delay of a start and longest control step since the last frame (µs).
    """

    period: float
    speed: float = 1.0
    keep: int = 0
    periods: int = 0
    misses: int = 0
    pace: float = 0.0
    worst_wake: float = 0.0
    worst_step: float = 0.0
    _due: float = 0.0
    _frame: float = 0.0
    _since: tuple[float, int] = (0.0, 0)
    _times: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    def __post_init__(self) -> None:
        self._times = np.zeros((self.keep, 2))
        self.begin()

    def begin(self) -> None:
        """Restart the clock now, after a pause or other work."""
        now = perf_counter()
        self._due, self._since = now, (now, self.periods)
        self._began = (now, self.periods)

    def wait(self, longest: float = float("inf")) -> bool:
        """Sleep until the next period is due, at most `longest` (s); True if it is due."""
        now = perf_counter()
        if self._due - now > longest:
            sleep(longest)
            return False
        if now < self._due:
            sleep(self._due - now)
            now = perf_counter()
        late = now - self._due
        self._wake = 1e6 * late
        if late > LATEST:  # the machine is too slow: give up the lost time
            self._due = now
        self.worst_wake = max(self.worst_wake, self._wake)
        return True

    def done(self, step_us: float) -> None:
        """End a period whose control step took `step_us` (µs)."""
        k, now = self.periods, perf_counter()
        self._due += self.period / self.speed
        self.misses += now > self._due
        if k < self.keep:
            self._times[k] = self._wake, step_us
        self.worst_step = max(self.worst_step, step_us)
        self.periods = k + 1
        then, before = self._since
        if now - then > SPAN:
            self.pace = (self.periods - before) * self.period / (now - then)
            self._since = (now, self.periods)

    def frame(self, rate: float) -> bool:
        """True when a frame is due, at `rate` frames a second."""
        now = perf_counter()
        if now < self._frame:
            return False
        self._frame = max(self._frame + 1 / rate, now)
        return True

    def statistics(self) -> ClockStatistics:
        """Statistics of all periods since the clock began."""
        count = min(self.periods, self.keep)
        wake, step = (
            {"median": float(np.median(row)), "p99": float(np.percentile(row, 99)),
             "max": float(row.max())}
            for row in self._times[:count].T
        ) if count else ({}, {})  # fmt: skip
        then, before = self._began
        pace = (self.periods - before) * self.period / max(perf_counter() - then, 1e-9)
        return ClockStatistics(self.periods, self.misses, wake, step, pace)
