"""Displacements of B's parts relative to A's at zero: the explanation with the fewest digits.

A joint's displacement moves all parts that it carries. So a chain of displacements explains the
differences in both files: axes, centres, tensors, frames, points of cables. An error may be
rounding or centimetres. Therefore it counts by its decimal digits above `GRAIN`, and so does each
displacement. The explanation with the fewest digits is chosen. The search goes from the root
outward and follows `BEAM` explanations at once. `GRAIN` is the tolerance for every kind of error.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product
from typing import Any

import numpy as np

from softdyn.validation.mjcf.comparison.matching import plain_name
from softdyn.validation.mjcf.comparison.neutral import WORLD, Neutral, Part
from softdyn.validation.mjcf.transform import Transform, cross, skew

GRAIN = 1e-9  # m, rad, relative: smaller errors are rounding
BEAM = 4  # on public pairs, 12 find the same
# digits that a moved zero costs in addition to its number; a pose or a base costs twice that
CAUSE = 0.5
SPOILED = 10.0  # times the distance: a feature beyond the joint that fits worse by less is free
LINK = 1.25  # weight of a link's origin, which both formats place at the joint
BEGINS = 4.0  # largest number of digits for a link's place on its hinge's axis, which is convention
PARALLEL = 1e-3  # sine of the angle below which two axes count as parallel
HINGED = ("hinge", "slide")
Pair = tuple[np.ndarray, np.ndarray]


def find_displacements(a: Neutral, b: Neutral) -> dict[int, Transform]:
    """For each part of A, and `WORLD`, the displacement that takes it to its place in B."""
    stories, left = [_Story(0.0, {})], _tree(a, b, WORLD)
    order = [left, *left.beyond]
    for at, joint in enumerate(order):
        visited = order[: at + 1]
        needed = [one.k for one in visited if any(below not in visited for below in one.below)]
        stories = joint.extend(stories, needed)
    return stories[0].places


def _tree(a: Neutral, b: Neutral, k: int) -> _Joint:
    return _Joint(a, b, k, tuple(_tree(a, b, child) for child in a.children(k)))


# -- screws, one or a stack of them ----------------------------------------------------------------


def displaced(part: Part, by: Transform) -> Part:
    """A part of which only the axis is displaced."""
    return replace(part, axis=(by.rotation @ part.axis), point=by.at(part.point))


def line_error(one: Part, other: Part) -> tuple[Any, Any, Any]:
    """Angle (rad) between two axes, whether their senses are opposite, and their distance (m)."""
    angle: Any = np.zeros(one.axis.shape[:-1])
    opposite: Any = angle > 0
    if one.kind in HINGED:
        sine = _norm(cross(one.axis, other.axis))
        cosine = one.axis @ other.axis
        angle, opposite = np.arctan2(sine, np.abs(cosine)), cosine < 0
    gap = other.point - one.point
    if one.kind == "hinge":
        gap = cross(gap, one.axis)
    return angle, opposite, _norm(gap) * (one.kind in ("hinge", "ball"))


def split(one: Part, other: Part, step: Transform) -> tuple[Transform, Any, Transform, Any]:
    """Split a displacement into a rest and then a twist along B's joint; `one` has A's axis.

    Returns
    -------
    twist : Transform
    amount : float
        The joint coordinate of the twist (rad, m).
    rest : Transform
    along : bool
        Whether the rest moves the joint's own axis, too.
    """
    if other.kind == "slide":
        amount = (step.at(one.point) - one.point) @ other.axis
        twist = _shift(amount[..., None] * other.axis)
    elif other.kind == "hinge":
        # the turn about the axis that is closest to the whole rotation
        trace = np.einsum("...ii->...", step.rotation)
        cosine = trace - (step.rotation @ other.axis) @ other.axis
        amount = np.arctan2(step.turn @ other.axis, cosine)
        twist = _turn(other, amount)
    else:
        amount = step.angle
        turned = (step.rotation @ other.point[..., None])[..., 0]
        twist = Transform(step.rotation, other.point - turned)
    rest = twist.inverse @ step
    stays, goes = (_line_digits(part, other) for part in (one, displaced(one, rest)))
    return twist, amount, rest, goes < stays


def _turn(part: Part, angle: Any) -> Transform:
    """A turn about a hinge's axis."""
    K, angle = skew(part.axis), np.asarray(angle)[..., None, None]
    turn = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    return Transform(turn, part.point - turn @ part.point)


