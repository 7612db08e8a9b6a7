"""All terms of a State in one kernel, from the results of Pinocchio's algorithms in its Data.

Joint Jacobian columns S_k = (v_k; ω_k) are in the world's axes about its origin. A point p of a
body that joint k moves therefore has ∂p/∂q_k = v_k + ω_k × p, and

    J̇_k = v̇_k + ω̇_k × p + ω_k × ṗ.

Each column is fixed to the first body that joint k moves. That body has the twist
(v; ω) = Σ S_j q̇_j, over its own joint and all before it, which moves the column:

    v̇_k = ω × v_k + v × ω_k,    ω̇_k = ω × ω_k.

Let F_k = (f_k; τ_k) be the momentum of all bodies at q̇_k = 1, about the same origin, and a the
acceleration of gravity. The mass matrix and the force of gravity are

    M_jk = S_j · F_k if joint j is joint k or before it,    g_k = -a · f_k

(Featherstone 2008, chapter 6; Orin & Goswami 2008). Pinocchio's centroidal map holds F_k about the
centre of mass c, so the kernel adds c × f_k. This M costs less than that of `crba`, because it is
written once, into its final place.

Without Numba, `TreeModel` computes the same in NumPy with Pinocchio's own algorithms.
`tests/dynamics/test_kernels.py` compares the two.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softdyn.compiled import compiled
from softdyn.dynamics.tendons import moment_arms


class Constants(NamedTuple):
    """A robot's constants for the kernels, in the order of their arguments.

    Kernels take these fields, and those of `softdyn.dynamics.engine.Memory`, one by one, because
    that is faster. Numba passes 13 arrays in 0.95 µs, one named tuple of them in 1.9 µs and two
    tuples in 4 µs. A State takes 20 µs.

    Attributes
    ----------
    tip : int
        Body of the tip.
    tip_offset : ndarray, (3,)
        The tip's position in this body.
    tree : ndarray of int, (n, 4)
        For each degree of freedom: whether it moves the tip, the first body that it moves, the body
        to whose twist it adds, and the next degree of freedom that is not in its subtree.
    gravity : ndarray, (3,)
        Acceleration.
    joints : ndarray, (n, 4)
        Stiffness, rest, damping and armature.
    tendons : ndarray, (tendons, 5)
        Constant length, stiffness, rest, damping, and 1 for a tendon that only pulls, else 0.
    coefficients : ndarray, (tendons, n)
        Moment arms of the fixed tendons.
    """

    tip: int
    tip_offset: np.ndarray
    tree: np.ndarray
    gravity: np.ndarray
    joints: np.ndarray
    tendons: np.ndarray
    coefficients: np.ndarray


JOINT_TERMS = 10  # number of vectors (n,) in `joint_terms`, without M


def joint_terms(joint_rows):
    """M, J, J̇, bias, K, h and g as views of joint_rows (≥ n + 10, n), which a kernel has filled."""
    n = joint_rows.shape[1]
    M, J, Jdot = joint_rows[:n], joint_rows[n : n + 3], joint_rows[n + 3 : n + 6]
    return M, J, Jdot, joint_rows[n + 6], joint_rows[n + 7], joint_rows[n + 8], joint_rows[n + 9]


def tendon_terms(joint_rows, tendons):
    """Moment arms and Bᵀ, which `spatial_terms` writes after the `joint_terms`."""
    first = joint_rows.shape[1] + JOINT_TERMS
    return joint_rows[first : first + tendons], joint_rows[first + tendons :]


def tip_terms(tip_and_lengths):
    """Tip position and velocity, tendon lengths: views of tip_and_lengths (6 + tendons,)."""
    return tip_and_lengths[:3], tip_and_lengths[3:6], tip_and_lengths[6:]


# Python code uses the uncompiled functions: for slices they are faster than a call of a kernel
_joint_terms = compiled(joint_terms, inline=True)
_tendon_terms = compiled(tendon_terms, inline=True)
_tip_terms = compiled(tip_terms, inline=True)


@compiled
def fixed_terms(
    joint_rows, tip_and_lengths, v, coordinates, bias, S, momenta, centre, rotations, translations,
    tip, tip_offset, tree, gravity, joints, tendons, coefficients,
):  # fmt: skip
    """All terms of a robot with constant moment arms.

    Parameters
    ----------
    joint_rows : ndarray, (n + 10, n)
        Filled with the `joint_terms`.
    tip_and_lengths : ndarray, (6 + tendons,)
        Filled with the `tip_terms`.
    v, coordinates : ndarray, (n,)
        Joint velocities and coordinates.
    bias, S, momenta, centre, rotations, translations : ndarray
        Fields of `softdyn.dynamics.engine.Memory`.
    tip, tip_offset, tree, gravity, joints, tendons, coefficients : ndarray
        Fields of `Constants`.
    """
    M, J, Jdot, bias_out, K, h, g = _joint_terms(joint_rows)
    y, ydot, lengths = _tip_terms(tip_and_lengths)
    _tip(J, Jdot, y, ydot, v, S, rotations, translations, tip, tip_offset, tree)
    _inertia(M, g, S, momenta, centre, tree, gravity, joints)
    _fixed_lengths(lengths, coordinates, tendons, coefficients)
    _forces(bias_out, K, h, v, coordinates, bias, joints, tendons, lengths, coefficients)


@compiled
def spatial_terms(
    joint_rows, tip_and_lengths, v, coordinates, bias, S, momenta, centre, rotations, translations,
    tip, tip_offset, tree, gravity, joints, tendons, coefficients,
    bodies, offsets, pairs, signs, actuated, gear,
):  # fmt: skip
    """All terms of a robot whose moment arms change with q.

    Parameters
    ----------
    joint_rows : ndarray, (n + 10 + tendons + m, n)
        Filled with the `joint_terms` and `tendon_terms`.
    tip_and_lengths : ndarray, (6 + tendons,)
        Filled with the `tip_terms`.
    v, coordinates : ndarray, (n,)
        Joint velocities and coordinates.
    bias, S, momenta, centre, rotations, translations : ndarray
        Fields of `softdyn.dynamics.engine.Memory`.
    tip, tip_offset, tree, gravity, joints, tendons, coefficients : ndarray
        Fields of `Constants`.
    bodies, offsets, pairs, signs : ndarray
        Fields of `softdyn.dynamics.tendons.Segments`.
    actuated, gear : ndarray, (m,)
        The tendon of each input, and its gear.
    """
    M, J, Jdot, bias_out, K, h, g = _joint_terms(joint_rows)
    y, ydot, lengths = _tip_terms(tip_and_lengths)
    arms, inputs = _tendon_terms(joint_rows, len(tendons))
    _tip(J, Jdot, y, ydot, v, S, rotations, translations, tip, tip_offset, tree)
    _inertia(M, g, S, momenta, centre, tree, gravity, joints)
    _fixed_lengths(lengths, coordinates, tendons, coefficients)
    for t in range(len(tendons)):
        for k in range(len(v)):
            arms[t, k] = coefficients[t, k]
    moment_arms(arms, lengths, S, rotations, translations, bodies, offsets, pairs, signs)
    for i in range(len(gear)):
        for k in range(len(v)):
            inputs[i, k] = gear[i] * arms[actuated[i], k]
    _forces(bias_out, K, h, v, coordinates, bias, joints, tendons, lengths, arms)


@compiled
def _fixed_lengths(lengths, coordinates, tendons, coefficients):
    """Tendon lengths without the segments that change."""
    for t in range(len(tendons)):
        lengths[t] = tendons[t, 0]
        for k in range(len(coordinates)):
            lengths[t] += coefficients[t, k] * coordinates[k]


@compiled
def _inertia(M, g, S, momenta, centre, tree, gravity, joints):
    """M, armature included, and g."""
    n = len(S)
    x, y, z = centre[0], centre[1], centre[2]
    columns = S.T.copy()
    for k in range(n):
        a, b, c = momenta[k, 0], momenta[k, 1], momenta[k, 2]
        g[k] = -(a * gravity[0] + b * gravity[1] + c * gravity[2])
        d, e, f = (
            momenta[k, 3] + y * c - z * b,
            momenta[k, 4] + z * a - x * c,
            momenta[k, 5] + x * b - y * a,
        )
        row = M[k]
        for j in range(k + 1):
            value = (
                a * columns[0, j] + b * columns[1, j] + c * columns[2, j]
                + d * columns[3, j] + e * columns[4, j] + f * columns[5, j]
            )  # fmt: skip
            row[j] = value if tree[j, 3] > k else 0.0
        row[k] += joints[k, 3]
        for j in range(k):
            M[j, k] = row[j]


@compiled
def _tip(J, Jdot, y, ydot, v, S, rotations, translations, tip, tip_offset, tree):
    """J, J̇, y and ẏ."""
    n = len(v)
    twists = np.zeros((len(translations), 6))
    for x in range(3):
        y[x] = translations[tip, x]
        for i in range(3):
            y[x] += rotations[tip, x, i] * tip_offset[i]
    ydot[:] = 0.0
    for k in range(n):
        if tree[k, 0]:
            J[0, k] = S[k, 0] + S[k, 4] * y[2] - S[k, 5] * y[1]
            J[1, k] = S[k, 1] + S[k, 5] * y[0] - S[k, 3] * y[2]
            J[2, k] = S[k, 2] + S[k, 3] * y[1] - S[k, 4] * y[0]
            for x in range(3):
                ydot[x] += J[x, k] * v[k]
        else:
            for x in range(3):
                J[x, k] = 0.0
        for x in range(6):
            twists[tree[k, 1], x] = twists[tree[k, 2], x] + S[k, x] * v[k]
    for k in range(n):
        if tree[k, 0]:
            a, b, c, d, e, f = S[k, 0], S[k, 1], S[k, 2], S[k, 3], S[k, 4], S[k, 5]
            twist = twists[tree[k, 1]]
            vx, vy, vz, wx, wy, wz = twist[0], twist[1], twist[2], twist[3], twist[4], twist[5]
            # the rate of (d, e, f), and from it that of (a, b, c) + (d, e, f) × y
            dd, de, df = wy * f - wz * e, wz * d - wx * f, wx * e - wy * d
            Jdot[0, k] = (
                wy * c - wz * b + vy * f - vz * e
                + de * y[2] - df * y[1] + e * ydot[2] - f * ydot[1]
            )  # fmt: skip
            Jdot[1, k] = (
                wz * a - wx * c + vz * d - vx * f
                + df * y[0] - dd * y[2] + f * ydot[0] - d * ydot[2]
            )  # fmt: skip
            Jdot[2, k] = (
                wx * b - wy * a + vx * e - vy * d
                + dd * y[1] - de * y[0] + d * ydot[1] - e * ydot[0]
            )  # fmt: skip
        else:
            for x in range(3):
                Jdot[x, k] = 0.0


@compiled
def _forces(bias_out, K, h, v, coordinates, bias, joints, tendons, lengths, arms):
    """Copy the bias, which Pinocchio overwrites later; compute K and h."""
    n = len(v)
    for k in range(n):
        bias_out[k] = bias[k]
        K[k] = joints[k, 0] * (coordinates[k] - joints[k, 1])
        h[k] = joints[k, 2] * v[k]
    for t in range(len(tendons)):
        stiffness, damping = tendons[t, 1], tendons[t, 3]
        if tendons[t, 4] != 0:
            force = 0.0
            for k in range(n):
                force += arms[t, k] * v[k]
            if stiffness * (lengths[t] - tendons[t, 2]) + damping * force <= 0:
                continue  # slack
        if stiffness != 0:
            force = stiffness * (lengths[t] - tendons[t, 2])
            for k in range(n):
                K[k] += arms[t, k] * force
        if damping != 0:
            force = 0.0
            for k in range(n):
                force += arms[t, k] * v[k]
            for k in range(n):
                h[k] += arms[t, k] * (damping * force)
    for k in range(n):
        h[k] += bias_out[k] + K[k]
