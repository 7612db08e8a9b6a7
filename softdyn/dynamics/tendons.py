"""Tendon geometry: lengths, moment arms ∂ℓ/∂q and their gradients ∂²ℓ/∂q², all analytic.

A spatial tendon is a chain of straight segments between sites. A segment has the unit direction d
through the point p and pulls its two ends along one line. Both ends therefore get the same wrench
w = (d, p × d) about the world's origin. With the joint Jacobian column S_k = (v_k, ω_k) in that
frame

    ∂ℓ/∂q_k = Σ_segments (χ_k(end) - χ_k(start)) · (v_k · d + ω_k · (p × d)),

where χ_k(x) is 1 if joint k moves x, else 0. Only joints *between* the two ends of a segment count;
`Segments` lists them once. A segment within one body adds a constant length only.

Let c_k be the difference of the two ends' Jacobian columns and s the segment's length. Then the
segment's entry (j, k) of the moment arms' gradient ∂²ℓ/∂q² is

    c_j · (I - ddᵀ) c_k / s  +  d · (ω_j × c_k).

Joint j is the one nearer to the base. The second term counts only if both joints move the same end
of the segment, because joint j then rotates the column c_k.

A rotor that a cable turns has the kinetic energy ½ m ℓ̇², where m (kg) is the cable's armature, and
ℓ̇ = α · q̇. With α = ∂ℓ/∂q and H = ∂²ℓ/∂q², Lagrange's equations give the terms

    m α αᵀ of M,    m α (H q̇)ᵀ of C,    and so the force m α (q̇ᵀ H q̇),

with which Ṁ - 2C stays skew. The derivatives need α along a motion with constant q̇ = v. There

    α̇ = H v,    α̈ = ∂(vᵀ H v)/∂q.

Both follow from α_k = d · c_k by the product rule. A column S_k moves with the twist V of its body,
Ṡ_k = V × S_k and S̈_k = V̇ × S_k + V × Ṡ_k, with V̇ = Σ Ṡ_j v_j over the joints up to joint k.

Two sites with a round body between them are no segment, but a piece of
`softdyn.dynamics.wrapped_paths`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from softdyn.compiled import compiled, compiled_or
from softdyn.description.robot import Tendon
from softdyn.dynamics.wrapped_paths import PlacedPaths, WrappedPaths, compile_wraps
from softdyn.exceptions import InputError

TINY = 2.2250738585072014e-308  # avoids 0/0: a segment of length zero gets the direction zero


class Segments(NamedTuple):
    """The segments that change, and the degrees of freedom that change them, segment by segment.

    Attributes
    ----------
    bodies : ndarray of int, (segments, 3)
        Body of the start, body of the end, and tendon.
    offsets : ndarray, (segments, 6)
        Start and end in their bodies' frames.
    pairs : ndarray of int, (pairs, 2)
        A degree of freedom, those near the base first, and a segment that it changes.
    signs : ndarray, (pairs,)
        1 if it moves the segment's end, -1 if it moves the start.
    """

    bodies: np.ndarray
    offsets: np.ndarray
    pairs: np.ndarray
    signs: np.ndarray


@dataclass(frozen=True, eq=False)
class Tendons:
    """All tendons of a robot, ready for evaluation.

    Attributes
    ----------
    names : tuple of str
        Names in the file's order.
    coefficients : ndarray, (tendons, nv)
        The constant moment arms of the fixed tendons.
    offset : ndarray, (tendons,)
        The lengths that never change.
    segments : Segments
        The segments of the spatial tendons.
    spatial : bool
        Whether any tendon's moment arms depend on q.
    wraps : WrappedPaths
        The pieces of the spatial tendons around round bodies.
    """

    names: tuple[str, ...]
    coefficients: np.ndarray
    offset: np.ndarray
    segments: Segments
    spatial: bool
    wraps: WrappedPaths

    def at(
        self,
        coordinates: np.ndarray,
        S: np.ndarray,
        rotations: np.ndarray,
        translations: np.ndarray,
    ) -> TendonGeometry:
        """The tendons at one configuration.

        Parameters
        ----------
        coordinates : ndarray, (nv,)
            Joint coordinates.
        S : ndarray, (nv, 6)
            Joint Jacobian columns (v; ω) about the world's origin, as rows.
        rotations, translations : ndarray, (bodies, 3, 3), (bodies, 3)
            The bodies' poses.
        """
        return TendonGeometry(self, coordinates, S, rotations, translations)

    def arm_rates(
        self, v: np.ndarray, S: np.ndarray, rotations: np.ndarray, translations: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The rates (tendons, nv) of the moment arms along a constant q̇ = v, and of these rates.

        Only joint terms and straight segments count.

        Parameters
        ----------
        v : ndarray, (nv,)
            Velocity.
        S, rotations, translations : ndarray
            As for `at`.
        """
        rates = np.zeros((len(self.names), len(v)))
        seconds = np.zeros(rates.shape)
        if len(self.segments.bodies) > 0:
            if not v.flags.writeable:
                v = v.copy()  # a read-only array would need a second compilation
            segment_rates(rates, seconds, S, rotations, translations, *self.segments, v)
        return rates, seconds


