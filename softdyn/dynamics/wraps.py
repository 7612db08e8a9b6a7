"""The course of a cable between two points around a cylinder or a sphere, with derivatives.

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

The choice between the two ways around is that of MuJoCo 4, see `_outside`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

import numpy as np

from softdyn.description.robot import Wrap

ON_RADIUS = 1e-9  # share of the radius by which a point on the surface may lie inside by rounding
SMALLEST = 1e-15  # m², m: nearer points are one, as for MuJoCo
NEAR = 1e-12  # smallest t/r, and second derivative of a way, by which a Hessian divides
FLAT = 1e-6  # rad; points nearer to one line with a sphere's centre have no steeper Hessian
TURN = 2.0 * math.pi
Pair = tuple[float, float]


class Contact(Enum):
    """How a cable touches a round body."""

    FREE = "free"
    """It is straight and does not touch the body."""
    ENTERED = "entered"
    """It is straight because one of its ends is inside the body."""
    CLOCKWISE = "clockwise"
    """It runs around the body, clockwise about a cylinder's axis, or the long way of a sphere."""
    COUNTER = "counter-clockwise"
    """It runs around the body the other way."""
    BENT = "bent"
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


class Course(NamedTuple):
    """A cable's course between two points.

    Attributes
    ----------
    contact : Contact
        How it touches the body.
    length : float
        Its length (m).
    gradient : ndarray, (2, 3)
        Derivatives of the length by both points: unit vectors along the cable's ends, outwards.
    turn : float
        Its total turn at the body (rad).
    points : ndarray, (2, 3) or None
        The points where it meets and leaves the surface; None if it is straight.
    bend : Bend or None
        Second derivatives, if they were asked for.
    """

    contact: Contact
    length: float
    gradient: np.ndarray
    turn: float
    points: np.ndarray | None
    bend: Bend | None


class Bend(NamedTuple):
    """Derivatives of a `Course`'s directions.

    Attributes
    ----------
    hessian : ndarray, (6, 6)
        Second derivatives of the length by both points.
    turn : ndarray, (6,)
        Gradient of the turn by both points.
    """

    hessian: np.ndarray
    turn: np.ndarray


class _Plane(NamedTuple):
    """A course in the plane: its `Contact`, straight pieces, turn, points (4,) and directions (4,).

    The arc is radius · turn outside, 0 inside.
    """

    contact: Contact
    before: float
    behind: float
    arc: float
    turn: float
    points: tuple[float, float, float, float]
    gradient: tuple[float, float, float, float]

    @property
    def length(self) -> float:
        return self.before + self.arc + self.behind


class _Curved(NamedTuple):
    """Second derivatives in the plane (4, 4) and normal to it (2, 2), and the turn's gradient."""

    hessian: np.ndarray
    normal: np.ndarray
    turn: np.ndarray


Points = tuple[float, float, float, float]


def body_of(wrap: Wrap) -> tuple[RoundBody, np.ndarray]:
    """A described round body, and its frame's axes in the link's frame as columns (3, 3)."""
    axis = wrap.direction
    across = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(across, axis)
    first /= np.linalg.norm(first)
    axes = np.column_stack((first, np.cross(axis, first), axis))
    side = None if wrap.side is None else axes.T @ wrap.across(wrap.side)
    return RoundBody(wrap.radius, wrap.axis is None, side, wrap.inside), axes


def course(body: RoundBody, a: np.ndarray, b: np.ndarray, *, bends: bool = False) -> Course:
    """The course of a cable from a to b (3,), with second derivatives if it `bends`."""
    axes = _plane_of(body, a, b)
    d = (*(axes[:2] @ a).tolist(), *(axes[:2] @ b).tolist())
    if body.inside:
        found = _inside(d, body.radius)
    else:
        side = None if body.side is None else tuple((axes[:2] @ body.side).tolist())
        found = _outside(d, side, body.radius)
    if isinstance(found, Contact):
        return _straight(found, a, b, bends)
    second: Callable[[_Plane, Points, float], _Curved] = _bent if body.inside else _around
    curved = second(found, d, body.radius) if bends else None
    if body.sphere:
        return _on_sphere(found, curved, axes)
    return _on_cylinder(found, curved, float(a[2]), float(b[2]))


