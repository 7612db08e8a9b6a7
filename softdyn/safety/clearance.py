"""Distances of many pairs of convex bodies at a State, as a barrier b = distance - margin.

Let n be the unit normal from B to A at their distance d. The plane with this normal, fixed to B,
separates them. After any motion the distance is at least min_i h_i, where h_i is the height over
this plane of those points x_i of A that can be nearest: corners, or points of a cylinder's rims.
At the moment min_i h_i = d. So every point has a row, with h_i as its barrier:

    ∂h/∂q = n · (J_A - J_B),    ḧ = ∂h/∂q q̈ + n · (J̇_A - J̇_B) q̇ + 2 (ω_B × n) · (J_A - J_B) q̇,

both Jacobians at x_i. A row of d itself would not do: its gradient jumps where flat faces or lines
become parallel, and its second derivative |v|²/d grows without bound where a corner passes another.
d is smooth where its nearest points are unique. Between a point or ball and a ball, the second
derivative |v|²/r is bounded, and the row has it.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from softdyn.dynamics.model import SoftModel, State
from softdyn.safety.nearest import Placed, nearest
from softdyn.safety.solids import Solid
from softdyn.tasks.link_motion import LinkKinematics, LinkMotion

MILLIMETRE, CENTIRADIAN = 1e-3, 1e-2  # m, rad; the units in which violations are compared
TIP = ""  # the link of a body that is the tip


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


class Motions(NamedTuple):
    """Motions of k bodies at a State.

    Attributes
    ----------
    each : LinkMotion
        The motions of their centres; every array has one more axis, the first.
    axes : ndarray, (k, 3, 3)
        Rotations of their own frames in the world.
    speeds : ndarray, (k,)
        Bounds of the speeds of their points.
    """

    each: LinkMotion
    axes: np.ndarray
    speeds: np.ndarray

    def of(self, i: int) -> LinkMotion:
        """The motion of one body."""
        return LinkMotion(*(part[i] for part in self.each))


class Bodies:
    """Bodies of links of one model; they keep their motions at the last State of each thread.

    Parameters
    ----------
    model : SoftModel
        The robot.
    solids : sequence of Solid
        Bodies of links, or one body at the tip, whose link is `TIP`.

    Raises
    ------
    InputError
        For a link that the robot does not have.
    """

    def __init__(self, model: SoftModel, solids: Sequence[Solid]) -> None:
        self._model = model
        self.solids, self._kinematics = tuple(solids), LinkKinematics.of(model)
        self._own = np.array([solid.rotation for solid in solids])
        self.radii = np.array([solid.radius for solid in solids])
        frames = [(str(solid.link), tuple(solid.centre.tolist())) for solid in solids]
        self._places = None if frames[0][0] == TIP else self._kinematics.places(frames)
        self._last = threading.local()

    def __reduce__(self) -> tuple[Any, ...]:
        return Bodies, (self._model, self.solids)

    def __call__(self, state: State) -> Motions:
        """The motions at this State."""
        last = self._last
        if getattr(last, "state", None) is not state:
            each = self._motions(state)
            linear, turn = each.velocity[:, :3], each.velocity[:, 3:]
            speeds = np.sqrt((linear**2).sum(axis=1)) + self.radii * np.sqrt((turn**2).sum(axis=1))
            last.motions, last.state = Motions(each, each.rotation @ self._own, speeds), state
        found: Motions = last.motions
        return found

    def _motions(self, state: State) -> LinkMotion:
        if self._places is not None:
            return self._kinematics.motions(state, self._places)
        zero = np.zeros((3, len(state.v)))
        velocity = np.concatenate((state.ydot, np.zeros(3)))
        drift = np.concatenate((state.Jdot @ state.v, np.zeros(3)))
        tip = np.eye(3), state.y, np.vstack((state.J, zero)), velocity, drift
        return LinkMotion(*(part[None] for part in tip))


class Clearance:
    """Distances between bodies of links and a body of the world, or between bodies of links.

    Parameters
    ----------
    bodies : Bodies
        Bodies of links.
    pairs : ndarray, (p, 2), or Solid
        Pairs of indices of bodies, or the body of the world.
    """

    def __init__(self, bodies: Bodies, pairs: np.ndarray | Solid) -> None:
        self._bodies = bodies
        self._world = pairs if isinstance(pairs, Solid) else None
        alone = np.arange(len(bodies.solids))[:, None]
        self._pairs = alone if isinstance(pairs, Solid) else pairs

    def __call__(self, state: State, reach: float, rate: float) -> Values:
        """The distances at most `reach` (m), and those that would close within 2 / `rate` (s).

        For the latter the row b̈ + 2 α ḃ + α² b ≥ 0 already asks for b̈ > 0.
        """
        motions = self._bodies(state)
        closing = motions.speeds[self._pairs].sum(axis=1)
        least = self._least(motions.each.position)
        near = np.flatnonzero(least <= np.maximum(reach, 2 / rate * closing)).tolist()
        parts = [self._rows(k, motions, state.v) for k in near]
        if not parts:
            return Values(np.empty(0), np.empty((0, len(state.v))), np.empty(0), np.empty(0))
        b, G, drift = (np.concatenate(same) for same in zip(*parts, strict=True))
        kept = (b <= reach) | (2 / rate * (G @ state.v) < -b)
        return Values(b[kept], G[kept], drift[kept], np.full(np.count_nonzero(kept), MILLIMETRE))

    def smallest(self, state: State) -> float:
        """The smallest of all distances (m)."""
        motions, found = self._bodies(state), np.inf
        least = self._least(motions.each.position)
        for k in np.argsort(least).tolist():
            if least[k] >= found:
                break
            found = min(found, nearest(*self._placed(k, motions)).distance)
        return found

    def _rows(
        self, k: int, motions: Motions, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Heights, gradients and drifts of a pair's points."""
        pair = self._placed(k, motions)
        d, n = nearest(*pair)
        solid, rotation, centre = pair[0]
        points = solid.extremes(rotation.T @ n) @ rotation.T + centre
        height, moved = points @ n, motions.of(self._pairs[k, 0])
        G, drift = _along(n, points, moved)
        if self._world is None:
            other = motions.of(self._pairs[k, 1])
            own, their = _along(n, points, other)
            G, drift = G - own, drift - their
            turned = _cross(other.velocity[3:], n)
            for sign, one in ((2.0, moved), (-2.0, other)):
                drift = drift + sign * (_along(turned, points, one)[0] @ v)
        elif len(points) == 1 and not pair[1][0].half.any():
            across = moved.velocity[:3]
            across = across - (n @ across) * n
            drift = drift + across @ across / (d + solid.swept + pair[1][0].swept)
        return d + height - height.min(), G, drift

    def _placed(self, k: int, motions: Motions) -> list[Placed]:
        """The bodies of a pair in the world."""
        found: list[Placed] = [
            (self._bodies.solids[i], motions.axes[i], motions.each.position[i])
            for i in self._pairs[k].tolist()
        ]
        world = self._world
        return found if world is None else [*found, (world, world.rotation, world.centre)]

    def _least(self, centres: np.ndarray) -> np.ndarray:
        """Lower bounds of all distances (p,), by the balls around the bodies."""
        radii = self._bodies.radii
        if self._world is not None:
            return self._world.bounds(centres) - radii
        one, two = self._pairs.T
        span = centres[one] - centres[two]
        return np.sqrt((span**2).sum(axis=1)) - radii[one] - radii[two]


def _along(n: np.ndarray, points: np.ndarray, moved: LinkMotion) -> tuple[np.ndarray, np.ndarray]:
    """n · J (k, dof) and n · J̇ q̇ (k,) at points (k, 3) of a body, from its centre's motion."""
    arms, turn = points - moved.position, moved.velocity[3:]
    both = np.empty((len(arms), 6))
    both[:, :3], both[:, 3:] = n, _cross(arms, n)
    return both @ moved.jacobian, both @ moved.drift + (arms @ turn) * (turn @ n) - (
        turn @ turn
    ) * (arms @ n)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a × b for the last axes; NumPy's own takes ten times as long."""
    product = np.empty(a.shape)
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    product[..., 0], product[..., 1] = y * b[2] - z * b[1], z * b[0] - x * b[2]
    product[..., 2] = x * b[1] - y * b[0]
    return product
