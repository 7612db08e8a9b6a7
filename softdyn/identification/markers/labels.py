"""Which measured marker is which point of the robot, where the capture system relabels them.

The rule: in a row, each marker is the point of the robot that makes the sum of squared distances
least. Rows of equilibria are compared with the model's. Of a motion only the first row is; each
later marker is the one whose last two places, extrapolated, are nearest. A camera that is not
known yet is the rigid transform with the least sum over all rows, among those that some order of
the markers in one of `STARTS` rows suggests.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pinocchio as pin
from scipy.optimize import linear_sum_assignment

from softdyn.exceptions import InputError
from softdyn.identification.markers.camera import FEWEST_POINTS, kabsch, seen_at

MOST = 7  # markers whose orders can all be tried
STARTS, KEPT = 12, 3  # rows whose orders are tried for an unknown camera, and orders kept of each
ROUNDS = 20
FAR = 1e6  # m^2, instead of the distance to a marker that was not seen


def nearest(points: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """For each point (m, 3) the index of its marker among those seen (m, 3); gaps come last."""
    apart = ((points[:, None] - seen[None]) ** 2).sum(2)
    result: np.ndarray = linear_sum_assignment(np.where(np.isfinite(apart), apart, FAR))[1]
    return result


def ordered(seen: np.ndarray, order: np.ndarray) -> np.ndarray:
    """The markers (N, m, 3) in the order (N, m) of the robot's points."""
    return np.take_along_axis(seen, order[:, :, None], 1)


def match(
    points: np.ndarray, seen: np.ndarray, camera: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """The order (N, m) of the markers in each row, and the camera (6,).

    Parameters
    ----------
    points : ndarray, (N, m, 3)
        Points of the robot in the world.
    seen : ndarray, (N, m, 3)
        Markers in the camera's frame, in any order; NaN where one was not seen.
    camera : ndarray, (6,), or None
        None if it is unknown.

    Raises
    ------
    InputError
        If the camera is unknown and no row has all markers, or they are fewer than 3 or more than
        `MOST`.
    """
    if camera is not None:
        return _orders(points, seen_back(camera, seen)), camera
    count = points.shape[1]
    whole = np.flatnonzero(np.isfinite(seen).all((1, 2)))
    if not (FEWEST_POINTS <= count <= MOST and whole.size):
        expected = f"{FEWEST_POINTS} to {MOST} markers that are all seen in some row"
        raise InputError("markers without names", expected, f"{count}, {whole.size} such rows")
    tries = np.array(list(permutations(range(count))))
    best: tuple[float, np.ndarray, np.ndarray] | None = None
    for row in whole[np.unique(np.linspace(0, len(whole) - 1, STARTS).astype(int))]:
        costs = [_cost(points[row], seen[row, order]) for order in tries]
        for k in np.argsort(costs)[:KEPT]:
            found = _improved(points, seen, kabsch(points[row], seen[row, tries[k]]))
            if best is None or found[0] < best[0]:
                best = found
    assert best is not None
    return best[1], best[2]


def seen_back(camera: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Markers (..., 3) of the camera's frame in the world: the inverse of `seen_at`."""
    result: np.ndarray = (seen - camera[:3]) @ pin.exp3(camera[3:])
    return result


def _orders(points: np.ndarray, back: np.ndarray) -> np.ndarray:
    return np.array([nearest(*row) for row in zip(points, back, strict=True)])


def _cost(points: np.ndarray, seen: np.ndarray) -> float:
    return float(((seen_at(kabsch(points, seen), points) - seen) ** 2).sum())


def _improved(
    points: np.ndarray, seen: np.ndarray, camera: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """The sum of squares, order and camera from alternating both (Besl and McKay 1992)."""
    order = _orders(points, seen_back(camera, seen))
    for _ in range(ROUNDS):
        camera = kabsch(points.reshape(-1, 3), ordered(seen, order).reshape(-1, 3))
        before, order = order, _orders(points, seen_back(camera, seen))
        if (order == before).all():
            break
    left = seen_at(camera, points) - ordered(seen, order)
    return float(np.nansum(left**2)), order, camera


def followed(seen: np.ndarray, t: np.ndarray, first: np.ndarray) -> np.ndarray:
    """The order (N, m) of markers in a motion, from that of its first row (m,).

    A marker that was not seen keeps its last place and speed for the comparison.
    """
    order = np.tile(first, (len(seen), 1))
    place, speed = seen[0, first], np.zeros((len(first), 3))
    last = np.full(len(first), t[0])
    for k in range(1, len(seen)):
        order[k] = nearest(place + speed * (t[k] - last)[:, None], seen[k])
        now = seen[k, order[k]]
        known = np.isfinite(now).all(1)
        speed[known] = (now - place)[known] / (t[k] - last)[known, None]
        place[known], last[known] = now[known], t[k]
    return order
