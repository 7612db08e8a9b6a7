"""The properties of a robot that its experiments depend on, and the paper's ellipse in its size."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from softdyn import Ellipse, InputError, Reference, SetPoint, SoftModel
from softdyn.checks import number
from softdyn.validation.loop.experiment import DEFAULT_PERIOD, SET_POINT_DURATION, Experiment
from softdyn.validation.loop.trajectories import CYCLES, Trajectory


@dataclass(frozen=True)
class Setup:
    """The properties of a robot that its experiments depend on.

    Attributes
    ----------
    robot : str
        Name of the robot.
    length : float
        Length L (m); the ellipse's semi-axes are L/3 and L/8. With 0, only `target` can be used.
    period : float
        Control period (s).
    reach : float
        The ellipse's far vertex in multiples of L: its centre is at c = reach · L - b.
    ellipse_scale : float
        Factor on both semi-axes; the centre stays.
    """

    robot: str
    length: float
    period: float
    reach: float = 1.0
    ellipse_scale: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "length", number("length", self.length, lower=0.0))
        for name in ("period", "reach", "ellipse_scale"):
            object.__setattr__(self, name, number(name, getattr(self, name), above=0.0))

    def ellipse(self, omega: float = 0.0) -> Ellipse:
        """The ellipse in the robot's size, traversed at `omega`.

        Raises
        ------
        InputError
            The robot has no length, so that only a target can be given.
        """
        if self.length == 0:
            raise InputError("length", "a robot with a length, or a target", f"{self.length:g} m")
        a, b = self.length / 3, self.length / 8
        c = self.reach * self.length - b
        return Ellipse(self.ellipse_scale * a, self.ellipse_scale * b, c, omega=omega)

    def set_point(self, theta: float) -> Experiment:
        """Reach the ellipse's point at `theta`, in multiples of π, within 10 s."""
        theta = number("theta", theta)
        return self._experiment("set_point", theta, None, SetPoint(self.ellipse().point(theta)))

    def tracking(self, omega: float) -> Experiment:
        """Follow the ellipse at `omega`, in multiples of π rad/s, for two cycles."""
        omega = number("omega", omega, above=0.0)
        duration = 2 * CYCLES / omega  # 4π / ω with ω in rad/s
        if not math.isfinite(duration):
            raise InputError("omega", "a rate that completes two cycles", omega)
        return self._experiment("tracking", None, omega, self.ellipse(omega), duration)

    def target(self, y: Any) -> Experiment:
        """Reach the point y (3,) of the world (m) within 10 s."""
        return self._experiment("set_point", None, None, SetPoint(y))

    def trajectory(self, trajectory: Trajectory) -> Experiment:
        """Follow a trajectory of one's own."""
        return self._experiment("tracking", None, None, trajectory.reference, trajectory.duration)

    def _experiment(
        self,
        kind: str,
        theta: float | None,
        omega: float | None,
        reference: Callable[[float], Reference],
        duration: float = SET_POINT_DURATION,
    ) -> Experiment:
        return Experiment(
            self.robot, kind, theta, omega, reference, duration, self.period, self.length
        )


# Lengths and centres: the paper. Control periods: its reference implementation.
ROBOTS = {
    setup.robot: setup
    for setup in (
        Setup("finger", 0.24, 0.005),
        Setup("helix", 0.45, 0.0075),
        Setup("spirob", 0.50, 0.002, reach=0.75),
        Setup("spirob48", 0.50, 0.002, reach=0.75),
    )
}


def setup(robot: str) -> Setup:
    """The setup of a robot of the paper.

    Raises
    ------
    InputError
        It is another robot; make a `Setup` for it.
    """
    found = ROBOTS.get(robot) if isinstance(robot, str) else None
    if found is None:
        raise InputError("robot", f"one of {', '.join(ROBOTS)}", repr(robot))
    return found


def setup_of(model: SoftModel) -> Setup:
    """The paper's setup of a bundled robot; for any other one its own length, and 2 ms periods."""
    if model.bundled in ROBOTS:
        return ROBOTS[model.bundled]
    return Setup(model.name, model.robot.length, DEFAULT_PERIOD)


def ellipse_points(model: SoftModel, count: int = 97) -> np.ndarray | None:
    """Points (count, 3) of the ellipse in the robot's size (m); None for one without a length."""
    found = setup_of(model)
    if found.length == 0:
        return None
    return np.array([found.ellipse().point(theta) for theta in np.linspace(0, 2, count)])
