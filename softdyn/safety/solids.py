"""Convex bodies: the shapes of a robot's links, and obstacles.

A link has its ``<collision>`` shapes or, if it has none, its ``<visual>`` shapes. A mesh counts as
its convex hull, because only convex bodies have distances with one gradient almost everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

import coal
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from softdyn.description.meshes import Mesh
from softdyn.description.robot import Robot, moving_link_of
from softdyn.description.visuals import BoxShape, CylinderShape, Visual, visuals
from softdyn.exceptions import InputError

MOST = 8  # points of a core that can be nearest within a step: corners of a box, or of a mesh
SIGNS = np.array(list(product((-1.0, 1.0), repeat=3)))  # (MOST, 3)
X = np.array([1.0, 0.0])  # the direction across a cylinder for a normal along it


@dataclass(frozen=True, eq=False)
class Solid:
    """A convex body in the frame of a link, or in the world's.

    Attributes
    ----------
    form : coal.CollisionGeometry
        The body in its own frame.
    rotation, centre : ndarray, (3, 3), (3,)
        Pose of its own frame.
    half : ndarray, (3,)
        Half sizes of its core: a box, or a cylinder (radius, radius, half length). The body is all
        points within `swept` of the core. A half-space is the core (∞, ∞, 0); NaN for a mesh.
    round : bool
        Whether the core is a cylinder.
    swept : float
        Radius around the core (m).
    radius : float
        Radius of a ball about `centre` that contains the body (m).
    link : str or None
        The link that carries it, None for the world.
    corners : ndarray, (k, 3), optional
        The vertices of a mesh in its own frame.
    """

    form: Any
    rotation: np.ndarray
    centre: np.ndarray
    half: np.ndarray
    round: bool = False
    swept: float = 0.0
    radius: float = np.inf
    link: str | None = None
    corners: np.ndarray | None = None

    def signed(self, points: np.ndarray) -> np.ndarray:
        """Distances (k,) of points (k, 3) of its own frame's parent; below 0 is the depth inside.

        Only of a half-space, a ball or a box.
        """
        local = (points - self.centre) @ self.rotation
        if np.isinf(self.half[0]):
            return np.asarray(local[:, 2])
        beyond = np.abs(local) - self.half
        if not self.half.any():
            return np.asarray(np.linalg.norm(local, axis=1) - self.swept)
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        return np.asarray(outside + np.minimum(beyond.max(axis=1), 0.0))

    @cached_property
    def is_mesh(self) -> bool:
        """Whether it has no core of simple form."""
        return bool(np.isnan(self.half[0]))


class Cores(NamedTuple):
    """The cores of k bodies of links.

    Attributes
    ----------
    half : ndarray, (k, 3)
        Their half sizes, see `Solid`.
    round, single : ndarray, (k,)
        Whether a core is a cylinder, and whether it is a point.
    corners : tuple
        The vertices of each mesh, None for other bodies.
    counts : ndarray, (k,)
        How many points of a core can be nearest within a step, at most `MOST`.
    """

    half: np.ndarray
    round: np.ndarray
    single: np.ndarray
    corners: tuple[np.ndarray | None, ...]
    counts: np.ndarray

    @classmethod
    def of(cls, solids: Sequence[Solid]) -> Cores:
        """The cores of these bodies."""
        half, corners = np.array([one.half for one in solids]), [one.corners for one in solids]
        single = np.asarray(~half.any(axis=1))
        counts = [MOST if points is None else min(MOST, len(points)) for points in corners]
        round = np.array([one.round for one in solids])
        return cls(half, round, single, tuple(corners), np.where(single, 1, counts))

    def extremes(self, which: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Points (p, MOST, 3) of cores, in their own frames, that lie deepest against the normals.

        They are the corners of a box or mesh. Of a cylinder they are points of both rims: the
        deepest, the one opposite, and those between. Only the first `counts` of a core count.

        Parameters
        ----------
        which : ndarray of int, (p,)
            The cores.
        normals : ndarray, (p, 3)
            A normal for each of them, in its own frame.
        """
        half = self.half[which]
        points = SIGNS * half[:, None]
        round = np.flatnonzero(self.round[which])
        if round.size:
            across, half = normals[round, :2], half[round]
            side = np.sqrt((across**2).sum(axis=1, keepdims=True))
            u, v = (half[:, :1] * np.where(side > 0, across / np.where(side > 0, side, 1), X)).T
            rim = np.stack((u, v, -u, -v, v, -u, -v, u), axis=1).reshape(-1, 4, 2)
            points[round, :4, :2] = points[round, 4:, :2] = rim
            points[round, :4, 2], points[round, 4:, 2] = -half[:, 2:], half[:, 2:]
        for k, core in enumerate(which.tolist()):
            corners = self.corners[core]
            if corners is None:
                continue
            deepest = corners[np.argsort(corners @ normals[k])[:MOST]]
            points[k] = deepest[np.minimum(np.arange(MOST), len(deepest) - 1)]
        return points


