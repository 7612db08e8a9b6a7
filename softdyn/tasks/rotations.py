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

import math

import numpy as np
from scipy.special import zeta

from softdyn.tasks.link_motion import LinkMotion

TURN = 1e-9  # rad; an angle this close to π counts as π

# coefficients of c in θ²: 2 ζ(2k) / (2π)^(2k), k = 1, 2, …
SERIES = (2 * zeta(2.0 * np.arange(1, 33)) / (2 * np.pi) ** (2 * np.arange(1, 33))).tolist()
# Gauss's series of θ / sin θ in sin² ½θ, its coefficients k! / (3/2)_k
HALVES = np.cumprod([1.0, *(j / (j + 0.5) for j in range(1, 15))]).tolist()


def cross_matrix(a: np.ndarray) -> np.ndarray:
    """The matrix (3, 3) of a × b."""
    x, y, z = a
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def log3(R: np.ndarray) -> np.ndarray:
    """The rotation vector (3,) of R (3, 3), of angle at most π."""
    # the quaternion with its largest component computed first loses no digits (Shepperd 1978)
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    trace = a + e + i
    if trace >= max(a, e, i):
        q = [h - f, c - g, d - b, 1 + trace]
    elif a >= max(e, i):
        q = [1 - trace + 2 * a, d + b, g + c, h - f]
    elif e >= i:
        q = [d + b, 1 - trace + 2 * e, f + h, c - g]
    else:
        q = [g + c, f + h, 1 - trace + 2 * i, d - b]
    size = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    sign = 1.0 if q[3] >= 0 else -1.0
    if abs(q[3]) <= 0.5 * TURN * size:
        first = next((x for x in q[:2] if abs(x) > TURN * size), q[2])
        sign = 1.0 if first >= 0 else -1.0
    angle = 2 * math.atan2(size, abs(q[3]))
    scale = sign * angle / size if size > 1e-12 * abs(q[3]) else 2 / q[3]
    return np.array([scale * x for x in q[:3]])


def _taylor(series: list[float], s: float) -> tuple[float, float, float]:
    """A power series and its first two derivatives at s."""
    f = f1 = f2 = 0.0
    for coefficient in reversed(series):
        f2 = f2 * s + 2 * f1
        f1 = f1 * s + f
        f = f * s + coefficient
    return f, f1, f2


def _cross_twists(a: np.ndarray) -> np.ndarray:
    """The matrix (6, 6) of a × b, of twists with their linear parts first."""
    found = np.zeros((6, 6))
    found[:3, 3:] = cross_matrix(a[:3])
    found[:3, :3] = found[3:, 3:] = cross_matrix(a[3:])
    return found


def pose_terms(
    motion: LinkMotion, pose_r: np.ndarray, velocity_r: np.ndarray, acceleration_r: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The error of a pose with two derivatives at q̈ = 0 (3, 6), and its Jacobian (6, n).

    Parameters
    ----------
    motion : LinkMotion
        That of the frame.
    pose_r, velocity_r, acceleration_r : ndarray, (4, 4), (6,), (6,)
        The target's pose, velocity (ṗ, ω) and acceleration.
    """
    E = motion.rotation @ pose_r[:3, :3].T
    d, turn, spin = motion.position - pose_r[:3, 3], log3(E), E @ velocity_r[3:]
    shifted = np.eye(6)
    shifted[:3, 3:] = cross_matrix(d)
    ddot, Omega = motion.velocity[:3] - velocity_r[:3], motion.velocity[3:] - spin
    moved = np.concatenate((ddot, Omega))
    accelerated = motion.drift - acceleration_r
    accelerated[:3] += cross_matrix(ddot) @ Omega
    accelerated[3:] = motion.drift[3:] - E @ acceleration_r[3:] + cross_matrix(spin) @ Omega
    nu, nudot = shifted @ moved, shifted @ accelerated

    c, c1, c2 = _taylor(SERIES, float(turn @ turn))
    about = cross_matrix(turn)
    once = about @ d
    error = np.concatenate((d - 0.5 * once + c * (about @ once), turn))  # (x, e), x = A d
    inward = float(error[:3] @ turn)
    dual, cross = 2 * c1 * inward, _cross_twists(error)
    A = np.eye(6) - 0.5 * cross + c * (cross @ cross)
    A[:3, 3:] += dual * (about @ about)
    # Ȧ ν
    rate = A @ nu
    turning, once = _cross_twists(rate), cross @ nu
    moving, twice = turning @ nu, cross @ once
    second = turning @ once + cross @ moving
    along = float(turn @ rate[3:])
    across = float(turn @ rate[:3] + error[:3] @ rate[3:])
    dual_rate = 2 * c1 * across + 4 * c2 * along * inward
    drift = A @ nudot + 2 * c1 * along * twice + c * second - 0.5 * moving
    drift[:3] += dual_rate * twice[3:] + dual * second[3:]
    return np.stack((error, rate, drift)), A @ shifted @ motion.jacobian


def axis_terms(
    motion: LinkMotion, axis: np.ndarray, d: np.ndarray, ddot: np.ndarray, dddot: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The error of a direction with two derivatives at q̈ = 0 (3, 3), and its Jacobian (3, n).

    Parameters
    ----------
    motion : LinkMotion
        That of the frame.
    axis : ndarray, (3,)
        The direction in the frame, a unit vector.
    d, ddot, dddot : ndarray, (3,)
        The target direction, a unit vector, and its two rates.
    """
    a, omega, alpha = motion.rotation @ axis, motion.velocity[3:], motion.drift[3:]
    turning, across, passing = cross_matrix(omega), cross_matrix(d), cross_matrix(ddot)
    adot = turning @ a
    addot = cross_matrix(alpha) @ a + turning @ adot
    # w = d × a, x = d·a
    w, wdot = across @ a, passing @ a + across @ adot
    wddot = cross_matrix(dddot) @ a + 2 * (passing @ adot) + across @ addot
    x, xdot = float(d @ a), float(ddot @ a + d @ adot)
    xddot, square = float(dddot @ a + 2 * ddot @ adot + d @ addot), float(w @ w)
    spins = motion.jacobian[3:]
    if x < 0 and square < TURN * TURN:
        # w serves as n, and the target's own turn is d × ḋ
        w = across @ np.eye(3)[np.argmin(np.abs(d))]
        square = float(w @ w)
        turn = float(w @ (omega - across @ ddot)) / square
        turned = float(w @ (alpha - across @ dddot)) / square
        values = np.stack((np.pi / math.sqrt(square) * w, turn * w, turned * w))
        return values, np.outer(w, w / square) @ spins
    # e = φ(x) w with φ = θ / sin θ
    u = 0.5 * (1 - x)
    if u < 0.04:
        phi, by_u, by_uu = _taylor(HALVES, u)
        first, second = -0.5 * by_u, 0.25 * by_uu
    else:
        size = math.sqrt(square)
        phi = math.atan2(size, x) / size
        first = (x * phi - 1) / square
        second = (phi + 3 * x * first) / square
    drift = (second * xdot * xdot + first * xddot) * w + 2 * first * xdot * wdot + phi * wddot
    by_spin = phi * x * np.eye(3) - first * np.outer(w, w) - phi * np.outer(a, d)
    return np.stack((phi * w, first * xdot * w + phi * wdot, drift)), by_spin @ spins
