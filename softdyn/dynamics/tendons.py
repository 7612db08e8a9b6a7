"""Tendon geometry: lengths, moment arms ∂ℓ/∂q and their gradients ∂²ℓ/∂q², all analytic.

A spatial tendon is a chain of straight segments between sites. A segment with unit direction d
through the point p pulls its two ends along one line, so both ends see the same wrench
w = (d, p × d) about the world's origin, and with the joint Jacobian column S_k = (v_k, ω_k)
in that frame

    ∂ℓ/∂q_k = Σ_segments (χ_k(end) - χ_k(start)) · (v_k · d + ω_k · (p × d)),

χ_k(x) being 1 where joint k moves x. Only joints *between* the two ends of a segment count, which
`Incidence` lists once; a segment within one body only adds a constant length.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from softdyn.compiled import compiled
from softdyn.description.robot import Tendon


@dataclass(frozen=True, eq=False)
class Anchors:
    """Points fixed to bodies: `body` (k,) joint indices, `offset` (k, 3) in the body's frame."""

    body: np.ndarray
    offset: np.ndarray

    def positions(self, rotations: np.ndarray, translations: np.ndarray) -> np.ndarray:
        """World positions (k, 3) from the bodies' rotations (·, 3, 3) and translations (·, 3)."""
        moved = np.matmul(rotations[self.body], self.offset[:, :, None])[:, :, 0]
        return moved + translations[self.body]


@dataclass(frozen=True, eq=False)
class Incidence:
    """Which degree of freedom changes which segment: parallel arrays, one entry a pair."""

    dof: np.ndarray
    segment: np.ndarray
    sign: np.ndarray
    slot: np.ndarray  # flat index into the (tendons, nv) moment arms


