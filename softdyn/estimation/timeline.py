"""The events of a filter in the order of their times: commands that act, readings, the clock.

A command acts from the time at which it was sent, behind the delay, rate and lag of its motor
(`softdyn.actuation.drives`). A late reading has two events: at its own time it is expected, and
later it arrives. Between two events the commands are those of a `Span`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from enum import Enum, auto
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from softdyn.actuation.drives import Drives
from softdyn.checks import real
from softdyn.description.readings import SAME
from softdyn.dynamics.model import State
from softdyn.estimation.arrivals import SensorChannel
from softdyn.estimation.covariance import usable

LATEST = 1e10  # s; a double resolves microseconds up to here
SHORTEST = 1e-9  # s; a step that is shorter is none
LONGEST_GAP = 0.5  # s without a step; after it the covariance begins anew
LARGEST = 1e6  # no reading is larger (rad, m, N, …)
LONGEST_AGE = 0.02  # s; a stamped reading that nothing waits for may be so old
SET_BACK = 10  # refused steps with rising times; the clock is taken to be set back then


class StepTime(Enum):
    """The kinds of a step's time: none that counts, the first one, the next one and so on."""

    REFUSED = auto()
    FIRST = auto()
    NEXT = auto()
    GAP = auto()
    SET_BACK = auto()


class Span(NamedTuple):
    """The mean commands (m,) that act over the next `length` (s)."""

    commands: np.ndarray
    length: float


class Expected(NamedTuple):
    """The own time (s) of readings that arrive later."""

    time: float
    channel: SensorChannel


class Reading(NamedTuple):
    """The readings of one channel that arrive.

    Attributes
    ----------
    channel : SensorChannel
        Its sensors.
    time : float
        Their own time (s); NaN where their stamps do not say it.
    given : ndarray, (k,)
        The readings, NaN for those that are of no use.
    good : int
        The number of the others.
    stamped : bool
        Whether the time is of stamps, not of the file's rate and latency.
    """

    channel: SensorChannel
    time: float
    given: np.ndarray
    good: int
    stamped: bool


class Timeline:
    """The events of one run.

    Parameters
    ----------
    drives : Drives
        The motors, which keep the commands that were sent.
    channels : list of SensorChannel
        The sensors; nothing of theirs is expected at first.
    longest : float
        No span is longer (s).

    Attributes
    ----------
    time : float
        The time (s) of the last event; NaN before the first.
    """

    time: float

    def __init__(self, drives: Drives, channels: list[SensorChannel], longest: float) -> None:
        self._drives, self._channels, self._longest = drives, channels, longest
        self._refused, self._behind = -math.inf, 0
        self.skip(math.nan)

    @property
    def commands(self) -> np.ndarray:
        """The values (m,) of the motors that act now."""
        return self._drives.commands

    def accept(self, t: float) -> StepTime:
        """The kind of the time t (s) of a step."""
        first = math.isnan(self.time)
        if not abs(t) <= LATEST or (not first and t < self.time + SHORTEST):
            behind = self._refused < t <= self.time
            self._refused, self._behind = t, self._behind + 1 if behind else 0
            if self._behind < SET_BACK:
                return StepTime.REFUSED
            self.time = -math.inf
        self._refused, self._behind = -math.inf, 0
        if first or self.time == -math.inf:
            return StepTime.FIRST if first else StepTime.SET_BACK
        return StepTime.GAP if t - self.time > LONGEST_GAP else StepTime.NEXT

    def begin(self, t: float, state: State, u: np.ndarray) -> None:
        """Inputs u (nu,) have acted for long at a state, and nothing else was before t (s)."""
        self._drives.reset(state, u, t)
        self.skip(t)

    def send(self, t: float, commands: np.ndarray, sent: float | None = None) -> None:
        """Commands (m,) were sent at the last event or at a later time `sent` (s), before t (s)."""
        since = max(self.time, t - LONGEST_GAP)
        at = since if sent is None else real("sent", sent)
        self._drives.send(at if since < at < t else since, commands)

    def skip(self, t: float) -> None:
        """Go to the time t (s) without events; nothing is expected any more."""
        self.time = t
        for channel in self._channels:
            channel.forget()

    def until(
        self, t: float, readings: np.ndarray, stamps: np.ndarray | None
    ) -> Iterator[Span | Expected | list[Reading]]:
        """The events up to t (s), with all readings that arrive at t in one list.

        Parameters
        ----------
        t : float
            Now (s).
        readings : ndarray, (k,)
            The readings that are there now. Those of no use become NaN.
        stamps : ndarray, (k,), optional
            Their own times (s).
        """
        begin, self.time = self.time, t
        waiting = [
            Expected(own, one) for one in self._channels
            for own in one.pending_times(begin, t, stamps is not None)
        ]  # fmt: skip
        waiting.sort(key=itemgetter(0))
        near, at, done = SAME * (t - begin), begin, 0
        # a camera's picture of this instant is expected once the other readings of it are known
        for event in waiting:
            if event.time >= t - near or begin == t:
                break
            if event.time > at + near:
                yield from self._spans(at, event.time)
                at = event.time
            yield event
            done += 1
        if at != t:
            yield from self._spans(at, t)
        yield self._arriving(t, readings, stamps)
        yield from waiting[done:]

    def _spans(self, begin: float, end: float) -> Iterator[Span]:
        """Spans of equal length, none longer than `longest`."""
        count = max(math.ceil((end - begin) / self._longest - SAME), 1)
        length = (end - begin) / count
        for k in range(count):
            commands = self._drives.over(begin + k * length, begin + (k + 1) * length)
            yield Span(commands, length)

    def _arriving(self, t: float, readings: np.ndarray, stamps: np.ndarray | None) -> list[Reading]:
        found, stamped = [], stamps is not None
        for channel in self._channels:
            if not (stamped or channel.arrives(t)):
                continue
            given, own = readings[channel.where], math.nan
            good = usable(given, LARGEST)
            if stamps is None:
                own = channel.times.own_time(t)
            elif good:
                own = float(stamps[channel.where][np.isfinite(given)].mean())
                own, good = min(own, t + LONGEST_AGE), good if math.isfinite(own) else 0
            found.append(Reading(channel, own, given, good, stamped))
        return found
