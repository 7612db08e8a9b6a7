"""Causes other than geometry: armature, damping, friction, springs, limits, gravity, frames.

A value that is zero in one file only is stated by the other file alone, and so is a value that a
URDF cannot state. Such a finding has the force that it makes, or says that it acts; a repair shows
what armature and gravity do. Between two MJCFs, both state all of MuJoCo's fields, because a
missing field has its default. If a
joint's sense or zero differs, its limits, rest or coefficients may refer to either one: both
readings count as agreement.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from softdyn.validation.mjcf.comparison.bodies import vector
from softdyn.validation.mjcf.comparison.drives import find_drives, largest_force
from softdyn.validation.mjcf.comparison.dynamics import States
from softdyn.validation.mjcf.comparison.finding import (
    LIMITS,
    SAME,
    Finding,
    Turns,
    apart,
    changes_motion,
    curves,
    differ,
    share,
    told_apart,
    with_urdf,
)
from softdyn.validation.mjcf.comparison.matching import plain_name
from softdyn.validation.mjcf.comparison.neutral import FREEDOMS, Neutral, NeutralTendon, Part
from softdyn.validation.mjcf.transform import Transform

NOTHING = 1e-12  # m
REST = 1e-6  # rad, m
# Farthest stops that act (rad, m), a turn each way; files that must state some write 9 or 1e4 rad.
TURN, TRAVEL = 6.3, 10.0
# Kinds of MuJoCo's joint fields; all other fields have the kind "feature".
FLUID = ("opt.density", "opt.viscosity", "opt.wind", "geom_")
KIND_OF = {
    "jnt_solref": "limit", "jnt_solimp": "limit", "jnt_margin": "limit", "qpos_spring": "rest",
    "jnt_actfrcrange": "effort", "dof_solref": "friction", "dof_solimp": "friction",
}  # fmt: skip


def _items(robot: Neutral) -> tuple[Part | NeutralTendon, ...]:
    return (*robot.parts, *robot.cables)


# What a flag switches off or on; any other flag or option acts on every robot.
SWITCHED: dict[str, Callable[[Neutral], bool]] = {
    "mjDSBL_SPRING": lambda robot: any(map(_springs, _items(robot))),
    "mjDSBL_DAMPER": lambda robot: any(
        item.damping or any(item.damping_curve) for item in _items(robot)
    ),
    "mjDSBL_FRICTIONLOSS": lambda robot: (
        any(part.friction for part in robot.parts)
        or any("tendon_frictionloss" in cable.more for cable in robot.cables)
    ),
    "mjDSBL_LIMIT": lambda robot: (
        any(map(_stops, robot.parts)) or any("tendon_range" in cable.more for cable in robot.cables)
    ),
    "mjDSBL_EQUALITY": lambda robot: bool(robot.couplings or robot.equalities),
    "mjDSBL_ACTUATION": lambda robot: bool(robot.motors),
    "mjDSBL_CLAMPCTRL": lambda robot: any(
        math.isfinite(end) for motor in robot.motors for end in (motor.lower, motor.upper)
    ),
}  # fmt: skip


def find_parameters(a: Neutral, b: Neutral, turns: Turns, states: States) -> Iterator[Finding]:
    """Findings on two robots whose geometry and bodies agree; each repair is independent."""
    urdf = with_urdf(a, b)
    followers = {coupling.joint for robot in (a, b) for coupling in robot.couplings}
    for k, part in enumerate(a.parts):
        found = _joint(a, b, k, turns.get(part.name, (1.0, 0.0)), states)
        # a mimic joint follows its leader, so its own limits are not used
        yield from (f for f in found if f.kind != "limit" or part.name not in followers)
    yield from _gravity(a, b)
    yield from _frames(a, b)
    for field, values, size in told_apart(a.features, b.features, urdf=urdf):
        kind = "fluid" if field.startswith(FLUID) else "feature"
        yield Finding(
            kind, field, values, "", lambda robot: robot, size, urdf, acts=_acts(field, a, b)
        )
    yield from find_drives(a, b, turns, states)
    yield from _sensors(a, b)


def _acts(field: str, a: Neutral, b: Neutral) -> bool:
    """Whether an option, a flag or a field of a geom or body changes the motion of the robots."""
    if field == "mjDSBL_CONSTRAINT":
        names = ("mjDSBL_FRICTIONLOSS", "mjDSBL_LIMIT", "mjDSBL_EQUALITY")
        return any(_acts(name, a, b) for name in names)
    switched = SWITCHED.get(field, lambda robot: changes_motion(field))
    return any(map(switched, (a, b)))


def _stops(part: Part) -> bool:
    far = TRAVEL if part.kind == "slide" else TURN
    return any(abs(end) <= far for end in (part.lower, part.upper))


def _set(k: int, **values: Any) -> Callable[[Neutral], Neutral]:
    return lambda robot: robot.with_part(k, replace(robot.parts[k], **values))


def _joint(
    a: Neutral, b: Neutral, k: int, turn: tuple[float, float], states: States
) -> Iterator[Finding]:
    one, other = a.parts[k], b.parts[k]
    sense, zero = turn
    first = sum(FREEDOMS[part.kind] for part in a.parts[:k])
    own = slice(first, first + FREEDOMS[one.kind])

    def on_joint(values: Any) -> np.ndarray:
        force = np.zeros_like(states.v)
        force[:, own] = values
        return force

    for name in ("armature", "friction"):
        p, q = getattr(one, name), getattr(other, name)
        # M contains the armature, so that a difference of rounding is repaired, too
        if (size := differ(p, q)) > (0.0 if name == "armature" else SAME):
            detail = f"{100 * (q / p - 1):+.3g} %" if p and q else "none in one file"
            yield Finding(
                name, one.name, (p, q), detail, _set(k, **{name: p}), size, not (p and q),
                force=on_joint(abs(p - q)) if name == "friction" else None,
            )  # fmt: skip
    units = ("N", "m") if one.kind == "slide" else ("N m", "rad")
    for gap in curves(one, other, _reach(one), units, urdf=with_urdf(a, b), sense=sense):
        detail = gap.words or "none in one file"
        if not gap.words and not gap.alone:
            detail = f"{100 * (gap.values[1] / gap.values[0] - 1):+.3g} %"
        repair = _set(k, **{n: getattr(one, n) for n in (gap.name, f"{gap.name}_curve")})
        at = states.v[:, own] if gap.name == "damping" else _displacement(one, states.q[k])
        yield Finding(
            gap.name, one.name, gap.values, detail, repair, gap.size, gap.alone,
            force=on_joint(gap.acting(at)),
        )  # fmt: skip
    rests = other.rest, sense * other.rest, sense * other.rest + zero
    poses = (part.more.get("qpos_spring", (0.0,)) for part in (one, other))  # of free bodies
    away = max(min(abs(one.rest - rest) for rest in rests), apart(*poses))
    if _springs(one) and _springs(other) and away > REST:
        yield Finding(
            "rest", one.name, (one.rest, other.rest), "", _set(k, rest=one.rest), 1.0,
            printed=share(away, max(abs(one.rest), abs(other.rest))),
        )  # fmt: skip
    span, others = [one.lower, one.upper], [other.lower, other.upper]
    readings = [others, sorted(sense * v for v in others), sorted(sense * v + zero for v in others)]
    if not any(_near(span[0], r[0]) and _near(span[1], r[1]) for r in readings):
        values = _stated(span), _stated(others)
        size = max(differ(p, q) for p, q in zip(span, others, strict=True))
        yield Finding(
            "limit", one.name, values, "", _set(k, lower=one.lower, upper=one.upper), size,
            None in values, acts=_stops(one) or _stops(other),
        )  # fmt: skip
    yield from _effort(a, b, k, states)
    for field, values, size in told_apart(one.more, other.more, urdf=with_urdf(a, b)):
        kind = KIND_OF.get(field, "feature")
        if kind not in ("effort", "rest"):  # which are already found
            where = one.name if kind != "feature" else f"{field} of {one.name}"
            detail = field if kind != "feature" else ""
            yield Finding(
                kind, where, values, detail, _set(k, more=one.more), size, with_urdf(a, b),
                acts=changes_motion(field),
            )  # fmt: skip


def _displacement(part: Part, q: np.ndarray) -> np.ndarray:
    """Displacements from the spring's rest (samples, freedoms); MuJoCo's `qpos_spring` of a ball
    or a free body counts as zero."""
    return q - part.rest


def _reach(part: Part) -> float:
    """The farthest displacement from the spring's rest within the limits (rad, m), at most π."""
    far = max(abs(part.lower - part.rest), abs(part.upper - part.rest))
    return min(far, math.pi if part.kind == "hinge" else 1.0) or 1.0


