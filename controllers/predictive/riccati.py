"""The backward pass of a plan: a quadratic cost-to-go along a linearised path, bounded commands.

Differences from the path obey x_{k+1} = A x_k + B c_k + d_k, where the path misses the model's step
by the drift d_k. With the cost-to-go ½ xᵀVx + sᵀx after step k, where s contains V d_k,

    Q_cc = Bᵀ V B + R,   Q_cx = Bᵀ V A + N,   Q_c = Bᵀ s + r,   c = step + gain x,

where the step minimises ½ cᵀ Q_cc c + Q_cᵀ c within the bounds, and the gain -Q_cc⁻¹ Q_cx is that
of the commands that are not at one (Tassa, Mansard and Todorov, "Control-limited differential
dynamic programming", 2014).
"""

from __future__ import annotations

import numpy as np

from softdyn.compiled import compiled

PASSES = 50  # of Newton's method in the free commands
ENOUGH = 1e-12  # relative decrease of the objective at which it ends


@compiled
def free_of(x, slope, lower, upper):
    """Whether each component (m,) is not pressed against a bound by the slope of the objective."""
    return ~(((x <= lower) & (slope > 0)) | ((x >= upper) & (slope < 0)))


@compiled
def bounded_minimum(H, g, lower, upper):
    """The minimiser x (m,) of ½ xᵀHx + gᵀx within bounds that contain 0, and its free components.

    Projected Newton steps, halved until the objective falls. H (m, m) must be positive definite.
    """
    x, value = np.zeros(len(g)), 0.0
    for _ in range(PASSES):
        slope = g + H @ x
        index = np.flatnonzero(free_of(x, slope, lower, upper))
        block = np.empty((len(index), len(index)))
        for i in range(len(index)):
            block[i] = H[index[i]][index]
        newton = np.zeros(len(g))
        newton[index] = -np.linalg.solve(block, slope[index])
        share, before = 1.0, value
        while share > 1e-9:
            trial = np.minimum(np.maximum(x + share * newton, lower), upper)
            found = np.dot(trial, 0.5 * (H @ trial) + g)
            if found < value:
                x, value = trial, found
                break
            share *= 0.5
        if before - value <= ENOUGH * abs(value):
            break
    return x, free_of(x, g + H @ x, lower, upper)


@compiled
def backward(A, B, J, error, away, gap, drift, weight, last, change, extra, lower, upper):
    """Steps (N, m) and gains (N, m, nx) of the commands.

    The cost is the sum over the steps of ‖error + J x‖² + (away + x)ᵀ weight (away + x) after each,
    and of (gap + c - a)ᵀ change (gap + c - a) with the acting input a.

    Parameters
    ----------
    A, B : (N, nx, nx), (N, nx, m) the linearised steps; a state ends with the acting input (m,).
    J, error : (N, 3, n), (N, 3) the tip's Jacobian and error after each step.
    away : (N, nx) the state after each step minus the target's.
    gap : (N, m) the path's command minus its acting input at the begin of each step.
    drift : (N, nx) the model's step minus the path's.
    weight, last : (nx, nx) the weights of a state, and what is added for the last one.
    change : (m, m) the weight of the command minus the acting input.
    extra : (m, m) what is added to Q_cc, so that a step stays small.
    lower, upper : (N, m) the bounds minus the path's commands.
    """
    count, nx, m = B.shape
    n, acting = J.shape[2], nx - m
    steps, gains = np.zeros((count, m)), np.zeros((count, m, nx))
    V, s = last.copy(), last @ away[count - 1]
    for k in range(count - 1, -1, -1):
        V += weight
        V[:n, :n] += J[k].T @ J[k]
        s += weight @ away[k]
        s[:n] += J[k].T @ error[k]
        s += V @ drift[k]
        VB, pull = V @ B[k], change @ gap[k]
        Qcc, Qcx, Qc = B[k].T @ VB + change, VB.T @ A[k], B[k].T @ s + pull
        Qxx, Qx = A[k].T @ (V @ A[k]), A[k].T @ s
        Qcx[:, acting:] -= change
        Qxx[acting:, acting:] += change
        Qx[acting:] -= pull
        step, free = bounded_minimum(Qcc + extra, Qc, lower[k], upper[k])
        index = np.flatnonzero(free)
        block, right = np.empty((len(index), len(index))), np.empty((len(index), nx))
        for i in range(len(index)):
            block[i] = (Qcc + extra)[index[i]][index]
            right[i] = Qcx[index[i]]
        right = -np.linalg.solve(block, right)
        for i in range(len(index)):
            gains[k, index[i]] = right[i]
        K = gains[k]
        V = Qxx + K.T @ (Qcc @ K) + K.T @ Qcx + Qcx.T @ K
        V = 0.5 * (V + V.T)
        s = Qx + K.T @ (Qcc @ step + Qc) + Qcx.T @ step
        steps[k] = step
    return steps, gains
