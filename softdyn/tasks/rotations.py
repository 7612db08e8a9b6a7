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
# Gauss's series of θ / sin θ in sin² ½θ, its coefficients k! / (3/2)_k
HALVES = np.cumprod([1.0, *(j / (j + 0.5) for j in range(1, 15))])


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


# Vectors inside the kernels are tuples, because an array of three costs more than its arithmetic.


@compiled
def _vector(a):
    return a[0], a[1], a[2]


@compiled
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def _dot3(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def _plus(a, scale, b):
    """a + scale b."""
    return a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]


@compiled
def _put(a, out):
    out[0], out[1], out[2] = a


@compiled
def _turned(E, a):
    """E a, of a matrix (3, 3) as an array."""
    return _dot3(_vector(E[0]), a), _dot3(_vector(E[1]), a), _dot3(_vector(E[2]), a)


@compiled
def _apply(e, c, x):
    """A x = x - ½ e × x + c e × (e × x)."""
    once = _cross(e, x)
    return _plus(_plus(x, -0.5, once), c, _cross(e, once))


@compiled
def _apply_rate(e, edot, c, cdot, x):
    """Ȧ x = -½ ė × x + ċ e × (e × x) + c (ė × (e × x) + e × (ė × x))."""
    along, moving = _cross(e, x), _cross(edot, x)
    found = _plus((-0.5 * moving[0], -0.5 * moving[1], -0.5 * moving[2]), cdot, _cross(e, along))
    return _plus(_plus(found, c, _cross(edot, along)), c, _cross(e, moving))


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
    E = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            E[i, j] = R[i, 0] * Rr[j, 0] + R[i, 1] * Rr[j, 1] + R[i, 2] * Rr[j, 2]
    turned = _turned(E, _vector(omega_r))
    Omega = _plus(_vector(omega), -1.0, turned)
    # Ω̇ without its part J q̈
    turning = _plus(_vector(drift), -1.0, _turned(E, _vector(alpha_r)))
    turning = _plus(turning, -1.0, _cross(Omega, turned))
    log3(E, error)
    e = _vector(error)
    c, c1, _ = _c(_dot3(e, e), series)
    edot = _apply(e, c, Omega)
    bent = _apply_rate(e, edot, c, 2 * c1 * _dot3(e, edot), Omega)
    _put(edot, rate)
    _put(_plus(bent, 1.0, _apply(e, c, turning)), rest)
    _multiply(
        _apply(e, c, (1.0, 0.0, 0.0)), _apply(e, c, (0.0, 1.0, 0.0)), _apply(e, c, (0.0, 0.0, 1.0)),
        J, rows,
    )  # fmt: skip


@compiled
def _multiply(first, second, third, J, rows):
    """rows = matrix J, of a matrix (3, 3) given by its columns."""
    for i in range(3):
        a, b, c = first[i], second[i], third[i]
        for k in range(J.shape[1]):
            rows[i, k] = a * J[0, k] + b * J[1, k] + c * J[2, k]


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
    orientation_terms(
        R, J[3:], twist[3:], drift[3:], pose_r[:3, :3], twist_r[3:], rate_r[3:], series,
        error[3:], rate[3:], rows[3:], rest[3:],
    )  # fmt: skip
    e, edot = _vector(error[3:]), _vector(rate[3:])
    d = p[0] - pose_r[0, 3], p[1] - pose_r[1, 3], p[2] - pose_r[2, 3]
    ddot = _plus(_vector(twist), -1.0, _vector(twist_r))
    dddot = _plus(_vector(drift), -1.0, _vector(rate_r))
    c, c1, c2 = _c(_dot3(e, e), series)
    along = _cross(e, d)
    twice, moving, inward = _cross(e, along), _cross(edot, d), _dot3(e, edot)
    # x = A d, ẋ = A ḋ + Ȧ d
    _put(_apply(e, c, d), error)
    _put(_plus(_apply(e, c, ddot), 1.0, _apply_rate(e, edot, c, 2 * c1 * inward, d)), rate)
    # ẍ = A d̈ + 2 Ȧ ḋ + Ä d; Ä d is linear in ë, see `_bend`, plus terms in ė²
    bent = _plus(_apply(e, c, dddot), 2.0, _apply_rate(e, edot, c, 2 * c1 * inward, ddot))
    bent = _plus(bent, 4 * c1 * inward, _plus(_cross(edot, along), 1.0, _cross(e, moving)))
    bent = _plus(bent, 4 * c2 * inward * inward + 2 * c1 * _dot3(edot, edot), twice)
    bent = _plus(bent, 2 * c, _cross(edot, moving))
    bent = _plus(bent, 1.0, _bend(e, d, along, twice, c, c1, _vector(rest[3:])))
    _put(bent, rest)
    x, y, z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    _multiply(_apply(e, c, x), _apply(e, c, y), _apply(e, c, z), J, rows)
    first, second = _bend(e, d, along, twice, c, c1, x), _bend(e, d, along, twice, c, c1, y)
    third = _bend(e, d, along, twice, c, c1, z)
    for i in range(3):
        for k in range(J.shape[1]):
            rows[i, k] += first[i] * rows[3, k] + second[i] * rows[4, k] + third[i] * rows[5, k]


