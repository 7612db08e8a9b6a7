"""Half-spaces and balls as barriers of a point: the tip, or a point of any link.

Distances of points are smooth but at a ball's centre.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Any, NamedTuple

import numpy as np

from softdyn import InputError, State
from softdyn.checks import array, number
from softdyn.tasks.link_motion import LinkKinematics

RATE = 10.0  # α (1/s)
MILLIMETRE, CENTIRADIAN = 1e-3, 1e-2  # m, rad; the units in which violations are compared


class Values(NamedTuple):
    """Barriers of one kind at a state.

    Attributes
    ----------
    b : ndarray, (p,)
        Values (m, rad); a violated barrier is negative.
    gradient : ndarray, (p, n)
        G = ∂b/∂q.
    drift : ndarray, (p,)
        r = b̈ - G q̈.
    unit : ndarray, (p,)
        The unit of violations: `MILLIMETRE` or `CENTIRADIAN`.
    """

    b: np.ndarray
    gradient: np.ndarray
    drift: np.ndarray
    unit: np.ndarray


@dataclass(frozen=True, eq=False)
class PointBarrier:
    """A barrier of the tip, or of a point of a link.

    Attributes
    ----------
    link : str, optional
        The link of the point; by default the point is the tip.
    point : array_like, (3,)
        The point in the link's frame (m).
    """

    _: KW_ONLY
    link: str | None = None
    point: Any = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.link is not None and not isinstance(self.link, str):
            raise InputError("link", "the name of a link", repr(self.link))
        point = tuple(array("point", self.point, (3,)).tolist())
        object.__setattr__(self, "point", point)
        if self.link is None and any(point):
            raise InputError("point", "a link too, for a point other than the tip", repr(point))


@dataclass(frozen=True, eq=False)
class HalfSpace(PointBarrier):
    """Keeps the tip, or a point of a link, in the half-space normal · y ≥ offset.

    Attributes
    ----------
    normal : ndarray, (3,)
        Direction into the allowed side; it is made a unit vector.
    offset : float
        Offset of the plane along the unit normal (m).
    rate : float
        α (1/s).
    """

    normal: np.ndarray
    offset: float
    rate: float = RATE

    def __post_init__(self) -> None:
        normal = array("normal", self.normal, (3,))
        length = float(np.linalg.norm(normal))
        if length == 0:
            raise InputError("normal", "a direction", normal)
        object.__setattr__(self, "normal", normal / length)
        object.__setattr__(self, "offset", number("offset", self.offset))
        object.__setattr__(self, "rate", number("rate", self.rate, above=0.0))
        super().__post_init__()

    def __call__(self, state: State) -> Values:
        """The point's distance from the plane."""
        at = _point(state, self)
        return _of_a_point(state, at, self.normal @ at.y - self.offset, self.normal, 0.0)


@dataclass(frozen=True, eq=False)
class KeepOutSphere(PointBarrier):
    """Keeps the tip, or a point of a link, out of a ball.

    Attributes
    ----------
    centre : ndarray, (3,)
        Centre of the ball (m).
    radius : float
        Radius of the ball (m).
    rate : float
        α (1/s).
    """

    centre: np.ndarray
    radius: float
    rate: float = RATE

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", array("centre", self.centre, (3,)))
        object.__setattr__(self, "radius", number("radius", self.radius, above=0.0))
        object.__setattr__(self, "rate", number("rate", self.rate, above=0.0))
        super().__post_init__()

    def __call__(self, state: State) -> Values:
        """The point's distance from the ball: n̂ the unit vector to it, b̈ = n̂·ÿ + |ẏ across|²/d."""
        at = _point(state, self)
        span = at.y - self.centre
        distance = max(float(np.linalg.norm(span)), np.finfo(float).tiny)
        n = span / distance
        across = at.ydot - (n @ at.ydot) * n
        return _of_a_point(state, at, distance - self.radius, n, across @ across / distance)


class _Point(NamedTuple):
    """A point that a barrier guards: ÿ = J q̈ + drift."""

    y: np.ndarray  # (3,)
    ydot: np.ndarray  # (3,)
    J: np.ndarray  # (3, n)
    drift: np.ndarray  # (3,)


def _point(state: State, barrier: PointBarrier) -> _Point:
    """The tip, or the barrier's point of a link."""
    if barrier.link is None:
        return _Point(state.y, state.ydot, state.J, state.Jdot @ state.v)
    at = LinkKinematics.of(state.model)(state, barrier.link, barrier.point)
    return _Point(at.position, at.velocity[:3], at.jacobian[:3], at.drift[:3])


def _of_a_point(state: State, at: _Point, b: float, n: np.ndarray, turning: float) -> Values:
    """A barrier b of a point with ∂b/∂y = n (3,), a unit vector that turns: b̈ = n·ÿ + `turning`."""
    drift = n @ at.drift + turning
    return Values(np.array([b]), (n @ at.J)[None], np.array([drift]), np.array([MILLIMETRE]))
