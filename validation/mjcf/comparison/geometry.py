"""Causes in the geometry: base, poses, zeros, axes.

From the root outward. At each joint the displacement is looked for that brings most of what the
joint carries together; it is then taken back for all beyond it, so that it is reported once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from softdyn.description.inertia import Inertia
from softdyn.validation.mjcf.comparison.bodies import find_body, vector
from softdyn.validation.mjcf.comparison.finding import Finding
from softdyn.validation.mjcf.comparison.matching import plain_name
from softdyn.validation.mjcf.comparison.neutral import WORLD, Neutral, Part, Transform
from softdyn.validation.mjcf.comparison.terms import rotations

CLOSE = 1e-4  # m, rad: what the votes on a displacement take for agreement
NOTHING = 1e-12  # m, rad
SHOWN = 1e-9  # m, rad: what less is, is rounding
DEPTH = 3  # how many joints further the votes look
Vote = tuple[
    float, Callable[[Transform], float]
]  # weight, and the error (m, rad) a displacement leaves


def find_geometry(a: Neutral, b: Neutral) -> tuple[list[Finding], Neutral]:
    """Findings, and B with all of them repaired; the robots have the same joints in one order."""
    found: list[Finding] = []

    def take(finding: Finding) -> None:
        nonlocal b
        found.append(finding)
        b = finding.repair(b)

    if a.parts and all(part.kind != "free" for part in a.parts):
        for finding in _base(a, b):
            take(finding)
    for k in range(len(a.parts)):
        for step in (_displacement, _axis):
            for finding in step(a, b, k):
                take(finding)
    for k in range(len(a.parts)):
        for finding in find_body(a, b, k):
            take(finding)
    return found, b


# -- displacements ---------------------------------------------------------------------------------


def _base(a: Neutral, b: Neutral) -> Iterator[Finding]:
    """How the fixed root of B stands against A's."""
    roots = a.children(WORLD)
    pairs = _frame_pairs(a, b, WORLD)
    own = [a.parts[k].pose for k in roots], [b.parts[k].pose for k in roots]
    candidates = [Transform(), *(_between(p, q) for p, q in [*pairs, *zip(*own, strict=True)])]
    frames = [_turn_error(p, q) for p, q in pairs]
    frames += [_pose_error(p, q) for p, q in _cable_points(a, b, WORLD)]
    carried: list[Vote] = []
    for k in roots:
        carried += [*_line_votes(a.parts[k], b.parts[k], 2.0), *_votes(a, b, k)]
    move = _elect(candidates, [*((1.0, error) for error in frames), *carried])
    # a base that moved takes some of the root's own frames along, and what the root carries
    if frames and min(error(move) for error in frames) > CLOSE:
        move = Transform()
    if not _is_some(_elect([move], carried)):
        move = Transform()
    if not frames and len(roots) == 1 and _zero_of(a.parts[roots[0]], move) is not None:
        move = Transform()  # it is the first joint's zero as well
    if _is_some(move):
        back = move.inverse
        yield Finding(
            "base", a.parts[roots[0]].name if not pairs else _root_name(a),
            (None, _numbers(move)), _described(move), lambda robot: robot.displaced(WORLD, back),
        )  # fmt: skip


def _root_name(a: Neutral) -> str:
    return next((name for name, frame in a.frames.items() if frame.part == WORLD), "world")


def _displacement(a: Neutral, b: Neutral, k: int) -> Iterator[Finding]:
    """How B's part k, and all that it carries, is displaced at zero."""
    one, other = a.parts[k], b.parts[k]
    votes = list(_votes(a, b, k))
    turns = [Transform()]
    solid = _first_solid(a, k)
    frames = _own_frames(a, b, k) or _own_frames(a, b, solid)
    moves = [_between(p, q) for p, q in frames]
    moves += [Transform(translation=q.translation - p.translation) for p, q in frames]
    if one.kind in ("hinge", "slide", "ball"):
        turns += _zeros(a, b, k)
    for child in a.children(k):
        turns += _zeros(a, b, k, child)
    bodies = a.parts[solid].inertia, b.parts[solid].inertia
    if all(body.mass for body in bodies):
        moves.append(Transform(translation=bodies[1].com - bodies[0].com))
    # a pose takes the joint's own axis along, a zero does not change it
    own = _line_votes(one, other, 1.5) if one.kind != "free" else []
    move = _elect([*turns, *moves], [*votes, *own])
    if not _is_some(move):
        return
    back = move.inverse
    amount = _zero_of(one, move)
    if one.kind == "free":
        yield Finding(
            "base", one.link or one.name, (None, _numbers(move)), _described(move),
            lambda robot: robot.displaced(k, back),
        )  # fmt: skip
    elif amount is not None:
        unit = "m" if one.kind == "slide" else "rad"
        yield Finding(
            "zero", one.name, (0.0, amount), f"moved {amount:+.6g} {unit}",
            lambda robot: robot.displaced(k, back, joint=False),
        )  # fmt: skip
    else:
        along = sum(error(move) for _, error in own) < 10 * CLOSE
        link = [_pose_error(p, q)(Transform()) for p, q in _own_frames(a, b, k)]
        bare = not link and solid != k and len(a.children(k)) == 1
        if not along and (bare or (link and max(link) < SHOWN)):
            return  # neither the axis nor the link moved: what it carries did
        yield Finding(
            "pose", one.name, (vector(one.point), vector(other.point)), _described(move),
            lambda robot: robot.displaced(k, back, joint=along),
        )  # fmt: skip


