"""A first guess: the equations of motion on smoothed joint angles, linear in the parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import make_smoothing_spline
from scipy.optimize import lsq_linear

from softdyn.dynamics.model import SoftModel
from softdyn.identification.data import Measurements
from softdyn.identification.parameters import Moment, Parameter, columns_of

MOST = 2000  # samples that the first guess uses


def smoothed(data: Measurements, joints: np.ndarray) -> np.ndarray:
    """Joint angles, rates and accelerations (3, N, n) from smoothing splines.

    The amount of smoothing is each joint's own, by generalised cross-validation (SciPy,
    `make_smoothing_spline`).

    Parameters
    ----------
    data : Measurements
    joints : ndarray, (N, n)
        The measured angles.
    """
    found = np.empty((3, *joints.shape))
    for j, values in enumerate(joints.T):
        spline = make_smoothing_spline(data.t, values) if np.ptp(values) else None
        for order in range(3):
            found[order, :, j] = 0.0 if spline is None else spline.derivative(order)(data.t)
        if spline is None:
            found[0, :, j] = values
    return found


def first_guess(
    model: SoftModel,
    unknowns: Sequence[Parameter],
    data: Measurements,
    smooth: np.ndarray,
    stops: np.ndarray,
) -> np.ndarray:
    """θ by weighted least squares on r(q, v, a, u; θ) = 0 with the parameters' lower bounds.

    Each joint's equation weighs by the inverse of what it leaves over, in a second pass. A
    joint's equation is left out where it is at a stop. Rest positions stay where the file has
    them: they multiply a stiffness.

    Returns
    -------
    ndarray, (P,)
    """
    theta = np.array([parameter.nominal for parameter in unknowns])
    linear = [k for k, parameter in enumerate(unknowns) if parameter.kind.name != "rest"]
    if not linear:
        return theta
    angles, rates, accelerations = smooth
    columns, loads, rows = [], [], []
    for k in np.unique(np.linspace(1, len(data.t) - 2, MOST).astype(int)):
        use = np.flatnonzero(~stops[k])
        state = model.state(model.configuration(angles[k]), rates[k])
        # the input changes at a sample, the smoothed acceleration does not: their mean
        u = (data.u[k - 1] + data.u[k]) / 2
        moment = Moment(state, accelerations[k], u, model)
        Y = columns_of(unknowns, moment, len(unknowns))[:, linear]
        r = state.M @ accelerations[k] + state.h - state.B @ u
        columns.append(Y[use])
        loads.append((Y @ theta[linear] - r)[use])  # r is linear: r = r₀ + Y (θ - θ₀)
        rows.append(use)
    A, b, joint = np.concatenate(columns), np.concatenate(loads), np.concatenate(rows)
    lower = np.array([unknowns[p].kind.lower for p in linear])
    size = np.maximum(np.abs(theta[linear]), 1e-12)
    weights = np.ones(model.nv)
    guess = theta.copy()
    for _ in range(2):
        scaled = A * size * weights[joint, None]
        bounds = (lower / size, np.full(len(linear), np.inf))
        guess[linear] = size * lsq_linear(scaled, b * weights[joint], bounds).x
        left = A @ guess[linear] - b
        count = np.maximum(np.bincount(joint, minlength=model.nv), 1)
        power = np.bincount(joint, left**2, model.nv) / count
        weights = 1 / np.sqrt(np.maximum(power, 1e-12 * max(power.max(), 1e-300)))
    # a guess far away is worse than the file: the fit starts within a factor of ten of it
    return np.clip(guess, theta - 0.9 * np.abs(theta), theta + 9 * np.abs(theta))
