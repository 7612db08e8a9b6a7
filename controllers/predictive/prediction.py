"""The linear prediction model of the predictive controller, and its condensed QP.

About the present (q₀, q̇₀) and the input a₀ that acts, with p = q ⊖ q₀ (`docs/beyond.md`),

    M q̈ = f - D_t q̇ - K_t p + B (a - a₀),      f = B a₀ - h + D_t q̇₀ + d,

is integrated by the two-stage, second-order, L-stable SDIRK method (Alexander 1977), whose two
stages share one matrix S = M + g D_t + g² K_t, g = (1 - 1/√2) Δt. The model does not change over
the horizon: the response to one unit of input in the first step, shifted, is the response to it in
every later one.
"""

from __future__ import annotations

import numpy as np

from softdyn.compiled import compiled

STAGE = 1.0 - 0.5**0.5


def ramps(knots: tuple[int, ...]) -> np.ndarray:
    """Mean inputs of the steps (N, knots): the input runs straight from knot to knot.

    Parameters
    ----------
    knots : the steps at whose ends the input is an unknown, the last one N; before the first it
        starts from w = 0, the input that acts then.
    """
    times = np.array((0, *knots), float)
    middle = np.arange(knots[-1]) + 0.5
    hats = np.eye(len(times))
    return np.stack([np.interp(middle, times, hat) for hat in hats[1:]], axis=1)


@compiled
def respond(M, K, D, B, force, p, v, step, count):
    """Responses p, q̇ (count, n, 1 + m): the free one, then those to a unit of each first input.

    Parameters: M, K_t, D_t (n, n), B (n, m), the force f (n,) at the point of linearisation, first
    p and q̇ (n,), Δt (s), number of steps.
    """
    n, m = B.shape
    g = STAGE * step
    rest = step - g
    inverse = np.linalg.inv(M + g * D + g * g * K)
    by_v, by_p = -inverse @ (D + g * K), -inverse @ K
    F = np.zeros((n, 1 + m))
    F[:, 0], F[:, 1:] = force, B
    F = inverse @ F
    P, V = np.zeros((n, 1 + m)), np.zeros((n, 1 + m))
    P[:, 0], V[:, 0] = p, v
    positions, speeds = np.empty((count, n, 1 + m)), np.empty((count, n, 1 + m))
    for k in range(count):
        if k == 1:
            F[:, 1:] = 0.0
        A = F + by_v @ V + by_p @ P
        P, V = P + rest * (V + g * A), V + rest * A
        A = F + by_v @ V + by_p @ P
        V = V + g * A
        P = P + g * V
        positions[k], speeds[k] = P, V
    return positions, speeds


@compiled
def stacked(rows, responses, shape):
    """Free outputs (N r,) and their map (N r, knots m) from the unknown inputs.

    Parameters
    ----------
    rows : (r, n) what is put out.
    responses : (N, n, 1 + m) from `respond`.
    shape : (N, knots) from `ramps`.
    """
    count, r, m = len(responses), len(rows), responses.shape[2] - 1
    knots = shape.shape[1]
    free, unit = np.empty(count * r), np.empty((count, r, m))
    for k in range(count):
        output = rows @ responses[k]
        free[k * r : (k + 1) * r] = output[:, 0]
        unit[k] = output[:, 1:]
    result = np.zeros((count * r, knots * m))
    for j in range(count):
        for b in range(knots):
            share = shape[j, b]
            if share != 0.0:
                for k in range(j, count):
                    for i in range(r):
                        for a in range(m):
                            result[k * r + i, b * m + a] += share * unit[k - j, i, a]
    return free, result


@compiled
def condensed_qp(M, K, D, B, rows, force, p, v, error, pace, shape, step, metric, inputs, offset):
    """Objective ½ xᵀHx + gᵀx + c over the inputs at the knots, x (knots m,) relative to a₀.

    Σ_k ‖error_k + rows p_k‖² + ‖metric q̇_k - pace_k‖² + xᵀ inputs x + 2 offsetᵀ x; error (N, r),
    pace (N, n).
    """
    positions, speeds = respond(M, K, D, B, force, p, v, step, len(error))
    free, tip = stacked(rows, positions, shape)
    free = free + error.copy().reshape(-1)
    idle, rush = stacked(metric, speeds, shape)
    idle = idle - pace.copy().reshape(-1)
    H = tip.T @ tip + rush.T @ rush + inputs
    for i in range(len(H)):
        H[i, i] += 1e-10 * np.trace(H) / len(H)
    g = tip.T @ free + rush.T @ idle + offset
    return 2.0 * H, 2.0 * g, np.dot(free, free) + np.dot(idle, idle)


@compiled
def ahead(M, K, D, B, force, p, v, changes, step):
    """p and q̇ (n,) after steps of backward Euler, and the matrix M + T D_t + T² K_t of one.

    Parameters: as `respond` has them; the mean change of the input a - a₀ over each step
    (steps, m); a step's length T (s).
    """
    matrix = M + step * D + step * step * K
    inverse = np.linalg.inv(matrix)
    p, speed = p.copy(), v.copy()
    for k in range(len(changes)):
        push = force + B @ changes[k] - K @ p
        speed = inverse @ (M @ speed + step * push)
        p = p + step * speed
    return p, speed, matrix