class World:
    """Bodies of the world, for bounds of distances from them."""

    def __init__(self, solids: Sequence[Solid]) -> None:
        self.solids = tuple(solids)
        self._rotation = np.array([one.rotation for one in solids])
        self._centre, self._half = (
            np.array([getattr(one, name) for one in solids])[:, None] for name in ("centre", "half")
        )
        self._swept = np.array([[one.swept] for one in solids])
        self._flat = np.isinf(self._half[..., 0])
        self.balls = np.asarray(~self._half.any(axis=(1, 2)))

    def bounds(self, points: np.ndarray) -> np.ndarray:
        """Lower bounds (w, k) of the distances of points (k, 3) from each body (m)."""
        local = (points - self._centre) @ self._rotation
        outside = np.maximum(np.abs(local) - self._half, 0.0)
        far = np.sqrt((outside**2).sum(axis=2)) - self._swept
        return np.where(self._flat, local[..., 2], far)


def ball(centre: np.ndarray, radius: float, link: str | None = None) -> Solid:
    """A ball, or a point if the radius is zero."""
    form, half = coal.Sphere(radius), np.zeros(3)
    return Solid(form, np.eye(3), centre, half, False, radius, radius, link)


def box(rotation: np.ndarray, centre: np.ndarray, half: np.ndarray) -> Solid:
    """A box with the half sizes `half` (3,)."""
    return Solid(coal.Box(*(2 * half)), rotation, centre, half, radius=float(np.linalg.norm(half)))


def half_space(normal: np.ndarray, offset: float) -> Solid:
    """All points with normal · y ≤ offset; z of its own frame is the unit normal."""
    across = np.linalg.svd(normal[None])[2][1:]
    rotation = np.array((*across, normal)).T
    form = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
    return Solid(form, rotation, offset * normal, np.array([np.inf, np.inf, 0.0]))


def link_solids(robot: Robot, links: Sequence[str] | None) -> tuple[Solid, ...]:
    """The bodies of these links, or of all links that move.

    Raises
    ------
    InputError
        For a link or a robot without a shape, and for a shape that cannot be read or has no extent.
    """
    shapes, problems = visuals(robot, ("collision", "visual"))
    if problems:
        raise InputError("links", "shapes that can be read", problems[0])
    found = [_solid(visual) for visual in shapes]
    if links is None:
        carrier = moving_link_of(robot)
        still = None if robot.floating else robot.root
        moving = tuple(solid for solid in found if carrier[str(solid.link)] != still)
        if not moving:
            expected = f"a link of {robot.path} that moves, with a <collision> or <visual> shape"
            raise InputError("links", expected, "none")
        return moving
    for link in links:
        if not any(solid.link == link for solid in found):
            raise InputError("links", "links with a <collision> or <visual> shape", repr(link))
    return tuple(solid for solid in found if solid.link in links)


def _solid(visual: Visual) -> Solid:
    shape, link = visual.shape, visual.link
    rotation, centre = visual.pose[:3, :3], visual.pose[:3, 3]
    if isinstance(shape, Mesh):
        points = np.asarray(shape.vertices, float) @ rotation.T + centre
        centre = (points.min(axis=0) + points.max(axis=0)) / 2
        form, corners = _hull(link, points - centre)
        radius = float(np.linalg.norm(corners, axis=1).max())
        nan = np.full(3, np.nan)
        return Solid(form, np.eye(3), centre, nan, radius=radius, link=link, corners=corners)
    if isinstance(shape, BoxShape):
        half, form = np.array(shape.size) / 2, coal.Box(*shape.size)
    elif isinstance(shape, CylinderShape):
        half = np.array([shape.radius, shape.radius, shape.length / 2])
        form = coal.Cylinder(shape.radius, shape.length)
    else:
        return ball(centre, shape.radius, link)
    round = isinstance(shape, CylinderShape)
    radius = float(np.linalg.norm(half[1:] if round else half))
    if not half.min() > 0:
        raise InputError("links", "shapes with an extent", f"one of link {link!r} without")
    return Solid(form, rotation, centre, half, round, 0.0, radius, link)


def _hull(link: str, points: np.ndarray) -> tuple[Any, np.ndarray]:
    try:
        hull = ConvexHull(points)
    except QhullError:
        raise InputError("links", "meshes with a volume", f"a flat one of link {link!r}") from None
    number = {int(k): i for i, k in enumerate(hull.vertices)}
    corners, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for k in hull.vertices:
        corners.append(points[k])
    for (a, b, c), (x, y, z, _) in zip(hull.simplices, hull.equations, strict=True):
        outward = np.cross(points[b] - points[a], points[c] - points[a]) @ (x, y, z) > 0
        faces.append(coal.Triangle(*(number[k] for k in ((a, b, c) if outward else (a, c, b)))))
    return coal.Convex(corners, faces), points[hull.vertices]
