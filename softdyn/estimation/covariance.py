"""The covariance of an extended Kalman filter: prediction, updates in Joseph's form, corrections.

The errors are those of q and q̇ (2n), of the disturbances (nd) and their rates (nr), and of the
predicted values of late readings, which wait for their arrival. They stay as they are until then.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg.blas import dger

from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.stops import Stops

RIDGE = 1e-12  # share of a variance; joints whose errors are one error have no inverse without it


def predict(
    P, by_state, by_force, noise, held, stops, span, step, moving, decay, added, turn, gained
):  # fmt: skip
    """Move the covariance P (s, s) over a step, q⁺ = q + T v⁺ and d⁺ of `softdyn.estimation.drift`.

    Parameters
    ----------
    P : ndarray, (s, s)
        Overwritten.
    by_state, by_force, held : ndarray
        Fields of `softdyn.dynamics.implicit_step.ImplicitStepResult`.
    noise : ndarray, (n,)
        Variances of the joint forces, each for a second.
    stops : float
        Variance of the positions of joints that stops hold, as shares of their ranges.
    span : ndarray, (n,)
        The joints' ranges (rad, m).
    step : float
        T (s).
    moving : ndarray of int, (nr,)
        The disturbances with rates; their rates are the errors after the disturbances.
    decay, added, turn, gained : ndarray
        Fields of `softdyn.estimation.drift.DriftStep`.
    """
    n, base = len(held), by_state.shape[1]
    cross = by_state @ P[:base]  # of v⁺ with all errors
    speed = by_state @ cross[:, :base].T
    speed += (by_force * (noise / step)) @ by_force.T
    speed += speed.T
    speed *= 0.5
    P[:n, :n] += step * (cross[:, :n] + cross[:, :n].T + step * speed)
    P[:n, 2 * n :] += step * cross[:, 2 * n :]
    P[:n, n : 2 * n] = cross[:, :n].T + step * speed
    P[n : 2 * n, n : 2 * n] = speed
    P[n : 2 * n, 2 * n :] = cross[:, 2 * n :]
    if base > 2 * n:
        drifts = slice(2 * n, base)
        P[: 2 * n, drifts] *= decay
        P[drifts, 2 * n :] *= decay[:, None]
        P[2 * n :, drifts] *= decay
        P[drifts, drifts] += np.diag(added)
    P[n : 2 * n, :n] = P[:n, n : 2 * n].T
    P[2 * n :, : 2 * n] = P[: 2 * n, 2 * n :].T
    for k, drift in enumerate(moving):
        pair = [2 * n + drift, base + k]
        P[pair] = turn @ P[pair]
        P[:, pair] = P[:, pair] @ turn.T
        P[np.ix_(pair, pair)] += gained
    stopped = np.flatnonzero(held)
    if stopped.size:
        P[stopped] = 0.0
        P[:, stopped] = 0.0
        P[stopped, stopped] = stops * span[stopped] ** 2


def update(P, rows, errors, variances, change, gate):
    """Fuse readings one by one, each with Joseph's form (I - k h) P (I - k h)ᵀ + k R kᵀ.

    With g = P hᵀ and S = h g + R it is P - k gᵀ - g kᵀ + S k kᵀ, for any gain k. An error of the
    gain therefore counts by its square only.

    Parameters
    ----------
    P : ndarray, (s, s)
        Overwritten; its rows are contiguous.
    rows : ndarray, (k, w)
        Jacobians h of the readings by the first w errors; those by the others are zero.
    errors, variances : ndarray, (k,)
        Reading minus prediction, and the variance R of its noise. Readings whose error is not
        finite are left out. The errors are overwritten by those that are left after the readings
        before, in deviations: independent and of variance 1.
    change : ndarray, (s,)
        The correction of the errors is added to it.
    gate : float
        The largest plausible error (deviations). The variance of a reading with a larger one is
        taken to be as large as needed, so that the correction falls with the error's inverse.

    Returns
    -------
    tuple of float, int, int, float and float
        Σ e² / S, the numbers of readings used and of those beyond the gate, and with the share
        w = h P hᵀ / S of the prediction in the variance Σ w (e² / S - 1) and Σ w².
    """
    nis, used, odd, excess, known, width = 0.0, 0, 0, 0.0, 0.0, rows.shape[1]
    # Python's numbers: one operation on a number of NumPy takes three times as long
    # views of the whole, which change with it; P.T is in the order of memory that BLAS expects
    wide, before, turned = P[:, :width], change[:width], P.T
    plain = zip(rows, errors.tolist(), variances.tolist(), strict=True)
    for k, (row, error, noise) in enumerate(plain):
        if not math.isfinite(error):
            continue
        spread = wide @ row
        error -= float(row @ before)
        predicted = float(row @ spread[:width])
        variance = noise + predicted
        if error * error > gate * gate * variance:
            odd += 1
            variance = error * error / (gate * gate)
        share = predicted / variance
        excess += share * (error * error / variance - 1.0)
        known += share * share
        nis += error * error / variance
        errors[k] = error / math.sqrt(variance)
        used += 1
        gain = spread / variance
        change += gain * error
        rest = spread - variance * gain
        dger(-1.0, spread, gain, a=turned, overwrite_a=1)
        dger(-1.0, gain, rest, a=turned, overwrite_a=1)
    return nis, used, odd, excess, known


def symmetrised(P):
    """Make P symmetric up to the last digit, and no variance negative by rounding; its trace."""
    P += P.T
    P *= 0.5
    variances = P.diagonal()
    if variances.min(initial=0.0) < 0:
        negative = np.flatnonzero(variances < 0)
        P[negative] = 0.0
        P[:, negative] = 0.0
    return variances.sum()


def append(P, jacobian):
    """The covariance (s + k, s + k) with the errors of readings whose Jacobian (k, 2n) this is."""
    size, (count, width) = len(P), jacobian.shape
    grown = np.empty((size + count, size + count))
    grown[:size, :size] = P
    grown[size:, :size] = jacobian @ P[:width]
    grown[:size, size:] = grown[size:, :size].T
    grown[size:, size:] = grown[size:, :width] @ jacobian.T
    return grown


def submatrix(P, keep):
    """The covariance of the errors to keep (s,)."""
    chosen = np.flatnonzero(keep)
    return P.take(chosen, axis=0).take(chosen, axis=1)  # np.ix_ takes three times the memory


def usable(readings, largest):
    """The number of readings (k,) that are at most so large; the others become NaN."""
    fits = np.abs(readings) <= largest
    readings[~fits] = np.nan
    return int(fits.sum())


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

    Raises
    ------
    LinAlgError
        As `Stops.solve`, for a covariance that is not finite or far from definite.
    """
    n, stops, wanted = model.nv, Stops.of(model), at + asked[: model.nv]
    deviation = np.sqrt(P.diagonal()[:n])
    known = np.flatnonzero(deviation > 0)  # the others stay where they are
    unit, own = deviation[known], wanted[known]
    scaled = Stops(stops.lower[known] / unit, stops.upper[known] / unit)
    near = P[np.ix_(known, known)] / np.outer(unit, unit) + RIDGE * np.eye(len(known))
    # P⁻¹ (x - asked) is the push of the stops, in deviations
    metric, guess = np.linalg.inv(near), np.sign(own - stops.within(wanted)[known]).astype(int)
    _, held = scaled.solve(metric, -metric @ (own / unit), np.zeros(len(known)), 1.0, guess)
    change, k = asked, known[held != 0]
    if k.size:
        ends = np.where(held[held != 0] > 0, stops.upper[k], stops.lower[k])
        push = np.linalg.solve(
            near[np.ix_(held != 0, held != 0)], (ends - wanted[k]) / deviation[k]
        )
        change = asked + P[:, k] @ (push / deviation[k])
    there = at + change[:n]
    inside = stops.within(there)
    if (inside != there).any():  # by rounding
        change = np.concatenate((inside - at, change[n:]))
    return change
