"""Errors of orientations, poses and directions with two exact derivatives, in the world's axes.

Let R be the rotation of a link and R_r that of its target. E = R R_rᵀ turns the target into the
link. With d = p - p_r the motion (E, d) moves the target's frame to the link's, about the target's
origin. The error of a pose is log₆ of this motion, ξ = (x, e). e = log₃ E is that of an
orientation.

The motion has the twist ν = (ḋ - Ω × d, Ω), with Ω = ω - E ω_r. With A(ξ), the inverse of the left
Jacobian of exp₆, and × the cross product of twists,

    ξ̇ = A ν,    ξ̈ = A ν̇ + Ȧ ν,    A ν = ν - ½ ξ × ν + C ξ × (ξ × ν).

C is a dual number, as a twist is a vector of dual numbers: its real part multiplies both parts of a
twist, and its dual part adds that multiple of the angular part to the linear one. The real part is
c(θ²) = (1 - ½θ cot ½θ) / θ², a power series regular up to θ = 2π (Solà et al. 2018, eqs. 146 and
147). The dual part is 2 c' e·x, because ξ·ξ = θ² + ε 2 e·x.

A direction a has the error e = θ n along n = d × a / |d × a|, the shortest turn from its target d
to a.

At θ = π both turns are equally short. Within `TURN` of it the branch of an orientation is that
whose axis has a positive first component that is not zero. The turn to a direction within `TURN` of
-d has no axis. There n is d × the world's axis with the smallest component of d, and only the
motion about n counts, so that all terms stay finite.
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
def _taylor(series, s):
    """A power series and its first two derivatives at s."""
    f = f1 = f2 = 0.0
    for k in range(len(series) - 1, -1, -1):
        f2 = f2 * s + 2 * f1
        f1 = f1 * s + f
        f = f * s + series[k]
    return f, f1, f2


@compiled
def cross_twists(a, b, out):
    """Write a × b of two twists, linear parts first."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i] = a[3 + j] * b[k] - a[3 + k] * b[j] + a[j] * b[3 + k] - a[k] * b[3 + j]
        out[3 + i] = a[3 + j] * b[3 + k] - a[3 + k] * b[3 + j]


@compiled
def pose_terms(R, p, velocity, drift, pose_r, velocity_r, acceleration_r, found):
    """Write the error of a pose with two derivatives at q̈ = 0, and the factor of its Jacobian.

    Parameters
    ----------
    R, p : ndarray, (3, 3), (3,)
        Pose of the frame.
    velocity, drift : ndarray, (6,), (6,)
        Its velocity (ṗ, ω), and its acceleration (p̈, ω̇) at q̈ = 0.
    pose_r, velocity_r, acceleration_r : ndarray, (4, 4), (6,), (6,)
        The target's pose, velocity and acceleration, likewise.
    found : ndarray, (9, 6)
        Filled: ξ, ξ̇, ξ̈, and the transpose of a matrix (6, 6) that makes the error's Jacobian of
        the frame's.
    """
    # ν, ν̇ at q̈ = 0, and the twists of unit motions of the frame
    twists, E, turned, turn = np.zeros((8, 6)), np.zeros((3, 3)), np.zeros(6), np.empty(3)
    once, twice, shift, error = np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6)
    for i in range(6):
        twists[0, i], twists[1, i], twists[2 + i, i] = velocity[i], drift[i], 1.0
    for i in range(3):
        twists[0, i] -= velocity_r[i]
        twists[1, i] -= acceleration_r[i]
        for j in range(3):
            for k in range(3):
                E[i, j] += R[i, k] * pose_r[j, k]
            turned[3 + i] += E[i, j] * velocity_r[3 + j]  # E ω_r
            twists[1, 3 + i] -= E[i, j] * acceleration_r[3 + j]
        twists[0, 3 + i] -= turned[3 + i]
    log3(E, turn)
    cross_twists(turned, twists[0], once)
    for i in range(3):
        twists[1, 3 + i] += once[3 + i]  # -Ω × E ω_r
        shift[i], error[3 + i] = twists[0, i], turn[i]
    cross_twists(shift, twists[0], once)
    for i in range(3):
        twists[1, i] += once[i]  # -Ω × ḋ
        shift[i] = p[i] - pose_r[i, 3]  # d
    for k in range(8):
        cross_twists(shift, twists[k], once)
        for i in range(3):
            twists[k, i] += once[i]  # d × Ω
    square = turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2]
    c, c1, c2 = _taylor(SERIES, square)
    cross_twists(error, shift, once)
    cross_twists(error, once, twice)
    inward = 0.0
    for i in range(3):
        error[i] = shift[i] - 0.5 * once[i] + c * twice[i]  # x = A d
        inward += error[i] * turn[i]
    dual = 2 * c1 * inward
    for k in range(7, -1, -1):
        cross_twists(error, twists[k], once)
        cross_twists(error, once, twice)
        for i in range(3):
            found[1 + k, i] = twists[k, i] - 0.5 * once[i] + c * twice[i] + dual * twice[3 + i]
            found[1 + k, 3 + i] = twists[k, 3 + i] - 0.5 * once[3 + i] + c * twice[3 + i]
    # Ȧ ν; `once` and `twice` are those of ν
    rate, moving, second = found[1], np.empty(6), np.empty(6)
    cross_twists(rate, twists[0], moving)
    cross_twists(rate, once, second)
    cross_twists(error, moving, once)
    along = across = 0.0  # e·ė, e·ẋ + x·ė
    for i in range(3):
        along += turn[i] * rate[3 + i]
        across += turn[i] * rate[i] + error[i] * rate[3 + i]
    c_rate, dual_rate = 2 * c1 * along, 2 * c1 * across + 4 * c2 * along * inward
    for i in range(6):
        second[i] += once[i]
        found[2, i] += c_rate * twice[i] + c * second[i] - 0.5 * moving[i]
        found[0, i] = error[i]
    for i in range(3):
        found[2, i] += dual_rate * twice[3 + i] + dual * second[3 + i]