def _first_solid(a: Neutral, k: int) -> int:
    """The first part from k on that has a mass, as far as there are no branches."""
    while not a.parts[k].inertia.mass and len(below := a.children(k)) == 1:
        k = below[0]
    return k


def _axis(a: Neutral, b: Neutral, k: int) -> Iterator[Finding]:
    """How B's axis of part k lies against A's."""
    one, other = a.parts[k], b.parts[k]
    if one.kind == "free":
        return
    words: list[str] = []
    angle = 0.0
    if one.kind in ("hinge", "slide"):
        angle = math.atan2(
            float(np.linalg.norm(np.cross(one.axis, other.axis))), float(one.axis @ other.axis)
        )
        if angle > math.pi / 2:
            words.append("reversed")
            angle = math.pi - angle
        if angle > SHOWN:
            words.append(f"tilted {angle:.6g} rad")
    gap = _off_line(one, other.point)
    if gap > SHOWN:
        words.append(f"displaced {1e3 * gap:.6g} mm")
    if words or gap > NOTHING or angle > NOTHING:
        first, second = ([*vector(part.axis), *vector(part.point)] for part in (one, other))
        # a link whose origin lies on its joint moves with it
        tied = all(np.allclose(p.point, p.pose.translation, atol=SHOWN) for p in (one, other))
        yield Finding(
            "axis", one.name, (first, second), ", ".join(words),
            lambda robot: robot.with_part(
                k,
                replace(
                    robot.parts[k], axis=one.axis, point=one.point,
                    pose=one.pose if tied else robot.parts[k].pose,
                ),
            ),
            # a wheel that turns the other way changes neither M nor g, and matters
            1.0 if "reversed" in words else 0.0,
        )  # fmt: skip


def _off_line(part: Part, point: np.ndarray) -> float:
    """Distance (m) of a point from a hinge's axis, or a ball's centre; a slide's axis has none."""
    gap = point - part.point
    if part.kind == "hinge":
        gap = np.cross(gap, part.axis)
    return 0.0 if part.kind in ("slide", "free") else float(np.linalg.norm(gap))


def _zero_of(part: Part, move: Transform) -> float | None:
    """The joint coordinate that `move` is; None where it is not one of this joint."""
    if part.kind == "slide":
        amount = float(move.translation @ part.axis)
        rest = np.linalg.norm(move.translation - amount * part.axis) + move.angle
        return amount if rest < CLOSE else None
    if part.kind not in ("hinge", "ball") or _off_fixed(part, move) > CLOSE:
        return None
    skew = move.rotation - move.rotation.T
    vector = np.array([skew[2, 1], skew[0, 2], skew[1, 0]]) / 2
    if part.kind == "ball":
        return move.angle
    along = float(vector @ part.axis)
    turned = move.rotation @ part.axis - part.axis
    cosine = (float(np.trace(move.rotation)) - 1) / 2
    return math.atan2(along, cosine) if np.linalg.norm(turned) < CLOSE else None


def _off_fixed(part: Part, move: Transform) -> float:
    """How far (m) a displacement moves the joint's own point."""
    return float(np.linalg.norm(move.at(part.point) - part.point))


def _zeros(a: Neutral, b: Neutral, k: int, child: int | None = None) -> list[Transform]:
    """Displacements by joint k alone that bring one feature of what it carries together."""
    one = a.parts[k]
    pairs: list[tuple[np.ndarray, np.ndarray]] = []
    both = (a.parts[k], b.parts[k]) if child is None else (a.parts[child], b.parts[child])
    if child is not None:
        pairs.append((both[0].point, both[1].point))
    placed = _own_frames(a, b, k) + _cable_points(a, b, k)[:3]
    pairs += [(p.translation, q.translation) for p, q in placed]
    if all(part.inertia.mass for part in both):
        pairs.append((both[0].inertia.com, both[1].inertia.com))
    if one.kind == "slide":
        shifts = [float((q - p) @ one.axis) for p, q in pairs]
        return [Transform(translation=shift * one.axis) for shift in shifts]
    if one.kind != "hinge":
        return []
    directions = [(p - one.point, q - one.point) for p, q in pairs]
    poses = _own_frames(a, b, k)
    directions += [(p.rotation[:, i], q.rotation[:, i]) for p, q in poses for i in range(3)]
    if child is not None and both[0].kind in ("hinge", "slide"):
        directions += [(both[0].axis, both[1].axis), (both[0].axis, -both[1].axis)]
    found = []
    for p, q in directions:
        p, q = (v - (v @ one.axis) * one.axis for v in (p, q))
        if min(np.linalg.norm(p), np.linalg.norm(q)) > CLOSE:
            angle = math.atan2(float(np.cross(p, q) @ one.axis), float(p @ q))
            turn = rotations(angle * one.axis)
            found.append(Transform(turn, one.point - turn @ one.point))
    return found


