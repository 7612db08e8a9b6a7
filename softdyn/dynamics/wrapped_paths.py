"""Pieces of cables around round bodies, as functions of a robot's configuration.

A piece runs from a site a around a body W to a site b. Its length depends on both points in W's
frame: see `softdyn.dynamics.wraps`. A joint that moves a but not W has the column c = v + ω × a, as
W sees it; one that moves W but not a has -c, and then also its rotation counts with the other sign.
With the gradients g and the Hessian H of the length by both points,

    ∂ℓ/∂q = Σ g · c,    ∂²ℓ/∂q_j ∂q_k = c_jᵀ H c_k + Σ g · (ω_j × c_k).

The sums are over both sites. The last term counts if both joints are between W and the same site,
and joint j is the one nearer to W, because it then carries the column c_k.

All pieces of a robot are computed at once, as arrays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from softdyn.description.robot import Tendon
from softdyn.dynamics.wraps import Courses, RoundBodies, body_of, courses

Anchor = Callable[[str, np.ndarray], tuple[int, np.ndarray]]
CROSS = np.array(
    (
        (0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0),
        (0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0),
        (0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    )
)  # x @ CROSS are the entries of the matrix X for which ω X is ω × x


@dataclass(frozen=True, eq=False)
class WrappedPaths:
    """All pieces of a robot's cables around round bodies; false if there are none.

    They are in the order of the tendons, and of the sites along each.

    Attributes
    ----------
    tendon, after : ndarray of int, (pieces,)
        The cable, and the number of the site before the round body.
    round_bodies : RoundBodies
        The round bodies.
    carriers : ndarray of int, (pieces, 3)
        The moving bodies that carry the round body and the two sites.
    places : ndarray, (pieces, 3, 3, 1)
        The round body's centre and the sites in the frames of these.
    axes : ndarray, (pieces, 3, 3)
        The round body's axes in the frame of its carrier, as columns.
    moves : ndarray, (pieces, 2, nv)
        1 if a degree of freedom moves a site but not the round body, -1 if it moves the round body
        but not the site, else 0.
    nearer : ndarray of bool, (pieces, nv, nv)
        Whether the first degree of freedom is not farther from the round body than the second.
    owners : ndarray, (tendons, pieces)
        1 if a piece belongs to a tendon, else 0.
    """

    tendon: np.ndarray
    after: np.ndarray
    round_bodies: RoundBodies
    carriers: np.ndarray
    places: np.ndarray
    axes: np.ndarray
    moves: np.ndarray
    nearer: np.ndarray
    owners: np.ndarray

    def __bool__(self) -> bool:
        return len(self.tendon) > 0

    def at(self, S: np.ndarray, rotations: np.ndarray, translations: np.ndarray) -> PlacedPaths:
        """The pieces at one configuration.

        Parameters
        ----------
        S : ndarray, (nv, 6)
            Joint Jacobian columns (v; ω) about the world's origin, as rows.
        rotations, translations : ndarray, (bodies, 3, 3), (bodies, 3)
            The bodies' poses.
        """
        turned = rotations[self.carriers]
        points = (turned @ self.places)[..., 0] + translations[self.carriers]
        axes = turned[:, 0] @ self.axes
        found = courses(self.round_bodies, (points[:, 1:] - points[:, :1]) @ axes)
        return PlacedPaths(self, S, axes, points[:, 1:], found)


@dataclass(frozen=True, eq=False)
class PlacedPaths:
    """The pieces at one configuration.

    Attributes
    ----------
    paths : WrappedPaths
        The pieces.
    S : ndarray, (nv, 6)
        Joint Jacobian columns, as rows.
    axes : ndarray, (pieces, 3, 3)
        The round bodies' axes in the world, as columns.
    points : ndarray, (pieces, 2, 3)
        The sites in the world.
    courses : Courses
        The cables' courses in the round bodies' frames.
    """

    paths: WrappedPaths
    S: np.ndarray
    axes: np.ndarray
    points: np.ndarray
    courses: Courses

    @cached_property
    def directions(self) -> np.ndarray:
        """Unit vectors (pieces, 2, 3) in the world along the cables at the sites, outwards."""
        along: np.ndarray = self.courses.gradient @ self.axes.transpose(0, 2, 1)
        return along

    def lengths(self) -> np.ndarray:
        """The pieces' part of the tendons' lengths (tendons,)."""
        found: np.ndarray = self.paths.owners @ self.courses.length
        return found

    def moment_arms(self) -> np.ndarray:
        """The pieces' part of the tendons' moment arms (tendons, nv)."""
        found: np.ndarray = self.paths.owners @ (self.arms[:, 0] + self.arms[:, 1])
        return found

    @cached_property
    def arms(self) -> np.ndarray:
        """The parts (pieces, 2, nv) of each piece's ∂ℓ/∂q by its sites."""
        wrenches, along = np.empty((*self.points.shape[:2], 6)), self.directions
        wrenches[..., :3] = along
        wrenches[..., 3:] = (_times(self.points) @ along[..., None])[..., 0]
        found: np.ndarray = self.paths.moves * (wrenches @ self.S.T)
        return found

    @cached_property
    def columns(self) -> np.ndarray:
        """∂/∂q (pieces, 2, nv, 3) of the sites' positions in the round bodies' frames."""
        S = self.S
        moved = (S[:, :3] + S[:, 3:] @ _times(self.points)) @ self.axes[:, None]
        found: np.ndarray = self.paths.moves[..., None] * moved
        return found

    @cached_property
    def arm_gradients(self) -> np.ndarray:
        """The gradients (pieces, 2, nv, nv) of the `arms`; of both sites they are ∂²ℓ/∂q²."""
        columns, count = self.columns, len(self.points)
        turning = (self.paths.moves[..., None] * self.S[:, 3:]) @ self.axes[:, None]
        across = columns @ _times(self.courses.gradient)
        carried = turning @ across.transpose(0, 1, 3, 2)
        nearer = self.paths.nearer[:, None]
        carried = np.where(nearer, carried, carried.transpose(0, 1, 3, 2))
        by_q = self._by_points(self.courses.bends.hessian, columns).reshape(count, 2, 3, -1)
        return columns @ by_q + carried

    def turn_gradients(self) -> np.ndarray:
        """∂φ/∂q (pieces, nv) of the turns at the bodies."""
        return self._by_points(self.courses.bends.turn[:, None], self.columns)[:, 0]

    def direction_gradients(self, moves: np.ndarray) -> np.ndarray:
        """∂/∂q (pieces, 2, nv, 3) of the `directions`; `moves` as for `compile_wraps`."""
        count = len(self.points)
        by_q = self._by_points(self.courses.bends.hessian, self.columns)
        by_q = by_q.reshape(count, 2, 3, -1).transpose(0, 1, 3, 2)
        turned = self.S[:, 3:] @ _times(self.directions)
        carried = moves.T[self.paths.carriers[:, 0], None, :, None] * turned
        found: np.ndarray = by_q @ self.axes.transpose(0, 2, 1)[:, None] + carried
        return found

    def curvature(self, force: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The pieces' part of `softdyn.dynamics.tendons.TendonGeometry.curvature`."""
        hessians = self.arm_gradients.sum(axis=1)
        total = np.tensordot(force[self.paths.tendon], hessians, 1)
        return total, self.paths.owners @ (hessians @ v)

    def _by_points(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Gradients (pieces, k, nv) of quantities with gradients (pieces, k, 6) by both points."""
        found: np.ndarray = rows @ columns.transpose(0, 1, 3, 2).reshape(len(rows), 6, -1)
        return found


def compile_wraps(tendons: tuple[Tendon, ...], anchor: Anchor, moves: np.ndarray) -> WrappedPaths:
    """The pieces around round bodies of described tendons.

    Parameters
    ----------
    tendons : tuple of Tendon
        As parsed.
    anchor : callable
        (link, xyz) → (body index, offset (3,) in the body's frame).
    moves : ndarray of bool, (nv, bodies)
        Whether a degree of freedom moves a body.
    """
    numbers, bodies, carriers, places, turned = [], [], [], [], []
    for t, tendon in enumerate(tendons):
        for wrap in tendon.wraps:
            body, axes = body_of(wrap)
            ends = [(site.link, np.array(site.xyz)) for site in tendon.sites[wrap.after :][:2]]
            anchored = [anchor(*point) for point in ((wrap.link, np.array(wrap.xyz)), *ends)]
            centre = anchored[0][1]
            tips = [anchor(wrap.link, np.array(wrap.xyz) + axis)[1] for axis in axes.T]
            numbers.append((t, wrap.after))
            bodies.append(body)
            carriers.append([carrier for carrier, _ in anchored])
            places.append([place for _, place in anchored])
            turned.append(np.array(tips).T - centre[:, None])
    nv = len(moves)
    owner, after = np.array(numbers, int).reshape(-1, 2).T
    carrier = np.array(carriers, int).reshape(-1, 3)
    beyond = moves.T[carrier[:, 0]]  # (pieces, nv): what moves the round body, the last one nearest
    order = np.where(beyond, -1 - np.arange(nv), np.arange(nv))
    return WrappedPaths(
        owner,
        after,
        RoundBodies.of(bodies),
        carrier,
        np.array(places).reshape(-1, 3, 3, 1),
        np.array(turned).reshape(-1, 3, 3),
        moves.T[carrier[:, 1:]].astype(float) - beyond[:, None],
        order[:, :, None] <= order[:, None],
        (np.arange(len(tendons))[:, None] == owner).astype(float),
    )


def _times(x: np.ndarray) -> np.ndarray:
    """The matrices X (..., 3, 3) of vectors x (..., 3), as `CROSS` states them."""
    found: np.ndarray = (x @ CROSS).reshape(*x.shape, 3)
    return found
