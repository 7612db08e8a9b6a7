"""The law of a motor between its command and the robot, and its states with their Jacobians.

A command passes through the bound on its rate, then through the lag λ. With the driven value c and
the acting value a at the begin of a span of length T,

    a⁺ = c + (a - c) e^(-T/λ),    mean(a) = c + (a - c) (1 - e^(-T/λ)) λ / T.

While a rate is at its bound, c is the middle of the values that it passes. The speed command of a
winch is integrated to its free length, within its bounds.

`softdyn.actuation.drives` has this law with delays. `Motors` has its Jacobians, for
`softdyn.dynamics.discretisation.discrete_step`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from softdyn.dynamics.model import SoftModel, check_model
from softdyn.dynamics.winches import Winches


def lag_shares(span: Any, lag: Any) -> tuple[np.ndarray, np.ndarray]:
    """The shares of a - c that are left after a span (s) and in its mean: e^(-T/λ) and its mean.

    Both are zero where the lag (s) is zero.
    """
    with np.errstate(divide="ignore"):
        ratio = np.divide(span, lag)
    return np.exp(-ratio), -np.expm1(-ratio) / ratio


def driven_values(
    limited: np.ndarray, target: np.ndarray, span: float, rate: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The command behind its bounded rate (m,): its value after a span (s), and the driven value.

    Parameters
    ----------
    limited, target : ndarray, (m,)
        Its value at the begin, and the command.
    span : float
        T (s).
    rate : ndarray, (m,)
        Largest rates (1/s), infinite without a bound.
    """
    reach = rate * span
    reached = limited + np.clip(target - limited, -reach, reach)
    return reached, np.where(np.isinf(reach), target, 0.5 * (limited + reached))


class MotorSpan(NamedTuple):
    """The motors after a span, and their values during it.

    Attributes
    ----------
    after : ndarray, (k,)
        The states at its end.
    mean : ndarray, (m,)
        The mean values that act: u, or free lengths of winches less their offsets.
    after_by_state, after_by_command : ndarray, (k, k), (k, m)
        Jacobians of `after`.
    mean_by_state, mean_by_command : ndarray, (m, k), (m, m)
        Jacobians of `mean`.
    """

    after: np.ndarray
    mean: np.ndarray
    after_by_state: np.ndarray
    after_by_command: np.ndarray
    mean_by_state: np.ndarray
    mean_by_command: np.ndarray


class Motors:
    """The states of a robot's motors, without delays.

    The first m states are the values that act on the robot: the force u of a motor, or the free
    length of a winch less its offset. Then follow the acting speeds of winches that command a speed
    and have a lag or a bounded rate. The commands behind their bounded rates come last, of motors
    with a lag and a bounded rate.

    Parameters
    ----------
    model : SoftModel
        The robot's model; its file states the motors.

    Attributes
    ----------
    size : int
        k, the number of states: m, or more where motors have several.
    """

    def __init__(self, model: SoftModel) -> None:
        self._model, self._winches = check_model(model), Winches(model)
        actuators, m = model.robot.actuators, model.nu
        self._lag = np.array([one.lag for one in actuators], float)
        self._rate = np.array([one.rate for one in actuators], float)
        self._speeds = np.array([one.is_speed for one in actuators], bool)
        bounded, lags = np.isfinite(self._rate), self._lag > 0
        # the place in the state of the command behind its rate, of the acting value and of the
        # free length of each motor; none has the place of the last one, a zero that is cut off
        moving = np.flatnonzero(self._speeds & (bounded | lags))
        both = np.flatnonzero(bounded & lags)
        self.size = m + len(moving) + len(both)
        self._places = np.full((3, m), self.size)
        self._places[1] = np.where(self._speeds, self.size, np.arange(m))
        self._places[1, moving] = m + np.arange(len(moving))
        self._places[0, bounded] = self._places[1, bounded]
        self._places[0, both] = m + len(moving) + np.arange(len(both))
        self._places[2, self._speeds] = np.flatnonzero(self._speeds)

    def settled(self, q: np.ndarray, v: np.ndarray, commands: np.ndarray) -> np.ndarray:
        """The states (k,) under commands (m,) that have acted for long.

        A winch that commands a speed has the free length at which its cable is just slack.
        """
        model, free = self._model, np.zeros(self._model.nu)
        if self._speeds.any():
            free = self._winches.commands(model.state(q, v), model.relaxed)
        found = np.zeros(self.size + 1)
        for places, values in zip(self._places, (commands, commands, free), strict=True):
            found[places] = values
        return found[:-1]

    def over(self, states: np.ndarray, commands: np.ndarray, span: float) -> MotorSpan:
        """The motors over a span (s) under constant commands (m,), from their states (k,)."""
        m = len(commands)
        limited, acting, free = np.append(states, 0.0)[self._places]
        # rows (m,) of derivatives by limited, acting, free and command
        of = np.eye(4)[:, :, None] * np.ones(m)
        bounded = np.isfinite(self._rate)
        reached, driven = driven_values(limited, commands, span, self._rate)
        inside = np.abs(commands - limited) <= self._rate * span
        by_reached = np.where(inside, of[3], of[0])
        by_driven = np.where(bounded, 0.5 * (of[0] + by_reached), of[3])
        left, in_mean = lag_shares(span, self._lag)
        after, mean = driven + (acting - driven) * left, driven + (acting - driven) * in_mean
        by_after = by_driven + (of[1] - by_driven) * left
        by_mean = by_driven + (of[1] - by_driven) * in_mean
        ends_reached = bounded & (self._lag == 0)
        after, by_after = (
            np.where(ends_reached, reached, after), np.where(ends_reached, by_reached, by_after)
        )  # fmt: skip
        lower, upper = self._winches.lower, self._winches.upper
        wound = np.clip(free + mean * span, lower, upper)
        turns = (lower < wound) & (wound < upper)
        by_wound = np.where(turns, of[2] + by_mean * span, 0.0)
        mean = np.where(self._speeds, 0.5 * (free + wound), mean)
        by_mean = np.where(self._speeds, 0.5 * (of[2] + by_wound), by_mean)

        found, slopes = np.zeros(self.size + 1), np.zeros((self.size + 1, self.size + 1 + m))
        ends = ((reached, by_reached), (after, by_after), (wound, by_wound))
        # a motor with a bounded rate and no lag has one state in both places, with the same value
        for places, (values, by) in zip(self._places, ends, strict=True):
            found[places] = values
            slopes[places] = self._spread(by)
        by_mean = self._spread(by_mean)
        k, parts = self.size, (slice(0, self.size), slice(self.size + 1, None))
        return MotorSpan(
            found[:k], mean, *(slopes[:k, part] for part in parts),
            *(by_mean[:, part] for part in parts),
        )  # fmt: skip

    def _spread(self, by: np.ndarray) -> np.ndarray:
        """Derivatives (4, m) of m numbers, as rows (m, k + 1 + m) by states and commands."""
        m = by.shape[1]
        rows = np.zeros((m, self.size + 1 + m))
        for places, column in zip(self._places, by, strict=False):
            np.add.at(rows, (np.arange(m), places), column)
        rows[np.arange(m), self.size + 1 + np.arange(m)] += by[3]
        return rows