def _elect(candidates: list[Transform], votes: list[Vote]) -> Transform:
    """The candidate with most votes; of equals the first, the identity before all."""

    def count(pose: Transform) -> float:
        return sum(weight / (1.0 + (error(pose) / CLOSE) ** 2) for weight, error in votes)

    best, most = Transform(), count(Transform()) + 0.3
    for pose in candidates:
        votes_for = count(pose)
        if votes_for > most + 1e-3:
            best, most = pose, votes_for
    return best


def _votes(a: Neutral, b: Neutral, k: int) -> Iterator[Vote]:
    """What part k carries: frames, centre, inertia, the next axes; those beyond count less."""
    weight, front = 1.0, [k]
    for _ in range(DEPTH):
        for m in front:
            one, other = a.parts[m], b.parts[m]
            for p, q in _own_frames(a, b, m) + _cable_points(a, b, m):
                yield weight, _pose_error(p, q)
            yield from _body_votes(one.inertia, other.inertia, weight)
            for child in a.children(m):
                yield from _line_votes(a.parts[child], b.parts[child], 2 * weight)
        weight /= 4
        front = [child for m in front for child in a.children(m)]


def _own_frames(a: Neutral, b: Neutral, k: int) -> list[tuple[Transform, Transform]]:
    """The link frames of part k, and at most three other frames of the same names."""
    one, other = a.parts[k], b.parts[k]
    own = [(one.pose, other.pose)] if one.link and other.link and one.kind != "free" else []
    return own + _frame_pairs(a, b, k)[:3]


def _frame_pairs(a: Neutral, b: Neutral, k: int) -> list[tuple[Transform, Transform]]:
    """Named frames of part k, or of the root, that both files have."""
    theirs = {plain_name(name): f.pose for name, f in b.frames.items() if f.part == k}
    return [
        (f.pose, theirs[plain_name(name)])
        for name, f in a.frames.items()
        if f.part == k and plain_name(name) in theirs
    ]


def _pose_error(p: Transform, q: Transform) -> Callable[[Transform], float]:
    # origins alone: how a frame is turned on its link is a convention that nothing depends on
    return lambda move: float(np.linalg.norm(move.at(p.translation) - q.translation))


def _turn_error(p: Transform, q: Transform) -> Callable[[Transform], float]:
    """As `_pose_error`, with the rotation: the root's frame is what its file says the base is."""
    origin = _pose_error(p, q)
    return lambda move: (
        origin(move) + float(np.linalg.norm(move.rotation @ p.rotation - q.rotation))
    )


def _cable_points(a: Neutral, b: Neutral, k: int) -> list[tuple[Transform, Transform]]:
    """Points of part k, or of the root, that cables of the same name run through."""
    theirs = {cable.name: cable.path for cable in b.cables}
    return [
        (Transform(translation=p.xyz), Transform(translation=q.xyz))
        for cable in a.cables
        for p, q in zip(cable.path, theirs.get(cable.name, ()), strict=False)
        if p.part == q.part == k
    ]


def _line_votes(one: Part, other: Part, weight: float) -> list[Vote]:
    if one.kind == "free":
        return []

    def error(move: Transform) -> float:
        axis = move.rotation @ one.axis
        moved = replace(one, axis=axis, point=move.at(one.point))
        return _off_line(moved, other.point) + float(np.linalg.norm(np.cross(axis, other.axis)))

    return [(weight, error)]


def _body_votes(one: Inertia, other: Inertia, weight: float) -> Iterator[Vote]:
    if not one.mass or not other.mass:
        return
    yield weight, lambda move: float(np.linalg.norm(move.at(one.com) - other.com))
    size = float(np.linalg.norm(one.tensor)) or 1.0
    if np.ptp(np.linalg.eigvalsh(one.tensor)) > 1e-3 * size:
        yield (
            weight,
            lambda move: float(
                np.linalg.norm(move.rotation @ one.tensor @ move.rotation.T - other.tensor) / size
            ),
        )


def _between(p: Transform, q: Transform) -> Transform:
    return q @ p.inverse


def _is_some(move: Transform) -> bool:
    return move.angle > NOTHING or float(np.linalg.norm(move.translation)) > NOTHING


def _described(move: Transform) -> str:
    """A displacement in words."""
    words = []
    if move.angle > SHOWN:
        words.append(f"turned {move.angle:.6g} rad")
    if (shift := float(np.linalg.norm(move.translation))) > SHOWN:
        words.append(f"moved {1e3 * shift:.6g} mm")
    return ", ".join(words)


def _numbers(move: Transform) -> list[float]:
    """Rotation, row by row, and translation."""
    return vector(np.concatenate((move.rotation.ravel(), move.translation)))
