"""The covariance of an extended Kalman filter: prediction, updates in Joseph's form, corrections.

The errors are those of q and q̇ (2n), of the disturbances (nd) and their rates (nr), and of the
predicted values of late readings, which wait for their arrival. They stay as they are until then.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from softdyn.compiled import compiled
from softdyn.dynamics.model import SoftModel

ROUNDED, RIDGE = 1e-12, 1e-12  # rad or m; share of a variance


@compiled
def predict(P, by_state, by_force, noise, held, step, moving, kept, added, turn, gained):
    """Move the covariance P (s, s) over a step, q⁺ = q + T v⁺ and d⁺ of `softdyn.estimation.drift`.

    Parameters
    ----------
    P : ndarray, (s, s)
        Overwritten.
    by_state, by_force, held : ndarray
        Fields of `softdyn.dynamics.implicit_step.ImplicitStepResult`.
    noise : ndarray, (n,)
        Variances of the joint forces, each for a second.
    step : float
        T (s).
    moving : ndarray of int, (nr,)
        The disturbances with rates; their rates are the errors after the disturbances.
    kept, added, turn, gained : ndarray
        Fields of `softdyn.estimation.drift.DriftStep`.
    """
    n, base, size = len(held), by_state.shape[1], len(P)
    cross = np.dot(by_state, P[:base])  # of v⁺ with all errors
    speed = np.dot(by_state, np.ascontiguousarray(cross[:, :base].T))
    pushes = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            pushes[i, j] = by_force[i, j] * noise[j] / step
    speed += np.dot(pushes, by_force.T.copy())
    for i in range(n):
        for j in range(i):
            P[i, j] += step * (cross[i, j] + cross[j, i]) + step * step * speed[i, j]
            P[j, i] = P[i, j]
        P[i, i] += step * (2.0 * cross[i, i] + step * speed[i, i])
        for j in range(2 * n, size):
            factor = kept[j - 2 * n] if j < base else 1.0
            P[i, j] = factor * (P[i, j] + step * cross[i, j])
            P[j, i] = P[i, j]
            P[n + i, j] = factor * cross[i, j]
            P[j, n + i] = P[n + i, j]
    for i in range(n):
        for j in range(n):
            P[i, n + j] = cross[j, i] + step * speed[i, j]
            P[n + j, i] = P[i, n + j]
            P[n + i, n + j] = 0.5 * (speed[i, j] + speed[j, i])
    for i in range(2 * n, base):
        for j in range(2 * n, size):
            P[i, j] *= kept[i - 2 * n]
            P[j, i] *= kept[i - 2 * n]
        P[i, i] += added[i - 2 * n]
    for k in range(len(moving)):
        i, rate = 2 * n + moving[k], base + k
        for j in range(size):
            a, b = P[i, j], P[rate, j]
            P[i, j] = turn[0, 0] * a + turn[0, 1] * b
            P[rate, j] = turn[1, 0] * a + turn[1, 1] * b
        for j in range(size):
            a, b = P[j, i], P[j, rate]
            P[j, i] = turn[0, 0] * a + turn[0, 1] * b
            P[j, rate] = turn[1, 0] * a + turn[1, 1] * b
        P[i, i] += gained[0, 0]
        P[i, rate] += gained[0, 1]
        P[rate, i] += gained[1, 0]
        P[rate, rate] += gained[1, 1]
    for i in range(n):
        if held[i] != 0:
            for j in range(size):
                P[i, j] = 0.0
                P[j, i] = 0.0


@partial(compiled, reorder=True)
def update(P, rows, errors, variances, change, gate):
    """Fuse readings one by one, each with Joseph's form (I - k h) P (I - k h)ᵀ + k R kᵀ.

    With g = P hᵀ and S = h g + R it is P - k gᵀ - g kᵀ + S k kᵀ, for any gain k. An error of the
    gain therefore counts by its square only.

    Parameters
    ----------
    P : ndarray, (s, s)
        Overwritten.
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
    size, nis, used, odd, excess, known = len(P), 0.0, 0, 0, 0.0, 0.0
    row, gain, rest = np.zeros(size), np.empty(size), np.empty(size)
    for k in range(len(rows)):
        error = errors[k]
        if not np.isfinite(error):
            continue
        row[: len(rows[k])] = rows[k]
        spread = np.dot(P, row)
        error -= np.dot(row, change)
        predicted = np.dot(row, spread)
        variance = variances[k] + predicted
        if error * error > gate * gate * variance:
            odd += 1
            variance = error * error / (gate * gate)
        share = predicted / variance
        excess += share * (error * error / variance - 1.0)
        known += share * share
        nis += error * error / variance
        errors[k] = error / np.sqrt(variance)
        used += 1
        for i in range(size):
            gain[i] = spread[i] / variance
            change[i] += gain[i] * error
            rest[i] = spread[i] - variance * gain[i]
        for i in range(size):
            a, b, line = gain[i], rest[i], P[i]
            for j in range(size):
                line[j] -= a * spread[j] + b * gain[j]
    return nis, used, odd, excess, known


