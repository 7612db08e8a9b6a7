"""Normalised errors of an estimate, and the bounds that a consistent filter keeps.

The normalised estimation error squared, eᵀ P⁻¹ e (NEES), and the normalised innovation squared
(NIS) are chi-squared (Bar-Shalom, Li and Kirubarajan 2001, section 5.4). A mean over runs below the
bounds shows a filter that trusts itself too little, one above them a filter that trusts itself too
much.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from softdyn.checks import array, number, whole
from softdyn.dynamics.model import State
from softdyn.estimation.estimate import StateEstimate
from softdyn.exceptions import InputError

LEAST = 1e-10  # of the largest variance; directions with less are known exactly (joints at a stop)


def chi_squared_bounds(freedom: int, runs: int = 1, level: float = 0.95) -> tuple[float, float]:
    """Bounds of the mean of `runs` independent chi-squared numbers of `freedom` degrees each.

    Raises
    ------
    InputError
        A number of degrees or runs below 1, a level outside (0, 1).
    """
    degrees = whole("freedom", freedom, lower=1) * whole("runs", runs, lower=1)
    level = number("level", level, above=0.0)
    if level >= 1:
        raise InputError("level", "a number < 1", repr(level))
    tail = (1 - level) / 2
    low, high = (float(chdtri(degrees, upper)) / runs for upper in (1 - tail, tail))
    return low, high


def nees(
    estimate: StateEstimate, truth: State, basis: np.ndarray | None = None
) -> tuple[float, int]:
    """Normalised estimation error squared, and its degrees of freedom.

    Parameters
    ----------
    estimate : StateEstimate
        The estimate.
    truth : State
        The robot's state at the same time.
    basis : array_like, (k, 2 nv), optional
        Rows that span the errors to judge; all of q and q̇ by default.

    Raises
    ------
    InputError
        For a basis of another shape.
    """
    model = truth.model
    error = np.concatenate((
        model.coordinates(truth.q) - model.coordinates(estimate.q), truth.v - estimate.v
    ))  # fmt: skip
    error[: model.nv] = np.where(
        np.isinf(model.upper) & (model.nq > model.nv), # a continuous joint's angle
        np.remainder(error[: model.nv] + np.pi, 2 * np.pi) - np.pi, error[: model.nv],
    )  # fmt: skip
    P = estimate.covariance
    if basis is not None:
        rows = np.asarray(basis, float)
        rows = array("basis", rows, (len(rows), len(error)))
        P, error = rows @ P @ rows.T, rows @ error
    values, axes = np.linalg.eigh(P)
    known = values > LEAST * values[-1]
    parts = (axes.T @ error)[known]
    return float(np.sum(parts**2 / values[known])), int(known.sum())