def _springs(part: Part | NeutralTendon) -> bool:
    return bool(part.stiffness) or any(part.stiffness_curve)


def _effort(a: Neutral, b: Neutral, k: int, states: States) -> Iterator[Finding]:
    """Finding on the largest force; between two MJCFs also on the range of all actuators' sum.

    MuJoCo clamps to a joint's range. A URDF's effort is a property of the motor, which nothing here
    applies, so one that only a URDF states does not act.
    """
    one, other = a.parts[k], b.parts[k]
    spans = ((r, s) for r, p in ((a, one), (b, other)) if (s := p.more.get("jnt_actfrcrange")))
    acts = any(
        largest_force(robot, k, states) > min(map(abs, span)) * (1 + SAME) for robot, span in spans
    )
    if (size := differ(one.effort, other.effort)) > SAME:
        values = _finite(one.effort), _finite(other.effort)
        repair = _set(k, effort=one.effort)
        yield Finding("effort", one.name, values, "", repair, size, None in values, acts=acts)
        return
    ours, theirs = (
        {"": s} if (s := part.more.get("jnt_actfrcrange")) else {} for part in (one, other)
    )
    uneven = any(low != -high for low, high in (*ours.values(), *theirs.values()))
    if uneven or not with_urdf(a, b):
        for _, span, size in told_apart(ours, theirs, urdf=with_urdf(a, b)):
            repair = _set(k, more=one.more)
            yield Finding(
                "effort", one.name, span, "of all actuators", repair, size, with_urdf(a, b),
                acts=acts,
            )  # fmt: skip


