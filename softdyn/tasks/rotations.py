"""Errors of orientations, poses and directions with two exact derivatives, in the world's axes.

Let R be the rotation of a link and R_r that of its target. E = R R_rᵀ turns the target into the
link, and its angular velocity is Ω = ω - E ω_r. The error is the rotation vector e = log E, of an
angle θ ≤ π. With A(e) = I - ½ [e] + c [e]², the inverse of the left Jacobian of exp,

    ė = A Ω,    ë = A Ω̇ + Ȧ Ω,    Ω̇ = ω̇ - Ω × E ω_r - E ω̇_r.

c(θ²) = (1 - ½θ cot ½θ) / θ² is a power series, regular up to θ = 2π (Solà et al. 2018, eqs. 146
and 147). A pose adds x = A d, d = p - p_r: (x, e) is log₆ of the motion from the target to the
link, about the target's origin.

At θ = π both turns are equally short. Within `TURN` of it the branch is that whose axis has a
positive first component that is not zero.

A direction a has the error e = θ n along n = d × a / |d × a|, the shortest turn from its target d
to a. Within `TURN` of -d the turn has no direction. There n is d × the world's axis with the
smallest component of d, and only the motion about n counts, so that all terms stay finite.
"""

from __future__ import annotations

import numpy as np
from scipy.special import zeta

from softdyn.compiled import compiled

TURN = 1e-9  # rad; an angle this close to π counts as π


# coefficients of c in θ²: 2 ζ(2k) / (2π)^(2k), k = 1, 2, …
SERIES = 2 * zeta(2.0 * np.arange(1, 33)) / (2 * np.pi) ** (2 * np.arange(1, 33))


@compiled
def log3(R: np.ndarray, e: np.ndarray) -> None:
    """Write the rotation vector of R (3, 3) into `e` (3,), of angle at most π."""
    # the quaternion with its largest component computed first loses no digits (Shepperd 1978)
    q = np.empty(4)
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    i, largest = 3, trace
    for k in range(3):
        if R[k, k] > largest:
            i, largest = k, R[k, k]
    if i == 3:
        q[3] = 1 + trace
        q[0], q[1], q[2] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        q[i] = 1 - trace + 2 * R[i, i]
        q[j], q[k] = R[j, i] + R[i, j], R[k, i] + R[i, k]
        q[3] = R[k, j] - R[j, k]
    size = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    sign = 1.0 if q[3] >= 0 else -1.0
    if abs(q[3]) <= 0.5 * TURN * size:
        first = q[0]
        for k in range(1, 3):
            if abs(first) <= TURN * size:
                first = q[k]
        sign = 1.0 if first >= 0 else -1.0
    angle = 2 * np.arctan2(size, abs(q[3]))
    scale = sign * angle / size if size > 1e-12 * abs(q[3]) else 2 / q[3]
    for k in range(3):
        e[k] = scale * q[k]


@compiled
def _c(s, series):
    """c, c' and c'' at s = θ²."""
    c = c1 = c2 = 0.0
    for k in range(len(series) - 1, -1, -1):
        c2 = c2 * s + 2 * c1
        c1 = c1 * s + c
        c = c * s + series[k]
    return c, c1, c2


