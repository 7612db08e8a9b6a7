"""Courses of cables between two points around a cylinder or a sphere, with derivatives.

The points a and b are in the body's frame, where a cylinder's axis is z. The problem is planar: for
a cylinder in the plane across its axis, for a sphere in the plane through a, b and its centre. With
the radius r, let a have the distance ρ and the angle θ, and t = √(ρ² - r²).

**Outside** the body the cable is two tangents and an arc. With s = 1 where it runs
counter-clockwise from a to b, else -1, its planar length and its turn are

    P = t_a + t_b + r φ,    φ = s (θ_b - θ_a) - acos(r/ρ_a) - acos(r/ρ_b)   (mod 2π).

So ∂P/∂a is the unit vector (t, -s r)/ρ in polar coordinates, which is the tangent's direction. The
curves of constant P are involutes, so that the Hessian by a is n nᵀ/t, with n normal to the
tangent. For a sphere the plane turns with the points. With γ the angle between them, the Hessian
normal to the plane is (t_a + s r cot γ)/ρ_a² by a, and -s r/(sin γ ρ_a ρ_b) by a and b.

**Inside** it bends at the point p of the circle for which P = |a - p| + |b - p| is least. P is
stationary there, so ∂P/∂a = (a - p)/|a - p|. The Hessian is that of the sum minus
P_xθ P_θx/P_θθ, as p moves along the circle (implicit function theorem).

A cylinder's cable rises by z = b_z - a_z, in proportion to the path. So its length is √(P² + z²),
and with the cosine c = P/ℓ of the pitch its total turn is φ c outside, 2 asin(c sin(φ/2)) inside.

The choice between the two ways around is that of MuJoCo 4, see `_ways_around`.

All courses of a robot are computed at once. In the plane points are complex numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np

from softdyn.description.robot import Wrap

ON_RADIUS = 1e-9  # share of the radius by which a point on the surface may lie inside by rounding
SMALLEST = 1e-15  # m², m: nearer points are one, as for MuJoCo
NEAR = 1e-12  # smallest t/r, and second derivative of a way, by which a Hessian divides
FLAT = 1e-6  # rad; points nearer to one line with a sphere's centre have no steeper Hessian
TURN = 2.0 * math.pi
ITERATIONS = 60  # of Newton's method or halvings; it needs about 5
ENDS = np.array((1.0, -1.0))  # the cable leaves its first point and arrives at the second
FREE, ENTERED, CLOCKWISE, COUNTER, BENT = range(5)  # a `Contact`; its own numbers slow NumPy down


class Contact(IntEnum):
    """How a cable touches a round body; from `CLOCKWISE` on it touches."""

    FREE = 0
    """It is straight and does not touch the body."""
    ENTERED = 1
    """It is straight because one of its ends is inside the body."""
    CLOCKWISE = 2
    """It runs around the body, clockwise about a cylinder's axis, or the long way of a sphere."""
    COUNTER = 3
    """It runs around the body the other way."""
    BENT = 4
    """It bends at a point inside the body."""


class RoundBody(NamedTuple):
    """A round body in its own frame.

    Attributes
    ----------
    radius : float
        Its radius (m).
    sphere : bool
        Whether it is a sphere; else it is a cylinder about z.
    side : ndarray, (3,) or None
        The side point; it lies across the axis of a cylinder.
    inside : bool
        Whether the side point lies inside the body.
    """

    radius: float
    sphere: bool
    side: np.ndarray | None
    inside: bool


class RoundBodies(NamedTuple):
    """Several round bodies, each in its own frame; fields as in `RoundBody`.

    Attributes
    ----------
    radius : ndarray, (k,)
        Radii (m).
    sphere : ndarray of bool, (k,)
        Whether each is a sphere.
    side : ndarray, (k, 3)
        Side points; zero without one.
    spheres, inside : ndarray of int
        Numbers of the spheres, and of the bodies with a side point inside.
    """

    radius: np.ndarray
    sphere: np.ndarray
    side: np.ndarray
    spheres: np.ndarray
    inside: np.ndarray

    @classmethod
    def of(cls, bodies: Sequence[RoundBody]) -> RoundBodies:
        """The bodies as arrays."""
        sphere = np.array([body.sphere for body in bodies], bool)
        sides = [np.zeros(3) if body.side is None else body.side for body in bodies]
        return cls(
            np.array([body.radius for body in bodies]),
            sphere,
            np.array(sides).reshape(-1, 3),
            np.flatnonzero(sphere),
            np.flatnonzero([body.inside for body in bodies]),
        )


