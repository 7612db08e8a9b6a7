"""Convex bodies: the shapes of a robot's links, and obstacles.

A link has its ``<collision>`` shapes or, if it has none, its ``<visual>`` shapes. A mesh counts as
its convex hull, because only convex bodies have distances with one gradient almost everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import coal
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from softdyn.description.meshes import Mesh
from softdyn.description.robot import Robot, moving_link_of
from softdyn.description.visuals import BoxShape, CylinderShape, Visual, visuals
from softdyn.exceptions import InputError

MOST = 8  # corners of a mesh that can be nearest within a step


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

    @cached_property
    def is_mesh(self) -> bool:
        """Whether it has no core of simple form."""
        return bool(np.isnan(self.half[0]))

    def extremes(self, normal: np.ndarray) -> np.ndarray:
        """Points (k, 3) of the core, in its own frame: all that lie deepest against `normal` (3,).

        They are the corners of a box or mesh. Of a cylinder they are points of both rims: the
        deepest, the one opposite, and those between.
        """
        if self.corners is not None:
            return self.corners[np.argsort(self.corners @ normal)[:MOST]]
        if not self.round:
            return self._box
        side = math.hypot(normal[0], normal[1])
        u, v = (normal[:2] / side).tolist() if side > 0 else (1.0, 0.0)
        r, _, h = self.half.tolist()
        points = np.empty((8, 3))
        points[:4, :2] = points[4:, :2] = r * np.array(((u, v), (-u, -v), (v, -u), (-v, u)))
        points[:4, 2], points[4:, 2] = -h, h
        return points

    @cached_property
    def _box(self) -> np.ndarray:
        sides = [(-x, x) if x else (0.0,) for x in self.half.tolist()]
        return np.array(list(product(*sides)))

    def bounds(self, points: np.ndarray) -> np.ndarray:
        """Lower bounds (k,) of the distances of points (k, 3) from a body of the world (m)."""
        local = (points - self.centre) @ self.rotation
        if np.isinf(self.half[0]):
            return local[:, 2]
        outside = np.maximum(np.abs(local) - self.half, 0.0)
        return np.sqrt((outside**2).sum(axis=1)) - self.swept


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
