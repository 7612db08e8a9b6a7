"""Pairs of joints of two files: by name, by like names, by kinematics.

Names come first. The remaining joints are matched along the tree, among children of matched parts.
Their cost depends only on what a moved zero or a turned base cannot change: angle and distance of
consecutive axes, size of the subtree. The assignment with the least cost is taken, without
implausible pairs.
"""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from softdyn.exceptions import InputError
from softdyn.validation.mjcf.comparison.neutral import WORLD, Frame, Neutral, Part
from softdyn.validation.mjcf.transform import Transform

PLAUSIBLE = 0.6  # the largest cost of a plausible pair
NOISE_WORDS = ("joint", "jnt", "link", "dof")


@dataclass(frozen=True)
class Match:
    """Pairs of parts (index in A, index in B), parents first, and how each was found."""

    pairs: tuple[tuple[int, int], ...]
    how: dict[int, str]


def match(a: Neutral, b: Neutral, given: dict[str, str] | None = None) -> Match:
    """Pair the joints of two robots.

    Parameters
    ----------
    a, b : Neutral
        The robots.
    given : dict[str, str] or None
        Given pairs, joints of A → joints of B; the others are matched as usual.

    Raises
    ------
    InputError
        A name in `given` is unknown, or its pairs contradict the trees.
    """
    found: dict[int, int] = {}
    how: dict[int, str] = {}
    _add(found, how, _decreed(a, b, given or {}), "map")
    _add(found, how, _free(a, b), "base")
    for keys, word in (((str, str), "name"), ((plain_name, plain_name), "like name"),
                       ((_without_prefix(a), _without_prefix(b)), "like name")):  # fmt: skip
        _add(found, how, _by(keys, a, b, found), word)
    dropped = _contradictions(a, b, found)
    if any(how[k] == "map" for k in dropped):
        names = ", ".join(a.parts[k].name for k in dropped if how[k] == "map")
        raise InputError("map", "pairs of joints in the same order along both trees", names)
    for k in dropped:
        del found[k], how[k]
    _add(found, how, _by_kinematics(a, b, found), "kinematics")
    for k in _contradictions(a, b, found):
        del found[k], how[k]
    return Match(tuple(sorted(found.items())), how)


def _add(
    found: dict[int, int], how: dict[int, str], pairs: Iterable[tuple[int, int]], word: str
) -> None:
    for i, j in pairs:
        if i not in found and j not in found.values():
            found[i], how[i] = j, word


def _decreed(a: Neutral, b: Neutral, given: dict[str, str]) -> list[tuple[int, int]]:
    places = [{part.name: k for k, part in enumerate(robot.parts)} for robot in (a, b)]
    pairs = []
    for names in given.items():
        for name, place, robot in zip(names, places, (a, b), strict=True):
            if name not in place:
                raise InputError("map", f"a joint of {robot.path.name}", repr(name))
        i, j = (place[name] for name, place in zip(names, places, strict=True))
        if a.parts[i].kind != b.parts[j].kind:
            got = f"a {a.parts[i].kind} and a {b.parts[j].kind}: {names[0]} = {names[1]}"
            raise InputError("map", "two joints of one kind", got)
        pairs.append((i, j))
    if len({j for _, j in pairs}) < len(pairs):
        raise InputError("map", "each joint once", given)
    return pairs


def _free(a: Neutral, b: Neutral) -> list[tuple[int, int]]:
    """The free bases that carry the most parts."""
    bases = []
    for robot in (a, b):
        free = [k for k, part in enumerate(robot.parts) if part.kind == "free"]
        if not free:
            return []
        bases.append(max(free, key=lambda k, robot=robot: len(robot.subtree(k))))  # type: ignore[misc]
    return [(bases[0], bases[1])]


def plain_name(name: str) -> str:
    """A name without case, punctuation and generic words."""
    words = re.findall(r"[a-z]+|\d+", re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower())
    return " ".join(word for word in words if word not in NOISE_WORDS) or name


