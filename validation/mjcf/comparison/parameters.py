"""Causes in what is no geometry: armature, damping, friction, springs, limits, cables, inputs.

What stands at zero, or nowhere, in one file only is one-sided. A joint whose sense or zero differs
may have its limits, rest or coefficients written either way: both readings count as agreement.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from softdyn.validation.mjcf.comparison.bodies import vector
from softdyn.validation.mjcf.comparison.finding import Finding
from softdyn.validation.mjcf.comparison.matching import plain_name
from softdyn.validation.mjcf.comparison.neutral import Coupling, Motor, Neutral, NeutralTendon
from softdyn.validation.mjcf.comparison.terms import States, lengths

SAME = 1e-6  # relative
LIMITS = 1e-4  # rad, m: limits are rounded in most files
FRAMES = 1e-6  # m
NOTHING = 1e-12  # m
ONLY = "only in one file"
SCALARS = ("armature", "damping", "friction", "stiffness")
Named = TypeVar("Named", NeutralTendon, Motor)
Turns = dict[str, tuple[float, float]]  # by joint: sense and zero, q_A = sense · q_B + zero


def find_parameters(a: Neutral, b: Neutral, turns: Turns, states: States) -> Iterator[Finding]:
    """Findings on two robots whose geometry and bodies agree; each repair stands alone."""
    followers = {coupling.joint for robot in (a, b) for coupling in robot.couplings}
    for k, part in enumerate(a.parts):
        found = _joint(a, b, k, turns.get(part.name, (1.0, 0.0)))
        # a follower goes where its leader lets it: its own limits are not used
        yield from (f for f in found if f.kind != "limit" or part.name not in followers)
    yield from _gravity(a, b)
    yield from _frames(a, b)
    yield from _cables(a, b, turns, states)
    yield from _motors(a, b, turns)
    yield from _couplings(a, b, turns)


def differ(a: float, b: float) -> float:
    """Relative difference of two values, 0 for two that are the same."""
    if a == b:
        return 0.0
    size = max(abs(a), abs(b))
    return abs(a - b) / size if math.isfinite(size) else 1.0


def _set(k: int, **values: Any) -> Callable[[Neutral], Neutral]:
    return lambda robot: robot.with_part(k, replace(robot.parts[k], **values))


def _joint(a: Neutral, b: Neutral, k: int, turn: tuple[float, float]) -> Iterator[Finding]:
    one, other = a.parts[k], b.parts[k]
    sense, zero = turn
    for name in SCALARS:
        p, q = getattr(one, name), getattr(other, name)
        if (size := differ(p, q)) > SAME:
            detail = f"{100 * (q / p - 1):+.3g} %" if p and q else "none in one file"
            yield Finding(name, one.name, (p, q), detail, _set(k, **{name: p}), size, not (p and q))
    both = one.stiffness > 0 and other.stiffness > 0
    if both and not _near(one.rest, (other.rest, sense * other.rest, sense * other.rest + zero)):
        yield Finding("rest", one.name, (one.rest, other.rest), "", _set(k, rest=one.rest), 1.0)
    ours, theirs = [one.lower, one.upper], [other.lower, other.upper]
    readings = [theirs, sorted(sense * v for v in theirs), sorted(sense * v + zero for v in theirs)]
    if not any(_near(ours[0], (r[0],)) and _near(ours[1], (r[1],)) for r in readings):
        values = _stated(ours), _stated(theirs)
        size = max(differ(p, q) for p, q in zip(ours, theirs, strict=True))
        yield Finding(
            "limit", one.name, values, "", _set(k, lower=one.lower, upper=one.upper), size,
            None in values,
        )  # fmt: skip
    if (size := differ(one.effort, other.effort)) > SAME:
        efforts = _finite(one.effort), _finite(other.effort)
        yield Finding(
            "effort", one.name, efforts, "", _set(k, effort=one.effort), size, None in efforts
        )


def _near(value: float, others: tuple[float, ...]) -> bool:
    return any(value == other or abs(value - other) <= LIMITS for other in others)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _stated(limits: list[float]) -> list[float | None] | None:
    """Limits with None for one that there is not; None for none at all."""
    return [_finite(v) for v in limits] if any(map(math.isfinite, limits)) else None


def _gravity(a: Neutral, b: Neutral) -> Iterator[Finding]:
    gap = float(np.linalg.norm(a.gravity - b.gravity))
    if gap > SAME * 9.81:
        yield Finding(
            "gravity", "world", (vector(a.gravity), vector(b.gravity)), "",
            lambda robot: replace(robot, gravity=a.gravity), gap / 9.81,
            "urdf" in (a.format, b.format),
        )  # fmt: skip


def _frames(a: Neutral, b: Neutral) -> Iterator[Finding]:
    """Origins of frames that both files have; link frames too, where a tip may be."""
    for k, (one, other) in enumerate(zip(a.parts, b.parts, strict=True)):
        gap = float(np.linalg.norm(one.pose.translation - other.pose.translation))
        if gap > NOTHING and one.link and other.link and one.kind != "free":
            yield Finding(
                "frame", one.link, (vector(one.pose.translation), vector(other.pose.translation)),
                f"{1e3 * gap:.4g} mm apart", _set(k, pose=one.pose), gap / a.size,
            )  # fmt: skip
    theirs = {plain_name(name): (name, frame) for name, frame in b.frames.items()}
    for name, frame in a.frames.items():
        label, found = theirs.get(plain_name(name), ("", frame))
        gap = float(np.linalg.norm(frame.pose.translation - found.pose.translation))
        if found.part == frame.part and gap > NOTHING:
            yield Finding(
                "frame", name, (vector(frame.pose.translation), vector(found.pose.translation)),
                f"{1e3 * gap:.4g} mm apart", _replaced_frame(label, frame), gap / a.size,
            )  # fmt: skip


def _replaced_frame(label: str, frame: Any) -> Callable[[Neutral], Neutral]:
    return lambda robot: replace(robot, frames=robot.frames | {label: frame})


def _paired(ours: tuple[Named, ...], theirs: tuple[Named, ...]) -> list[tuple[Any, Any]]:
    """Tendons or actuators of the same name, then of like names; None where one has no partner."""
    left = {item.name: item for item in theirs}
    pairs: list[tuple[Any, Any]] = []
    for item in ours:
        like = [name for name in left if plain_name(name) == plain_name(item.name)]
        name = item.name if item.name in left else like[0] if len(like) == 1 else None
        pairs.append((item, left.pop(name) if name is not None else None))
    return pairs + [(None, item) for item in left.values()]


def _alone(
    kind: str, one: Named | None, other: Named | None, words: Callable[[Named], str]
) -> Finding:
    """One of the two is None: the file that has no such thing."""
    ours, theirs = (None if item is None else words(item) for item in (one, other))
    item = one if one is not None else other
    assert item is not None
    return Finding(kind, item.name, (ours, theirs), ONLY, lambda robot: robot, 1.0, True)


def _cables(a: Neutral, b: Neutral, turns: Turns, states: States) -> Iterator[Finding]:
    ours = lengths(a, states)
    theirs = lengths(b, states)
    for one, other in _paired(a.cables, b.cables):
        if one is None or other is None:
            if not (_drives(one, a) or _drives(other, b)):
                yield _alone("tendon", one, other, _cable_words)
            continue
        scale = float(np.abs(ours[one.name]).max()) or 1.0
        error = float(np.abs(ours[one.name] - theirs[other.name]).max()) / scale
        signed = {joint: turns.get(joint, (1.0, 0.0))[0] * c for joint, c in other.terms.items()}
        same_terms = any(_same_terms(one.terms, terms) for terms in (other.terms, signed))
        around = [p.around for p in one.path] != [p.around for p in other.path]
        if (one.terms or other.terms) and same_terms and not one.path:
            error = 0.0
        if error > SAME or around:
            yield Finding(
                "tendon", one.name, (_cable_words(one), _cable_words(other)),
                _path_words(one, other) or f"length {100 * error:.3g} % apart",
                _with_cable(other.name, one), max(error, 1.0 if around else 0.0),
            )  # fmt: skip
        for name in ("stiffness", "damping"):
            p, q = getattr(one, name), getattr(other, name)
            if (size := differ(p, q)) > SAME:
                yield Finding(
                    "tendon", one.name, (p, q), name, _with_cable(other.name, one), size,
                    not (p and q),
                )  # fmt: skip
        sprung = one.stiffness > 0 and other.stiffness > 0
        if sprung and max(abs(p - q) for p, q in zip(one.rest, other.rest, strict=True)) > FRAMES:
            yield Finding(
                "tendon", one.name, (list(one.rest), list(other.rest)), "rest length",
                _with_cable(other.name, one), 1.0,
            )  # fmt: skip


def _drives(cable: NeutralTendon | None, robot: Neutral) -> bool:
    """Whether a tendon says no more than its actuators do: it is plain, and over one joint."""
    if cable is None or len(cable.terms) != 1 or cable.stiffness or cable.damping:
        return False
    return any(motor.target == f"tendon:{cable.name}" for motor in robot.motors)


def _same_terms(ours: dict[str, float], theirs: dict[str, float]) -> bool:
    return all(
        differ(ours.get(joint, 0.0), theirs.get(joint, 0.0)) <= SAME for joint in {**ours, **theirs}
    )


def _with_cable(name: str, cable: NeutralTendon) -> Callable[[Neutral], Neutral]:
    def repair(robot: Neutral) -> Neutral:
        cables = tuple(replace(cable, name=c.name) if c.name == name else c for c in robot.cables)
        return replace(robot, cables=cables)

    return repair


def _cable_words(cable: NeutralTendon) -> str:
    if cable.terms:
        return " + ".join(f"{coefficient:g} {joint}" for joint, coefficient in cable.terms.items())
    return f"{len(cable.path)} points"


def _path_words(one: NeutralTendon, other: NeutralTendon) -> str:
    """Which points of two paths are apart, and how far."""
    if len(one.path) != len(other.path):
        return "another number of points"
    words = []
    for k, (p, q) in enumerate(zip(one.path, other.path, strict=True)):
        gap = float(np.linalg.norm(p.xyz - q.xyz))
        if p.part != q.part:
            words.append(f"point {k + 1} on another body")
        elif gap > FRAMES:
            words.append(f"point {k + 1} moved {1e3 * gap:.4g} mm")
    return ", ".join(words)


def _motors(a: Neutral, b: Neutral, turns: Turns) -> Iterator[Finding]:
    for one, other in _paired(a.motors, b.motors):
        if one is None or other is None:
            yield _alone("actuator", one, other, _motor_words)
            continue
        first, second = one, other
        if plain_name(one.target) != plain_name(other.target):
            first, second = _on_joint(one, a), _on_joint(other, b)
        _, _, joint = first.target.partition("joint:")
        sense = turns.get(joint, (1.0, 0.0))[0]
        words = []
        size = 0.0
        if plain_name(first.target) != plain_name(second.target):
            words.append("acts on another target")
        if one.law != other.law:
            words.append("another law")
        if min(differ(first.gear, second.gear), differ(first.gear, sense * second.gear)) > SAME:
            words.append("gear")
            size = differ(first.gear, second.gear)
        spans = [(one.lower, other.lower), (one.upper, other.upper)]
        if any(differ(p, q) > SAME for p, q in spans):
            words.append("range")
            size = max(size, *(differ(p, q) for p, q in spans))
        if words:
            yield Finding(
                "actuator", one.name, (_motor_words(one), _motor_words(other)), ", ".join(words),
                _with_motor(other.name, one), size or 1.0,
            )  # fmt: skip


def _on_joint(motor: Motor, robot: Neutral) -> Motor:
    """The same force as one on the joint itself, if the tendon it pulls is over one joint alone."""
    for cable in robot.cables:
        if motor.target == f"tendon:{cable.name}" and len(cable.terms) == 1:
            ((joint, coefficient),) = cable.terms.items()
            return replace(motor, target=f"joint:{joint}", gear=motor.gear * coefficient)
    return motor


def _with_motor(name: str, motor: Motor) -> Callable[[Neutral], Neutral]:
    def repair(robot: Neutral) -> Neutral:
        motors = tuple(replace(motor, name=m.name) if m.name == name else m for m in robot.motors)
        return replace(robot, motors=motors)

    return repair


def _motor_words(motor: Motor) -> str:
    words = f"{motor.target}, gear {motor.gear:g}, input {motor.lower:g} … {motor.upper:g}"
    return f"{words}, {motor.law}" if motor.law else words


def _couplings(a: Neutral, b: Neutral, turns: Turns) -> Iterator[Finding]:
    def by_pair(robot: Neutral) -> dict[tuple[str, ...], Coupling]:
        return {tuple(sorted((c.joint, c.leader))): c for c in robot.couplings}

    ours, theirs = by_pair(a), by_pair(b)
    for pair in {**ours, **theirs}:
        one, other = ours.get(pair), theirs.get(pair)
        first, second = (None if c is None else [c.multiplier, c.offset] for c in (one, other))
        if one is None or other is None:
            yield Finding(
                "coupling", " and ".join(pair), (first, second), ONLY, lambda robot: robot, 1.0,
                True,
            )  # fmt: skip
            continue
        if other.joint != one.joint and other.multiplier:  # solved for the other joint
            other = Coupling(
                other.leader, other.joint, 1 / other.multiplier, -other.offset / other.multiplier
            )
        sense = math.prod(turns.get(joint, (1.0, 0.0))[0] for joint in pair)
        readings = other.multiplier, sense * other.multiplier
        multiplier = min(differ(one.multiplier, reading) for reading in readings)
        if multiplier > SAME or abs(abs(one.offset) - abs(other.offset)) > LIMITS:
            yield Finding(
                "coupling", one.joint, (first, second), f"to {one.leader}",
                lambda robot: robot, max(multiplier, abs(one.offset - other.offset)),
            )  # fmt: skip


def find_order(a: Neutral, b: Neutral) -> Finding | None:
    """Whether the joints that both have stand in another order, however A's may be read.

    A URDF states none: engines read it in the file's order, along the tree, or by name.
    """
    if not (a.orders and b.orders):
        return None
    common = {name for name in a.orders[0] if name in b.orders[0]}
    ours, theirs = (
        [tuple(name for name in order if name in common) for order in robot.orders]
        for robot in (a, b)
    )
    if len(common) < 2 or set(ours) & set(theirs):
        return None
    names, others = ours[0], theirs[0]
    first = next(p for p, q in zip(names, others, strict=True) if p != q)
    return Finding(
        "order", first, (list(names), list(others)), "joints in another order", lambda robot: robot,
        1.0, a.format != b.format,
    )  # fmt: skip
