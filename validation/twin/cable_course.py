"""The course of a cable around round bodies, as MuJoCo's points of its path show it.

MuJoCo lists the points of each tendon's path in its order: the sites, and two points for each body
that the cable touches, where it meets and where it leaves the surface. Turns come from these points
alone. On a cylinder the turn is the angle about its axis from one point to the other, in the sense
in which the cable arrives, times the cosine of its pitch; on a sphere the axis is normal to the
cable's plane. Where both points are one, the cable bends, by the angle between its straight pieces.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from softdyn.description.robot import PathEnd, Robot, Site, Tendon, Wrap, driven_end
from softdyn.validation.twin.drives import anchor_name, wrap_name

ONE_POINT = 1e-12  # m between two points of a bend
NOTHING = 1e-9  # m; a shorter piece of cable has no direction


class Turn(NamedTuple):
    """An element of a path at which a cable rubs: its number in the path, and μ there."""

    element: int
    friction: float


def turns_of(tendon: Tendon) -> list[Turn]:
    """The elements of a path at which its cable turns, in the file's order."""
    return [
        Turn(k, tendon.friction_at(part) if isinstance(part, Wrap) else tendon.friction)
        for k, part in enumerate(tendon.path[1:-1], 1)
    ]


class CableCourse:
    """A cable around round bodies in a compiled model.

    Parameters
    ----------
    model : mujoco.MjModel
        The model; the sites where the cable leaves its bodies are moved.
    robot : Robot
        The description.
    tendon : Tendon
        The cable.
    """

    def __init__(self, model: mujoco.MjModel, robot: Robot, tendon: Tendon) -> None:
        self._model, self._parts = model, tendon.path
        self._tendon = model.tendon(tendon.name).id
        self._geoms = [
            -1 if isinstance(part, Site) else model.geom(wrap_name(tendon, part)).id
            for part in tendon.path
            if isinstance(part, Site | Wrap)
        ]
        # the cable leaves a body at its second point in the file's order, or at its first
        self._last = int(driven_end(robot, tendon) is PathEnd.FIRST)
        self._anchors = {
            k: model.site(anchor_name(tendon, part)).id
            for k, part in enumerate(tendon.path)
            if isinstance(part, Wrap)
        }
        model.site_sameframe[list(self._anchors.values())] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE

    def points(self, data: mujoco.MjData) -> list[np.ndarray]:
        """The points of each element of the path: (1, 3), or of a body (2, 3) or (0, 3)."""
        first = int(data.ten_wrapadr[self._tendon])
        count = int(data.ten_wrapnum[self._tendon])
        owners = data.wrap_obj.ravel()[first : first + count].tolist()
        places = data.wrap_xpos.reshape(-1, 3)[first : first + count]
        found, k = [], 0
        for geom in self._geoms:
            own = 1 if geom < 0 else 2 if owners[k] == geom else 0
            found.append(places[k : k + own])
            k += own
        return found

    def place_anchors(self, data: mujoco.MjData) -> None:
        """Move the sites where the cable leaves its bodies to their present places."""
        points = self.points(data)
        for k, site in self._anchors.items():
            body = self._model.site_bodyid[site]
            if len(points[k]):
                place = points[k][self._last]
            else:  # a straight cable: any point of it
                place = (points[k - 1][-1] + points[k + 1][0]) / 2
            turned = data.xmat[body].reshape(3, 3)
            self._model.site_pos[site] = turned.T @ (place - data.xpos[body])

    def turn(self, data: mujoco.MjData, turns: Sequence[Turn]) -> float:
        """Σ μ φ over some elements of the path."""
        points = self.points(data)
        return sum(t.friction * self._angle(data, points, t.element) for t in turns)

    def _angle(self, data: mujoco.MjData, points: list[np.ndarray], k: int) -> float:
        """The turn φ (rad) at an element."""
        own, flat = points[k], np.concatenate(points)
        if not len(own):
            return 0.0
        first = sum(map(len, points[:k]))
        before = own[0] - flat[first - 1]
        behind = flat[first + len(own)] - own[-1]
        if len(own) == 1 or np.linalg.norm(own[1] - own[0]) < ONE_POINT:
            return _between(before, behind)
        geom = self._geoms[k]
        here, there = own - data.geom_xpos[geom]
        from_end = np.linalg.norm(before) < NOTHING  # a site on the surface
        place, along = (there, behind) if from_end else (here, before)
        axis, cosine = np.cross(place, along), 1.0
        if self._model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER:
            cylinder = data.geom_xmat[geom].reshape(3, 3)[:, 2]
            rise = along @ cylinder
            cosine = float(np.sqrt(1.0 - rise * rise / (along @ along)))
            axis = np.copysign(1.0, axis @ cylinder) * cylinder
            here, there = (x - (x @ cylinder) * cylinder for x in (here, there))
        axis = axis / np.linalg.norm(axis)
        angle = float(np.arctan2(axis @ np.cross(here, there), here @ there))
        return cosine * (angle % (2 * np.pi))


def _between(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
