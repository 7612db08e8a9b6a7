"""A first guess: the equations of motion on smoothed joint angles, linear in the parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import make_smoothing_spline
from scipy.optimize import lsq_linear, minimize_scalar

from softdyn.dynamics.model import SoftModel
from softdyn.identification.data import Measurements
from softdyn.identification.parameters import Parameter, columns_of, neighbours_of
from softdyn.identification.unknowns.friction import friction_of
from softdyn.identification.unknowns.kinds import Around, MotionSample
from softdyn.identification.unknowns.relaxation import SHARE, TIME

MOST = 2000  # samples that the first guess uses
WINDOW = 500  # samples that choose the smoothing
LAMBDA = (-16, 2)  # range of the exponent of the smoothing λ, for times in seconds


def smoothed(data: Measurements, joints: np.ndarray) -> np.ndarray:
    """Joint angles, rates and accelerations (3, N, n) from smoothing splines.

    The splines are SciPy's `make_smoothing_spline`. Each joint has its own amount of smoothing, by
    cross-validation: of the `WINDOW` samples in which the joint moves most, every second one
    predicts the others. SciPy's generalised cross-validation takes five times as long for the same
    result.

    Parameters
    ----------
    data : Measurements
    joints : ndarray, (N, n)
        The measured angles.
    """
    found = np.empty((3, *joints.shape))
    for j, values in enumerate(joints.T):
        spline = None
        if np.ptp(values):
            spline = make_smoothing_spline(data.t, values, lam=_smoothing(data.t, values))
        for order in range(3):
            found[order, :, j] = 0.0 if spline is None else spline.derivative(order)(data.t)
        if spline is None:
            found[0, :, j] = values
    return found


def _smoothing(t: np.ndarray, values: np.ndarray) -> float:
    """λ of the spline that best predicts samples to which it was not fitted."""
    begins = range(0, max(1, len(t) - WINDOW + 1), WINDOW)
    parts = [slice(begin, begin + WINDOW) for begin in begins]
    part = max(parts, key=lambda part: float(np.var(values[part])))
    t, values = t[part], values[part]

    def missed(exponent: float) -> float:
        seen = make_smoothing_spline(t[::2], values[::2], lam=10**exponent)
        return float(np.mean((seen(t[1::2]) - values[1::2]) ** 2))

    return float(10 ** minimize_scalar(missed, bounds=LAMBDA, options={"xatol": 0.1}).x)


def first_guess(
    model: SoftModel,
    unknowns: Sequence[Parameter],
    data: Measurements,
    smooth: np.ndarray,
    stops: np.ndarray,
) -> np.ndarray:
    """θ by weighted least squares on r(q, v, a, u; θ) = 0 with the parameters' lower bounds.

    A second pass weights each joint's equation by the inverse of its residual in the first. If a
    joint is at a stop, its equation is left out of that sample. Rest positions keep the file's
    values, because they multiply a stiffness and the problem would not be linear. So do Maxwell
    branches, whose torques this balance lacks.

    Returns
    -------
    ndarray, (P,)
    """
    theta = np.array([parameter.nominal for parameter in unknowns])
    linear = [
        k for k, parameter in enumerate(unknowns)
        if parameter.kind.name not in ("rest", SHARE, TIME) and not parameter.kind.measures
    ]  # fmt: skip
    if not linear:
        return theta
    angles, rates, accelerations = smooth
    around = Around(model, neighbours_of(model, unknowns, theta))
    rub, columns, loads, rows = friction_of(model), [], [], []
    for k in np.unique(np.linspace(1, len(data.t) - 2, MOST).astype(int)):
        use = np.flatnonzero(~stops[k])
        state = model.state(model.configuration(angles[k]), rates[k])
        # the input jumps at a sample, the smoothed acceleration does not: take the mean of both
        u = (data.u[k - 1] + data.u[k]) / 2
        sample = MotionSample(state, accelerations[k], u, around)
        Y = columns_of(unknowns, sample, len(unknowns))[:, linear]
        r = state.M @ accelerations[k] + state.h - state.B @ u + rub.size * rub.signs(rates[k])
        columns.append(Y[use])
        loads.append((Y @ theta[linear] - r)[use])  # r is linear: r = r₀ + Y (θ - θ₀)
        rows.append(use)
    A, b, joint = np.concatenate(columns), np.concatenate(loads), np.concatenate(rows)
    lower = np.array([unknowns[p].lower for p in linear])
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
    return guess


def near_file(unknowns: Sequence[Parameter], guess: np.ndarray) -> np.ndarray:
    """The guess (P,) within a factor of ten of the file's values, where the file has some."""
    theta = np.array([parameter.nominal for parameter in unknowns])
    free = np.array([one.kind.from_none and one.nominal == 0 for one in unknowns])
    near = np.clip(guess, theta - 0.9 * np.abs(theta), theta + 9 * np.abs(theta))
    return np.where(free, guess, near)