def with_links_of(robot: Neutral, other: Neutral) -> Neutral:
    """Each part with the link that the other robot's part names, if that is among its frames.

    In a URDF, a body whose frame does not lie on its joint is a link fixed to the one that moves.
    Both robots have the same joints in one order.
    """
    parts, frames = list(robot.parts), dict(robot.frames)
    for k, (part, theirs) in enumerate(zip(robot.parts, other.parts, strict=True)):
        if not theirs.link or part.link == theirs.link or part.kind == "free":
            continue
        own = [name for name, frame in frames.items() if frame.part == k]
        held = [name for name in own if name == theirs.link]
        if plain_name(part.link) != plain_name(theirs.link):
            held += [name for name in own if plain_name(name) == plain_name(theirs.link)]
        if held:
            name = held[0]
            parts[k] = replace(part, link=name, pose=frames.pop(name).pose)
            if part.link:
                frames[part.link] = Frame(k, part.pose, of_joint=True)
    return replace(robot, parts=tuple(parts), frames=frames)


def _without_prefix(robot: Neutral) -> Callable[[str], str]:
    """`plain_name` without the words with which most names of a robot begin."""
    names = [plain_name(part.name).split() for part in robot.parts]
    heads = Counter(words[0] for words in names if len(words) > 1)
    head, count = heads.most_common(1)[0] if heads else ("", 0)

    def key(name: str) -> str:
        words = plain_name(name).split()
        if words[0] == head and len(words) > 1 and 2 * count > len(names):
            words = words[1:]
        return " ".join(words)

    return key


def _by(
    keys: tuple[Callable[[str], str], ...], a: Neutral, b: Neutral, found: dict[int, int]
) -> list[tuple[int, int]]:
    """Pairs whose names have the same key, if no other joint has it."""
    tables = []
    for robot, taken, key in ((a, set(found), keys[0]), (b, set(found.values()), keys[1])):
        table: dict[str, list[int]] = {}
        for k, part in enumerate(robot.parts):
            if k not in taken:
                table.setdefault(key(part.name), []).append(k)
        tables.append({name: ks[0] for name, ks in table.items() if len(ks) == 1})
    return [
        (i, tables[1][name])
        for name, i in tables[0].items()
        if name in tables[1] and a.parts[i].kind == b.parts[tables[1][name]].kind
    ]


def _contradictions(a: Neutral, b: Neutral, found: dict[int, int]) -> list[int]:
    """Matched parts whose nearest matched carriers are not matched."""

    def carrier(robot: Neutral, k: int, matched: set[int]) -> int:
        k = robot.parts[k].parent
        while k != WORLD and k not in matched:
            k = robot.parts[k].parent
        return k

    wrong: list[int] = []
    good = dict(found)
    for i in sorted(found):
        above = carrier(a, i, set(good))
        if good.get(above, WORLD) != carrier(b, found[i], set(good.values())):
            wrong.append(i)
            del good[i]
    return wrong


def _by_kinematics(a: Neutral, b: Neutral, found: dict[int, int]) -> list[tuple[int, int]]:
    if not (a.parts and b.parts):
        return []
    # align matched parts, or else the parts that the roots carry, in any orientation
    known = [*found.items()] or [(WORLD, WORLD)]
    ours, theirs = (
        np.mean([p for k in ks for p in _anchors(robot, k)], axis=0)
        for robot, ks in zip((a, b), zip(*known, strict=True), strict=True)
    )
    best: tuple[float, dict[int, int]] = (np.inf, {})
    for turn in [np.eye(3)] if found else _turns():
        pairs, cost = _walk(a, b, found, Transform(turn, theirs - turn @ ours))
        cost -= 10 * PLAUSIBLE * len(pairs)
        if cost < best[0] - 1e-9:
            best = cost, pairs
    pairs = best[1]
    # most of a robot must fit; otherwise it is another robot that also has hinges
    if not found and 2 * len(pairs) < min(len(a.parts), len(b.parts)):
        return []
    return list(pairs.items())


def _anchors(robot: Neutral, k: int) -> list[np.ndarray]:
    """The point of a joint, or the points of all joints that the root carries."""
    return [robot.parts[m].point for m in (robot.children(k) if k == WORLD else [k])]