class Bends(NamedTuple):
    """Derivatives of the directions of `Courses`.

    Attributes
    ----------
    hessian : ndarray, (k, 6, 6)
        Second derivatives of the lengths by both points.
    turn : ndarray, (k, 6)
        Gradients of the turns by both points.
    """

    hessian: np.ndarray
    turn: np.ndarray


@dataclass(frozen=True, eq=False)
class Courses:
    """Courses of cables, each between two points around a round body.

    Attributes
    ----------
    contact : ndarray of int, (k,)
        How each touches its body: the numbers of a `Contact`.
    length : ndarray, (k,)
        Lengths (m).
    gradient : ndarray, (k, 2, 3)
        Derivatives of the lengths by both points: unit vectors along the cable's ends, outwards.
    turn : ndarray, (k,)
        Total turns at the bodies (rad).
    rows : ndarray of int or slice
        Those that touch their bodies.
    touching : _Touching
        More about these.
    """

    contact: np.ndarray
    length: np.ndarray
    gradient: np.ndarray
    turn: np.ndarray
    rows: np.ndarray | slice
    touching: _Touching

    def points(self, count: int = 2) -> np.ndarray:
        """Points (k, count, 3) from where they meet to where they leave the surfaces.

        They are in the bodies' frames, and NaN for a straight course.
        """
        found = np.full((len(self.length), count, 3), np.nan)
        found[self.rows] = self.touching.points(count)
        return found

    @cached_property
    def bends(self) -> Bends:
        """The second derivatives."""
        if isinstance(self.rows, slice):
            return Bends(*self.touching.bends())
        # a straight cable's Hessian is (I - ddᵀ)/ℓ by the difference of its ends
        along, count = self.gradient[:, 1], len(self.length)
        across = np.eye(3) - along[:, :, None] * along[:, None]
        across /= np.maximum(self.length, SMALLEST)[:, None, None]
        hessian = np.empty((count, 2, 3, 2, 3))
        hessian[:, 0, :, 0] = hessian[:, 1, :, 1] = across
        hessian[:, 0, :, 1] = hessian[:, 1, :, 0] = -across
        found = Bends(hessian.reshape(count, 6, 6), np.zeros((count, 6)))
        found.hessian[self.rows], found.turn[self.rows] = self.touching.bends()
        return found


def body_of(wrap: Wrap) -> tuple[RoundBody, np.ndarray]:
    """A described round body, and its frame's axes in the link's frame as columns (3, 3)."""
    axis = wrap.direction
    across = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(across, axis)
    first /= np.linalg.norm(first)
    axes = np.column_stack((first, np.cross(axis, first), axis))
    side = None if wrap.side is None else axes.T @ wrap.across(wrap.side)
    return RoundBody(wrap.radius, wrap.axis is None, side, wrap.inside), axes


def courses(bodies: RoundBodies, ends: np.ndarray) -> Courses:
    """The courses of cables around bodies, each between two points `ends` (k, 2, 3)."""
    axes, side = None, bodies.side
    if len(bodies.spheres):
        axes = _planes(bodies, ends)
        side = (axes @ side[:, :, None])[..., 0]
    placed = ends if axes is None else ends @ axes.transpose(0, 2, 1)
    z, radius = _complex(placed), bodies.radius
    distance = np.abs(z)
    contact, sense = _ways_around(z, distance, _complex(side), radius)
    inner, angle = bodies.inside, np.zeros(len(z))
    if len(inner):
        contact[inner], angle[inner] = _inner_bends(z[inner], distance[inner], radius[inner])
    touches = contact >= CLOCKWISE
    every = np.count_nonzero(touches) == len(z)
    rows = slice(None) if every else np.flatnonzero(touches)
    flat = _flat(
        z[rows], distance[rows], radius[rows], sense[rows], contact[rows] == BENT, angle[rows]
    )
    touching = _Touching(
        flat, bodies.sphere[rows], None if axes is None else axes[rows], placed[rows, :, 2]
    )
    if every:
        return Courses(contact, touching.length, touching.gradient, touching.turn, rows, touching)
    span, gradient, turn = ends[:, 1] - ends[:, 0], np.empty(ends.shape), np.zeros(len(z))
    length = np.sqrt((span * span).sum(axis=1))
    gradient[:, 1] = span / np.maximum(length, SMALLEST)[:, None]
    gradient[:, 0] = -gradient[:, 1]
    length[rows], gradient[rows], turn[rows] = touching.length, touching.gradient, touching.turn
    return Courses(contact, length, gradient, turn, rows, touching)