@compiled
def axis_terms(a, omega, alpha, d, ddot, dddot, found):
    """Write the error of a direction with two derivatives at q̈ = 0, and its Jacobian's factor.

    Parameters
    ----------
    a : ndarray, (3,)
        The link's direction in the world, a unit vector.
    omega, alpha : ndarray, (3,), (3,)
        The link's angular velocity, and its angular acceleration at q̈ = 0.
    d, ddot, dddot : ndarray, (3,)
        The target direction, a unit vector, and its two rates.
    found : ndarray, (9, 6)
        Filled as by `pose_terms`, the error in its first three columns.
    """
    found[:] = 0.0
    adot, addot, w, wdot, wddot = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        adot[i] = omega[j] * a[k] - omega[k] * a[j]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        addot[i] = alpha[j] * a[k] - alpha[k] * a[j] + omega[j] * adot[k] - omega[k] * adot[j]
    # w = d × a, x = d·a
    x = xdot = xddot = square = 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        w[i] = d[j] * a[k] - d[k] * a[j]
        wdot[i] = ddot[j] * a[k] - ddot[k] * a[j] + d[j] * adot[k] - d[k] * adot[j]
        wddot[i] = dddot[j] * a[k] - dddot[k] * a[j] + d[j] * addot[k] - d[k] * addot[j]
        wddot[i] += 2 * (ddot[j] * adot[k] - ddot[k] * adot[j])
        square += w[i] * w[i]
        x += d[i] * a[i]
        xdot += ddot[i] * a[i] + d[i] * adot[i]
        xddot += dddot[i] * a[i] + 2 * ddot[i] * adot[i] + d[i] * addot[i]
    if x < 0 and square < TURN * TURN:
        # w serves as n, and the target's own turn is d × ḋ
        axis = np.zeros(3)
        axis[np.argmin(np.abs(d))] = 1.0
        turn = turning = square = 0.0
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            w[i] = d[j] * axis[k] - d[k] * axis[j]
            square += w[i] * w[i]
            turn += w[i] * (omega[i] - d[j] * ddot[k] + d[k] * ddot[j])
            turning += w[i] * (alpha[i] - d[j] * dddot[k] + d[k] * dddot[j])
        for i in range(3):
            found[0, i] = np.pi * w[i] / np.sqrt(square)
            found[1, i], found[2, i] = turn * w[i] / square, turning * w[i] / square
            for j in range(3):
                found[6 + j, i] = w[i] * w[j] / square
        return
    # e = φ(x) w with φ = θ / sin θ
    u = 0.5 * (1 - x)
    if u < 0.04:
        phi, by_u, by_uu = _taylor(HALVES, u)
        first, second = -0.5 * by_u, 0.25 * by_uu
    else:
        size = np.sqrt(square)
        phi = np.arctan2(size, x) / size
        first = (x * phi - 1) / square
        second = (phi + 3 * x * first) / square
    for i in range(3):
        found[0, i] = phi * w[i]
        found[1, i] = first * xdot * w[i] + phi * wdot[i]
        found[2, i] = (second * xdot * xdot + first * xddot) * w[i]
        found[2, i] += 2 * first * xdot * wdot[i] + phi * wddot[i]
        found[6 + i, i] += phi * x
        for j in range(3):
            found[6 + j, i] -= first * w[i] * w[j] + phi * a[i] * d[j]
