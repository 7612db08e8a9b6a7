"""The way of a command to the plant as a controller knows it: a delay, then a first-order lag.

A command c acts after the delay, through λ ȧ = c - a. Between two changes of the command

    a(t) = c + (a(0) - c) e^(-t/λ),      its mean over [0, t]  c + (a(0) - c) (1 - e^(-t/λ)) λ/t.
"""

from __future__ import annotations

import math

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.checks import number
from softdyn.compiled import compiled
from softdyn.description.rig import LONGEST_DELAY

MOST_WAITING = 20_000  # commands on their way: 10 s in periods of 0.5 ms
MOST_STEPS = 1_000  # of a prediction over the delay


class Actuation:
    """The commands on their way to the plant, and the input that acts there.

    Parameters
    ----------
    delay : float
        Time (s) from a state to the begin of the command that answers it.
    lag : float
        Time constant λ (s) of the actuators.

    Attributes
    ----------
    acting : ndarray, (nu,)
        The input that acts at the present instant.

    Raises
    ------
    InputError
        A time that is negative or not finite, a delay of more than 10 s.
    """

    def __init__(self, delay: float = 0.0, lag: float = 0.0) -> None:
        self.delay = number("delay", delay, lower=0.0, upper=LONGEST_DELAY)
        self.lag = number("lag", lag, lower=0.0)

    @classmethod
    def of(
        cls, model: SoftModel, delay: float | None = None, lag: float | None = None
    ) -> Actuation:
        """The actuation of a robot: the longest delay and lag of its file where none is given."""
        actuators = model.robot.actuators
        if delay is None:
            delay = max((actuator.delay for actuator in actuators), default=0.0)
        if lag is None:
            lag = max((actuator.lag for actuator in actuators), default=0.0)
        return cls(delay, lag)

    def reset(self, period: float, u: np.ndarray) -> None:
        """Begin a run with a control period (s): `u` (nu,) has acted long enough to act whole.

        Raises
        ------
        InputError
            A period that is not positive, or so short that too many commands are on their way.
        """
        number("period", period, above=0.0)
        if not self.delay / period <= MOST_WAITING:
            least = f"{self.delay / MOST_WAITING:.3g} s or more, for a delay of {self.delay:g} s"
            raise InputError("period", least, f"{period:g} s")
        whole = math.floor(self.delay / period + 1e-9)
        rest = max(self.delay - whole * period, 0.0)
        rest = rest if rest > 1e-9 * period else 0.0
        count = whole + (rest > 0)
        self.period, self.acting = period, np.array(u, float)
        self._waiting = np.tile(self.acting, (count, 1))
        self._spans = np.full(count, period)
        self._spans[:1] = rest or period
        self._first = rest
        self._before = self.acting, self._waiting
        self.kept = math.exp(-period / self.lag) if self.lag > 0 else 0.0

    def over_delay(self, longest: float) -> tuple[np.ndarray, np.ndarray]:
        """Mean inputs (steps, nu) over equal steps of the delay, and the input (nu,) at its end.

        Parameters
        ----------
        longest : float
            No step is longer (s), unless there would be more than 1000 of them.
        """
        steps = math.ceil(min(self.delay / longest, MOST_STEPS) - 1e-9)
        return _means(self._waiting, self._spans, self.acting, self.lag, steps)

    def command_for(self, goal: np.ndarray, start: np.ndarray) -> np.ndarray:
        """The command (nu,) under which the acting input goes from `start` to `goal` in a period.

        It is the goal itself where nothing lags.
        """
        return start + (goal - start) / (1.0 - self.kept)

    def send(self, command: np.ndarray) -> np.ndarray:
        """A period goes by with this command sent at its begin; the mean input (nu,) of it."""
        self._before = self.acting, self._waiting
        sent = np.vstack((self._waiting, command))
        spans = np.array([self._first, self.period - self._first])
        acts = sent[:2] if self._first > 0 else sent[:1]
        means, self.acting = _means(acts, spans[-len(acts) :], self.acting, self.lag, 1)
        self._waiting = sent[1:]
        mean: np.ndarray = means[0]
        return mean

    def send_instead(self, command: np.ndarray) -> np.ndarray:
        """As `send`, for a command that was sent instead of the last one."""
        self.acting, self._waiting = self._before
        return self.send(command)


@compiled
def _means(commands, spans, acting, lag, steps):
    """Means (steps, m) of the acting input over equal parts of all spans, and its last value."""
    m = len(acting)
    means, acts = np.zeros((steps, m)), acting.copy()
    total = 0.0
    for span in spans:
        total += span
    part = total / max(steps, 1)
    k, room = 0, part
    for i in range(len(spans)):
        left = spans[i]
        while left > 1e-9 * part:
            dt = min(left, room)
            share = dt / lag if lag > 0 else np.inf
            kept = np.exp(-share)
            mean = -np.expm1(-share) / share if lag > 0 else 0.0
            for j in range(m):
                gap = acts[j] - commands[i, j]
                means[k, j] += dt / part * (commands[i, j] + gap * mean)
                acts[j] = commands[i, j] + gap * kept
            left, room = left - dt, room - dt
            if room <= 1e-9 * part and k < steps - 1:
                k, room = k + 1, part
    return means, acts
