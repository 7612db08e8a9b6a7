"""Pieces of cables around round bodies, as functions of a robot's configuration.

A piece runs from a site a around a body W to a site b. Its length depends on both points in W's
frame: see `softdyn.dynamics.wraps`. A joint that moves a but not W has the column c = v + ω × a, as
W sees it; one that moves W but not a has -c, and then also its rotation counts with the other sign.
With the gradients g and the Hessian H of the length by both points,

    ∂ℓ/∂q = Σ g · c,    ∂²ℓ/∂q_j ∂q_k = c_jᵀ H c_k + Σ g · (ω_j × c_k).

The sums are over both sites. The last term counts if both joints are between W and the same site,
and joint j is the one nearer to W, because it then carries the column c_k.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from softdyn.description.robot import Tendon
from softdyn.dynamics.wraps import Contact, Course, RoundBody, body_of, course

Anchor = Callable[[str, np.ndarray], tuple[int, np.ndarray]]


@dataclass(frozen=True, eq=False)
class WrappedPiece:
    """A cable's piece from one site to the next around a round body.

    Attributes
    ----------
    tendon, after : int
        The cable, and the index of the site before the body.
    body : RoundBody
        The round body.
    carrier : int
        The moving body that carries it.
    centre, axes : ndarray, (3,), (3, 3)
        Its frame in that of the carrier; the axes are columns.
    bodies : tuple of int
        The moving bodies that carry the two sites.
    sites : ndarray, (2, 3)
        The sites in the frames of their bodies.
    dofs, signs : tuple of ndarray, (k,)
        For each site the degrees of freedom that move it against the round body, those near the
        round body first, with 1 if they move the site and -1 if they move the round body.
    """

    tendon: int
    after: int
    body: RoundBody
    carrier: int
    centre: np.ndarray
    axes: np.ndarray
    bodies: tuple[int, int]
    sites: np.ndarray
    dofs: tuple[np.ndarray, np.ndarray]
    signs: tuple[np.ndarray, np.ndarray]

    def at(
        self, rotations: np.ndarray, translations: np.ndarray, *, bends: bool = False
    ) -> PlacedPiece:
        """The piece at the bodies' poses, with second derivatives if it `bends`."""
        rotation = rotations[self.carrier]
        axes, centre = rotation @ self.axes, rotation @ self.centre + translations[self.carrier]
        where = list(self.bodies)
        points = np.matmul(rotations[where], self.sites[:, :, None])[:, :, 0] + translations[where]
        a, b = (points - centre) @ axes
        return PlacedPiece(self, axes, centre, points, course(self.body, a, b, bends=bends))


