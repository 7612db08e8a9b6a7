"""All terms of a State in one kernel, from what Pinocchio's algorithms leave in its Data.

Joint Jacobian columns S_k = (v_k; ω_k) are in the world's axes about its origin, so a point p of a
body that joint k moves has ∂p/∂q_k = v_k + ω_k × p, and

    J̇_k = v̇_k + ω̇_k × p + ω_k × ṗ.

Each column is fixed to the body that joint k moves first, whose twist (v; ω) = Σ S_j q̇_j, over its
own joint and all before it, carries it along:

    v̇_k = ω × v_k + v × ω_k,    ω̇_k = ω × ω_k.

With F_k = (f_k; τ_k) the momentum of everything at q̇_k = 1, about the same origin, the mass matrix
and the force of gravity a are

    M_jk = S_j · F_k where joint j is joint k or before it,    g_k = -a · f_k

(Featherstone 2008, chapter 6; Orin & Goswami 2008). Pinocchio's centroidal map holds F_k about the
centre of mass c: it lacks c × f_k. This M costs less than that of `crba`: it is written once, where
it stays.

`SoftModel` does the same in NumPy and with Pinocchio's own algorithms where nothing is compiled;
`tests/dynamics/test_kernels.py` holds the two against each other.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from softdyn.compiled import compiled
from softdyn.dynamics.tendons import moment_arms


class Live:
    """Views of a Data's memory, which Pinocchio's algorithms refresh in place.

    Going through Data's accessors costs a microsecond each, and one a joint for `oMi`, a C++ vector
    of (rotation, translation) pairs, contiguous by the standard.

    Attributes
    ----------
    bias : (nv,) of `nonLinearEffects`.
    S : (nv, 6) joint Jacobian columns about the world's origin, as rows.
    momenta, centre : (nv, 6), (3,) columns of the centroidal map, as rows; the centre of mass that
        they are about.
    rotations, translations : (bodies, 3, 3), (bodies, 3) joint placements.

    Raises
    ------
    RuntimeError
        Where this Pinocchio lays its memory out in another way.
    """

    def __init__(self, data: pin.Data) -> None:
        n = len(data.nle)  # of one joint, Pinocchio hands matrices out as vectors
        self.bias, self.S = data.nle, data.J.T.reshape(n, 6)
        self.momenta, self.centre = data.Ag.T.reshape(n, 6), data.com[0]
        self.rotations = _stacked([placement.rotation for placement in data.oMi])
        self.translations = _stacked([placement.translation for placement in data.oMi])
        pairs = [(self.bias, data.nle), (self.S, data.J)]
        pairs += [(self.momenta, data.Ag), (self.centre, data.com[0])]
        for i, placement in enumerate(data.oMi):
            pairs.append((self.rotations[i], placement.rotation))
            pairs.append((self.translations[i], placement.translation))
        if any(view.ctypes.data != array.ctypes.data for view, array in pairs) or not all(
            view.flags.c_contiguous for view in (self.bias, self.S, self.momenta, self.centre)
        ):
            raise RuntimeError("this Pinocchio keeps its results in an unknown layout")


def _stacked(arrays: list[np.ndarray]) -> np.ndarray:
    """One view of arrays that follow each other in memory at even distances."""
    first, last = arrays[0], arrays[-1]
    stride = (last.ctypes.data - first.ctypes.data) // max(len(arrays) - 1, 1)
    return as_strided(first, (len(arrays), *first.shape), (stride, *first.strides))


@compiled
def fixed_terms(
    rows, few, v, coordinates, bias, S, momenta, centre, rotations, translations,
    tip, tip_offset, tree, gravity, joints, tendons, arms,
):  # fmt: skip
    """Everything where moment arms are constant.

    Parameters
    ----------
    rows : (n + 10, n) filled with M, J, J̇, bias, K, h and g.
    few : (6 + tendons,) filled with y, ẏ and the lengths.
    bias … translations : of `Live`.
    tip, tip_offset : body of the tip and its position in it.
    tree : (n, 4) of each degree of freedom: whether it moves the tip, the body that it moves
        first, the body whose twist it adds to, and the first degree of freedom after it that is
        not beyond it.
    gravity : (3,) acceleration.
    joints : (n, 4) stiffness, rest, damping and armature.
    tendons : (tendons, 4) constant length, stiffness, rest and damping.
    arms : (tendons, n) moment arms.
    """
    _tip(rows, few, v, S, rotations, translations, tip, tip_offset, tree)
    _inertia(rows, S, momenta, centre, tree, gravity, joints)
    n = len(v)
    for t in range(len(tendons)):
        length = tendons[t, 0]
        for k in range(n):
            length += arms[t, k] * coordinates[k]
        few[6 + t] = length
    _forces(rows, few, v, coordinates, bias, joints, tendons, arms)


@compiled
def spatial_terms(
    rows, few, v, coordinates, bias, S, momenta, centre, rotations, translations,
    tip, tip_offset, tree, gravity, joints, tendons, coefficients,
    bodies, offsets, pairs, signs, actuated, gear,
):  # fmt: skip
    """Everything where moment arms change with q; see `fixed_terms`.

    Parameters
    ----------
    rows : (n + 10 + tendons + m, n), after `fixed_terms`' the moment arms and Bᵀ.
    coefficients : (tendons, n) moment arms of the fixed tendons.
    bodies, offsets, pairs, signs : of `Tendons`.
    actuated, gear : (m,) the tendon of each input, and its gear.
    """
    _tip(rows, few, v, S, rotations, translations, tip, tip_offset, tree)
    _inertia(rows, S, momenta, centre, tree, gravity, joints)
    n, nt, m = len(v), len(tendons), len(gear)
    arms, lengths = rows[n + 10 : n + 10 + nt], few[6:]
    arms[:] = coefficients
    for t in range(nt):
        lengths[t] = tendons[t, 0]
        for k in range(n):
            lengths[t] += coefficients[t, k] * coordinates[k]
    moment_arms(arms, lengths, S, rotations, translations, bodies, offsets, pairs, signs)
    for i in range(m):
        for k in range(n):
            rows[n + 10 + nt + i, k] = gear[i] * arms[actuated[i], k]
    _forces(rows, few, v, coordinates, bias, joints, tendons, arms)


@compiled
def _inertia(rows, S, momenta, centre, tree, gravity, joints):
    """M, armature included, and g."""
    n = len(S)
    x, y, z = centre[0], centre[1], centre[2]
    columns, g = S.T.copy(), rows[n + 9]
    for k in range(n):
        a, b, c = momenta[k, 0], momenta[k, 1], momenta[k, 2]
        g[k] = -(a * gravity[0] + b * gravity[1] + c * gravity[2])
        d, e, f = (
            momenta[k, 3] + y * c - z * b,
            momenta[k, 4] + z * a - x * c,
            momenta[k, 5] + x * b - y * a,
        )
        row = rows[k]
        for j in range(k + 1):
            value = (
                a * columns[0, j] + b * columns[1, j] + c * columns[2, j]
                + d * columns[3, j] + e * columns[4, j] + f * columns[5, j]
            )  # fmt: skip
            row[j] = value if tree[j, 3] > k else 0.0
        row[k] += joints[k, 3]
        for j in range(k):
            rows[j, k] = row[j]


@compiled
def _tip(rows, few, v, S, rotations, translations, tip, tip_offset, tree):
    """J, J̇, y and ẏ."""
    n = len(v)
    twists = np.zeros((len(translations), 6))
    J, Jdot, y, ydot = rows[n : n + 3], rows[n + 3 : n + 6], few[:3], few[3:6]
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
def _forces(rows, few, v, coordinates, bias, joints, tendons, arms):
    """Bias, K and h, from the lengths in `few`."""
    n = len(v)
    kept, K, h = rows[n + 6], rows[n + 7], rows[n + 8]
    for k in range(n):
        kept[k] = bias[k]
        K[k] = joints[k, 0] * (coordinates[k] - joints[k, 1])
        h[k] = joints[k, 2] * v[k]
    for t in range(len(tendons)):
        stiffness, damping = tendons[t, 1], tendons[t, 3]
        if stiffness != 0:
            force = stiffness * (few[6 + t] - tendons[t, 2])
            for k in range(n):
                K[k] += arms[t, k] * force
        if damping != 0:
            force = 0.0
            for k in range(n):
                force += arms[t, k] * v[k]
            for k in range(n):
                h[k] += arms[t, k] * (damping * force)
    for k in range(n):
        h[k] += kept[k] + K[k]
