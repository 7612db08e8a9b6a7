"""Drives: from the commands that are sent to the values that act, over spans of any length.

A command passes first through the delay, then through the law of `softdyn.dynamics.motors`: the
bound on its rate and the lag. The speed command of a winch is integrated to its free length.

Controllers, the observer and plans use this law. The twin's drives are MuJoCo's own.
"""

from __future__ import annotations

from bisect import bisect_right
from operator import itemgetter
from typing import Any

import numpy as np

from softdyn.dynamics.model import SoftModel, State
from softdyn.dynamics.motors import driven_values, lag_shares
from softdyn.dynamics.winches import Winches

SAME = 1e-9  # s; times this close are one


class Drives:
    """The acting values of a robot's motors, over spans of any length.

    Parameters
    ----------
    lag, delay, rate : array_like, (m,)
        Time constant (s), delay (s) and largest rate of change of each command (1/s).
    winches : Winches, optional
        The winches; needed where a speed is commanded.
    speeds : ndarray of bool, (m,), optional
        Whether each command is the speed of a winch.

    Attributes
    ----------
    acting : ndarray, (m,)
        The value of each motor that acts now; of a commanded speed, that speed.
    """

    def __init__(
        self,
        lag: Any,
        delay: Any,
        rate: Any,
        winches: Winches | None = None,
        speeds: np.ndarray | None = None,
    ) -> None:
        self._lag, delays, self._rate = (np.array(one, float) for one in (lag, delay, rate))
        self._speeds = np.zeros(len(self._lag), bool) if speeds is None else speeds
        self._winches, self._longest = winches, float(delays.max(initial=0.0))
        # each delay with the motors that have it; None means all of them
        self._delays = [(float(one), delays == one) for one in np.unique(delays)]
        if len(self._delays) == 1:
            self._delays = [(self._longest, None)]
        self._bounded = bool(np.isfinite(self._rate).any())
        self._winds = bool(self._speeds.any())
        self._ideal = not (self._lag.any() or delays.any() or self._winds or self._bounded)

    @classmethod
    def of(cls, model: SoftModel) -> Drives:
        """The motors of a robot's file."""
        actuators = model.robot.actuators
        lag, delay, rate = (
            [getattr(actuator, name) for actuator in actuators] for name in ("lag", "delay", "rate")
        )
        return cls(lag, delay, rate, Winches(model), model.robot.speeds)

    def copy(self) -> Drives:
        """The same motors, which go on apart from these."""
        other = object.__new__(Drives)
        vars(other).update(vars(self), _sent=list(self._sent))
        return other

    def begin(self, acting: np.ndarray, t: float) -> None:
        """Begin at time t (s) with values (m,) that have acted for long."""
        self.acting = self._limited = acting
        self._sent = [(t - self._longest - 1.0, acting)]

    def reset(self, state: State, u: np.ndarray, t: float) -> None:
        """Begin at a state, with inputs u (m,) that have acted for long, at time t (s)."""
        assert self._winches is not None
        self.hold(self._winches.commands(state, u), t)

    def hold(self, values: np.ndarray, t: float) -> None:
        """Begin at time t (s) with u or free lengths (m,) that have acted for long."""
        self._free = values
        self.begin(np.where(self._speeds, 0.0, values), t)

    def send(self, t: float, commands: np.ndarray) -> None:
        """The commands (m,) that are sent at time t (s), before the end of the next span.

        No span begins before the commands that were sent last.
        """
        while len(self._sent) > 1 and self._sent[1][0] + self._longest <= self._sent[-1][0]:
            del self._sent[0]
        self._sent.append((t, commands.copy()))

    @property
    def commands(self) -> np.ndarray:
        """The values (m,) that act now: u, or free lengths of winches."""
        return np.where(self._speeds, self._free, self.acting) if self._winds else self.acting

    def over(self, begin: float, end: float) -> np.ndarray:
        """Mean acting values (m,) over the next span (s): u, or free lengths of winches."""
        if self._ideal and self._sent[-1][0] < begin + SAME:
            self.acting = self._sent[-1][1]
            return self.acting
        mean = np.zeros(len(self._lag))
        for delay, mask in self._delays:
            last = bisect_right(self._sent, begin + SAME - delay, key=itemgetter(0)) - 1
            at = begin
            for k in range(max(last, 0), len(self._sent)):
                until = end
                if k + 1 < len(self._sent):
                    until = min(self._sent[k + 1][0] + delay, end)
                if until > at + SAME:
                    part = self._piece(mask, self._sent[k][1], until - at)
                    mean += part * ((until - at) / (end - begin))
                    at = until
                if until == end:
                    break
        return self._wound(mean, end - begin) if self._winds else mean

    def _piece(self, mask: np.ndarray | None, target: np.ndarray, span: float) -> np.ndarray:
        """Mean acting values (m,) of the motors of `mask` while their target is constant."""
        reached = driven = target
        if self._bounded:
            reached, driven = driven_values(self._limited, target, span, self._rate)
        left, in_mean = lag_shares(span, self._lag)
        gap = self.acting - driven
        after, mean = driven + gap * left, driven + gap * in_mean
        if self._bounded:
            after = np.where(self._lag > 0, after, reached)
        if mask is not None:
            reached = np.where(mask, reached, self._limited)
            after = np.where(mask, after, self.acting)
            mean = np.where(mask, mean, 0.0)
        self._limited, self.acting = reached, after
        return mean

    def _wound(self, mean: np.ndarray, span: float) -> np.ndarray:
        """The mean values with the free lengths of winches in place of their speeds."""
        assert self._winches is not None
        before = self._free
        after = np.clip(before + mean * span, self._winches.lower, self._winches.upper)
        self._free = np.where(self._speeds, after, before)
        return np.where(self._speeds, 0.5 * (before + after), mean)
