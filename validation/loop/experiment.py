"""The task of a closed loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from softdyn import Reference

SET_POINT_DURATION = 10.0  # s, default length of a run
DEFAULT_PERIOD = 0.002  # s, default control period
ROLLOUT = "rollout"  # kind of a run without a controller and a reference


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
        θ of a set point or ω of a trajectory, in multiples of π (rad, rad/s), else None.
    reference : Callable[[float], Reference]
        The reference at t (s).
    duration, period : float
        Length of the run and of the control period (s).
    length : float
        The robot's length (m). A tip error above twice this length counts as divergence.
    """

    robot: str
    kind: str
    theta: float | None
    omega: float | None
    reference: Callable[[float], Reference]
    duration: float
    period: float
    length: float