@dataclass(frozen=True, eq=False)
class PlacedPiece:
    """A piece at one configuration.

    Attributes
    ----------
    piece : WrappedPiece
        The piece.
    axes, centre : ndarray, (3, 3), (3,)
        The round body's frame in the world; the axes are columns.
    points : ndarray, (2, 3)
        The sites in the world.
    course : Course
        The cable's course in the round body's frame.
    """

    piece: WrappedPiece
    axes: np.ndarray
    centre: np.ndarray
    points: np.ndarray
    course: Course

    @property
    def directions(self) -> np.ndarray:
        """Unit vectors (2, 3) in the world along the cable at the sites, away from the body."""
        return self.course.gradient @ self.axes.T

    def touches(self) -> np.ndarray:
        """The points (2, 3) in the world where the cable meets and leaves the body, if it does."""
        points = self.course.points
        return np.zeros((0, 3)) if points is None else points @ self.axes.T + self.centre

    def columns(self, S: np.ndarray, end: int) -> np.ndarray:
        """∂/∂q (k, 3) of a site's position in the round body's frame, over its `dofs`."""
        dofs, signs = self.piece.dofs[end], self.piece.signs[end]
        moved = S[dofs, :3] + S[dofs, 3:] @ _times(self.points[end])
        return (signs[:, None] * moved) @ self.axes

    def moment_arms(self, S: np.ndarray, end: int) -> np.ndarray:
        """The part of ∂ℓ/∂q (k,) by one of the sites, over its `dofs`."""
        along = self.axes @ self.course.gradient[end]
        wrench = np.concatenate((along, _times(self.points[end]) @ along))
        return self.piece.signs[end] * (S[self.piece.dofs[end]] @ wrench)

    def jacobian(self, S: np.ndarray) -> np.ndarray:
        """∂/∂q (6, nv) of both sites' positions in the round body's frame."""
        found = np.zeros((6, len(S)))
        for end in (0, 1):
            found[3 * end : 3 * end + 3, self.piece.dofs[end]] = self.columns(S, end).T
        return found

    def carried(self, S: np.ndarray, end: int, columns: np.ndarray) -> np.ndarray:
        """Σ g · ∂²x/∂q² (k, k) of a site's position x in the round body's frame.

        It is over the site's `dofs`; `columns` (3, k) is their part of the `jacobian`.
        """
        dofs, signs = self.piece.dofs[end], self.piece.signs[end]
        turning = (signs[:, None] * S[dofs, 3:]) @ self.axes
        values = turning @ (columns.T @ _times(self.course.gradient[end])).T
        nearer = np.arange(len(dofs))[:, None] <= np.arange(len(dofs))
        return np.where(nearer, values, values.T)

    def hessian(self, S: np.ndarray) -> np.ndarray:
        """∂²ℓ/∂q² (nv, nv)."""
        bend, columns = self.course.bend, self.jacobian(S)
        assert bend is not None
        found: np.ndarray = columns.T @ bend.hessian @ columns
        for end in (0, 1):
            rows, dofs = slice(3 * end, 3 * end + 3), self.piece.dofs[end]
            found[dofs[:, None], dofs] += self.carried(S, end, columns[rows, dofs])
        return found

    def arm_rates(self, S: np.ndarray, end: int) -> np.ndarray:
        """The gradient (nv, nv) of one site's part of ∂ℓ/∂q; of both it is the `hessian`."""
        bend, columns = self.course.bend, self.jacobian(S)
        assert bend is not None
        rows, dofs = slice(3 * end, 3 * end + 3), self.piece.dofs[end]
        found: np.ndarray = columns[rows].T @ bend.hessian[rows] @ columns
        found[dofs[:, None], dofs] += self.carried(S, end, columns[rows, dofs])
        return found

    def turn_gradient(self, S: np.ndarray) -> np.ndarray:
        """∂φ/∂q (nv,) of the turn at the body."""
        assert self.course.bend is not None
        return self.course.bend.turn @ self.jacobian(S)

    def direction_rates(self, S: np.ndarray, end: int, moves: np.ndarray) -> np.ndarray:
        """∂/∂q (nv, 3) of one of the `directions`; `moves` as for `compile_wraps`."""
        assert self.course.bend is not None
        rows = slice(3 * end, 3 * end + 3)
        own = (self.course.bend.hessian[rows] @ self.jacobian(S)).T @ self.axes.T
        turned = S[:, 3:] @ _times(self.directions[end])
        return own + moves[:, self.piece.carrier, None] * turned


