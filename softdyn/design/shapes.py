"""Unit shapes that a robot's URDF scales, as triangles and as binary STL."""

from __future__ import annotations

import numpy as np


def grid_triangles(grid: np.ndarray) -> np.ndarray:
    """Return the triangles of a grid of points that is closed along its second axis.

    Parameters
    ----------
    grid : ndarray, (rows, columns, 3)
        Seen from outside, columns run counter-clockwise about the rows.

    Returns
    -------
    ndarray, (n, 3, 3)
        Corners; triangles without area (at a pole) are left out.
    """
    right = np.roll(grid, -1, axis=1)
    a, b, c, d = grid[:-1], right[:-1], right[1:], grid[1:]
    triangles = np.stack([np.stack([a, b, c], axis=-2), np.stack([a, c, d], axis=-2)])
    triangles = triangles.reshape(-1, 3, 3)
    return triangles[np.linalg.norm(normals(triangles), axis=1) > 1e-9]


def normals(triangles: np.ndarray) -> np.ndarray:
    """Return the cross product of two edges of each triangle, (n, 3)."""
    return np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def stl(triangles: np.ndarray) -> bytes:
    """Return a binary STL file. Rounding makes its bytes independent of the C library."""
    # adding 0 turns -0 into 0
    corners = np.round(triangles, 6) + 0.0
    facing = normals(corners)
    facing = np.round(facing / np.linalg.norm(facing, axis=1, keepdims=True), 4) + 0.0
    record = np.dtype([("vectors", "<f4", (4, 3)), ("attribute", "<u2")])
    data = np.zeros(len(corners), record)
    data["vectors"] = np.concatenate([facing[:, None], corners], axis=1)
    return b"\0" * 80 + np.array(len(corners), "<u4").tobytes() + data.tobytes()


def lathe(profile: np.ndarray, outline: np.ndarray | float = 1.0, columns: int = 72) -> np.ndarray:
    """Return the body that a profile sweeps about x.

    Parameters
    ----------
    profile : ndarray, (rows, 2)
        Radius and x, from the near to the far end.
    outline : float or ndarray, (columns,) or (rows, columns)
        Factor of the radius at each angle, which turns from +z towards -y.
    columns : int
        Number of angles.
    """
    around = np.linspace(0.0, 2 * np.pi, columns, endpoint=False)
    radius = profile[:, :1] * np.ones_like(around) * outline
    x = np.broadcast_to(profile[:, 1:], radius.shape)
    return grid_triangles(np.stack([x, -radius * np.sin(around), radius * np.cos(around)], axis=-1))


def spiral_mesh(taper: float = 0.92258) -> np.ndarray:
    """Return one block of a log-spiral arm, along +x, of length and cable radius 1.

    Three lobes carry a groove each for the cables, at 0, 120 and 240 degrees from +z towards -y.
    The ends are conical, so that blocks touch at the backbone only and the arm can curl.

    Parameters
    ----------
    taper : float
        Radius at the far end relative to the near end.
    """
    around = np.linspace(0.0, 2 * np.pi, 72, endpoint=False)
    to_cable = (around + np.pi / 3) % (2 * np.pi / 3) - np.pi / 3
    lobes = 1.1 + 0.1 * np.cos(3 * around) - 0.22 * np.exp(-((to_cable / 0.11) ** 2))
    # radius and x; the rim covers the sites at 23 % and 93 %
    profile = np.array(
        [
            (0.0, 0.0), (0.34, 0.0), (0.34, 0.06), (0.93, 0.22), (1.0, 0.28),
            (1.0, 0.86), (0.93, 0.92), (0.34, 0.98), (0.34, 1.0), (0.0, 1.0),
        ]
    )  # fmt: skip
    # the backbone is round, the rim is not
    outline = np.where(profile[:, :1] > 0.5, lobes, 1.0) * (1 + (taper - 1) * profile[:, 1:])
    return lathe(profile, outline)


def phalanx_mesh() -> np.ndarray:
    """Return a finger bone along +x, of length 1 and radius 1 at its ends, slimmer in between."""
    end = np.linspace(0.0, np.pi / 2, 7)
    x = np.linspace(0.14, 0.86, 11)
    waist = 1.0 - 0.14 * np.sin(np.pi * (x - x[0]) / (x[-1] - x[0])) ** 2
    near = np.stack([np.sin(end), 0.14 * (1 - np.cos(end))], 1)
    far = np.stack([np.cos(end), 1 - 0.14 * (1 - np.sin(end))], 1)
    return lathe(np.concatenate([near[:-1], np.stack([waist, x], 1), far[1:]]), columns=48)