@compiled
def _cross(a, b, out):
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@compiled
def _dot3(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def _relative(R, omega, drift, Rr, omega_r, alpha_r, E, Omega, rest):
    """E, Ω, and Ω̇ without its part J_ω q̈."""
    turned, across = np.empty(3), np.empty(3)
    for i in range(3):
        Omega[i], rest[i] = omega[i], drift[i]
        for j in range(3):
            E[i, j] = R[i, 0] * Rr[j, 0] + R[i, 1] * Rr[j, 1] + R[i, 2] * Rr[j, 2]
    for i in range(3):
        turned[i] = _dot3(E[i], omega_r)
        Omega[i] -= turned[i]
        rest[i] -= _dot3(E[i], alpha_r)
    _cross(Omega, turned, across)
    for i in range(3):
        rest[i] -= across[i]


@compiled
def _apply(e, c, x, out):
    """A x = x - ½ e × x + c e × (e × x)."""
    once, twice = np.empty(3), np.empty(3)
    _cross(e, x, once)
    _cross(e, once, twice)
    for i in range(3):
        out[i] = x[i] - 0.5 * once[i] + c * twice[i]


@compiled
def _apply_rate(e, edot, c, cdot, x, out):
    """Ȧ x = -½ ė × x + ċ e × (e × x) + c (ė × (e × x) + e × (ė × x))."""
    along, moving, work = np.empty(3), np.empty(3), np.empty(3)
    _cross(e, x, along)
    _cross(edot, x, moving)
    _cross(e, along, work)
    for i in range(3):
        out[i] = -0.5 * moving[i] + cdot * work[i]
    _cross(edot, along, work)
    for i in range(3):
        out[i] += c * work[i]
    _cross(e, moving, work)
    for i in range(3):
        out[i] += c * work[i]


@compiled
def orientation_terms(
    R: np.ndarray, J: np.ndarray, omega: np.ndarray, drift: np.ndarray,
    Rr: np.ndarray, omega_r: np.ndarray, alpha_r: np.ndarray, series: np.ndarray,
    error: np.ndarray, rate: np.ndarray, rows: np.ndarray, rest: np.ndarray,
) -> None:  # fmt: skip
    """Write the error of an orientation, its rate, Jacobian and drift.

    Parameters
    ----------
    R : ndarray, (3, 3)
        Rotation of the link.
    J, omega, drift : ndarray, (3, n), (3,), (3,)
        Its angular Jacobian, angular velocity and angular acceleration at q̈ = 0.
    Rr, omega_r, alpha_r : ndarray, (3, 3), (3,), (3,)
        The target's rotation, angular velocity and acceleration.
    series : ndarray
        `SERIES`.
    error, rate, rows, rest : ndarray, (3,), (3,), (3, n), (3,)
        Filled: e, ė, and the two parts in ë = rows q̈ + rest.
    """
    E, Omega, turning, column = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    _relative(R, omega, drift, Rr, omega_r, alpha_r, E, Omega, turning)
    log3(E, error)
    c, c1, _ = _c(_dot3(error, error), series)
    _apply(error, c, Omega, rate)
    _apply_rate(error, rate, c, 2 * c1 * _dot3(error, rate), Omega, rest)
    _apply(error, c, turning, column)
    for i in range(3):
        rest[i] += column[i]
    matrix, axis = np.empty((3, 3)), np.zeros(3)
    for j in range(3):
        axis[j] = 1.0
        _apply(error, c, axis, column)
        axis[j] = 0.0
        for i in range(3):
            matrix[i, j] = column[i]
    _multiply(matrix, J, rows)


@compiled
def _multiply(matrix, J, rows):
    """rows = matrix J, of a matrix (3, 3)."""
    for i in range(3):
        for k in range(J.shape[1]):
            rows[i, k] = matrix[i, 0] * J[0, k] + matrix[i, 1] * J[1, k] + matrix[i, 2] * J[2, k]


@compiled
def pose_terms(
    R: np.ndarray, p: np.ndarray, J: np.ndarray, twist: np.ndarray, drift: np.ndarray,
    pose_r: np.ndarray, twist_r: np.ndarray, rate_r: np.ndarray, series: np.ndarray,
    error: np.ndarray, rate: np.ndarray, rows: np.ndarray, rest: np.ndarray,
) -> None:  # fmt: skip
    """Write the error (x, e) of a pose, its rate, Jacobian and drift.

    Parameters
    ----------
    R, p : ndarray, (3, 3), (3,)
        Pose of the frame.
    J, twist, drift : ndarray, (6, n), (6,), (6,)
        Its Jacobian, velocity (ṗ, ω) and acceleration (p̈, ω̇) at q̈ = 0, in the world's axes.
    pose_r, twist_r, rate_r : ndarray, (4, 4), (6,), (6,)
        The target's pose, velocity and acceleration, likewise.
    series : ndarray
        `SERIES`.
    error, rate, rows, rest : ndarray, (6,), (6,), (6, n), (6,)
        Filled, as by `orientation_terms`; the translation comes first.
    """
    e, edot = error[3:], rate[3:]
    orientation_terms(
        R, J[3:], twist[3:], drift[3:], pose_r[:3, :3], twist_r[3:], rate_r[3:], series,
        e, edot, rows[3:], rest[3:],
    )  # fmt: skip
    d, ddot, dddot = np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        d[i] = p[i] - pose_r[i, 3]
        ddot[i], dddot[i] = twist[i] - twist_r[i], drift[i] - rate_r[i]
    c, c1, c2 = _c(_dot3(e, e), series)
    along, twice, moving, work = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    _cross(e, d, along)
    _cross(e, along, twice)
    _cross(edot, d, moving)
    inward = _dot3(e, edot)
    # x = A d, ẋ = A ḋ + Ȧ d
    _apply(e, c, d, work)
    for i in range(3):
        error[i] = work[i]
    _apply(e, c, ddot, work)
    for i in range(3):
        rate[i] = work[i]
    _apply_rate(e, edot, c, 2 * c1 * inward, d, work)
    for i in range(3):
        rate[i] += work[i]
    # ẍ = A d̈ + 2 Ȧ ḋ + Ä d; Ä d is linear in ë, see `_bend`, plus terms in ė²
    _apply(e, c, dddot, work)
    for i in range(3):
        rest[i] = work[i]
    _apply_rate(e, edot, c, 2 * c1 * inward, ddot, work)
    for i in range(3):
        rest[i] += 2 * work[i]
    _cross(edot, along, work)
    for i in range(3):
        rest[i] += 4 * c1 * inward * work[i]
        rest[i] += (4 * c2 * inward * inward + 2 * c1 * _dot3(edot, edot)) * twice[i]
    _cross(e, moving, work)
    for i in range(3):
        rest[i] += 4 * c1 * inward * work[i]
    _cross(edot, moving, work)
    for i in range(3):
        rest[i] += 2 * c * work[i]
    _bend(e, d, along, twice, c, c1, rest[3:], work)
    for i in range(3):
        rest[i] += work[i]
    matrix, turned, axis, column = np.empty((3, 3)), np.empty((3, 3)), np.zeros(3), np.empty(3)
    for j in range(3):
        axis[j] = 1.0
        _apply(e, c, axis, column)
        _bend(e, d, along, twice, c, c1, axis, work)
        axis[j] = 0.0
        for i in range(3):
            matrix[i, j], turned[i, j] = column[i], work[i]
    _multiply(matrix, J, rows)
    for i in range(3):
        for k in range(J.shape[1]):
            for j in range(3):
                rows[i, k] += turned[i, j] * rows[3 + j, k]


@compiled
def _bend(e, d, along, twice, c, c1, x, out):
    """The part of Ä d that is linear in ë = x: -½ x × d + 2 c' (e·x) e × (e × d) + c (…)."""
    moving, work = np.empty(3), np.empty(3)
    _cross(x, d, moving)
    _cross(x, along, work)
    inward = 2 * c1 * _dot3(e, x)
    for i in range(3):
        out[i] = -0.5 * moving[i] + inward * twice[i] + c * work[i]
    _cross(e, moving, work)
    for i in range(3):
        out[i] += c * work[i]


@compiled
def axis_terms(
    a: np.ndarray, J: np.ndarray, omega: np.ndarray, drift: np.ndarray,
    d: np.ndarray, ddot: np.ndarray, dddot: np.ndarray,
    error: np.ndarray, rate: np.ndarray, rows: np.ndarray, rest: np.ndarray,
) -> None:  # fmt: skip
    """Write the error θ n of a direction, its rate, Jacobian and drift.

    Parameters
    ----------
    a : ndarray, (3,)
        The link's direction in the world, a unit vector.
    J, omega, drift : ndarray, (3, n), (3,), (3,)
        The link's angular Jacobian, angular velocity and angular acceleration at q̈ = 0.
    d, ddot, dddot : ndarray, (3,)
        The target direction, a unit vector, and its two rates.
    error, rate, rows, rest : ndarray, (3,), (3,), (3, n), (3,)
        Filled, as by `orientation_terms`.
    """
    adot, addot, w = np.empty(3), np.empty(3), np.empty(3)
    wdot, wddot, work, column = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    _cross(omega, a, adot)
    _cross(drift, a, addot)
    _cross(omega, adot, work)
    for i in range(3):
        addot[i] += work[i]
    _cross(d, a, w)
    square, x = _dot3(w, w), _dot3(d, a)
    size = np.sqrt(square)
    if x < 0 and size < TURN:
        # w serves as n, and the target's own turn is d × ḋ
        k = 0
        for i in range(1, 3):
            if abs(d[i]) < abs(d[k]):
                k = i
        work[:] = 0.0
        work[k] = 1.0
        _cross(d, work, w)
        size = np.sqrt(_dot3(w, w))
        _cross(d, ddot, work)
        _cross(d, dddot, column)
        for i in range(3):
            w[i] /= size
        turn, turning = _dot3(w, omega) - _dot3(w, work), _dot3(w, drift) - _dot3(w, column)
        for i in range(3):
            error[i], rate[i], rest[i] = np.pi * w[i], turn * w[i], turning * w[i]
        for j in range(J.shape[1]):
            along = _dot3(w, J[:, j])
            for i in range(3):
                rows[i, j] = along * w[i]
        return
    # e = φ(x) w with φ = θ / sin θ, w = d × a, x = d·a
    u = 0.5 * (1 - x)
    if u < 0.04:
        # Gauss's series of θ / sin θ in sin² ½θ, its coefficients k! / (3/2)_k
        phi = by_u = by_uu = 0.0
        for k in range(14, -1, -1):
            share = 1.0
            for j in range(1, k + 1):
                share *= j / (j + 0.5)
            by_uu = by_uu * u + 2 * by_u
            by_u = by_u * u + phi
            phi = phi * u + share
        first, second = -0.5 * by_u, 0.25 * by_uu
    else:
        phi = np.arctan2(size, x) / size
        first = (x * phi - 1) / square
        second = (phi + 3 * x * first) / square
    _cross(ddot, a, wdot)
    _cross(d, adot, work)
    xdot, xddot = _dot3(ddot, a) + _dot3(d, adot), _dot3(dddot, a) + 2 * _dot3(ddot, adot)
    xddot += _dot3(d, addot)
    for i in range(3):
        wdot[i] += work[i]
    _cross(dddot, a, wddot)
    _cross(ddot, adot, work)
    for i in range(3):
        wddot[i] += 2 * work[i]
    _cross(d, addot, work)
    for i in range(3):
        wddot[i] += work[i]
        error[i] = phi * w[i]
        rate[i] = first * xdot * w[i] + phi * wdot[i]
        rest[i] = (second * xdot * xdot + first * xddot) * w[i]
        rest[i] += 2 * first * xdot * wdot[i] + phi * wddot[i]
    matrix, axis = np.empty((3, 3)), np.zeros(3)
    for j in range(3):
        axis[j] = 1.0
        _cross(axis, a, column)
        axis[j] = 0.0
        _cross(d, column, work)
        along = first * _dot3(d, column)
        for i in range(3):
            matrix[i, j] = along * w[i] + phi * work[i]
    _multiply(matrix, J, rows)
