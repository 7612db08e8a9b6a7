"""Errors in the data that the distances between markers and points reveal: units, frame, names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations, product

import numpy as np
from scipy.spatial.transform import Rotation

from softdyn.exceptions import InputError
from softdyn.identification.markers.camera import kabsch, seen_at

UNITS = {1000.0: "millimetres", 100.0: "centimetres", 39.37: "inches"}  # numbers of each in a metre
SURE = 3.0  # a correction that reduces the distances by this factor is the likely one
LARGE = 0.2  # of the robot's size; smaller distances may come from the file's values


def check_size(points: np.ndarray, seen: np.ndarray) -> None:
    """Refuse markers whose distances from each other are not in metres.

    Parameters
    ----------
    points, seen : ndarray, (N, m, 3)
        Points of the robot, and their markers in any frame and order.

    Raises
    ------
    InputError
        If the distances are those of the robot times a factor beyond 10.
    """
    sizes = [_size(each) for each in (points, seen)]
    if not all(size > 0 for size in sizes):
        return
    ratio = sizes[1] / sizes[0]
    if ratio > 10 or ratio < 0.1:
        unit = min(UNITS, key=lambda one: abs(np.log(ratio / one)))
        guess = f": {UNITS[unit]}?" if 0.5 < ratio / unit < 2 else ""
        got = f"distances between the markers {ratio:.3g} times the robot's{guess}"
        raise InputError("markers", "metres", got)


def _size(places: np.ndarray) -> float:
    """The median over the rows of the markers' spread (m), or of all rows for one marker."""
    if places.shape[1] == 1:
        places = places.transpose(1, 0, 2)
    sizes = []
    for row in places:
        seen = row[np.isfinite(row).all(1)]
        if len(seen) > 1:
            sizes.append(np.sqrt(((seen - seen.mean(0)) ** 2).sum(1).mean()))
    return float(np.median(sizes)) if sizes else 0.0


def check_frame(points: np.ndarray, seen: np.ndarray) -> None:
    """Refuse markers in another frame than the world's, if no camera was stated.

    Raises
    ------
    InputError
        If a turned or moved frame explains the distances much better.
    """
    known = np.isfinite(seen).all(2)
    p, s = points[known], seen[known]
    apart = _rms(p - s)
    if apart < LARGE * np.ptp(points.reshape(-1, 3), axis=0).max() or len(p) < 4:
        return
    camera = kabsch(p, s)
    if SURE * _rms(seen_at(camera, p) - s) > apart:
        return
    turn = Rotation.from_rotvec(camera[3:])
    right = [one for one in _right_angles() if (turn * one.inv()).magnitude() < np.pi / 6]
    angle = np.degrees(np.linalg.norm((right[0] if right else turn).as_rotvec()))
    guess = f"turned by {angle:.0f}°" if angle > 15 else "moved"
    got = f"markers {1e3 * apart:.0f} mm away: a frame that is {guess}? --camera fit finds it"
    raise InputError("markers", "the robot's world frame", got)


def _right_angles() -> Iterator[Rotation]:
    for turns in product(range(4), repeat=3):
        yield Rotation.from_euler("xyz", [90 * turn for turn in turns], degrees=True)


def exchanged(
    names: Sequence[str], points: np.ndarray, seen: np.ndarray, fitted: bool
) -> tuple[str, ...]:
    """A line for the pair of markers that are probably exchanged, if there is one.

    Parameters
    ----------
    names : sequence of str
    points : ndarray, (N, m, 3)
        The model's points in the camera's frame.
    seen : ndarray, (N, m, 3)
    fitted : bool
        Whether the camera is fitted again for each pair.
    """
    count = len(names)
    pairs = list(combinations(range(count), 2))
    costs = {}
    for pair in [(), *pairs]:
        order = np.arange(count)
        order[list(pair)] = order[list(pair[::-1])]
        costs[pair] = _distances(points, seen[:, order], fitted)
    now = costs.pop(())
    if not costs:
        return ()
    best = min(costs, key=lambda pair: float(np.nansum(costs[pair])))
    a, b = (names[k] for k in best)
    text = f"markers {a} and {b} are probably exchanged"
    if SURE**2 * np.nansum(costs[best]) < np.nansum(now):
        return (f"{text}: exchange their columns, or --relabel",)
    better = {pair: SURE**2 * cost < now for pair, cost in costs.items()}
    large = now > 4 * np.nanmedian(now)
    for pair, rows in better.items():
        wrong = np.flatnonzero(rows & large)
        if wrong.size and not fitted:
            a, b = (names[k] for k in pair)
            shown = ", ".join(str(k + 1) for k in wrong[:6]) + (" …" if len(wrong) > 6 else "")
            return (f"markers {a} and {b} are probably exchanged in rows {shown}: --relabel",)
    return ()


def _distances(points: np.ndarray, seen: np.ndarray, fitted: bool) -> np.ndarray:
    """Sum of squared distances in each row (N,)."""
    if fitted:
        points = seen_at(kabsch(points.reshape(-1, 3), seen.reshape(-1, 3)), points)
    result: np.ndarray = np.nansum((points - seen) ** 2, axis=(1, 2))
    return result


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).sum(1).mean()))