def _turns() -> list[np.ndarray]:
    """The 24 rotations of a cube, the identity first."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.linalg.det(matrix) > 0:
                found.append(matrix)
    return sorted(found, key=lambda matrix: -np.trace(matrix))


def _walk(
    a: Neutral, b: Neutral, found: dict[int, int], place: Transform
) -> tuple[dict[int, int], float]:
    """Pairs of children of pairs, root to leaf, and their cost."""
    matched = {WORLD: WORLD} | found
    pairs: dict[int, int] = {}
    total = 0.0
    size = max(a.size, b.size)
    for i in (WORLD, *range(len(a.parts))):
        if i not in matched:
            continue
        left = [k for k in a.children(i) if k not in matched]
        right = [k for k in b.children(matched[i]) if k not in matched.values()]
        if not left or not right:
            continue
        costs = np.array([[_cost(a, b, k, m, place, size) for m in right] for k in left])
        for row, column in zip(*linear_sum_assignment(costs), strict=True):
            if costs[row, column] < PLAUSIBLE:
                matched[left[row]] = pairs[left[row]] = right[column]
                total += costs[row, column]
    return pairs, total


def _cost(a: Neutral, b: Neutral, i: int, j: int, place: Transform, size: float) -> float:
    """Dissimilarity of two parts: 0 for equal ones, more than `PLAUSIBLE` for impossible pairs."""
    one, other = a.parts[i], b.parts[j]
    if one.kind != other.kind:
        return 10.0
    cost = 0.3 * abs(np.log(len(a.subtree(i)) / len(b.subtree(j))))
    if one.parent != WORLD and other.parent != WORLD:
        first = _relation(a.parts[one.parent], one)
        second = _relation(b.parts[other.parent], other)
        cost += abs(first[0] - second[0]) + abs(first[1] - second[1]) / size
    mass = [sum(r.parts[k].inertia.mass for k in r.subtree(m)) for r, m in ((a, i), (b, j))]
    cost += 0.2 * min(1.0, abs(np.log((mass[0] + 1e-9) / (mass[1] + 1e-9))))
    # its place, as far as it is independent of zeros and a displaced base
    cost += 0.3 * float(np.linalg.norm(place.at(one.point) - other.point)) / size
    return float(cost + 0.3 * _angle(place.rotation @ one.axis, other.axis))


def _relation(above: Part, part: Part) -> tuple[float, float]:
    """Angle (rad) and distance (m) of two consecutive axes, which no zero can change."""
    if above.kind not in ("hinge", "slide") or part.kind not in ("hinge", "slide"):
        return 0.0, 0.0
    normal = np.cross(above.axis, part.axis)
    gap = part.point - above.point
    sine = float(np.linalg.norm(normal))
    if "slide" in (above.kind, part.kind):
        distance = 0.0
    elif sine > 1e-6:
        distance = abs(float(gap @ normal)) / sine
    else:
        distance = float(np.linalg.norm(np.cross(gap, above.axis)))
    return _angle(above.axis, part.axis), distance


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    """Angle of two lines (rad), independent of their senses."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), abs(float(a @ b))))


def reduce(a: Neutral, b: Neutral, found: Match) -> tuple[Neutral, Neutral]:
    """Both robots with the matched joints only, in A's order and by A's names.

    If only one file has a joint, the part that it moves is left out or welded to its carrier,
    whichever makes the carrier's masses more similar. Parts between matched joints are welded.
    """
    order = [i for i, _ in found.pairs]
    other = [j for _, j in found.pairs]
    names = {b.parts[j].name: a.parts[i].name for i, j in found.pairs}
    welded = [_between(a, order), _between(b, other)]
    for side, (robot, kept) in enumerate(((a, order), (b, other))):
        for k, part in enumerate(robot.parts):
            loose = k not in kept and k not in welded[side]
            if not loose or (part.parent != WORLD and part.parent not in [*kept, *welded[side]]):
                continue
            beyond = set(robot.subtree(k))
            gaps = []
            for choice in (welded[side], welded[side] | beyond):
                masses = [
                    [part.inertia.mass for part in r.arranged(ks, weld).parts]
                    for r, ks, weld in (
                        (a, order, choice if side == 0 else welded[0]),
                        (b, other, choice if side == 1 else welded[1]),
                    )
                ]
                gaps.append(float(np.abs(np.array(masses[0]) - np.array(masses[1])).sum()))
            if gaps[1] < gaps[0]:
                welded[side] |= beyond
    return a.arranged(order, welded[0]), b.arranged(other, welded[1]).renamed(names)


def _between(robot: Neutral, kept: list[int]) -> set[int]:
    """Parts that are not kept, but carry some that are."""
    found: set[int] = set()
    for k in kept:
        above = robot.parts[k].parent
        while above != WORLD:
            if above not in kept:
                found.add(above)
            above = robot.parts[above].parent
    return found
