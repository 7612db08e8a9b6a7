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

Two sites with a round body between them are no segment, but a piece of
`softdyn.dynamics.wrapped_paths`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from softdyn.compiled import compiled
from softdyn.description.robot import Tendon
from softdyn.dynamics.wrapped_paths import PlacedPaths, WrappedPaths, compile_wraps

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

    def lengths(
        self,
        coordinates: np.ndarray,
        rotations: np.ndarray,
        translations: np.ndarray,
        placed: PlacedPaths | None = None,
    ) -> np.ndarray:
        """Lengths (tendons,) in metres, or in the unit of ``coef · q`` for fixed tendons.

        Parameters
        ----------
        coordinates : ndarray, (nv,)
            Joint coordinates.
        rotations, translations : ndarray, (bodies, 3, 3), (bodies, 3)
            The bodies' poses.
        placed : PlacedPaths, optional
            The pieces around round bodies at these poses, if they are known.
        """
        lengths = self.coefficients @ coordinates + self.offset
        if self.spatial:
            norms = self._directions(rotations, translations)[2]
            lengths += np.bincount(self.segments.bodies[:, 2], norms, len(self.names))
        if self.wraps:
            placed = self.wraps.at(rotations, translations) if placed is None else placed
            lengths += placed.lengths()
        return lengths

    def moment_arms(
        self,
        jacobian: np.ndarray,
        rotations: np.ndarray,
        translations: np.ndarray,
        placed: PlacedPaths | None = None,
    ) -> np.ndarray:
        """Moment arms ∂ℓ/∂q (tendons, nv).

        Parameters
        ----------
        jacobian : ndarray, (6, nv)
            Joint Jacobian columns (v; ω) about the world's origin.
        rotations, translations : ndarray, (bodies, 3, 3), (bodies, 3)
            The bodies' poses.
        placed : PlacedPaths, optional
            The pieces around round bodies at these poses, if they are known.
        """
        start, direction, _ = self._directions(rotations, translations)
        wrench = np.concatenate((direction, np.cross(start, direction)), axis=1)
        (dof, segment), signs = self.segments.pairs.T, self.segments.signs
        values = np.einsum("ik,ki->k", jacobian[:, dof], wrench[segment]) * signs
        arms = self.coefficients.copy()
        np.add.at(arms, (self.segments.bodies[segment, 2], dof), values)
        if self.wraps:
            placed = self.wraps.at(rotations, translations) if placed is None else placed
            arms += placed.moment_arms(jacobian.T)
        return arms

    def geometry(
        self,
        coordinates: np.ndarray,
        S: np.ndarray,
        rotations: np.ndarray,
        translations: np.ndarray,
        placed: PlacedPaths | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """The `lengths` (tendons,) and `moment_arms` (tendons, nv), by the kernel.

        Parameters
        ----------
        coordinates : ndarray, (nv,)
            Joint coordinates.
        S : ndarray, (nv, 6)
            Joint Jacobian columns (v; ω) about the world's origin, as rows.
        rotations, translations : ndarray, (bodies, 3, 3), (bodies, 3)
            The bodies' poses.
        placed : PlacedPaths, optional
            The pieces around round bodies at these poses, if they are known.
        """
        lengths, arms = self.coefficients @ coordinates + self.offset, self.coefficients
        if self.spatial:
            arms = arms.copy()
            moment_arms(arms, lengths, S, rotations, translations, *self.segments)
        if self.wraps:
            placed = self.wraps.at(rotations, translations) if placed is None else placed
            lengths += placed.lengths()
            arms += placed.moment_arms(S)
        return lengths, arms

    def curvature(
        self,
        S: np.ndarray,
        rotations: np.ndarray,
        translations: np.ndarray,
        force: np.ndarray,
        v: np.ndarray,
        placed: PlacedPaths | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Σ f_t ∂²ℓ_t/∂q² (nv, nv), and the rates (tendons, nv) of the moment arms along q̇ = v.

        Parameters
        ----------
        S : ndarray, (nv, 6)
            Joint Jacobian columns (v; ω) about the world's origin, as rows.
        rotations, translations : ndarray, (bodies, 3, 3), (bodies, 3)
            The bodies' poses.
        force : ndarray, (tendons,)
            The force f along each tendon.
        v : ndarray, (nv,)
            Velocity.
        placed : PlacedPaths, optional
            The pieces around round bodies at these poses, if they are known.
        """
        if len(self.segments.bodies) == 0:
            total, rates = np.zeros((len(v), len(v))), np.zeros((len(force), len(v)))
        else:
            if not v.flags.writeable:
                v = v.copy()  # a read-only array would need a second compilation
            total, rates = segment_curvature(S, rotations, translations, *self.segments, force, v)
        if self.wraps:
            placed = self.wraps.at(rotations, translations) if placed is None else placed
            more = placed.curvature(S, force, v)
            total, rates = total + more[0], rates + more[1]
        return total, rates

    def _directions(
        self, rotations: np.ndarray, translations: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Start points (ns, 3), unit directions (ns, 3) and lengths (ns,) of the segments."""
        bodies, offsets = self.segments.bodies, self.segments.offsets
        start, end = (
            np.matmul(rotations[body], offset[:, :, None])[:, :, 0] + translations[body]
            for body, offset in ((bodies[:, 0], offsets[:, :3]), (bodies[:, 1], offsets[:, 3:]))
        )
        span = end - start
        norms = np.sqrt(np.einsum("ij,ij->i", span, span))
        return start, span / np.maximum(norms, TINY)[:, None], norms


@compiled
def moment_arms(arms, lengths, S, rotations, translations, bodies, offsets, pairs, signs):
    """Add the spatial tendons' moment arms to `arms` (nt, nv) and lengths to `lengths` (nt,).

    It computes `Tendons.moment_arms` in loops over segments and pairs.

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
    """Compute `Tendons.curvature`; only joints between a segment's ends contribute.

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
    """
    nt, nv = len(tendons), len(moves)
    coefficients, offset = np.zeros((nt, nv)), np.zeros(nt)
    bodies: list[tuple[int, int, int]] = []
    offsets: list[tuple[float, ...]] = []
    for t, tendon in enumerate(tendons):
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