def _near(value: float, other: float) -> bool:
    return value == other or abs(value - other) <= LIMITS


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _stated(limits: list[float]) -> list[float | None] | None:
    """Limits, with None for a missing one; None if both are missing."""
    return [_finite(v) for v in limits] if any(map(math.isfinite, limits)) else None


def _gravity(a: Neutral, b: Neutral) -> Iterator[Finding]:
    gap = float(np.linalg.norm(a.gravity - b.gravity))
    if gap > 0:
        yield Finding(
            "gravity", "world", (vector(a.gravity), vector(b.gravity)), "",
            lambda robot: replace(robot, gravity=a.gravity), gap / 9.81, with_urdf(a, b),
            acts=gap / 9.81 > SAME,  # on a load, too, where the robot's own joints do not feel it
        )  # fmt: skip
    for k, (one, other) in enumerate(zip(a.parts, b.parts, strict=True)):
        ours, theirs = one.uplift, other.uplift
        size = float(np.abs(ours - theirs).max()) / max(float(np.abs([ours, theirs]).max()), 1e-300)
        if size > 0:
            shares = [float(p.uplift[0] / p.inertia.mass) if p.uplift.any() else 0.0
                      for p in (one, other)]  # fmt: skip
            yield Finding(
                "gravity", one.link or one.name, (shares[0], shares[1]), "weight compensated",
                _set(k, pieces=one.pieces, gravcomp=one.gravcomp), size, with_urdf(a, b),
            )  # fmt: skip


