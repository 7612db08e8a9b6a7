"""A correction of an estimate that ends within the joint limits."""

from __future__ import annotations

import numpy as np

from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.stops import Stops

ROUNDED, RIDGE = 1e-12, 1e-12  # rad or m; share of a variance


def onto_stops(model: SoftModel, at: np.ndarray, asked: np.ndarray, P: np.ndarray) -> np.ndarray:
    """The correction (s,) that ends within the joint limits, nearest to `asked` in P⁻¹.

    It is the projection of Simon and Chia (2002). To clip each joint alone would leave the others
    where they fit a shape that the robot cannot have.

    Parameters
    ----------
    model : SoftModel
        The robot's model.
    at : ndarray, (n,)
        Joint coordinates that it corrects.
    asked : ndarray, (s,)
        A correction, of q first.
    P : ndarray, (s, s)
        Covariance of the errors.
    """
    n, change, stops = model.nv, asked.copy(), Stops.of(model)
    held = np.zeros(n, bool)
    for _ in range(n):
        there = at + change[:n]
        beyond = (there > stops.upper + ROUNDED) | (there < stops.lower - ROUNDED)
        beyond &= np.diag(P)[:n] > 0
        if not (beyond & ~held).any():
            break
        held |= beyond
        k = np.flatnonzero(held)
        wanted = at + asked[:n]
        target = (stops.within(wanted) - wanted)[k]
        variances = P[np.ix_(k, k)] + np.diag(RIDGE * np.diag(P)[k])
        change = asked + P[:, k] @ np.linalg.solve(variances, target)
    there = at + change[:n]
    inside = stops.within(there)
    if (inside != there).any():  # by rounding
        change[:n] = inside - at
    return change
