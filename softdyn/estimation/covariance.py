"""The covariance of an extended Kalman filter: prediction, and updates in Joseph's form.

The errors are those of q and q̇ (2n), of the disturbances (nd), and of the predicted values of late
readings, which wait for their arrival. They stay as they are until then.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from softdyn.compiled import compiled


@compiled
def predict(P, by_state, by_force, noise, held, step, kept, drift):
    """Move the covariance P (s, s) over a step, q⁺ = q + T v⁺ and d⁺ = kept d.

    Parameters
    ----------
    P : ndarray, (s, s)
        Overwritten.
    by_state, by_force, held : ndarray
        Fields of `softdyn.estimation.implicit_step.ImplicitStepResult`.
    noise : ndarray, (n,)
        Variances of the joint forces over this step.
    step : float
        T (s).
    kept : float
        Share of a disturbance that is left after the step.
    drift : ndarray, (nd,)
        Variances that the step adds to the disturbances.
    """
    n, base, size = len(held), by_state.shape[1], len(P)
    cross = np.dot(by_state, P[:base])  # of v⁺ with all errors
    speed = np.dot(by_state, np.ascontiguousarray(cross[:, :base].T))
    pushes = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            pushes[i, j] = by_force[i, j] * noise[j]
    speed += np.dot(pushes, by_force.T.copy())
    for i in range(n):
        for j in range(i):
            P[i, j] += step * (cross[i, j] + cross[j, i]) + step * step * speed[i, j]
            P[j, i] = P[i, j]
        P[i, i] += step * (2.0 * cross[i, i] + step * speed[i, i])
        for j in range(2 * n, size):
            factor = kept if j < base else 1.0
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
            P[i, j] *= kept
            P[j, i] *= kept
        P[i, i] += drift[i - 2 * n]
    for i in range(n):
        if held[i] != 0:
            for j in range(size):
                P[i, j] = 0.0
                P[j, i] = 0.0


@partial(compiled, reorder=True)
def update(P, rows, errors, variances, change):
    """Fuse readings one by one, each with Joseph's form (I - k h) P (I - k h)ᵀ + k R kᵀ.

    With g = P hᵀ and S = h g + R it is P - k gᵀ - g kᵀ + S k kᵀ, for any gain k. An error of the
    gain therefore counts by its square only.

    Parameters
    ----------
    P : ndarray, (s, s)
        Overwritten.
    rows : ndarray, (k, s)
        Jacobians h of the readings.
    errors, variances : ndarray, (k,)
        Reading minus prediction, and the variance R of its noise. Readings whose error is not
        finite are left out. The errors are overwritten by those that are left after the readings
        before, in deviations: independent and of variance 1.
    change : ndarray, (s,)
        The correction of the errors is added to it.

    Returns
    -------
    tuple of float and int
        Σ e² / (h P hᵀ + R), and the number of readings used.
    """
    size, nis, used = len(P), 0.0, 0
    gain, rest = np.empty(size), np.empty(size)
    for k in range(len(rows)):
        row, error = rows[k], errors[k]
        if not np.isfinite(error):
            continue
        spread = np.dot(P, row)
        error -= np.dot(row, change)
        variance = variances[k] + np.dot(row, spread)
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
    for i in range(size):
        for j in range(i):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i])
    return nis, used
