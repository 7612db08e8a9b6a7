"""The way of a command to the plant as a controller knows it: the law of a drive, for all inputs.

One delay and one lag hold for all of them; `softdyn.actuation.drives` has the law.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.actuation.drives import Drives
from softdyn.checks import number
from softdyn.controllers.controller import KnownRig
from softdyn.description.rig import LONGEST_DELAY
from softdyn.dynamics.motors import lag_shares

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
        cls,
        model: SoftModel,
        delay: float | None = None,
        lag: float | None = None,
        rig: KnownRig | None = None,
    ) -> Actuation:
        """The actuation of a robot: delay and lag of the rig where none is given.

        Without a rig they are the longest of the robot's file.
        """
        actuators = model.robot.actuators
        if delay is None and rig is not None:
            delay = rig.delay
        elif delay is None:
            delay = max((actuator.delay for actuator in actuators), default=0.0)
        if lag is None and rig is not None:
            lag = rig.lag
        elif lag is None:
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
        self.period, self._t = period, 0.0
        self._left = float(lag_shares(period, self.lag)[0])
        every = np.ones(len(u))
        self._drives = Drives(self.lag * every, self.delay * every, math.inf * every)
        self._drives.begin(np.array(u, float), self._t)
        self._before = self._t, self._drives.copy()

    @property
    def acting(self) -> np.ndarray:
        """The input (nu,) that acts at the present instant."""
        return self._drives.acting

    def over_delay(self, longest: float) -> tuple[np.ndarray, np.ndarray]:
        """Mean inputs (steps, nu) over equal steps of the delay, and the input (nu,) at its end.

        Parameters
        ----------
        longest : float
            No step is longer (s), unless there would be more than 1000 of them.
        """
        steps = math.ceil(min(self.delay / longest, MOST_STEPS) - 1e-9)
        times = self._t + np.linspace(0.0, self.delay, steps + 1)
        ahead = self._drives.copy()
        means = [ahead.over(*span) for span in pairwise(times)]
        return np.array(means).reshape(steps, len(self.acting)), ahead.acting

    def command_for(self, goal: np.ndarray, start: np.ndarray) -> np.ndarray:
        """The command (nu,) under which the acting input goes from `start` to `goal` in a period.

        It is the goal itself where nothing lags.
        """
        return start + (goal - start) / (1.0 - self._left)

    def send(self, command: np.ndarray) -> np.ndarray:
        """A period goes by with this command sent at its begin; the mean input (nu,) of it."""
        self._before = self._t, self._drives.copy()
        end = self._t + self.period
        self._drives.send(self._t, command)
        mean = self._drives.over(self._t, end)
        self._t = end
        return mean

    def send_instead(self, command: np.ndarray) -> np.ndarray:
        """As `send`, for a command that was sent instead of the last one."""
        self._t, self._drives = self._before
        return self.send(command)