def _complex(x: np.ndarray) -> np.ndarray:
    """The first two of the components (..., 3) as complex numbers."""
    return np.ascontiguousarray(x[..., :2]).view(complex)[..., 0]


def _planes(bodies: RoundBodies, ends: np.ndarray) -> np.ndarray:
    """Axes (k, 3, 3), as rows: two in each course's plane, and its normal."""
    axes, rows = np.empty((len(ends), 3, 3)), bodies.spheres
    axes[:] = np.eye(3)
    a, b = ends[rows, 0], ends[rows, 1]
    first = a / np.maximum(np.linalg.norm(a, axis=1), SMALLEST)[:, None]
    beside = np.eye(3)[np.argmin(np.abs(first), axis=1)]
    second = np.zeros(first.shape)
    for other in (beside, bodies.side[rows], b):  # the last one that is not along a
        across = other - (other * first).sum(axis=1)[:, None] * first
        size = np.linalg.norm(across, axis=1)
        apart = size > NEAR * np.linalg.norm(other, axis=1) + SMALLEST
        second[apart] = across[apart] / size[apart, None]
    axes[rows] = np.stack((first, second, np.cross(first, second)), axis=1)
    return axes


# -- in the plane ----------------------------------------------------------------------------------


def _ways_around(
    z: np.ndarray, distance: np.ndarray, side: np.ndarray, r: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Contacts of cables outside their bodies, and 1 where they run counter-clockwise, else -1.

    The cable does not cross the ray from the centre away from `side`. If the straight line meets
    this ray, the cable goes the long way around. Else it is straight if it does not meet the
    circle, and goes the short way around if it does. It is straight, too, if an end is inside.
    """
    a, b = z[:, 0], z[:, 1]
    short = np.copysign(1.0, (a.conj() * b).imag)
    long = (short * (side.conj() * a).imag > 0.0) & (short * (b.conj() * side).imag > 0.0)
    span = b - a
    square = np.abs(span) ** 2
    share = -(span.conj() * a).real / np.maximum(square, SMALLEST)
    # an end that is the nearest point may lie on the circle
    meets = (share > 0.0) & (share < 1.0) & (np.abs(a + share * span) <= r)
    sense = np.where(long, -short, short)
    contact = (sense > 0.0) + CLOCKWISE
    contact[~(long | meets) | (square < SMALLEST)] = FREE
    contact[np.minimum(distance[:, 0], distance[:, 1]) < r * (1.0 - ON_RADIUS)] = ENTERED
    return contact, sense


def _inner_bends(
    z: np.ndarray, distance: np.ndarray, r: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Contacts of cables inside their bodies, and the angles from a where they bend.

    The path's derivative by the angle of its point on the circle rises between the points where the
    tangents from a and b touch, so that Newton's method within these bounds finds its zero.
    """
    gamma = np.abs(np.angle(z[:, 1] * z[:, 0].conj()))
    open_ = np.arccos(np.minimum(r[:, None] / np.maximum(distance, SMALLEST), 1.0))
    low, high = np.maximum(0.0, gamma - open_[:, 1]), np.minimum(gamma, open_[:, 0])
    entered = distance.min(axis=1) <= r
    straight = (low >= high) & (gamma > 0)  # the line meets the circle
    contact = np.where(straight, FREE, BENT)
    contact[entered] = ENTERED
    bent = np.flatnonzero(contact == BENT)
    found = np.zeros(len(z))
    if len(bent):
        found[bent] = _shortest(distance[bent], r[bent, None], gamma[bent], low[bent], high[bent])
    return contact, found


def _shortest(
    distance: np.ndarray, r: np.ndarray, gamma: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """The angles within bounds at which the paths over the circle are shortest."""
    shares = distance / distance.sum(axis=1)[:, None]
    x = low + (high - low) * shares[:, 1]
    for _ in range(ITERATIONS):
        angles = np.stack((x, gamma - x), axis=1)
        across, along = distance * r * np.sin(angles), distance * r * np.cos(angles)
        ways = np.sqrt(distance**2 + r**2 - 2.0 * along)
        slopes = across / ways
        value = slopes[:, 0] - slopes[:, 1]
        slope = ((along - slopes**2) / ways).sum(axis=1)
        low, high = np.where(value < 0, x, low), np.where(value < 0, high, x)
        new = x - value / np.where(slope > 0, slope, np.inf)
        new = np.where((slope > 0) & (low < new) & (new < high), new, (low + high) / 2)
        moved, x = np.abs(new - x), new
        if (moved <= 1e-16 * (1.0 + gamma)).all():
            break
    return x


class _Flat(NamedTuple):
    """Courses in the plane that touch their bodies.

    Attributes
    ----------
    z, distance : ndarray, (k, 2)
        The points, and their distances from the centre.
    radius, sense : ndarray, (k,)
        Radii; 1 for a course outside that is counter-clockwise, else -1.
    bent : ndarray of bool, (k,)
        Whether it bends inside.
    straight, tangents : ndarray, (k, 2)
        Straight pieces, and their directions away from the body.
    turn, length : ndarray, (k,)
        Turns along the circle (rad), and whole lengths.
    """

    z: np.ndarray
    distance: np.ndarray
    radius: np.ndarray
    sense: np.ndarray
    bent: np.ndarray
    straight: np.ndarray
    tangents: np.ndarray
    turn: np.ndarray
    length: np.ndarray

    @property
    def touches(self) -> np.ndarray:
        """The points (k, 2) where they meet and leave the circles."""
        return self.z - self.straight * self.tangents


def _flat(
    z: np.ndarray, distance: np.ndarray, r: np.ndarray, sense: np.ndarray, bent: np.ndarray,
    angle: np.ndarray,
) -> _Flat:  # fmt: skip
    """The courses around circles, or bent at an angle from the first point."""
    radii = r[:, None]
    straight = np.sqrt(np.maximum(distance**2 - radii**2, 0.0))
    tangents = (straight - 1j * ((r * sense)[:, None] * ENDS)) / z.conj()
    between, open_ = np.angle(z[:, 1] * z[:, 0].conj()), np.arctan2(straight, radii)
    turn = (sense * between - open_[:, 0] - open_[:, 1]) % TURN
    turn[turn > TURN - ON_RADIUS] = 0.0  # below zero by rounding
    if np.count_nonzero(bent):
        here = z[bent]
        way = np.where(between[bent] < 0.0, -1.0, 1.0) * angle[bent]
        point = r[bent] * np.exp(1j * way) * here[:, 0] / distance[bent, 0]
        off = here - point[:, None]
        straight[bent] = np.abs(off)
        tangents[bent] = off / straight[bent]
        turn[bent] = 0.0
    length = straight[:, 0] + straight[:, 1] + r * turn
    return _Flat(z, distance, r, sense, bent, straight, tangents, turn, length)


# -- in space --------------------------------------------------------------------------------------


class _Touching:
    """Courses in space that touch their bodies; attributes as in `Courses`.

    Parameters
    ----------
    flat : _Flat
        The courses in their planes.
    sphere : ndarray of bool, (k,)
        Whether the bodies are spheres.
    axes : ndarray, (k, 3, 3), or None
        Rows: two axes of each plane, and its normal; None if all are those of the bodies.
    heights : ndarray, (k, 2)
        Heights of the points above the planes; zero at a sphere.
    """

    def __init__(
        self, flat: _Flat, sphere: np.ndarray, axes: np.ndarray | None, heights: np.ndarray
    ) -> None:
        self._flat, self._sphere, self._axes, self._heights = flat, sphere, axes, heights
        self._rise = heights[:, 1] - heights[:, 0]
        self.length = np.hypot(flat.length, self._rise)
        self._cosine, self._sine = flat.length / self.length, self._rise / self.length
        self.gradient = self._in_space(
            self._cosine[:, None] * flat.tangents, -self._sine[:, None] * ENDS
        )
        self.turn = self._cosine * flat.turn
        self._bent = np.count_nonzero(flat.bent) > 0
        if self._bent:
            one, other = self.gradient[flat.bent].transpose(1, 0, 2)
            apart, along = (np.linalg.norm(x, axis=1) for x in (one + other, one - other))
            self.turn[flat.bent] = 2.0 * np.arctan2(apart, along)

    def points(self, count: int) -> np.ndarray:
        """Points (k, count, 3) from where they meet to where they leave the bodies."""
        flat, shares = self._flat, np.linspace(0.0, 1.0, count)
        slope = self._rise / flat.length
        heights = self._heights[:, 0] + slope * flat.straight[:, 0]
        climb, angle = slope * flat.radius * flat.turn, flat.sense * flat.turn
        return self._in_space(
            flat.touches[:, :1] * np.exp(1j * angle[:, None] * shares),
            heights[:, None] + climb[:, None] * shares,
        )

    def bends(self) -> tuple[np.ndarray, np.ndarray]:
        """The fields of `Bends`."""
        flat, count, level = self._flat, len(self.length), np.zeros((len(self.length), 2))
        cosine, sine = self._cosine[:, None], self._sine[:, None]
        ways = np.maximum(flat.straight, NEAR * flat.radius[:, None])
        normals = self._in_space(1j * flat.tangents, level)
        blocks = np.zeros((count, 2, 3, 2, 3))
        for end in (0, 1):
            blocks[:, end, :, end] = _squares(normals[:, end]) / ways[:, end, None, None]
        hessian = blocks.reshape(count, 6, 6)
        if self._bent:
            hessian[flat.bent] -= self._relief(normals[flat.bent], ways[flat.bent])
        across = self._in_space(sine * flat.tangents, cosine * ENDS).reshape(count, 6)
        rising = _squares(across) / self.length[:, None, None]
        if self._axes is not None:
            beside = self._beside(ways)[self._sphere]
            normal = _squares(self._axes[self._sphere, 2])
            turning = beside[:, :, None, :, None] * normal[:, None, :, None]
            rising[self._sphere] = turning.reshape(-1, 6, 6)
        hessian *= cosine[:, :, None]
        hessian += rising
        sense = flat.sense[:, None] * ENDS
        by_turn = -(flat.radius[:, None] / ways + 1j * sense) * flat.z / flat.distance**2
        turn = cosine * self._in_space(by_turn, level).reshape(count, 6)
        turn += (sine * flat.turn[:, None] / self.length[:, None]) * across
        if self._bent:  # from the cosine of the angle between the directions
            other = self.gradient[flat.bent, ::-1].reshape(-1, 1, 6)
            change = (other @ hessian[flat.bent])[:, 0]
            turn[flat.bent] = change / np.maximum(np.sin(self.turn[flat.bent]), NEAR)[:, None]
        return hessian, turn

    def _relief(self, normals: np.ndarray, ways: np.ndarray) -> np.ndarray:
        """P_xθ P_θx/P_θθ (k, 6, 6) of the courses that bend, from their normals and ways."""
        flat, bent = self._flat, self._flat.bent
        lever = (flat.tangents[bent].conj() * flat.touches[bent]).real
        mixed = (normals * (lever / ways)[:, :, None]).reshape(-1, 6)
        twice = (lever**2 / ways + lever).sum(axis=1)
        twice = np.maximum(twice, NEAR * flat.radius[bent])
        found: np.ndarray = _squares(mixed) / twice[:, None, None]
        return found

    def _beside(self, ways: np.ndarray) -> np.ndarray:
        """Second derivatives (k, 2, 2) of the lengths by both points normal to the plane."""
        flat, r = self._flat, self._flat.radius
        found = np.zeros((len(r), 2, 2))
        product = flat.z[:, 1] * flat.z[:, 0].conj() / flat.distance.prod(axis=1)
        lean = flat.sense * r / np.maximum(product.imag, FLAT)
        for end in (0, 1):
            t, square = flat.straight[:, end], flat.distance[:, end] ** 2
            found[:, end, end] = (t + lean * product.real) / square
        found[:, 0, 1] = found[:, 1, 0] = -lean / flat.distance.prod(axis=1)
        if self._bent:
            bent, shares = flat.bent, 1.0 / ways[flat.bent]
            lever = (flat.tangents[bent].conj() * flat.touches[bent]).real.sum(axis=1)
            square = r[bent] ** 2
            sums = np.maximum(lever + square * shares.sum(axis=1), NEAR * r[bent])
            found[bent] = shares[:, :, None] * np.eye(2)
            found[bent] -= (square / sums)[:, None, None] * _squares(shares)
        return found

    def _in_space(self, flat: np.ndarray, up: np.ndarray) -> np.ndarray:
        """Vectors (k, n, 3) from their parts in the plane and normal to it (k, n)."""
        found = np.empty((*up.shape, 3))
        found[..., 0], found[..., 1], found[..., 2] = flat.real, flat.imag, up
        return found if self._axes is None else found @ self._axes


def _squares(x: np.ndarray) -> np.ndarray:
    """The matrices x xᵀ (k, n, n) of vectors (k, n)."""
    return x[:, :, None] * x[:, None]
