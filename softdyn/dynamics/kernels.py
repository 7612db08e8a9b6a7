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
    tendons : ndarray, (tendons, 4)
        Stiffness, rest, damping, and 1 for a tendon that only pulls, else 0.
    actuated, gear : ndarray, (m,)
        The tendon of each input, and its gear.
    """

    tip: int
    tip_offset: np.ndarray
    tree: np.ndarray
    gravity: np.ndarray
    joints: np.ndarray
    tendons: np.ndarray
    actuated: np.ndarray
    gear: np.ndarray


JOINT_TERMS = 10  # number of vectors (n,) in `joint_terms`, without M


def joint_terms(joint_rows):
    """M, J, J̇, bias, K, h and g as views of joint_rows (≥ n + 10, n), which a kernel has filled."""
    n = joint_rows.shape[1]
    M, J, Jdot = joint_rows[:n], joint_rows[n : n + 3], joint_rows[n + 3 : n + 6]
    return M, J, Jdot, joint_rows[n + 6], joint_rows[n + 7], joint_rows[n + 8], joint_rows[n + 9]


def tendon_terms(joint_rows, tendons):
    """Moment arms and Bᵀ, after the `joint_terms`."""
    first = joint_rows.shape[1] + JOINT_TERMS
    return joint_rows[first : first + tendons], joint_rows[first + tendons :]


def tip_terms(tip_and_lengths):
    """Tip position and velocity, tendon lengths: views of tip_and_lengths (6 + tendons,)."""
    return tip_and_lengths[:3], tip_and_lengths[3:6], tip_and_lengths[6:]


@compiled
def segments_and_state(
    joint_rows, tip_and_lengths, v, coordinates, bias, S, momenta, centre, rotations, translations,
    tip, tip_offset, tree, gravity, joints, tendons, actuated, gear,
    offset, coefficients, bodies, offsets, pairs, signs,
):  # fmt: skip
    """All terms of a State of a robot whose cables are joint terms and segments, in one call.

    The arguments are those of `state_terms`, then two fields of `softdyn.dynamics.tendons.Tendons`
    and those of its `Segments`.
    """
    n, count = len(v), len(tendons)
    first = n + JOINT_TERMS
    lengths, arms = tip_and_lengths[6:], joint_rows[first : first + count]
    for t in range(count):
        length = offset[t]
        for k in range(n):
            arms[t, k] = coefficients[t, k]
            length += coefficients[t, k] * coordinates[k]
        lengths[t] = length
    if len(bodies) > 0:
        moment_arms(arms, lengths, S, rotations, translations, bodies, offsets, pairs, signs)
    state_terms(
        joint_rows, tip_and_lengths, v, coordinates, bias, S, momenta, centre, rotations,
        translations, tip, tip_offset, tree, gravity, joints, tendons, actuated, gear,
    )  # fmt: skip


@compiled
def state_terms(
    joint_rows, tip_and_lengths, v, coordinates, bias, S, momenta, centre, rotations, translations,
    tip, tip_offset, tree, gravity, joints, tendons, actuated, gear,
):  # fmt: skip
    """All terms of a State, in plain loops: slices and array expressions take long to compile.

    Parameters
    ----------
    joint_rows : ndarray, (n + 10 + tendons + m, n)
        The moment arms among the `tendon_terms` are given; the rest is filled, and the
        `joint_terms`.
    tip_and_lengths : ndarray, (6 + tendons,)
        The tendons' lengths among the `tip_terms` are given; the rest is filled.
    v, coordinates : ndarray, (n,)
        Joint velocities and coordinates.
    bias, S, momenta, centre, rotations, translations : ndarray
        Fields of `softdyn.dynamics.engine.Memory`.
    tip, tip_offset, tree, gravity, joints, tendons, actuated, gear : ndarray
        Fields of `Constants`.
    """
    n, count = len(v), len(tendons)
    first = n + JOINT_TERMS
    lengths, arms = tip_and_lengths[6:], joint_rows[first : first + count]

    # the tip's position y, and the bodies' twists with the tip's Jacobian and velocity
    y, ydot = tip_and_lengths[:3], tip_and_lengths[3:6]
    for i in range(3):
        y[i], ydot[i] = translations[tip, i], 0.0
        for j in range(3):
            y[i] += rotations[tip, i, j] * tip_offset[j]
    twists, turned, force = np.zeros((len(translations), 6)), np.empty(3), np.empty(6)
    for k in range(n):
        for x in range(3):
            i, j = (x + 1) % 3, (x + 2) % 3
            moved = S[k, x] + S[k, 3 + i] * y[j] - S[k, 3 + j] * y[i] if tree[k, 0] else 0.0
            joint_rows[n + x, k] = moved
            ydot[x] += moved * v[k]
        for x in range(6):
            twists[tree[k, 1], x] = twists[tree[k, 2], x] + S[k, x] * v[k]
    for k in range(n):
        own = tree[k, 1]
        for x in range(3):
            i, j = (x + 1) % 3, (x + 2) % 3
            # the rate of ω_k, and from it that of v_k + ω_k × y
            turned[x] = twists[own, 3 + i] * S[k, 3 + j] - twists[own, 3 + j] * S[k, 3 + i]
        for x in range(3):
            i, j = (x + 1) % 3, (x + 2) % 3
            rate = (
                twists[own, 3 + i] * S[k, j] - twists[own, 3 + j] * S[k, i]
                + twists[own, i] * S[k, 3 + j] - twists[own, j] * S[k, 3 + i]
                + turned[i] * y[j] - turned[j] * y[i]
                + S[k, 3 + i] * ydot[j] - S[k, 3 + j] * ydot[i]
            )  # fmt: skip
            joint_rows[n + 3 + x, k] = rate if tree[k, 0] else 0.0

    # M, armature included, and g, from the momenta about the origin
    columns = np.empty((6, n))
    for k in range(n):
        for i in range(6):
            columns[i, k] = S[k, i]
    for k in range(n):
        weight = 0.0
        for x in range(3):
            i, j = (x + 1) % 3, (x + 2) % 3
            force[x] = momenta[k, x]
            force[3 + x] = momenta[k, 3 + x] + centre[i] * momenta[k, j] - centre[j] * momenta[k, i]
            weight += momenta[k, x] * gravity[x]
        joint_rows[n + 9, k] = -weight
        for j in range(k + 1):
            value = 0.0
            for i in range(6):
                value += force[i] * columns[i, j]
            joint_rows[k, j] = value if tree[j, 3] > k else 0.0
        joint_rows[k, k] += joints[k, 3]
        for j in range(k):
            joint_rows[j, k] = joint_rows[k, j]

    for i in range(len(gear)):
        for k in range(n):
            joint_rows[first + count + i, k] = gear[i] * arms[actuated[i], k]

    # the bias is copied, because Pinocchio overwrites it later; K and h follow
    for k in range(n):
        joint_rows[n + 6, k] = bias[k]
        joint_rows[n + 7, k] = joints[k, 0] * (coordinates[k] - joints[k, 1])
        joint_rows[n + 8, k] = joints[k, 2] * v[k]
    for t in range(count):
        stiffness, damping = tendons[t, 0], tendons[t, 2]
        if stiffness == 0 and damping == 0:
            continue
        rate = 0.0
        for k in range(n):
            rate += arms[t, k] * v[k]
        stretched, damped = stiffness * (lengths[t] - tendons[t, 1]), damping * rate
        if tendons[t, 3] != 0 and stretched + damped <= 0:
            continue  # slack
        for k in range(n):
            joint_rows[n + 7, k] += arms[t, k] * stretched
            joint_rows[n + 8, k] += arms[t, k] * damped
    for k in range(n):
        joint_rows[n + 8, k] += joint_rows[n + 6, k] + joint_rows[n + 7, k]
