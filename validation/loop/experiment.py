"""The task of a closed loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from softdyn import Reference

SET_POINT_DURATION = 10.0  # s, of a run that is not told how long it lasts
DEFAULT_PERIOD = 0.002  # s, of a run that is not told how often its controller acts


@dataclass(frozen=True)
class Experiment:
    """One closed loop to run: a robot starts at rest and follows a reference.

    Attributes
    ----------
    robot : str
        Name of the robot it is meant for.
    kind : str
        ``"set_point"`` or ``"tracking"``.
    theta, omega : float or None
        Which of its kind, in multiples of π (rad, rad/s); None where it has no such number.
    reference : Callable[[float], Reference]
        The reference at t (s).
    duration, period : float
        Length of the run and of the control period (s).
    length : float
        The robot's length (m), the scale of a divergence.
    """

    robot: str
    kind: str
    theta: float | None
    omega: float | None
    reference: Callable[[float], Reference]
    duration: float
    period: float
    length: float