@compiled
def _bend(e, d, along, twice, c, c1, x):
    """The part of Ä d that is linear in ë = x: -½ x × d + 2 c' (e·x) e × (e × d) + c (…)."""
    moving = _cross(x, d)
    found = -0.5 * moving[0], -0.5 * moving[1], -0.5 * moving[2]
    found = _plus(found, 2 * c1 * _dot3(e, x), twice)
    return _plus(_plus(found, c, _cross(x, along)), c, _cross(e, moving))


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
    a, d, ddot, dddot = _vector(a), _vector(d), _vector(ddot), _vector(dddot)
    omega, drift = _vector(omega), _vector(drift)
    adot = _cross(omega, a)
    addot = _plus(_cross(drift, a), 1.0, _cross(omega, adot))
    w = _cross(d, a)
    square, x = _dot3(w, w), _dot3(d, a)
    size = np.sqrt(square)
    if x < 0 and size < TURN:
        # w serves as n, and the target's own turn is d × ḋ
        w = _cross(d, (1.0, 0.0, 0.0))
        if abs(d[1]) < abs(d[0]) and abs(d[1]) <= abs(d[2]):
            w = _cross(d, (0.0, 1.0, 0.0))
        elif abs(d[2]) < abs(d[0]):
            w = _cross(d, (0.0, 0.0, 1.0))
        size = np.sqrt(_dot3(w, w))
        w = w[0] / size, w[1] / size, w[2] / size
        turn = _dot3(w, omega) - _dot3(w, _cross(d, ddot))
        turning = _dot3(w, drift) - _dot3(w, _cross(d, dddot))
        for i in range(3):
            error[i], rate[i], rest[i] = np.pi * w[i], turn * w[i], turning * w[i]
        for j in range(J.shape[1]):
            along = w[0] * J[0, j] + w[1] * J[1, j] + w[2] * J[2, j]
            for i in range(3):
                rows[i, j] = along * w[i]
        return
    # e = φ(x) w with φ = θ / sin θ, w = d × a, x = d·a
    u = 0.5 * (1 - x)
    if u < 0.04:
        phi = by_u = by_uu = 0.0
        for k in range(len(HALVES) - 1, -1, -1):
            by_uu = by_uu * u + 2 * by_u
            by_u = by_u * u + phi
            phi = phi * u + HALVES[k]
        first, second = -0.5 * by_u, 0.25 * by_uu
    else:
        phi = np.arctan2(size, x) / size
        first = (x * phi - 1) / square
        second = (phi + 3 * x * first) / square
    wdot = _plus(_cross(ddot, a), 1.0, _cross(d, adot))
    wddot = _plus(_plus(_cross(dddot, a), 2.0, _cross(ddot, adot)), 1.0, _cross(d, addot))
    xdot = _dot3(ddot, a) + _dot3(d, adot)
    xddot = _dot3(dddot, a) + 2 * _dot3(ddot, adot) + _dot3(d, addot)
    for i in range(3):
        error[i] = phi * w[i]
        rate[i] = first * xdot * w[i] + phi * wdot[i]
        rest[i] = (second * xdot * xdot + first * xddot) * w[i]
        rest[i] += 2 * first * xdot * wdot[i] + phi * wddot[i]
    _multiply(
        _swing(d, a, w, phi, first, (1.0, 0.0, 0.0)), _swing(d, a, w, phi, first, (0.0, 1.0, 0.0)),
        _swing(d, a, w, phi, first, (0.0, 0.0, 1.0)), J, rows,
    )  # fmt: skip


@compiled
def _swing(d, a, w, phi, first, omega):
    """The rate of φ w while the direction turns at `omega`."""
    moved = _cross(omega, a)
    across, along = _cross(d, moved), first * _dot3(d, moved)
    return (
        along * w[0] + phi * across[0],
        along * w[1] + phi * across[1],
        along * w[2] + phi * across[2],
    )
