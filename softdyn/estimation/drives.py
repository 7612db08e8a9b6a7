"""The acting commands of motors with delay, bounded rate and lag, over spans of any length.

Commands pass first through the delay, then through the bound on their rate, then through the lag
λ: with the driven value c and the acting value a at the begin of a span of length T,

    a⁺ = c + (a - c) e^(-T/λ),    mean(a) = c + (a - c) (1 - e^(-T/λ)) λ / T.

While a rate is at its bound, c is the middle of the values that it passes. The speed command of a
winch is integrated to its free length.
"""

from __future__ import annotations

from bisect import bisect_right
from operator import itemgetter

import numpy as np

from softdyn.actuation import Winches
from softdyn.description.rig import CommandKind
from softdyn.dynamics.model import SoftModel, State

SAME = 1e-9  # s; times this close are one


class Drives:
    """The motors of a robot.

    Parameters
    ----------
    model : SoftModel
        The robot's model.
    """

    def __init__(self, model: SoftModel) -> None:
        actuators = model.robot.actuators
        self._winches = Winches(model)
        self._lag, delay, self._rate = (
            np.array([getattr(a, name) for a in actuators], float)
            for name in ("lag", "delay", "rate")
        )
        self._speeds = np.array([a.command is CommandKind.VELOCITY for a in actuators], bool)
        self._delays = [(float(one), delay == one) for one in np.unique(delay)]
        self._longest = float(delay.max(initial=0.0))
        self._ideal = not (self._lag.any() or delay.any() or self._speeds.any()) and bool(
            np.isinf(self._rate).all()
        )

    def reset(self, state: State, u: np.ndarray, t: float) -> None:
        """Begin at a state, with inputs u (m,) that have acted for long, at time t (s)."""
        self._free = self._winches.commands(state, u)
        self._limited = np.where(self._speeds, 0.0, self._free)
        self._acting = self._limited.copy()
        self._sent = [(t - self._longest - 1.0, self._limited.copy())]

    def send(self, t: float, commands: np.ndarray) -> None:
        """The commands (m,) that are sent at time t (s), the begin of a span or before it."""
        if self._ideal:
            self._sent[-1][1][:] = commands
            return
        while len(self._sent) > 1 and self._sent[1][0] + self._longest <= t:
            del self._sent[0]
        self._sent.append((t, commands.copy()))

    def over(self, begin: float, end: float) -> np.ndarray:
        """Mean acting commands (m,) over the next span (s): u, or free lengths of winches."""
        if self._ideal:
            return self._sent[-1][1]
        mean = np.zeros(len(self._lag))
        for delay, mask in self._delays:
            last = bisect_right(self._sent, begin + SAME - delay, key=itemgetter(0)) - 1
            at = begin
            for k in range(max(last, 0), len(self._sent)):
                until = end
                if k + 1 < len(self._sent):
                    until = min(self._sent[k + 1][0] + delay, end)
                if until > at + SAME:
                    part = self._piece(mask, self._sent[k][1][mask], until - at)
                    mean[mask] += part * (until - at) / (end - begin)
                    at = until
                if until == end:
                    break
        speed = mean[self._speeds]
        free = self._free[self._speeds]
        after = free + speed * (end - begin)
        lower, upper = self._winches.lower[self._speeds], self._winches.upper[self._speeds]
        self._free[self._speeds] = after = np.clip(after, lower, upper)
        mean[self._speeds] = 0.5 * (free + after)
        return mean

    def _piece(self, mask: np.ndarray, target: np.ndarray, span: float) -> np.ndarray:
        """Mean acting values of some motors while their target is constant."""
        reach = self._rate[mask] * span
        begin, lag, acting = self._limited[mask], self._lag[mask], self._acting[mask]
        end = begin + np.clip(target - begin, -reach, reach)
        driven = np.where(np.isinf(reach), target, 0.5 * (begin + end))
        share = np.divide(span, lag, out=np.full(len(lag), np.inf), where=lag > 0)
        gap = acting - driven
        self._limited[mask] = end
        lagged = driven + gap * np.exp(-share)
        self._acting[mask] = np.where(lag > 0, lagged, end)
        means: np.ndarray = driven + gap * -np.expm1(-share) / share
        return means