def _plane_of(body: RoundBody, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Axes (3, 3), as rows: two in the plane, and its normal."""
    if not body.sphere:
        return np.eye(3)
    distance = math.sqrt(a @ a)
    if distance < SMALLEST:
        return np.eye(3)
    first = a / distance
    for other in (b, body.side, np.eye(3)[int(np.argmin(np.abs(first)))]):
        if other is not None:
            second = other - (other @ first) * first
            size = math.sqrt(second @ second)
            if size > NEAR * math.sqrt(other @ other) + SMALLEST:
                break
    (x, y, z), (u, v, w) = first.tolist(), (second / size).tolist()
    return np.array(((x, y, z), (u, v, w), (y * w - z * v, z * u - x * w, x * v - y * u)))


def _straight(contact: Contact, a: np.ndarray, b: np.ndarray, bends: bool) -> Course:
    span = b - a
    length = math.sqrt(span @ span)
    along = span / max(length, SMALLEST)
    bend = None
    if bends:
        across = (np.eye(3) - np.outer(along, along)) / max(length, SMALLEST)
        both = np.hstack((np.eye(3), -np.eye(3)))
        bend = Bend(both.T @ across @ both, np.zeros(6))
    return Course(contact, length, np.array((-along, along)), 0.0, None, bend)


# -- in the plane ----------------------------------------------------------------------------------


def _outside(d: Points, side: Pair | None, r: float) -> _Plane | Contact:
    """Two tangents and an arc.

    The cable does not cross the ray from the centre away from `side`. If the straight line meets
    this ray, the cable goes the long way around. Else it is straight if it does not meet the
    circle, and goes the short way around if it does. It is straight, too, if an end is inside.
    """
    ax, ay, bx, by = d
    ra, rb = math.hypot(ax, ay), math.hypot(bx, by)
    if min(ra, rb) < r * (1.0 - ON_RADIUS):
        return Contact.ENTERED
    dx, dy = bx - ax, by - ay
    square = dx * dx + dy * dy
    if square < SMALLEST:
        return Contact.FREE
    sense = 1.0 if ax * by - ay * bx >= 0.0 else -1.0  # of the short way
    if side is not None and _opposite(d, side):
        sense = -sense
    else:
        share = -(dx * ax + dy * ay) / square
        nx, ny = ax + share * dx, ay + share * dy
        # an end that is the nearest point may lie on the circle
        if not 0.0 < share < 1.0 or nx * nx + ny * ny > r * r:
            return Contact.FREE
    ta, tb = math.sqrt(max(ra * ra - r * r, 0.0)), math.sqrt(max(rb * rb - r * r, 0.0))
    turn = sense * (math.atan2(by, bx) - math.atan2(ay, ax)) - math.atan2(ta, r) - math.atan2(tb, r)
    turn %= TURN
    if turn > TURN - ON_RADIUS:  # below zero by rounding
        turn = 0.0
    gradient = (
        (ta * ax + sense * r * ay) / ra**2, (ta * ay - sense * r * ax) / ra**2,
        (tb * bx - sense * r * by) / rb**2, (tb * by + sense * r * bx) / rb**2,
    )  # fmt: skip
    points = (
        ax - ta * gradient[0], ay - ta * gradient[1], bx - tb * gradient[2], by - tb * gradient[3],
    )  # fmt: skip
    contact = Contact.COUNTER if sense > 0 else Contact.CLOCKWISE
    return _Plane(contact, ta, tb, r * turn, turn, points, gradient)


def _opposite(d: Points, side: Pair) -> bool:
    """Whether the ray from the centre away from the side meets the line from a to b."""
    ax, ay, bx, by = d
    sense = 1.0 if ax * by - ay * bx >= 0.0 else -1.0
    first, last = side[0] * ay - side[1] * ax, bx * side[1] - by * side[0]
    return first * sense > 0.0 and last * sense > 0.0


def _around(plane: _Plane, d: Points, r: float) -> _Curved:
    """Second derivatives of a course outside."""
    sense = 1.0 if plane.contact is Contact.COUNTER else -1.0
    hessian, turn, normal = np.zeros((4, 4)), np.zeros(4), np.zeros((2, 2))
    for k, (t, s) in enumerate(((plane.before, -sense), (plane.behind, sense))):
        x, y, u, w = *d[2 * k : 2 * k + 2], *plane.gradient[2 * k : 2 * k + 2]
        t = max(t, NEAR * r)
        square = x * x + y * y
        hessian[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = (
            np.array(((w * w, -u * w), (-u * w, u * u))) / t
        )
        turn[2 * k : 2 * k + 2] = (-r * x / t - s * y) / square, (-r * y / t + s * x) / square
        normal[k, k] = t / square
    cross, dot = d[0] * d[3] - d[1] * d[2], d[0] * d[2] + d[1] * d[3]
    sine = max(cross / math.hypot(cross, dot), FLAT)
    ra, rb = math.hypot(*d[:2]), math.hypot(*d[2:])
    cotangent = dot / (ra * rb) / sine
    normal += (
        sense
        * r
        * np.array(
            (
                (cotangent / ra**2, -1.0 / (sine * ra * rb)),
                (-1.0 / (sine * ra * rb), cotangent / rb**2),
            )
        )
    )
    return _Curved(hessian, normal, turn)


def _inside(d: Points, r: float) -> _Plane | Contact:
    """One bend at the point of the circle that gives the shortest path.

    The path's derivative by the point's angle rises between the points where the tangents from a
    and b touch, so that Newton's method within these bounds finds its zero.
    """
    ax, ay, bx, by = d
    ra, rb = math.hypot(ax, ay), math.hypot(bx, by)
    if min(ra, rb) <= r:
        return Contact.ENTERED
    cross, dot = ax * by - ay * bx, ax * bx + ay * by
    gamma, s = math.atan2(abs(cross), dot), math.copysign(1.0, cross)
    low = max(0.0, gamma - math.acos(r / rb))
    high = min(gamma, math.acos(r / ra))
    if low >= high and gamma > 0:
        return Contact.FREE  # the line meets the circle
    x = low + (high - low) * rb / (ra + rb) if ra > rb else high - (high - low) * ra / (ra + rb)
    for _ in range(60):
        (first, second), (other, bends) = _slopes(ra, r, x), _slopes(rb, r, gamma - x)
        value, slope = first - other, second + bends
        low, high = (x, high) if value < 0 else (low, x)
        step = x - value / slope if slope > 0 else low
        new = step if low < step < high else (low + high) / 2
        if abs(new - x) <= 1e-16 * (1.0 + gamma):
            break
        x = new
    ux, uy = ax / ra, ay / ra
    cosine, sine = math.cos(x), s * math.sin(x)
    px, py = r * (cosine * ux - sine * uy), r * (sine * ux + cosine * uy)
    before, behind = math.hypot(ax - px, ay - py), math.hypot(bx - px, by - py)
    ga = (ax - px) / before, (ay - py) / before
    gb = (bx - px) / behind, (by - py) / behind
    turn = 2.0 * math.atan2(
        math.hypot(ga[0] + gb[0], ga[1] + gb[1]), math.hypot(ga[0] - gb[0], ga[1] - gb[1])
    )
    return _Plane(Contact.BENT, before, behind, 0.0, turn, (px, py, px, py), (*ga, *gb))


def _slopes(distance: float, r: float, angle: float) -> Pair:
    """First and second derivative of the way to the circle's point at an angle, by the angle."""
    across = distance * r * math.sin(angle)
    along = distance * r * math.cos(angle)
    length = math.sqrt(distance * distance + r * r - 2.0 * along)
    slope = across / length
    return slope, (along - slope * slope) / length


def _bent(plane: _Plane, d: Points, r: float) -> _Curved:
    """Second derivatives of a course inside."""
    p = np.array(plane.points[:2])
    along = np.array((-p[1], p[0]))  # ∂p/∂θ
    hessian, mixed, turning = np.zeros((4, 4)), np.zeros(4), np.zeros(4)
    ways = np.array((plane.before, plane.behind))
    twice, outwards = 0.0, 0.0
    for k, way in enumerate(ways):
        here = slice(2 * k, 2 * k + 2)
        u = np.array(plane.gradient[here])
        across = np.array((-u[1], u[0]))
        hessian[here, here] = np.outer(across, across) / way
        mixed[here] = -across * (across @ along) / way
        turning[here] = across / way
        twice += (across @ along) ** 2 / way
        outwards += float(u @ p)
    twice += outwards
    moved = -mixed / max(twice, NEAR * r)  # ∂θ by both points
    hessian += np.outer(mixed, moved)
    # the angle from the direction of a to that of b, and the turn that is left of π
    rates = []
    for k in (0, 1):
        here = slice(2 * k, 2 * k + 2)
        own = np.zeros(4)
        own[here] = turning[here]
        rates.append(own - float(turning[here] @ along) * moved)
    ux, uy, wx, wy = plane.gradient
    opens = math.copysign(1.0, ux * wy - uy * wx)
    sums = outwards + r * r * float((1.0 / ways).sum())
    normal = np.diag(1.0 / ways) - r * r / max(sums, NEAR * r) * np.outer(1.0 / ways, 1.0 / ways)
    return _Curved(hessian, normal, -opens * (rates[1] - rates[0]))


# -- in space --------------------------------------------------------------------------------------


def _on_sphere(plane: _Plane, curved: _Curved | None, axes: np.ndarray) -> Course:
    flat = axes[:2]
    gradient = np.reshape(plane.gradient, (2, 2)) @ flat
    points = np.reshape(plane.points, (2, 2)) @ flat
    bend = None
    if curved is not None:
        both, beside = _of_both(flat), _of_both(axes[2:])
        hessian = both.T @ curved.hessian @ both + beside.T @ curved.normal @ beside
        bend = Bend(hessian, curved.turn @ both)
    return Course(plane.contact, plane.length, gradient, plane.turn, points, bend)


def _of_both(rows: np.ndarray) -> np.ndarray:
    """The matrix (2 k, 6) that takes components (k, 3) of both points."""
    k = len(rows)
    found = np.zeros((2 * k, 6))
    found[:k, :3] = found[k:, 3:] = rows
    return found


def _on_cylinder(plane: _Plane, curved: _Curved | None, low: float, high: float) -> Course:
    way, rise = plane.length, high - low
    length = math.hypot(way, rise)
    cosine, sine = way / length, rise / length
    first = np.array((*plane.gradient[:2], 0.0, *plane.gradient[2:], 0.0))
    up = np.array((0.0, 0.0, -1.0, 0.0, 0.0, 1.0))
    gradient = cosine * first + sine * up
    inside = plane.contact is Contact.BENT
    half = cosine * math.sin(plane.turn / 2)
    turn = 2.0 * math.asin(min(half, 1.0)) if inside else cosine * plane.turn
    heights = (low + rise * plane.before / way, high - rise * plane.behind / way)
    points = np.column_stack((np.reshape(plane.points, (2, 2)), heights))
    bend = None
    if curved is not None:
        both = _of_both(np.eye(2, 3))
        across = sine * first - cosine * up
        hessian = cosine * (both.T @ curved.hessian @ both) + np.outer(across, across) / length
        steeper = sine * across / length  # the gradient of the cosine
        if inside:
            change = steeper * math.sin(plane.turn / 2)
            change += cosine * math.cos(plane.turn / 2) / 2 * (curved.turn @ both)
            change *= 2.0 / math.sqrt(max(1.0 - half * half, SMALLEST))
        else:
            change = steeper * plane.turn + cosine * (curved.turn @ both)
        bend = Bend(hessian, change)
    return Course(plane.contact, length, gradient.reshape(2, 3), turn, points, bend)
