"""The beginnings of control periods, as absolute deadlines on the monotonic clock."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

LATE = 0.5  # of a period; one that cannot begin before is left out


@dataclass(frozen=True)
class TimeSource:
    """A clock (s), and how to wait on it for a time (s)."""

    now: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep


MONOTONIC = TimeSource()


class Deadlines:
    """Period k begins at its deadline, begin + k · period, so that lateness never adds up.

    A deadline is missed if the loop is still at work when it passes, or asleep until the next one.
    The last command then acts longer. A period that would begin more than half a period late is
    left out, and the next one begins at its deadline.

    Parameters
    ----------
    period : float
        Control period (s).
    source : TimeSource
        The clock.

    Attributes
    ----------
    begin : float
        The time of period 0 (s); NaN before it.
    missed : int
        Missed deadlines.
    in_a_row : int
        Missed deadlines since the last one that was kept.
    late : float
        Lateness (s) of the last beginning.
    """

    def __init__(self, period: float, source: TimeSource = MONOTONIC) -> None:
        self.period, self._now, self._sleep = period, source.now, source.sleep
        self.begin, self.missed, self.in_a_row, self.late, self._next = math.nan, 0, 0, 0.0, 0

    def at(self, k: int) -> float:
        """The deadline (s) of period `k`."""
        return self.begin + k * self.period

    @property
    def left(self) -> float:
        """Time (s) to the next deadline; negative after it."""
        return self.at(self._next) - self._now()

    def wait(self) -> int:
        """Sleep until the next period begins; return the number of periods left out before it.

        The first call does not sleep: period 0 begins with it.
        """
        if not self._next:
            self.begin, self._next = self._now(), 1
            return 0
        k, over = self._next, -self.left
        missed = 0 if over <= 0 else math.floor(over / self.period) + 1
        first = k + max(missed - 1, 0)
        if missed and self._now() - self.at(first) > LATE * self.period:
            first += 1
        if (left := self.at(first) - self._now()) > 0:
            self._sleep(left)
        woke = self._now()
        asleep = max(math.floor((woke - self.at(first)) / self.period), 0)
        first += asleep
        missed += asleep
        self.late, self._next = woke - self.at(first), first + 1
        self.missed += missed
        self.in_a_row = self.in_a_row + missed if missed else 0
        return first - k