@compiled
def symmetrised(P):
    """Make P symmetric up to the last digit, and no variance negative by rounding; its trace."""
    trace = 0.0
    for i in range(len(P)):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])
    for i in range(len(P)):
        if P[i, i] < 0:
            P[i] = 0.0
            P[:, i] = 0.0
        trace += P[i, i]
    return trace


@compiled
def append(P, jacobian):
    """The covariance (s + k, s + k) with the errors of readings whose Jacobian (k, 2n) this is."""
    size, (count, width) = len(P), jacobian.shape
    cross = np.dot(jacobian, P[:width])
    own = np.dot(cross[:, :width].copy(), jacobian.T)
    grown = np.empty((size + count, size + count))
    for i in range(size):
        for j in range(size):
            grown[i, j] = P[i, j]
    for k in range(count):
        for j in range(size):
            grown[size + k, j] = grown[j, size + k] = cross[k, j]
        for j in range(count):
            grown[size + k, size + j] = own[k, j]
    return grown


@compiled
def kept_rows(P, keep):
    """The covariance of the errors to keep (s,)."""
    chosen = np.flatnonzero(keep)
    left = np.empty((len(chosen), len(chosen)))
    for i in range(len(chosen)):
        for j in range(len(chosen)):
            left[i, j] = P[chosen[i], chosen[j]]
    return left


@compiled
def usable(readings, largest):
    """The number of readings (k,) that are at most so large; the others become NaN."""
    count = 0
    for k in range(len(readings)):
        if abs(readings[k]) <= largest:
            count += 1
        else:
            readings[k] = np.nan
    return count


@compiled
def moved(q, v, d, change, lower, upper):
    """Correct q, v and d in place if q (n,) stays within its limits; else return False."""
    n = len(v)
    for i in range(n):
        if not lower[i] <= q[i] + change[i] <= upper[i]:
            return False
    for i in range(n):
        q[i] += change[i]
        v[i] += change[n + i]
    for i in range(len(d)):
        d[i] += change[2 * n + i]
    return True


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
    n, change = model.nv, asked.copy()
    held = np.zeros(n, bool)
    for _ in range(n):
        there = at + change[:n]
        beyond = (there > model.upper + ROUNDED) | (there < model.lower - ROUNDED)
        beyond &= np.diag(P)[:n] > 0
        if not (beyond & ~held).any():
            break
        held |= beyond
        k = np.flatnonzero(held)
        wanted = at[k] + asked[k]
        target = np.clip(wanted, model.lower[k], model.upper[k]) - wanted
        variances = P[np.ix_(k, k)] + np.diag(RIDGE * np.diag(P)[k])
        change = asked + P[:, k] @ np.linalg.solve(variances, target)
    there = at + change[:n]
    inside = np.clip(there, model.lower, model.upper)
    if (inside != there).any():  # by rounding
        change[:n] = inside - at
    return change