def _sensors(a: Neutral, b: Neutral) -> Iterator[Finding]:
    """Sensors of one file, of another kind or target; an MJCF states no errors of its sensors.

    Those of an MJCF beside a file without any are no cause: models have sensors for their users.
    """
    stated = [robot for robot in (a, b) if robot.sensors]
    if len(stated) < 2 and all(robot.format == "mjcf" for robot in stated):
        return
    theirs = {plain_name(name): sensor for name, sensor in b.sensors.items()}
    ours = {plain_name(name): (name, sensor) for name, sensor in a.sensors.items()}
    for key in {**ours, **theirs}:
        name, one = ours.get(key, (key, None))
        other = theirs.get(key)
        if one is None or other is None:
            said = tuple(
                None if s is None else f"{s.kind} {s.target}".strip() for s in (one, other)
            )
            yield Finding(
                "feature", name, (said[0], said[1]), "sensor, only in one file", lambda r: r, 1.0,
                True,
            )  # fmt: skip
            continue
        p, q = (f"{s.kind} {plain_name(s.target)}".strip() for s in (one, other))
        if p != q:
            yield Finding("feature", name, (p, q), "sensor", lambda r: r, 1.0)
        for field, values, size in told_apart(one.more, other.more, urdf=False):
            alone = a.format != b.format and field not in ("rate", "latency")
            yield Finding("feature", name, values, f"sensor's {field}", lambda r: r, size, alone)


def _frames(a: Neutral, b: Neutral) -> Iterator[Finding]:
    """Findings on origins and axes of frames in both files; also of link frames, as of a tip.

    The axes of a moving link's frame are a matter between files of one format only, and no motion
    depends on them: a link or body that `export` writes has those of the root.
    """
    for k, (one, other) in enumerate(zip(a.parts, b.parts, strict=True)):
        named = one.link and other.link and a.format == b.format
        if named and (angle := _turned(one.pose, other.pose)):
            yield Finding(
                "frame", one.link, (vector(one.pose.rotation[0]), vector(other.pose.rotation[0])),
                f"its axes turned by {math.degrees(angle):.4g}°", _set(k, pose=one.pose), angle,
                True,
            )  # fmt: skip
        gap = float(np.linalg.norm(one.pose.translation - other.pose.translation))
        if gap > NOTHING and one.link and other.link and one.kind != "free":
            yield Finding(
                "frame", one.link, (vector(one.pose.translation), vector(other.pose.translation)),
                f"{1e3 * gap:.4g} mm apart", _set(k, pose=one.pose), gap / a.size,
                printed=share(gap, a.extent(k)),
            )  # fmt: skip
    theirs = {plain_name(name): (name, frame) for name, frame in b.frames.items()}
    theirs |= {name: (name, frame) for name, frame in b.frames.items()}
    for name, frame in a.frames.items():
        label, found = theirs.get(name) or theirs.get(plain_name(name), ("", frame))
        gap = float(np.linalg.norm(frame.pose.translation - found.pose.translation))
        fixed = found.part == frame.part and not (frame.of_joint or found.of_joint)
        if fixed and (angle := _turned(frame.pose, found.pose)):
            yield Finding(
                "frame", name, (vector(frame.pose.rotation[0]), vector(found.pose.rotation[0])),
                f"its axes turned by {math.degrees(angle):.4g}°", _replaced_frame(label, frame),
                angle,
            )  # fmt: skip
        if found.part == frame.part and gap > NOTHING:
            yield Finding(
                "frame", name, (vector(frame.pose.translation), vector(found.pose.translation)),
                f"{1e3 * gap:.4g} mm apart", _replaced_frame(label, frame), gap / a.size,
                printed=share(gap, a.extent(frame.part)),
            )  # fmt: skip


def _turned(one: Transform, other: Transform) -> float:
    """The angle (rad) between the axes of two frames."""
    return float(Transform(one.rotation.T @ other.rotation).angle)


def _replaced_frame(label: str, frame: Any) -> Callable[[Neutral], Neutral]:
    return lambda robot: replace(robot, frames=robot.frames | {label: frame})


def find_order(a: Neutral, b: Neutral) -> Iterator[Finding]:
    """Findings on the common joints in different orders, for every order in which A may be read.

    A URDF states no order: engines read it in the file's order, along the tree, or by name.
    """
    if not (a.orders and b.orders):
        return
    common = {name for name in a.orders[0] if name in b.orders[0]}
    ours, theirs = (
        [tuple(name for name in order if name in common) for order in robot.orders]
        for robot in (a, b)
    )
    if len(common) < 2 or set(ours) & set(theirs):
        return
    names, others = ours[0], theirs[0]
    first = next(p for p, q in zip(names, others, strict=True) if p != q)
    yield Finding(
        "order", first, (list(names), list(others)), "joints in another order", lambda robot: robot,
        1.0, a.format != b.format,
    )  # fmt: skip