class TendonGeometry:
    """All tendons of a robot at one configuration.

    `softdyn.dynamics.tree.TreeModel.tendon_geometry` makes one from views of the engine's results.
    Use it before the engine computes another configuration.

    Parameters
    ----------
    tendons : Tendons
        The tendons.
    coordinates : ndarray, (nv,)
        Joint coordinates.
    S : ndarray, (nv, 6)
        Joint Jacobian columns (v; ω) about the world's origin, as rows.
    rotations, translations : ndarray, (bodies, 3, 3), (bodies, 3)
        The bodies' poses.

    Attributes
    ----------
    lengths : ndarray, (tendons,)
        Lengths in metres, or in the unit of ``coef · q`` for fixed tendons.
    moment_arms : ndarray, (tendons, nv)
        Moment arms ∂ℓ/∂q.
    """

    def __init__(
        self,
        tendons: Tendons,
        coordinates: np.ndarray,
        S: np.ndarray,
        rotations: np.ndarray,
        translations: np.ndarray,
    ) -> None:
        self.tendons, self.coordinates, self.S = tendons, coordinates, S
        self.rotations, self.translations = rotations, translations
        self.lengths = tendons.coefficients @ coordinates + tendons.offset
        self.moment_arms = tendons.coefficients
        if tendons.spatial:
            self.moment_arms = tendons.coefficients.copy()
            moment_arms(
                self.moment_arms, self.lengths, S, rotations, translations, *tendons.segments
            )
        if tendons.wraps:
            self.lengths += self.around.lengths()
            self.moment_arms += self.around.moment_arms()

    @cached_property
    def around(self) -> PlacedPaths:
        """The pieces around round bodies."""
        return self.tendons.wraps.at(self.S, self.rotations, self.translations)

    def curvature(self, force: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Σ f_t ∂²ℓ_t/∂q² (nv, nv), and the rates (tendons, nv) of the moment arms along q̇ = v.

        Parameters
        ----------
        force : ndarray, (tendons,)
            The force f along each tendon.
        v : ndarray, (nv,)
            Velocity.
        """
        segments = self.tendons.segments
        if len(segments.bodies) == 0:
            total, rates = np.zeros((len(v), len(v))), np.zeros((len(force), len(v)))
        else:
            if not v.flags.writeable:
                v = v.copy()  # a read-only array would need a second compilation
            total, rates = segment_curvature(
                self.S, self.rotations, self.translations, *segments, force, v
            )
        if self.tendons.wraps:
            more = self.around.curvature(force, v)
            total, rates = total + more[0], rates + more[1]
        return total, rates

    def hessians(self) -> np.ndarray:
        """Gradients of the moment arms ∂²ℓ/∂q² (tendons, nv, nv)."""
        still, units = np.zeros(len(self.S)), np.eye(len(self.tendons.names))
        found = [self.curvature(unit, still)[0] for unit in units]
        return np.array(found).reshape(-1, len(still), len(still))


def arms_in_numpy(
    arms: np.ndarray, lengths: np.ndarray, S: np.ndarray, rotations: np.ndarray,
    translations: np.ndarray, bodies: np.ndarray, offsets: np.ndarray, pairs: np.ndarray,
    signs: np.ndarray,
) -> None:  # fmt: skip
    """Compute `moment_arms` without compiled loops; its arguments are the same."""
    start, end = (
        np.matmul(rotations[body], offset[:, :, None])[:, :, 0] + translations[body]
        for body, offset in ((bodies[:, 0], offsets[:, :3]), (bodies[:, 1], offsets[:, 3:]))
    )
    span, tendon = end - start, bodies[:, 2]
    norms = np.sqrt(np.einsum("ij,ij->i", span, span))
    direction = span / np.maximum(norms, TINY)[:, None]
    wrench = np.concatenate((direction, np.cross(start, direction)), axis=1)
    dof, segment = pairs.T
    values = np.einsum("ki,ki->k", S[dof], wrench[segment]) * signs
    np.add.at(lengths, tendon, norms)
    np.add.at(arms, (tendon[segment], dof), values)


@compiled_or(arms_in_numpy)
def moment_arms(arms, lengths, S, rotations, translations, bodies, offsets, pairs, signs):
    """Add the segments' moment arms to `arms` (nt, nv) and lengths to `lengths` (nt,).

    Parameters
    ----------
    S : ndarray, (nv, 6)
        Joint Jacobian columns (v; ω) about the world's origin, as rows.
    rotations, translations : ndarray, (bodies, 3, 3), (bodies, 3)
        The bodies' poses.
    bodies, offsets, pairs, signs : ndarray
        Fields of `Segments`.
    """
    wrench = np.empty((len(bodies), 6))
    a, d = np.empty(3), np.empty(3)
    for s in range(len(bodies)):
        i, j = bodies[s, 0], bodies[s, 1]
        square = 0.0
        for x in range(3):
            a[x], b = translations[i, x], translations[j, x]
            for y in range(3):
                a[x] += rotations[i, x, y] * offsets[s, y]
                b += rotations[j, x, y] * offsets[s, 3 + y]
            d[x] = b - a[x]
            square += d[x] * d[x]
        length = np.sqrt(square)
        lengths[bodies[s, 2]] += length
        for x in range(3):
            d[x] /= max(length, TINY)
            wrench[s, x] = d[x]
        wrench[s, 3] = a[1] * d[2] - a[2] * d[1]
        wrench[s, 4] = a[2] * d[0] - a[0] * d[2]
        wrench[s, 5] = a[0] * d[1] - a[1] * d[0]
    for p in range(len(pairs)):
        k, s = pairs[p, 0], pairs[p, 1]
        value = 0.0
        for x in range(6):
            value += S[k, x] * wrench[s, x]
        arms[bodies[s, 2], k] += signs[p] * value


@compiled
def segment_curvature(S, rotations, translations, bodies, offsets, pairs, signs, force, v):
    """Compute `TendonGeometry.curvature`; only joints between a segment's ends contribute.

    The arguments are those of `moment_arms`, with force (tendons,) and v (nv,).
    """
    nv = len(S)
    total, rates = np.zeros((nv, nv)), np.zeros((len(force), nv))
    columns, along = np.empty((len(pairs), 3)), np.empty(len(pairs))
    start, d, p = np.empty(3), np.empty(3), np.empty(3)
    last = 0
    for s in range(len(bodies)):
        i, j, t = bodies[s, 0], bodies[s, 1], bodies[s, 2]
        square = 0.0
        for x in range(3):
            start[x], end = translations[i, x], translations[j, x]
            for y in range(3):
                start[x] += rotations[i, x, y] * offsets[s, y]
                end += rotations[j, x, y] * offsets[s, 3 + y]
            d[x] = end - start[x]
            square += d[x] * d[x]
        norm = np.sqrt(square)
        length = max(norm, TINY)
        for x in range(3):
            d[x] /= length
        first = last
        while last < len(pairs) and pairs[last, 1] == s:
            k, sign = pairs[last, 0], signs[last]
            for x in range(3):
                p[x] = start[x] + (norm * d[x] if sign > 0 else 0.0)
            along[last] = 0.0
            for x in range(3):
                y, z = (x + 1) % 3, (x + 2) % 3
                columns[last, x] = sign * (S[k, x] + S[k, 3 + y] * p[z] - S[k, 3 + z] * p[y])
                along[last] += columns[last, x] * d[x]
            last += 1
        for a in range(first, last):
            j = pairs[a, 0]
            for b in range(a, last):
                k = pairs[b, 0]
                value = -along[a] * along[b]
                for x in range(3):
                    value += columns[a, x] * columns[b, x]
                value /= length
                if signs[a] == signs[b]:
                    for x in range(3):
                        y, z = (x + 1) % 3, (x + 2) % 3
                        value += S[j, 3 + x] * (columns[b, y] * d[z] - columns[b, z] * d[y])
                total[j, k] += force[t] * value
                rates[t, j] += value * v[k]
                if j != k:
                    total[k, j] += force[t] * value
                    rates[t, k] += value * v[j]
    return total, rates


@compiled
def segment_rates(
    rates, seconds, S, rotations, translations, bodies, offsets, pairs, signs, v
):  # fmt: skip
    """Add the rates of the segments' moment arms, and the rates of these: see `arm_rates`.

    Parameters
    ----------
    rates, seconds : ndarray, (tendons, nv)
        Sums to add to.
    v : ndarray, (nv,)
        Velocity.

    The other arguments are those of `moment_arms`.
    """
    # position, velocity and acceleration of the start (0) and of the end (1)
    point, speed, turn = np.empty((2, 3)), np.empty((2, 3)), np.empty((2, 3))
    # the direction with its rates
    d, d1, d2 = np.empty(3), np.empty(3), np.empty(3)
    # a body's twist and its rate; a column's rates
    twist, drift, first, second = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    last = 0
    for s in range(len(bodies)):
        begin = last
        while last < len(pairs) and pairs[last, 1] == s:
            last += 1
        for end in range(2):
            body = bodies[s, end]
            for x in range(3):
                point[end, x] = translations[body, x]
                for y in range(3):
                    point[end, x] += rotations[body, x, y] * offsets[s, 3 * end + y]
            for x in range(6):
                twist[x] = drift[x] = 0.0
            for p in range(begin, last):
                if (signs[p] > 0) == (end == 1):
                    advance(twist, drift, first, S[pairs[p, 0]], v[pairs[p, 0]])
            for x in range(3):
                speed[end, x] = twist[x] + cross(twist[3:], point[end], x)
            for x in range(3):
                turn[end, x] = (
                    drift[x] + cross(drift[3:], point[end], x) + cross(twist[3:], speed[end], x)
                )
        square = along = swift = pull = 0.0
        for x in range(3):
            d[x] = point[1, x] - point[0, x]
            square += d[x] * d[x]
        length = max(np.sqrt(square), TINY)
        for x in range(3):
            d[x] /= length
            d1[x], d2[x] = speed[1, x] - speed[0, x], turn[1, x] - turn[0, x]
            along += d[x] * d1[x]
            swift += d1[x] * d1[x]
            pull += d[x] * d2[x]
        pull += (swift - along * along) / length
        for x in range(3):
            d1[x] = (d1[x] - along * d[x]) / length
            d2[x] = (d2[x] - pull * d[x] - 2 * along * d1[x]) / length
        for end in range(2):
            for x in range(6):
                twist[x] = drift[x] = 0.0
            for p in range(begin, last):
                if (signs[p] > 0) != (end == 1):
                    continue
                k = pairs[p, 0]
                column = S[k]
                advance(twist, drift, first, column, v[k])
                for x in range(6):
                    second[x] = motion_cross(drift, column, x) + motion_cross(twist, first, x)
                rate = more = 0.0
                for x in range(3):
                    c = column[x] + cross(column[3:], point[end], x)
                    c1 = first[x] + cross(first[3:], point[end], x)
                    c1 += cross(column[3:], speed[end], x)
                    c2 = second[x] + cross(second[3:], point[end], x)
                    c2 += 2 * cross(first[3:], speed[end], x) + cross(column[3:], turn[end], x)
                    rate += d1[x] * c + d[x] * c1
                    more += d2[x] * c + 2 * d1[x] * c1 + d[x] * c2
                rates[bodies[s, 2], k] += signs[p] * rate
                seconds[bodies[s, 2], k] += signs[p] * more


@compiled
def advance(twist, drift, rate, column, speed):
    """Add a joint's motion to the twist and its rate; write the rate of its column."""
    for x in range(6):
        twist[x] += column[x] * speed
    for x in range(6):
        rate[x] = motion_cross(twist, column, x)
        drift[x] += rate[x] * speed


@compiled
def cross(a, b, x):
    """The x-th number of the product a × b of two vectors (3,)."""
    y, z = (x + 1) % 3, (x + 2) % 3
    return a[y] * b[z] - a[z] * b[y]


@compiled
def motion_cross(a, b, x):
    """The x-th number of the product of two twists (v; ω): the rate of b carried by a."""
    if x >= 3:
        return cross(a[3:], b[3:], x - 3)
    return cross(a[3:], b[:3], x) + cross(a[:3], b[3:], x)


def compile_tendons(
    tendons: tuple[Tendon, ...],
    dof: dict[str, int],
    anchor: Callable[[str, np.ndarray], tuple[int, np.ndarray]],
    moves: np.ndarray,
) -> Tendons:
    """Turn the description into arrays.

    Parameters
    ----------
    tendons : tuple of Tendon
        As parsed.
    dof : dict of str to int
        Index in v of each moving joint.
    anchor : callable
        (link, xyz) → (body index, offset (3,) in the body's frame).
    moves : ndarray of bool, (nv, bodies)
        Whether a degree of freedom moves a body.

    Raises
    ------
    InputError
        For the armature of a tendon around a round body.
    """
    nt, nv = len(tendons), len(moves)
    coefficients, offset = np.zeros((nt, nv)), np.zeros(nt)
    bodies: list[tuple[int, int, int]] = []
    offsets: list[tuple[float, ...]] = []
    for t, tendon in enumerate(tendons):
        if tendon.armature and tendon.wraps:
            expected = f"no armature of tendon {tendon.name!r} around a round body"
            raise InputError("armature", expected, tendon.armature)
        for term in tendon.terms:
            coefficients[t, dof[term.joint]] = term.coef
        points = (anchor(site.link, np.array(site.xyz)) for site in tendon.sites)
        around = {wrap.after for wrap in tendon.wraps}
        for k, ((i, a), (j, b)) in enumerate(pairwise(points)):
            if k in around:
                continue
            if i == j:
                offset[t] += np.linalg.norm(b - a)
            else:
                bodies.append((i, j, t))
                offsets.append((*a, *b))
    ends = np.array(bodies, int).reshape(-1, 3)
    sign = moves[:, ends[:, 1]].astype(float) - moves[:, ends[:, 0]]
    segment, dofs = np.nonzero(sign.T)
    segments = Segments(
        ends, np.array(offsets).reshape(-1, 6), np.column_stack((dofs, segment)),
        sign[dofs, segment],
    )  # fmt: skip
    names = tuple(tendon.name for tendon in tendons)
    wraps = compile_wraps(tendons, anchor, moves)
    return Tendons(names, coefficients, offset, segments, len(ends) > 0 or bool(wraps), wraps)