@dataclass(frozen=True, eq=False)
class WrappedPaths:
    """All pieces of a robot's cables around round bodies; false if there are none.

    Attributes
    ----------
    pieces : tuple of WrappedPiece
        In the order of the tendons, and of the sites along each.
    """

    pieces: tuple[WrappedPiece, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.pieces)

    def at(
        self, rotations: np.ndarray, translations: np.ndarray, *, bends: bool = False
    ) -> Iterator[PlacedPiece]:
        """The pieces at the bodies' poses (bodies, 3, 3), (bodies, 3)."""
        for piece in self.pieces:
            yield piece.at(rotations, translations, bends=bends)

    def contacts(self, rotations: np.ndarray, translations: np.ndarray) -> tuple[Contact, ...]:
        """How each piece touches its body."""
        return tuple(placed.course.contact for placed in self.at(rotations, translations))

    def add_lengths(
        self, lengths: np.ndarray, rotations: np.ndarray, translations: np.ndarray
    ) -> None:
        """Add the pieces' lengths to those of the tendons (tendons,)."""
        for placed in self.at(rotations, translations):
            lengths[placed.piece.tendon] += placed.course.length

    def add_geometry(
        self,
        lengths: np.ndarray,
        arms: np.ndarray,
        S: np.ndarray,
        rotations: np.ndarray,
        translations: np.ndarray,
    ) -> None:
        """Add lengths to (tendons,) and moment arms to (tendons, nv).

        Parameters
        ----------
        lengths, arms : ndarray, (tendons,), (tendons, nv)
            They are changed.
        S : ndarray, (nv, 6)
            Joint Jacobian columns (v; ω) about the world's origin, as rows.
        rotations, translations : ndarray, (bodies, 3, 3), (bodies, 3)
            The bodies' poses.
        """
        for placed in self.at(rotations, translations):
            lengths[placed.piece.tendon] += placed.course.length
            for end in (0, 1):
                arms[placed.piece.tendon, placed.piece.dofs[end]] += placed.moment_arms(S, end)

    def add_curvature(
        self,
        total: np.ndarray,
        rates: np.ndarray,
        S: np.ndarray,
        rotations: np.ndarray,
        translations: np.ndarray,
        force: np.ndarray,
        v: np.ndarray,
    ) -> None:
        """Add to the two results of `softdyn.dynamics.tendons.Tendons.curvature`."""
        for placed in self.at(rotations, translations, bends=True):
            hessian = placed.hessian(S)
            total += force[placed.piece.tendon] * hessian
            rates[placed.piece.tendon] += hessian @ v

    def add_compliance(
        self,
        by_q: np.ndarray,
        force: np.ndarray,
        damping: np.ndarray,
        arms: np.ndarray,
        v: np.ndarray,
        S: np.ndarray,
        rotations: np.ndarray,
        translations: np.ndarray,
    ) -> None:
        """Add the curvature's part of ∂(-αᵀ f)/∂q, as `softdyn.dynamics.balance` states it."""
        bend, rates = np.zeros((len(S), len(S))), np.zeros(arms.shape)
        self.add_curvature(bend, rates, S, rotations, translations, force, v)
        by_q += arms.T @ (damping[:, None] * rates) - bend


def compile_wraps(tendons: tuple[Tendon, ...], anchor: Anchor, moves: np.ndarray) -> WrappedPaths:
    """The pieces around round bodies of described tendons.

    Parameters
    ----------
    tendons : tuple of Tendon
        As parsed.
    anchor : callable
        (link, xyz) → (body index, offset (3,) in the body's frame).
    moves : ndarray of bool, (nv, bodies)
        Whether a degree of freedom moves a body.
    """
    found = []
    for t, tendon in enumerate(tendons):
        for wrap in tendon.wraps:
            body, axes = body_of(wrap)
            carrier, centre = anchor(wrap.link, np.array(wrap.xyz))
            turned = [anchor(wrap.link, np.array(wrap.xyz) + axis)[1] - centre for axis in axes.T]
            ends = [anchor(s.link, np.array(s.xyz)) for s in tendon.sites[wrap.after :][:2]]
            (first, second), sites = zip(*ends, strict=True)
            between = [_between(moves, carrier, k) for k in (first, second)]
            (dofs, signs) = zip(*between, strict=True)
            found.append(
                WrappedPiece(
                    t, wrap.after, body, carrier, centre, np.array(turned).T, (first, second),
                    np.array(sites), dofs, signs,
                )
            )  # fmt: skip
    return WrappedPaths(tuple(found))


def _times(x: np.ndarray) -> np.ndarray:
    """The matrix X (3, 3) for which ω X is ω × x."""
    a, b, c = x.tolist()
    return np.array(((0.0, -c, b), (c, 0.0, -a), (-b, a, 0.0)))


def _between(moves: np.ndarray, start: int, end: int) -> tuple[np.ndarray, np.ndarray]:
    """Degrees of freedom between two bodies, from the first, and 1 if they move the second."""
    before = np.flatnonzero(moves[:, start] & ~moves[:, end])[::-1]
    behind = np.flatnonzero(moves[:, end] & ~moves[:, start])
    signs = np.concatenate((-np.ones(len(before)), np.ones(len(behind))))
    return np.concatenate((before, behind)), signs
