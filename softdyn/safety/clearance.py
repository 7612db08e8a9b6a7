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
from softdyn.safety.solids import MOST, Cores, Solid, World
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

    def of(self, which: np.ndarray) -> LinkMotion:
        """The motions of some bodies."""
        return LinkMotion(*(part[which] for part in self.each))


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
        self.radii, self.cores = np.array([solid.radius for solid in solids]), Cores.of(solids)
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
    """Distances between bodies of links and bodies of the world, or between bodies of links.

    Parameters
    ----------
    bodies : Bodies
        Bodies of links.
    others : sequence of Solid, or ndarray, (p, 2)
        Bodies of the world, each with every body of a link; or pairs of indices of bodies.
    """

    def __init__(self, bodies: Bodies, others: Sequence[Solid] | np.ndarray) -> None:
        self._bodies = bodies
        if isinstance(others, np.ndarray):
            self._world, (self._one, self._two) = None, others.T
            self._whose = np.zeros(len(others), int)
        else:
            count = len(bodies.solids)
            self._world = World(others)
            self._two, self._one = np.divmod(np.arange(len(others) * count), count)
            self._whose = self._two

    def __call__(
        self, state: State, reach: np.ndarray, rate: np.ndarray
    ) -> tuple[Values, np.ndarray]:
        """The distances at most `reach` (m), and those that would close within 2 / `rate` (s).

        For the latter the row b̈ + 2 α ḃ + α² b ≥ 0 already asks for b̈ > 0.

        Parameters
        ----------
        state : State
            The state.
        reach, rate : ndarray, (w,)
            One for each body of the world, or one for all pairs.

        Returns
        -------
        Values
            The distances' values.
        ndarray of int, (rows,)
            The body of the world that each is from.
        """
        motions = self._bodies(state)
        reach, soon, closing = (
            reach[self._whose],
            (2 / rate)[self._whose],
            motions.speeds[self._one],
        )
        if self._world is None:
            closing = closing + motions.speeds[self._two]
        near = np.flatnonzero(
            self._least(motions.each.position) <= np.maximum(reach, soon * closing)
        )
        if not near.size:
            none = np.empty(0)
            return Values(none, np.empty((0, len(state.v))), none, none), np.empty(0, int)
        b, G, drift, pair = self._rows(near, motions, state.v)
        kept = (b <= reach[pair]) | (soon[pair] * (G @ state.v) < -b)
        values = Values(b[kept], G[kept], drift[kept], np.full(np.count_nonzero(kept), MILLIMETRE))
        return values, self._whose[pair[kept]]

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
        self, near: np.ndarray, motions: Motions, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Heights, gradients and drifts of the points of some pairs, and the pair of each."""
        found, cores = (
            [nearest(*self._placed(k, motions)) for k in near.tolist()],
            self._bodies.cores,
        )
        d, n = np.array([one.distance for one in found]), np.array([one.normal for one in found])
        one, two = self._one[near], self._two[near]
        moved, axes = motions.of(one), motions.axes[one]
        normals = (n[:, None] @ axes)[:, 0]
        arms = cores.extremes(one, normals) @ axes.transpose(0, 2, 1)
        height = (arms @ n[:, :, None])[..., 0]
        G, drift = _along(n, arms, moved)
        if self._world is None:
            other = motions.of(two)
            from_other = arms + (moved.position - other.position)[:, None]
            own, their = _along(n, from_other, other)
            G, drift = G - own, drift - their
            turned = _cross(other.velocity[:, 3:], n)
            drift += 2 * (_along(turned, arms, moved)[0] - _along(turned, from_other, other)[0]) @ v
        else:
            curved = np.flatnonzero(cores.single[one] & self._world.balls[two])
            for k in curved.tolist():
                across = moved.velocity[k, :3] - (n[k] @ moved.velocity[k, :3]) * n[k]
                radii = self._bodies.solids[one[k]].swept + self._world.solids[two[k]].swept
                drift[k] += across @ across / (d[k] + radii)
        counted = np.arange(MOST) < cores.counts[one][:, None]
        b = (d - height.min(axis=1))[:, None] + height
        return b[counted], G[counted], drift[counted], near[np.nonzero(counted)[0]]

    def _placed(self, k: int, motions: Motions) -> list[Placed]:
        """The bodies of a pair in the world."""
        which = [self._one[k]] if self._world is not None else [self._one[k], self._two[k]]
        found: list[Placed] = [
            (self._bodies.solids[i], motions.axes[i], motions.each.position[i]) for i in which
        ]
        if self._world is None:
            return found
        world = self._world.solids[self._two[k]]
        return [*found, (world, world.rotation, world.centre)]

    def _least(self, centres: np.ndarray) -> np.ndarray:
        """Lower bounds of all distances (p,), by the balls around the bodies."""
        radii = self._bodies.radii
        if self._world is not None:
            least: np.ndarray = (self._world.bounds(centres) - radii).ravel()
            return least
        span = centres[self._one] - centres[self._two]
        return np.sqrt((span**2).sum(axis=1)) - radii[self._one] - radii[self._two]


def _along(n: np.ndarray, arms: np.ndarray, moved: LinkMotion) -> tuple[np.ndarray, np.ndarray]:
    """n · J (p, k, dof) and n · J̇ q̇ (p, k) at k points of each of p bodies.

    Parameters
    ----------
    n : ndarray, (p, 3)
        A direction for each body.
    arms : ndarray, (p, k, 3)
        The points, from the bodies' centres.
    moved : LinkMotion
        The motions of the centres.
    """
    turn = moved.velocity[:, 3:]
    both = np.empty((*arms.shape[:2], 6))
    both[..., :3], both[..., 3:] = n[:, None], _cross(arms, n[:, None])
    terms = np.stack((turn, n), axis=2)  # ω (ω · a) - (ω · ω) a along n
    along = arms @ terms
    pull = np.stack(((turn * n).sum(axis=1), -(turn**2).sum(axis=1)), axis=1)
    drift = both @ moved.drift[:, :, None] + along @ pull[:, :, None]
    return both @ moved.jacobian, drift[..., 0]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a × b for the last axes; NumPy's own takes ten times as long."""
    product = np.empty(a.shape)
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    u, v, w = b[..., 0], b[..., 1], b[..., 2]
    product[..., 0], product[..., 1], product[..., 2] = y * w - z * v, z * u - x * w, x * v - y * u
    return product
