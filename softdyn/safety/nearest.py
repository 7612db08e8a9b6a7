"""The distance of two convex bodies with its nearest points, by Coal.

Coal computes it in closed form for half-spaces, balls and capsules, and by GJK for other bodies
(Montaut et al. 2022). GJK is exact for polytopes; at a cylinder its points are accurate to the
square root of its tolerance, and a small tolerance makes it fail. Those points are refined here by
Newton's method on the fixed point a = P_A(P_B(a)) of alternating projections, whose Jacobians are
known in closed form. Where bodies overlap a little, EPA's depth is exact, but not its normal. Then
the normal is that between smaller cores.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import coal
import numpy as np

from softdyn.compiled import compiled
from softdyn.safety.solids import Solid

SURE = 1e-6  # Coal's own tolerance, with which GJK converges at cylinders
SHRUNK = 0.2  # share by which overlapping cores are made smaller, so that they have a normal
TOUCHING = 1e-7  # m between cores; nearer ones have no line between their nearest points
ROUNDS = 40


def _request(tolerance: float) -> Any:
    request = coal.DistanceRequest(True)
    request.enable_signed_distance = True
    request.gjk_tolerance = request.epa_tolerance = tolerance
    request.gjk_max_iterations = request.epa_max_iterations = 500
    return request


EXACT, ROBUST = _request(1e-10), _request(SURE)


class Nearest(NamedTuple):
    """Two bodies' distance (m), negative if they overlap.

    `normal` (3,) is the unit vector from the second body to the first: the gradient of the distance
    in the first body's position.
    """

    distance: float
    normal: np.ndarray


Placed = tuple[Solid, np.ndarray, np.ndarray]  # rotation and centre in the world


def nearest(one: Placed, two: Placed) -> Nearest:
    """The nearest points of two bodies."""
    (A, RA, pA), (B, RB, pB), result = one, two, coal.DistanceResult()
    curved = (A.round and B.half[2] != 0.0) or (B.round and A.half[2] != 0.0)
    request = ROBUST if curved else EXACT
    d = coal.distance(
        A.form, coal.Transform3s(RA, pA), B.form, coal.Transform3s(RB, pB), request, result
    )
    normal = -result.normal
    if curved and not (A.is_mesh or B.is_mesh):
        shrink = 0.0 if d + A.swept + B.swept > TOUCHING else SHRUNK
        halves = A.half * (1 - shrink), B.half * (1 - shrink)
        start = result.getNearestPoint1() + A.swept * normal
        x, y = _refine(start, RA, pA, halves[0], A.round, RB, pB, halves[1], B.round)
        span = x - y
        far = math.sqrt(span @ span)
        if far > TOUCHING:
            normal = span / far
            if not shrink:
                d = far - A.swept - B.swept
    return Nearest(d, normal)


@compiled
def _project(x, R, p, half, round, y, J):
    """Write the point of a core nearest to x to y (3,), the projection's Jacobian to J (3, 3)."""
    own, local = np.empty(3), np.empty(3)  # factors along the axes; along z, u and v of a cylinder
    for i in range(3):
        local[i] = 0.0
        for j in range(3):
            local[i] += R[j, i] * (x[j] - p[j])
        own[i] = 1.0
        if (i == 2 or not round) and abs(local[i]) > half[i]:
            local[i] = half[i] if local[i] > 0 else -half[i]
            own[i] = 0.0
    u, v = 1.0, 0.0
    if round:
        far = np.sqrt(local[0] * local[0] + local[1] * local[1])
        if far > half[0]:
            u, v = local[0] / far, local[1] / far
            local[0], local[1], own[0], own[1] = half[0] * u, half[0] * v, 0.0, half[0] / far
    for i in range(3):
        y[i] = p[i] + R[i, 0] * local[0] + R[i, 1] * local[1] + R[i, 2] * local[2]
        ui, vi = R[i, 0] * u + R[i, 1] * v, R[i, 1] * u - R[i, 0] * v
        for j in range(i + 1):
            uj, vj = R[j, 0] * u + R[j, 1] * v, R[j, 1] * u - R[j, 0] * v
            J[i, j] = own[0] * ui * uj + own[1] * vi * vj + own[2] * R[i, 2] * R[j, 2]
            J[j, i] = J[i, j]


@compiled
def _refine(a, RA, pA, halfA, roundA, RB, pB, halfB, roundB):
    """The nearest points of two cores that do not overlap, from a point `a` near A's.

    The distance of a point of A from B is convex over A. So every round keeps the better of
    Newton's point and the alternating projection, which never ascends.
    """
    JA, JB, N, S = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    b, plain, newton, other = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    right, step = np.empty(3), np.empty(3)
    _project(a, RA, pA, halfA, roundA, plain, JA)
    a = plain.copy()
    _project(a, RB, pB, halfB, roundB, b, JB)
    for _ in range(ROUNDS):
        _project(b, RA, pA, halfA, roundA, plain, JA)
        for i in range(3):
            for j in range(3):
                N[i, j] = (1.0 if i == j else 0.0) - (
                    JA[i, 0] * JB[0, j] + JA[i, 1] * JB[1, j] + JA[i, 2] * JB[2, j]
                )
        for i in range(3):
            right[i] = 0.0
            for k in range(3):
                right[i] += N[k, i] * (plain[k] - a[k])
            for j in range(3):
                S[i, j] = 1e-14 if i == j else 0.0
                for k in range(3):
                    S[i, j] += N[k, i] * N[k, j]
        _solve(S, right, step)
        for i in range(3):
            step[i] += a[i]
        _project(step, RA, pA, halfA, roundA, newton, JA)
        _project(plain, RB, pB, halfB, roundB, other, JB)
        gap = np.sum((plain - other) ** 2)
        _project(newton, RB, pB, halfB, roundB, b, JB)
        if np.sum((newton - b) ** 2) > gap:
            newton[:] = plain
            _project(plain, RB, pB, halfB, roundB, b, JB)
        moved = np.sum((newton - a) ** 2)
        a[:] = newton
        if moved < 1e-24:
            break
    return a, b


@compiled
def _solve(S, right, step):
    """Solve S step = right for a symmetric positive definite S (3, 3), which is overwritten."""
    for j in range(3):
        for k in range(j):
            S[j, j] -= S[j, k] * S[j, k]
        S[j, j] = np.sqrt(max(S[j, j], 1e-16))
        for i in range(j + 1, 3):
            for k in range(j):
                S[i, j] -= S[i, k] * S[j, k]
            S[i, j] /= S[j, j]
    for i in range(3):
        step[i] = right[i]
        for k in range(i):
            step[i] -= S[i, k] * step[k]
        step[i] /= S[i, i]
    for i in range(2, -1, -1):
        for k in range(i + 1, 3):
            step[i] -= S[k, i] * step[k]
        step[i] /= S[i, i]