@dataclass(frozen=True, eq=False)
class Tendons:
    """All tendons of a robot, ready for evaluation.

    `coefficients` (nt, nv) are the constant moment arms of the fixed tendons, `offset` (nt,) the
    lengths that never change, `segment_tendon` (ns,) the tendon each moving segment belongs to,
    `supports` (nv, bodies) whether a degree of freedom moves a body.
    """

    names: tuple[str, ...]
    coefficients: np.ndarray
    offset: np.ndarray
    start: Anchors
    end: Anchors
    segment_tendon: np.ndarray
    incidence: Incidence
    supports: np.ndarray

    @property
    def spatial(self) -> bool:
        """Whether any tendon's moment arms depend on q."""
        return self.segment_tendon.size > 0

    def lengths(
        self, coordinates: np.ndarray, rotations: np.ndarray, translations: np.ndarray
    ) -> np.ndarray:
        """Lengths (nt,) in metres, or in the unit of ``coef · q`` for fixed tendons."""
        lengths = self.coefficients @ coordinates + self.offset
        if self.spatial:
            norms = self.directions(rotations, translations)[2]
            lengths += np.bincount(self.segment_tendon, norms, len(self.names))
        return lengths

    def directions(
        self, rotations: np.ndarray, translations: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Start points (ns, 3), unit directions (ns, 3) and lengths (ns,) of moving segments.

        A segment shrunk to a point has no direction: zero is the only unbiased answer.
        """
        start = self.start.positions(rotations, translations)
        span = self.end.positions(rotations, translations) - start
        norms = np.sqrt(np.einsum("ij,ij->i", span, span))
        return start, span / np.maximum(norms, np.finfo(float).tiny)[:, None], norms

    def moment_arms(
        self, jacobian: np.ndarray, rotations: np.ndarray, translations: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Moment arms ∂ℓ/∂q (nt, nv) and the spatial part (nt,) of the lengths.

        `jacobian` (6, nv): joint Jacobian columns (v; ω) about the world's origin.
        """
        nt, nv = self.coefficients.shape
        start, direction, norms = self.directions(rotations, translations)
        wrench = np.concatenate((direction, np.cross(start, direction)), axis=1)
        pairs = self.incidence
        values = np.einsum("ik,ki->k", jacobian[:, pairs.dof], wrench[pairs.segment]) * pairs.sign
        arms = np.bincount(pairs.slot, values, nt * nv).reshape(nt, nv)
        return arms + self.coefficients, np.bincount(self.segment_tendon, norms, nt)

    def packed(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """What the kernel `moment_arms` reads: its last four arguments."""
        bodies = np.column_stack((self.start.body, self.end.body, self.segment_tendon))
        offsets = np.column_stack((self.start.offset, self.end.offset))
        pairs = np.column_stack((self.incidence.dof, self.incidence.segment))
        return bodies, offsets, pairs, self.incidence.sign

    def hessian(
        self, jacobian: np.ndarray, rotations: np.ndarray, translations: np.ndarray
    ) -> np.ndarray:
        """Gradients of the moment arms, ∂²ℓ/∂q² (nt, nv, nv).

        For a segment of length s, with ΔJ the difference of its ends' Jacobians,
        ΔJᵀ(I - ddᵀ)ΔJ / s plus ±d · ∂J/∂q at each end; joint j moves the column J_k of a more
        distal joint k as a rigid vector, ∂J_k/∂q_j = ω_j × J_k, symmetric in j and k.
        """
        nt, nv = self.coefficients.shape
        result = np.zeros((nt, nv, nv))
        if not self.spatial:
            return result
        start, direction, norms = self.directions(rotations, translations)
        end = start + direction * norms[:, None]
        linear, angular = jacobian[:3], jacobian[3:]
        distal = np.triu(np.ones((nv, nv), bool))
        for s, t in enumerate(self.segment_tendon):
            difference = np.zeros((3, nv))
            for body, point, sign in (
                (self.start.body[s], start[s], -1.0),
                (self.end.body[s], end[s], 1.0),
            ):
                moves = self.supports[:, body]
                columns = (linear + np.cross(angular, point, axisa=0, axisc=0)) * moves
                difference += sign * columns
                turned = angular.T @ np.cross(columns, direction[s], axisa=0, axisc=0)
                upper = np.where(distal, turned * moves[:, None], 0.0)
                result[t] += sign * (upper + np.triu(upper, 1).T)
            across = difference - np.outer(direction[s], direction[s] @ difference)
            result[t] += difference.T @ across / max(norms[s], np.finfo(float).tiny)
        return result


@compiled
def moment_arms(arms, lengths, S, rotations, translations, bodies, offsets, pairs, signs):
    """Add the spatial tendons' moment arms to `arms` (nt, nv) and lengths to `lengths` (nt,).

    `Tendons.moment_arms` segment by segment and pair by pair.

    Parameters
    ----------
    S : (nv, 6) joint Jacobian columns (v; ω) about the world's origin, as rows.
    rotations, translations : (bodies, 3, 3), (bodies, 3).
    bodies : (ns, 3) body of the start and of the end of each segment, and its tendon.
    offsets : (ns, 6) its start and its end in their bodies' frames.
    pairs, signs : (pairs, 2), (pairs,) a degree of freedom, a segment that it changes, and how.
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
            d[x] /= max(length, 2.2250738585072014e-308)  # a segment shrunk to a point
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


def _anchors(points: list[tuple[int, np.ndarray]]) -> Anchors:
    return Anchors(
        np.array([body for body, _ in points], int),
        np.array([offset for _, offset in points], float).reshape(-1, 3),
    )


def compile_tendons(
    tendons: tuple[Tendon, ...],
    dof: dict[str, int],
    anchor: Callable[[str, np.ndarray], tuple[int, np.ndarray]],
    supports: np.ndarray,
) -> Tendons:
    """Turn the description into arrays.

    Parameters
    ----------
    tendons : as parsed.
    dof : index in v of each moving joint.
    anchor : (link, xyz) → (body index, offset (3,) in the body's frame).
    supports : (nv, bodies) bool, whether a degree of freedom moves a body.
    """
    nt, nv = len(tendons), supports.shape[0]
    coefficients, offset = np.zeros((nt, nv)), np.zeros(nt)
    owner: list[int] = []
    starts: list[tuple[int, np.ndarray]] = []
    ends: list[tuple[int, np.ndarray]] = []
    for t, tendon in enumerate(tendons):
        for term in tendon.terms:
            coefficients[t, dof[term.joint]] = term.coef
        for a, b in pairwise(anchor(site.link, site.xyz) for site in tendon.sites):
            if a[0] == b[0]:
                offset[t] += np.linalg.norm(b[1] - a[1])
            else:
                owner.append(t)
                starts.append(a)
                ends.append(b)
    start, end = _anchors(starts), _anchors(ends)
    segment_tendon = np.array(owner, int)
    sign = supports[:, end.body].astype(float) - supports[:, start.body]
    dofs, segments = np.nonzero(sign)
    incidence = Incidence(
        dofs, segments, sign[dofs, segments], segment_tendon[segments] * nv + dofs
    )
    names = tuple(tendon.name for tendon in tendons)
    return Tendons(names, coefficients, offset, start, end, segment_tendon, incidence, supports)
