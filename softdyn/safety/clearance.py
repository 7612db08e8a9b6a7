"""Distances of many pairs of convex bodies at a State, as a barrier b = distance - margin.

Let n be the unit normal from B to A at the nearest points a and b. Then ∂d/∂q = n · (J_a - J_b),
where J_a and J_b are Jacobians of the points of the bodies that are nearest at the moment. The part
of d̈ without q̈ is n · (J̇_a - J̇_b) q̇ and the `nearest.turning`. For meshes it is a central
difference of d along the motion with q̈ = 0.

A distance of convex bodies is smooth where the nearest points are unique. Its gradient jumps where
they change their feature at once: flat faces or lines that become parallel, and, for overlapping
bodies, where two faces are equally near.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from softdyn.dynamics.model import SoftModel, State
from softdyn.safety.nearest import Placed, nearest, turning
from softdyn.safety.solids import Solid
from softdyn.tasks.link_motion import LinkKinematics, LinkMotion

MILLIMETRE, CENTIRADIAN = 1e-3, 1e-2  # m, rad; the units in which violations are compared
DIFFERENCE = 1e-3  # s, of the order of a control period: a jump counts as its mean over it
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


class Clearance:
    """Distances between bodies of links and a body of the world, or between bodies of links.

    Parameters
    ----------
    model : SoftModel
        The robot.
    solids : sequence of Solid
        Bodies of links; those of the link `TIP` are at the tip.
    pairs : ndarray, (p, 2), or Solid
        Pairs of indices into `solids`, or the body of the world.
    """

    def __init__(self, model: SoftModel, solids: Sequence[Solid], pairs: np.ndarray | Solid):
        self._kinematics, self._solids = LinkKinematics.of(model), tuple(solids)
        self._points = [tuple(solid.centre.tolist()) for solid in solids]
        self._radii = np.array([solid.radius for solid in solids])
        self._world, self._pairs = None, np.empty((len(solids), 0), int)
        if isinstance(pairs, Solid):
            self._world = pairs
        else:
            self._pairs = pairs

    def __call__(self, state: State, reach: float, rate: float) -> Values:
        """The distances at most `reach` (m), and those that a body approaches faster.

        A body that would close its distance within 2 / `rate` (s) counts: its row
        b̈ + 2 α ḃ + α² b ≥ 0 would already ask for b̈ > 0.
        """
        moved = [self._motion(state, k) for k in range(len(self._solids))]
        centres = np.array([each.position for each in moved])
        least = self._least(centres)
        speed = np.array(
            [_speed(each, solid) for each, solid in zip(moved, self._solids, strict=True)]
        )
        closing = speed if self._world is not None else speed[self._pairs].sum(axis=1)
        near = np.flatnonzero(least <= np.maximum(reach, 2 / rate * closing)).tolist()
        n = len(state.v)
        b, G, drift = np.empty(len(near)), np.empty((len(near), n)), np.empty(len(near))
        for row, k in enumerate(near):
            b[row], G[row], drift[row] = self._row(k, [moved[i] for i in self._bodies(k)])
        return Values(b, G, drift, np.full(len(near), MILLIMETRE))

    def smallest(self, state: State) -> float:
        """The smallest of all distances (m)."""
        moved = [self._motion(state, k) for k in range(len(self._solids))]
        least = self._least(np.array([each.position for each in moved]))
        found = np.inf
        for k in np.argsort(least):
            if least[k] >= found:
                break
            pair = self._placed(k, [moved[i] for i in self._bodies(k)], 0.0)
            found = min(found, nearest(*pair).distance)
        return found

    def _row(self, k: int, moved: Sequence[LinkMotion]) -> tuple[float, np.ndarray, float]:
        """Distance, gradient (n,) and drift of a pair."""
        one, two = self._placed(k, moved, 0.0)
        found = nearest(one, two)
        G, drift, rates = np.zeros(len(moved[0].jacobian.T)), 0.0, np.zeros((2, 6))
        for i, (sign, at, motion) in enumerate(
            zip((1, -1), (found.a, found.b), moved, strict=False)
        ):
            arm, turn = at - motion.position, motion.velocity[3:]
            both = sign * np.concatenate((found.normal, np.cross(arm, found.normal)))
            G += both @ motion.jacobian
            drift += both @ motion.drift + sign * found.normal @ np.cross(turn, np.cross(turn, arm))
            rates[i] = motion.velocity
        if one[0].is_mesh or two[0].is_mesh:
            ahead, behind = (
                nearest(*self._placed(k, moved, t)).distance for t in (DIFFERENCE, -DIFFERENCE)
            )
            return found.distance, G, (ahead - 2 * found.distance + behind) / DIFFERENCE**2
        return found.distance, G, drift + turning(found, one, two, rates)

    def _motion(self, state: State, k: int) -> LinkMotion:
        link = self._solids[k].link
        if link == TIP:
            zero = np.zeros((3, len(state.v)))
            velocity = np.concatenate((state.ydot, np.zeros(3)))
            drift = np.concatenate((state.Jdot @ state.v, np.zeros(3)))
            return LinkMotion(np.eye(3), state.y, np.vstack((state.J, zero)), velocity, drift)
        return self._kinematics(state, str(link), self._points[k])

    def _bodies(self, k: int) -> tuple[int, ...]:
        """Indices of the links' bodies of a pair; one if the other is the world's."""
        return (k,) if self._world is not None else tuple(self._pairs[k])

    def _placed(self, k: int, moved: Sequence[LinkMotion], t: float) -> list[Placed]:
        """The bodies of a pair after a time t with q̈ = 0, to the second order in t."""
        found: list[Placed] = []
        for motion, i in zip(moved, self._bodies(k), strict=True):
            solid, rotation, centre = self._solids[i], motion.rotation, motion.position
            if t:
                change = t * motion.velocity + t * t / 2 * motion.drift
                rotation, centre = pin.exp3(change[3:]) @ rotation, centre + change[:3]
            found.append((solid, rotation @ solid.rotation, centre))
        world = self._world
        return found if world is None else [*found, (world, world.rotation, world.centre)]

    def _least(self, centres: np.ndarray) -> np.ndarray:
        """Lower bounds of all distances (p,), by the balls around the bodies."""
        if self._world is not None:
            return self._world.bounds(centres) - self._radii
        one, two = self._pairs.T
        apart = np.linalg.norm(centres[one] - centres[two], axis=1)
        return apart - self._radii[one] - self._radii[two]


def _speed(moved: LinkMotion, solid: Solid) -> float:
    """An upper bound of the speed of a body's points (m/s)."""
    linear, turn = moved.velocity[:3], moved.velocity[3:]
    return float(np.linalg.norm(linear) + solid.radius * np.linalg.norm(turn))