def _shift(by: np.ndarray) -> Transform:
    return Transform(np.broadcast_to(np.eye(3), (*by.shape, 3)), by)


def _onto(one: Part, other: Part) -> Transform:
    """The smallest displacement that takes one axis onto another, in either sense."""
    turn, gap = np.eye(3), other.point - one.point
    if one.kind in HINGED:
        axis = other.axis if one.axis @ other.axis >= 0 else -other.axis
        K = skew(cross(one.axis, axis))
        turn = turn + K + K @ K / (1 + one.axis @ axis)
        gap = gap - (gap @ axis) * axis
    return Transform(turn, one.point + gap * (one.kind != "slide") - turn @ one.point)


def _norm(values: np.ndarray) -> Any:
    return np.linalg.norm(values, axis=-1)


def digits(error: Any) -> Any:
    """Decimal digits of errors (m, rad, relative) above `GRAIN`."""
    return np.log10(1.0 + error / GRAIN)


def _line_digits(one: Part, other: Part) -> Any:
    """Digits between two axes: the tilt and its direction; a reversed one is half a turn away."""
    angle, opposite, gap = line_error(one, other)
    return 2 * digits(angle) + digits(gap) + opposite * digits(np.pi)


def _move_digits(move: Transform, point: np.ndarray) -> Any:
    """Digits of a displacement: its angle and the direction of its axis, and a point's way."""
    return 2 * digits(move.angle) + digits(_norm(move.at(point) - point))


# -- the search ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Story:
    """A partial explanation: its digits, and the places of A's parts."""

    cost: float
    places: dict[int, Transform]


