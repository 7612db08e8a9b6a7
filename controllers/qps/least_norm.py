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
from softdyn.controllers.qps.linear_algebra import add, dot, factor, lq

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
    r, m = Q.shape
    Qt, target, y, total = np.empty((m, r)), np.empty(m), np.empty(r), 0.0
    free, barred = np.ones(m), np.zeros(m)  # 1 for an input in this set, else 0
    for x in range(r):
        total += abs(d[x])
        for i in range(r):
            total += abs(R[x, i])
        for i in range(m):
            Qt[i, x] = Q[x, i]
    if not total < np.inf:
        return np.nan
    _face(R, Qt, d, u, free, target, y)
    for i in range(m):
        inside = lower[i] <= target[i] <= upper[i]
        free[i] = 1.0 if lower[i] < upper[i] and inside else 0.0
        u[i] = target[i] if inside else lower[i] if target[i] < lower[i] else upper[i]
    released, wrong = -1, np.inf
    for _ in range(20 + 10 * m):
        _face(R, Qt, d, u, free, target, y)
        share, blocking = 1.0, -1
        for i in range(m):
            if free[i] != 0 and not lower[i] <= target[i] <= upper[i]:
                bound = lower[i] if target[i] < lower[i] else upper[i]
                part = (bound - u[i]) / (target[i] - u[i])
                if part < share or blocking < 0:
                    share, blocking = part, i
        for i in range(m):
            if free[i] != 0:
                u[i] += share * (target[i] - u[i])
        if blocking >= 0:
            u[blocking] = lower[blocking] if target[blocking] < lower[blocking] else upper[blocking]
            free[blocking] = 0.0
            if share > 0.0:
                for i in range(m):
                    barred[i] = 0.0
            elif blocking == released:
                barred[blocking] = 1.0  # its multiplier was only rounding
            continue
        released, wrong = _leaves(R, Qt, d, u, y, free, barred, lower, upper)
        if released < 0:
            return 0.0
        free[released] = 1.0
    return wrong


@compiled
def _face(R, Qt, d, u, free, target, y):
    """Write the least-norm minimiser over the free inputs into `target`; the others stay at u.

    `y` (r,) is filled too: the minimiser is Qᵀ y.
    """
    (m, r), count = Qt.shape, 0
    columns, rest = np.empty((m, r)), np.zeros(r)
    for i in range(m):
        if free[i] != 0:
            for x in range(r):
                columns[count, x] = Qt[i, x]
            count += 1
        else:
            add(rest, u[i], Qt[i])
    for x in range(r):
        y[x] = 0.0
    if count == 0:
        return
    span, triangle, rows = factor(columns[:count], ROUNDING)
    # Q u = rest + spanᵀ s, where s is the least-squares solution of R spanᵀ s = d - R rest
    k = len(span)
    mapped, basis, corner = np.empty((k, r)), np.empty((k, r)), np.empty((k, k))
    right, s = np.empty(r), np.empty(k)
    for x in range(r):
        right[x] = d[x] - dot(R[x, x:], rest[x:])
        for i in range(k):
            mapped[i, x] = dot(R[x, x:], span[i, x:])
    lq(mapped, basis, corner)
    for i in range(k - 1, -1, -1):  # cornerᵀ s = basis right
        s[i] = dot(basis[i], right)
        for j in range(i + 1, k):
            s[i] -= corner[j, i] * s[j]
        s[i] /= corner[i, i]
    for i in range(k):  # triangle s = s
        for j in range(i):
            s[i] -= triangle[i, j] * s[j]
        s[i] /= triangle[i, i]
    count = 0
    for i in range(m):
        if free[i] != 0:
            target[i] = 0.0
            for j in range(k):
                target[i] += s[j] * rows[j, count]
            count += 1
    for i in range(k - 1, -1, -1):  # triangleᵀ s = s
        for j in range(i + 1, k):
            s[i] -= triangle[j, i] * s[j]
        s[i] /= triangle[i, i]
    for i in range(k):
        add(y, s[i], span[i])


@compiled
def _leaves(R, Qt, d, u, y, free, barred, lower, upper):
    """The input that leaves its bound (-1 for none), and the size of its wrong multiplier.

    Multipliers of ‖R Q u - d‖² come first; those of ‖u‖² count only if the former are zero.
    """
    m, r = Qt.shape
    reached, back, size = np.zeros(r), np.zeros(r), 0.0
    for i in range(m):
        add(reached, u[i], Qt[i])
    for x in range(r):
        moved = dot(R[x, x:], reached[x:])
        size += abs(d[x]) + abs(moved)
        for i in range(x, r):
            back[i] += (d[x] - moved) * R[x, i]
    first, second, wrong, wrong_norm = -1, -1, ROUNDING, ROUNDING
    for i in range(m):
        if free[i] != 0 or barred[i] != 0 or not lower[i] < upper[i]:
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
