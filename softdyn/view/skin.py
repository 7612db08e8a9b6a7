"""The smooth skin of a soft arm: rings along the visuals that its file names ``skin``.

The page draws a surface through the rings in every frame. Between two rings it follows a cubic
curve that is tangent to both rings' axes. The bend of a joint is therefore spread over its two
segments, as in the continuous arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise

import numpy as np

from softdyn.description.robot import Robot
from softdyn.description.visuals import CylinderShape, Rgba, Visual


@dataclass(frozen=True, eq=False)
class Ring:
    """A circle about the z-axis of `pose` (4, 4), a pose in the link's frame."""

    link: str
    pose: np.ndarray
    radius: float
    rgba: Rgba


def skins(robot: Robot, shapes: Sequence[Visual]) -> list[list[Ring]]:
    """The rings of each skin, from base to tip; a skin covers one chain of links."""
    rods = [s for s in shapes if s.skin and isinstance(s.shape, CylinderShape)]
    found: list[list[list[Visual]]] = []
    for (link, _), pieces in groupby(rods, key=lambda rod: (rod.link, rod.rgba)):
        above = {link, *(joint.parent for joint in robot.chain(link))}
        if not found or found[-1][-1][-1].link not in above:
            found.append([])
        found[-1].append(list(pieces))
    return [_rings(strand) for strand in found]


def _rings(strand: list[list[Visual]]) -> list[Ring]:
    """A ring in the middle of each piece, and one at each end unless a joint follows there."""
    rings = [_end(strand[0][0], -1)]
    for piece, following in pairwise([*strand, []]):
        low, high = _end(piece[0], -1), _end(piece[-1], 1)
        middle = low.pose.copy()
        middle[:3, 3] = (low.pose[:3, 3] + high.pose[:3, 3]) / 2
        rings.append(replace(low, pose=middle, radius=(low.radius + high.radius) / 2))
        if not following or following[0].link == piece[0].link:
            rings.append(high)
            rings += [_end(following[0], -1)] if following else []
    return rings


def _end(rod: Visual, side: int) -> Ring:
    assert isinstance(rod.shape, CylinderShape)
    pose = rod.pose.copy()
    pose[:3, 3] += side * rod.shape.length / 2 * pose[:3, 2]
    return Ring(rod.link, pose, rod.shape.radius, rod.rgba)
