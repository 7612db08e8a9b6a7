"""Exact bounded least squares: the minimiser of least norm.

    minimise ‖R Q u - d‖², then ‖u‖², over lower ≤ u ≤ upper

It is a primal active-set method (Stark and Parker 1995, BVLS). Each step goes to the least-norm
minimiser over the free inputs, and multipliers are checked in the same order: first those of the
residual, then those of the norm. The objective has no weight on u, so a smaller norm never costs
accuracy. A library's QP solver would need two solves.
"""

from __future__ import annotations

import numpy as np

from softdyn.compiled import compiled
from softdyn.controllers.qps.linear_algebra import (
    add,
    dot,
    factor,
    lq,
    put,
    substitute,
    substitute_back,
)

ROUNDING = 1e-13  # a multiplier below this share of its cancelling terms counts as zero


@compiled
def bounded_least_norm(
    R: np.ndarray,
    Q: np.ndarray,
    d: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    u: np.ndarray,
) -> float:
    """Write the minimiser into `u` (m,), and return its optimality residual.

    Parameters
    ----------
    R : ndarray, (r, r)
        Upper triangular, invertible.
    Q : ndarray, (r, m)
        Orthonormal rows.
    d : ndarray, (r,)
    lower, upper, u : ndarray, (m,)

    Returns
    -------
    float
        0 if no multiplier has the wrong sign; else the largest wrong one, as a share of its
        cancelling terms; NaN if data are not finite.
    """
    (r, m), Qt = Q.shape, Q.T.copy()
    if not np.abs(d).sum() + np.abs(R).sum() < np.inf:
        return np.nan
    free, barred = np.ones(m, np.bool_), np.zeros(m, np.bool_)
    target, y = np.empty(m), np.empty(r)
    _face(R, Qt, d, u, free, target, y)
    for i in range(m):
        free[i] = lower[i] < upper[i] and lower[i] <= target[i] <= upper[i]
        u[i] = min(max(target[i], lower[i]), upper[i])
    released, wrong = -1, np.inf
    for _ in range(20 + 10 * m):
        _face(R, Qt, d, u, free, target, y)
        share, blocking = 1.0, -1
        for i in range(m):
            if free[i] and not lower[i] <= target[i] <= upper[i]:
                bound = lower[i] if target[i] < lower[i] else upper[i]
                part = (bound - u[i]) / (target[i] - u[i])
                if part < share or blocking < 0:
                    share, blocking = part, i
        for i in range(m):
            if free[i]:
                u[i] += share * (target[i] - u[i])
        if blocking >= 0:
            u[blocking] = lower[blocking] if target[blocking] < lower[blocking] else upper[blocking]
            free[blocking] = False
            if share > 0.0:
                barred[:] = False
            elif blocking == released:
                barred[blocking] = True  # its multiplier was only rounding
            continue
        released, wrong = _leaves(R, Qt, d, u, y, free, barred, lower, upper)
        if released < 0:
            return 0.0
        free[released] = True
    return wrong


@compiled
def _face(R, Qt, d, u, free, target, y):
    """Write the least-norm minimiser over the free inputs into `target`; the others stay at u.

    `y` (r,) is filled too: the minimiser is Qᵀ y.
    """
    (m, r), count = Qt.shape, 0
    columns, rest = np.empty((m, r)), np.zeros(r)
    for i in range(m):
        if free[i]:
            put(columns[count], Qt[i])
            count += 1
        else:
            add(rest, u[i], Qt[i])
    y[:] = 0.0
    if count == 0:
        return
    span, triangle, rows = factor(columns[:count], ROUNDING)
    # Q u = rest + spanᵀ s, where s is the least-squares solution of R spanᵀ s = d - R rest
    k = len(span)
    mapped, basis, corner = np.empty((k, r)), np.empty((k, r)), np.empty((k, k))
    right, s = np.empty(r), np.empty((1, k))
    for x in range(r):
        right[x] = d[x] - dot(R[x, x:], rest[x:])
        for i in range(k):
            mapped[i, x] = dot(R[x, x:], span[i, x:])
    lq(mapped, basis, corner)
    for i in range(k):
        s[0, i] = dot(basis[i], right)
    substitute_back(corner.T.copy(), s)
    coordinates = s.T.copy()
    substitute(triangle, coordinates)
    count = 0
    for i in range(m):
        if free[i]:
            target[i] = 0.0
            for j in range(k):
                target[i] += coordinates[j, 0] * rows[j, count]
            count += 1
    for i in range(k):
        s[0, i] = coordinates[i, 0]
    substitute_back(triangle.T.copy(), s)
    for i in range(k):
        add(y, s[0, i], span[i])


@compiled
def _leaves(R, Qt, d, u, y, free, barred, lower, upper):
    """The input that leaves its bound (-1 for none), and the size of its wrong multiplier.

    Multipliers of ‖R Q u - d‖² come first; those of ‖u‖² count only if the former are zero.
    """
    m, r = Qt.shape
    reached, left, back, size = np.zeros(r), np.empty(r), np.zeros(r), 0.0
    for i in range(m):
        add(reached, u[i], Qt[i])
    for x in range(r):
        moved = dot(R[x, x:], reached[x:])
        left[x] = d[x] - moved
        size += abs(d[x]) + abs(moved)
    for x in range(r):
        add(back[x:], left[x], R[x, x:])
    first, second, wrong, wrong_norm = -1, -1, ROUNDING, ROUNDING
    for i in range(m):
        if free[i] or barred[i] or not lower[i] < upper[i]:
            continue
        inward = 1.0 if u[i] == lower[i] else -1.0
        square = 0.0
        for x in range(r):
            column = dot(R[x, x:], Qt[i, x:])
            square += column * column
        scale = np.sqrt(square) * size
        gain = inward * dot(Qt[i], back) / scale if scale > 0 else 0.0
        if gain > wrong:
            first, wrong = i, gain
        elif gain >= -ROUNDING:
            along = dot(Qt[i], y)
            scale = abs(along) + abs(u[i])
            gain = inward * (along - u[i]) / scale if scale > 0 else 0.0
            if gain > wrong_norm:
                second, wrong_norm = i, gain
    return (first, wrong) if first >= 0 else (second, wrong_norm)