@dataclass(frozen=True, eq=False)
class _Joint:
    """One joint of both robots, or the root, with the features that it carries in both files."""

    a: Neutral
    b: Neutral
    k: int
    below: tuple[_Joint, ...]

    def extend(self, stories: list[_Story], needed: list[int]) -> list[_Story]:
        """Extend the best explanations by this joint; `needed` are the places still in use."""
        found: list[tuple[float, _Story]] = []
        for story in stories:
            carrier = Transform() if self.k == WORLD else story.places[self.one.parent]
            places = self._candidates(carrier)
            costs = story.cost + self._step_digits(carrier, places) + self._misfit(places)
            ahead = costs + sum(joint.line_digits(places) for joint in self.below)
            for m in np.argsort(ahead, kind="stable")[:BEAM]:
                place = Transform(places.rotation[m], places.translation[m])
                found.append((ahead[m], _Story(costs[m], story.places | {self.k: place})))
        best: dict[bytes, _Story] = {}
        for _, story in sorted(found, key=lambda pair: pair[0]):
            key = b"".join(_rounded(story.places[p]).tobytes() for p in needed)
            best.setdefault(key, story)
        return list(best.values())[:BEAM]

    @property
    def one(self) -> Part:
        """A's part."""
        return self.a.parts[self.k]

    @property
    def other(self) -> Part:
        """B's part."""
        return self.b.parts[self.k]

    @property
    def is_base(self) -> bool:
        """Whether it is a base: the fixed root, or a free base."""
        return self.k == WORLD or self.one.kind == "free"

    @property
    def has_link(self) -> bool:
        """Whether both files name the link that the joint moves."""
        return self.k != WORLD and bool(self.one.link and self.other.link)

    @cached_property
    def beyond(self) -> list[_Joint]:
        """All joints beyond it, depth first."""
        return [found for joint in self.below for found in (joint, *joint.beyond)]

    # -- what both files show ----------------------------------------------------------------------

    @cached_property
    def frames(self) -> list[tuple[Transform, Transform]]:
        """The link's own frames, then those of the same names."""
        theirs = {plain_name(name): f.pose for name, f in self.b.frames.items() if f.part == self.k}
        found = [(self.one.pose, self.other.pose)] if self.has_link else []
        return found + [
            (f.pose, theirs[plain_name(name)])
            for name, f in self.a.frames.items()
            if f.part == self.k and plain_name(name) in theirs
        ]

    @cached_property
    def points(self) -> list[Pair]:
        """Origins of the frames, points of cables of the same name, centres of mass."""
        found = [(p.translation, q.translation) for p, q in self.frames]
        theirs = {(cable.name, cable.shapes): cable.path for cable in self.b.cables}
        for cable in self.a.cables:
            pairs = zip(cable.path, theirs.get((cable.name, cable.shapes), ()), strict=False)
            found += [(p.xyz, q.xyz) for p, q in pairs if p.part == q.part == self.k]
        if self.k != WORLD and self.one.inertia.mass and self.other.inertia.mass:
            found.append((self.one.inertia.com, self.other.inertia.com))
        return found

    @cached_property
    def tensors(self) -> list[Pair]:
        """The bodies' tensors, if neither is a point."""
        if self.k == WORLD:
            return []
        one, other = self.one.inertia.tensor, self.other.inertia.tensor
        return [(one, other)] if one.any() and other.any() else []

    @cached_property
    def principal(self) -> list[tuple[Transform, Transform]]:
        """The bodies' principal frames, in the four ways in which they may be paired."""
        found = []
        for tensors in self.tensors:
            axes = [np.linalg.eigh(tensor)[1] for tensor in tensors]
            ours, theirs = (turn * np.sign(np.linalg.det(turn)) for turn in axes)
            for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
                first = Transform(ours * np.array(signs), self.one.inertia.com)
                found.append((first, Transform(theirs, self.other.inertia.com)))
        return found

    # -- digits ------------------------------------------------------------------------------------

    def line_digits(self, carriers: Transform) -> Any:
        """Digits between B's axis and A's, carried along."""
        return _line_digits(displaced(self.one, carriers), self.other)

    def _step_digits(self, carrier: Transform, places: Transform) -> np.ndarray:
        """Digits of the joint's own displacements and of its axis; the first one is zero."""
        steps = places @ carrier.inverse
        if self.is_base:
            zeros = _stack([carrier])
            found = digits(steps.angle) + digits(_norm(steps.translation)) + 2 * CAUSE
        else:
            one = displaced(self.one, carrier)
            twist, amount, rest, along = split(one, self.other, steps)
            zeros = twist @ carrier
            as_zero = digits(np.abs(amount)) + _move_digits(rest, one.point) + CAUSE
            found = np.minimum(as_zero, _move_digits(steps, one.point) + 2 * CAUSE)
            goes, stays = (_line_digits(p, self.other) for p in (displaced(one, rest), one))
            found += np.where(along, goes, stays)
        found[0] = 0.0 if self.is_base else stays
        return found + self._spoiled(zeros, places)

    def _spoiled(self, zeros: Transform, places: Transform) -> Any:
        """Digits of the features beyond it that fit worse than if only the joint's zero moved.

        Worse means more than `SPOILED` times the distance, because rounding adds up along a chain.
        """
        before, after = (
            [joint.line_digits(place) for joint in self.beyond]
            + [digits(_norm(place.at(p) - q)) for joint in self.beyond for p, q in joint.points]
            for place in (zeros, places)
        )
        gaps = (now - then for then, now in zip(before, after, strict=True))
        return sum(np.maximum(0.0, gap - np.log10(SPOILED)) for gap in gaps)

    def _misfit(self, places: Transform) -> np.ndarray:
        """Digits of the remaining errors between the features of both."""
        found = np.zeros(len(places.translation))
        for m, (p, q) in enumerate(self.points):
            gap = places.at(p) - q
            link = m == 0 and self.has_link
            if link and self.one.kind == "hinge":
                along = gap @ self.other.axis
                found += np.minimum(LINK * digits(np.abs(along)), BEGINS)
                gap = gap - along[:, None] * self.other.axis
            found += (LINK if link else 1.0) * digits(_norm(gap))
        for frame, other in self.frames:
            gap = (places.rotation @ frame.rotation - other.rotation).reshape(-1, 9)
            found += digits(_norm(gap) / np.sqrt(2))
        for p, q in self.tensors:
            gap = (places.rotation @ p @ places.rotation.swapaxes(-1, -2) - q).reshape(-1, 9)
            found += digits(_norm(gap) / np.linalg.norm(p))
        return found

    # -- candidates --------------------------------------------------------------------------------

    def _candidates(self, carrier: Transform) -> Transform:
        """Distinct places that make some feature coincide, the carrier's own first."""
        frames = self.frames + self.principal
        points = self.points + [pair for joint in self.below for pair in joint.points]
        if self.is_base:
            if any(joint.one.kind == "free" for joint in self.below):
                return _stack([carrier])
            frames += [pair for joint in self.below for pair in joint.frames + joint.principal]
            found = [carrier, *self._of_lines(), *(q @ p.inverse for p, q in frames)]
            bases = [carrier]
        else:
            points += [(joint.one.point, joint.other.point) for joint in self.below]
            one = displaced(self.one, carrier)
            bases = [carrier, _onto(one, self.other) @ carrier]
            placed = _stack([carrier, *(q @ p.inverse for p, q in frames)])
            twists, *_ = split(one, self.other, placed @ carrier.inverse)
            found = [placed, bases[1], twists @ carrier]
            found += [place for base in bases for place in self._twists(base, points)]
        for base in bases:
            found += [Transform(base.rotation, q - base.rotation @ p) for p, q in points]
        return _stack(found)

    def _twists(self, base: Transform, points: list[Pair]) -> list[Transform]:
        """Places along the joint at which a point, or the next axis, coincides."""
        axis, origin = self.other.axis, self.other.point
        pairs = [(base.at(p) - origin, q - origin) for p, q in points]
        for joint in self.below:
            if self.other.kind == "hinge" and joint.one.kind in HINGED:
                turned = base.rotation @ joint.one.axis
                pairs += [(turned, sense * joint.other.axis) for sense in (1.0, -1.0)]
        if not pairs or self.other.kind not in HINGED:
            return []
        p, q = (np.array(vectors) for vectors in zip(*pairs, strict=True))
        rise = _shift(((q - p) @ axis)[:, None] * axis)
        if self.other.kind == "slide":
            return [rise @ base]
        cosine = np.einsum("ij,ij->i", p, q) - (p @ axis) * (q @ axis)
        turned = _turn(self.other, np.arctan2(cross(p, q) @ axis, cosine)) @ base
        return [turned, rise @ turned]

    def _of_lines(self) -> Iterator[Transform]:
        """Displacements that take two of the next axes to B's, in either sense."""
        near = [found for joint in self.below for found in (joint, *joint.below)]
        lines = [joint for joint in near if joint.one.kind in HINGED]
        for first, second in combinations(lines[:3], 2):
            (p, q), (r, s) = (first.one, first.other), (second.one, second.other)
            for senses in product((1.0, -1.0), repeat=2):
                ours, theirs = (
                    _triad(p.axis, r.axis),
                    _triad(senses[0] * q.axis, senses[1] * s.axis),
                )
                turn = theirs @ ours.T
                yield Transform(turn, q.point - turn @ p.point)


def _triad(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Axes of two directions; of one where they are parallel."""
    normal = cross(first, second)
    if _norm(normal) < PARALLEL:
        normal = cross(first, np.eye(3)[np.argmin(np.abs(first))])
    normal = normal / _norm(normal)
    return np.column_stack((first, normal, cross(first, normal)))


def _stack(places: list[Transform]) -> Transform:
    """All places in one stack, without duplicates."""
    rotation = np.concatenate([place.rotation.reshape(-1, 3, 3) for place in places])
    translation = np.concatenate([place.translation.reshape(-1, 3) for place in places])
    whole = Transform(rotation, translation)
    _, first = np.unique(_rounded(whole), axis=0, return_index=True)
    first.sort()
    return Transform(rotation[first], translation[first])


def _rounded(place: Transform) -> np.ndarray:
    """The rounded numbers of places, by which they are compared."""
    shape = (*place.translation.shape[:-1], 9)
    numbers = np.concatenate((place.rotation.reshape(shape), place.translation), axis=-1)
    return np.round(numbers, 10) + 0.0
