"""Causes in tendons, actuators, couplings and other equalities."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from softdyn.validation.mjcf.comparison.dynamics import (
    States,
    Terms,
    evaluate,
    random_states,
)
from softdyn.validation.mjcf.comparison.finding import (
    LIMITS,
    SAME,
    CurveGap,
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
from softdyn.validation.mjcf.comparison.neutral import (
    FREEDOMS,
    Coupling,
    Equality,
    Motor,
    Neutral,
    NeutralTendon,
    Point,
)
from softdyn.validation.mjcf.compiled_rig import ABSENT, CABLE, about_joint

FRAMES = 1e-6  # m
ONLY = "only in one file"
PLACES = ("its axis", "its side")  # points of a wrapped shape that are no shape themselves
LAW = ("gaintype", "biastype", "dyntype", "gainprm", "biasprm", "dynprm")  # fields of actuators
GROWTH = "area_growth"
TIMING = ("lag", "delay", "rate")  # fields of `Motor.rig`
MANY = 256  # states for the shortest and the longest length of a path
Named = TypeVar("Named", NeutralTendon, Motor)
Pairs = list[tuple[Any, Any]]


def find_drives(a: Neutral, b: Neutral, turns: Turns, states: States) -> Iterator[Finding]:
    """Findings on tendons, actuators and couplings of two robots whose geometry agrees."""
    terms = evaluate(a, states), evaluate(b, states)
    tendons = _paired_tendons(a, b, turns, terms)
    yield from _tendons(a, b, tendons, turns, states, terms)
    motors = _paired_motors(a, b, tendons, turns)
    yield from _motors(a, b, motors, _called(tendons), turns)
    yield from _order(a, b, motors)
    a, b = _uncoupled(a, b), _uncoupled(b, a)
    yield from _couplings(a, b, turns)
    yield from _equalities(a, b)


def _paired(ours: tuple[Named, ...], theirs: tuple[Named, ...]) -> Pairs:
    """Tendons or actuators of the same name, then of like names; None where one has no partner."""
    left = {item.name: item for item in theirs}
    pairs: Pairs = []
    for item in ours:
        like = [name for name in left if plain_name(name) == plain_name(item.name)]
        name = item.name if item.name in left else like[0] if len(like) == 1 else None
        pairs.append((item, left.pop(name) if name is not None else None))
    return pairs + [(None, item) for item in left.values()]


# -- tendons ---------------------------------------------------------------------------------------


def _paired_tendons(a: Neutral, b: Neutral, turns: Turns, terms: tuple[Terms, Terms]) -> Pairs:
    """Tendons of like names; those that are left by their lengths, which tell one path or sum."""
    pairs = _paired(a.cables, b.cables)
    alone = [other for one, other in pairs if one is None]
    found: Pairs = []
    for one, other in pairs:
        if one is None:
            continue
        if other is None:
            like = [t for t in alone if _length_error(a, b, one, t, turns, terms) <= SAME]
            if like:
                other = like[0]
                alone.remove(other)
        found.append((one, other))
    return found + [(None, other) for other in alone]


def _length_error(
    a: Neutral, b: Neutral, one: NeutralTendon, other: NeutralTendon, turns: Turns,
    terms: tuple[Terms, Terms],
) -> float:  # fmt: skip
    """The largest relative difference of two tendons' lengths; 1 for other shapes.

    If a joint has the other sense, both readings of a sum's coefficients count as agreement.
    """
    if one.shapes != other.shapes:
        return 1.0
    signed = {joint: turns.get(joint, (1.0, 0.0))[0] * c for joint, c in other.terms.items()}
    same_terms = any(_same_terms(one.terms, sums) for sums in (other.terms, signed))
    if (one.terms or other.terms) and same_terms and not one.path:
        return 0.0
    ours = terms[0].lengths[:, a.cables.index(one)]
    theirs = terms[1].lengths[:, b.cables.index(other)]
    return float(np.abs(ours - theirs).max()) / (float(np.abs(ours).max()) or 1.0)


def _tendons(
    a: Neutral, b: Neutral, pairs: Pairs, turns: Turns, states: States, terms: tuple[Terms, Terms]
) -> Iterator[Finding]:
    urdf = with_urdf(a, b)
    for one, other in pairs:
        if one is None or other is None:
            if not (_drives(one, a) or _drives(other, b)):
                robot, item, there = (a, one, terms[0]) if other is None else (b, other, terms[1])
                yield _tendon_alone(one, other, *_acting(robot, item, states, there))
            continue
        lengths = terms[0].lengths[:, a.cables.index(one)]
        arms = terms[0].arms[:, a.cables.index(one)]
        error = _length_error(a, b, one, other, turns, terms)
        around = one.shapes != other.shapes
        if error > SAME or around:
            yield Finding(
                "tendon", one.name, _path_values(one, other),
                _path_words(one, other, error),
                _with_tendon(other.name, terms=one.terms, path=one.path),
                max(error, 1.0 if around else 0.0), printed=_terms_apart(one.terms, other.terms),
            )  # fmt: skip
        if (size := differ(one.armature, other.armature)) > 0:
            yield Finding(
                "armature", one.name, (one.armature, other.armature), "of the tendon",
                _with_tendon(other.name, armature=one.armature), size,
                not (one.armature and other.armature),
            )  # fmt: skip
        reach = _stretch(one, lengths)
        for gap in curves(one, other, reach, _units(one, a), urdf=urdf):
            repair = _with_tendon(
                other.name, **{n: getattr(one, n) for n in (gap.name, f"{gap.name}_curve")}
            )
            detail = ": ".join(filter(None, (gap.name, gap.words)))
            yield Finding(
                "tendon", one.name, gap.values, detail, repair, gap.size, gap.alone,
                force=_pulling(one, gap, lengths, arms, states),
            )  # fmt: skip
        sprung = all(t.stiffness or any(t.stiffness_curve) for t in (one, other))
        away = max(abs(p - q) for p, q in zip(one.rest, other.rest, strict=True))
        if sprung and away > FRAMES:
            yield Finding(
                "tendon", one.name, (list(one.rest), list(other.rest)), "rest length",
                _with_tendon(other.name, rest=one.rest), 1.0,
                printed=share(away, max(map(abs, (*one.rest, *other.rest)))),
            )  # fmt: skip
        if one.slack != other.slack:
            yield Finding(
                "tendon", one.name, (one.slack, other.slack), "slack",
                _with_tendon(other.name, slack=one.slack), 1.0,
            )  # fmt: skip
        if one.friction != other.friction:
            repair = _with_tendon(other.name, friction=one.friction)
            rubs = one.friction[0], other.friction[0]
            yield Finding(
                "friction", one.name, rubs, "of the cable", repair, 1.0, not all(rubs),
                acts=any(rubs),
            )  # fmt: skip
        for field, values, size in told_apart(one.more, other.more, urdf=urdf):
            repair = _with_tendon(other.name, more=one.more)
            acts = any(
                _field_acts(robot, tendon, field)
                for robot, tendon in ((a, one), (b, other))
                if field in tendon.more
            )
            yield Finding("tendon", one.name, values, field, repair, size, urdf, acts=acts)


def _acting(
    robot: Neutral, tendon: NeutralTendon, states: States, terms: Terms
) -> tuple[np.ndarray, bool]:
    """Force at the states of a tendon's spring and damper, and whether it acts in another way."""
    index = robot.cables.index(tendon)
    lengths, arms = terms.lengths[:, index], terms.arms[:, index]
    bare = replace(tendon, stiffness=0.0, damping=0.0, stiffness_curve=(0.0, 0.0),
                   damping_curve=(0.0, 0.0))  # fmt: skip
    gaps = curves(tendon, bare, _stretch(tendon, lengths), ("", ""), urdf=False)
    force = sum((_pulling(tendon, gap, lengths, arms, states) for gap in gaps), 0.0 * states.v)
    acts = tendon.friction[0] > 0 or any(_field_acts(robot, tendon, f) for f in tendon.more)
    return force, acts


def _pulling(
    tendon: NeutralTendon, gap: CurveGap, lengths: np.ndarray, arms: np.ndarray, states: States
) -> np.ndarray:
    """Generalized force (samples, nv) of a spring outside the rest lengths, or of a damper."""
    low, high = tendon.rest
    stretch = np.maximum(lengths - high, 0.0) + np.minimum(lengths - low, 0.0)
    speed = np.einsum("sj,sj->s", arms, states.v)
    at = speed if gap.name == "damping" else stretch
    return np.asarray(gap.acting(at)[:, None] * arms)


def _field_acts(robot: Neutral, tendon: NeutralTendon, field: str) -> bool:
    """Whether a field of a tendon changes the motion: a range if it is reached."""
    if field in ("tendon_range", "tendon_margin"):
        return _reaches(robot, tendon)
    if field == "tendon_actfrcrange":
        pulls = sum(_strength(m) for m in robot.motors if m.target == f"tendon:{tendon.name}")
        return pulls > min(map(abs, tendon.more[field])) * (1 + SAME)
    return changes_motion(field)


def _reaches(robot: Neutral, tendon: NeutralTendon) -> bool:
    """Whether a tendon reaches its range's ends within the joints' limits.

    The lengths of sums are exact, those of paths are sampled. Lengths around shapes are not known
    here, so such a range counts as reached.
    """
    if "tendon_range" not in tendon.more:
        return False
    if tendon.shapes:
        return True
    (margin,) = tendon.more.get("tendon_margin", (0.0,))
    low, high = tendon.more["tendon_range"]
    if tendon.terms:
        part = {part.name: part for part in robot.parts}
        ends = [
            sorted((c * part[joint].lower, c * part[joint].upper))
            for joint, c in tendon.terms.items()
            if c
        ]
        shortest, longest = sum(end[0] for end in ends), sum(end[1] for end in ends)
    else:
        index = robot.cables.index(tendon)
        lengths = evaluate(robot, random_states(robot, MANY, 0)).lengths[:, index]
        shortest, longest = float(lengths.min()), float(lengths.max())
    return shortest < low + margin or longest > high - margin


def _terms_apart(ours: dict[str, float], theirs: dict[str, float]) -> float | None:
    """The largest relative difference of two coefficients; None for paths."""
    if not (ours and theirs):
        return None
    return max(differ(ours.get(joint, 0.0), theirs.get(joint, 0.0)) for joint in ours | theirs)


def _stretch(tendon: NeutralTendon, lengths: np.ndarray) -> float:
    """The farthest that some lengths are outside the tendon's rest (m, rad); 1 if none is."""
    low, high = tendon.rest
    far = float(np.maximum(lengths - high, low - lengths).max())
    return far if far > 0 else 1.0


def _units(tendon: NeutralTendon, robot: Neutral) -> tuple[str, str]:
    """Units of a tendon's tension and length; a sum over hinges is an angle."""
    kinds = {part.kind for part in robot.parts if part.name in tendon.terms}
    return ("N m", "rad") if kinds == {"hinge"} else ("N", "m")


def _drives(tendon: NeutralTendon | None, robot: Neutral) -> bool:
    """Whether a tendon adds nothing to its actuators: it is plain, and over one joint."""
    if tendon is None or len(tendon.terms) != 1:
        return False
    plain = NeutralTendon(tendon.name, tendon.terms, (), rest=tendon.rest)
    springs = curves(tendon, plain, 1.0, ("", ""), urdf=False)
    own = (tendon.armature, tendon.more, tendon.friction[0], *springs)
    return not any(own) and any(m.target == f"tendon:{tendon.name}" for m in robot.motors)


def _same_terms(ours: dict[str, float], theirs: dict[str, float]) -> bool:
    return all(
        differ(ours.get(joint, 0.0), theirs.get(joint, 0.0)) <= SAME for joint in {**ours, **theirs}
    )


def _with_tendon(name: str, **values: Any) -> Callable[[Neutral], Neutral]:
    def repair(robot: Neutral) -> Neutral:
        tendons = tuple(replace(c, **values) if c.name == name else c for c in robot.cables)
        return replace(robot, cables=tendons)

    return repair


def _tendon_alone(
    one: NeutralTendon | None, other: NeutralTendon | None, force: np.ndarray, acts: bool
) -> Finding:
    """Finding on a tendon that one file does not have."""

    def repair(robot: Neutral) -> Neutral:
        left = tuple(tendon for tendon in robot.cables if tendon is not other)
        return replace(robot, cables=left if one is None else (*left, one))

    item = one if one is not None else other
    assert item is not None
    ours, theirs = (None if t is None else _tendon_words(t) for t in (one, other))
    return Finding(
        "tendon", item.name, (ours, theirs), ONLY, repair, 1.0, True, force=force, acts=acts
    )


def _tendon_words(tendon: NeutralTendon) -> str:
    if tendon.terms:
        return _sum(tendon.terms)
    sites = sum(not point.around for point in tendon.path)
    return ", ".join([f"{sites} sites", *(name for name in tendon.shapes if name not in PLACES)])


def _sum(terms: dict[str, float]) -> str:
    return " + ".join(f"{coefficient:.9g} {joint}" for joint, coefficient in terms.items())


def _path_values(one: NeutralTendon, other: NeutralTendon) -> tuple[str, str]:
    """Both paths; for sums, only the differing terms."""
    if not (one.terms and other.terms):
        return _tendon_words(one), _tendon_words(other)
    changed = [
        joint
        for joint in {**one.terms, **other.terms}
        if differ(one.terms.get(joint, 0.0), other.terms.get(joint, 0.0)) > SAME
    ]
    ours, theirs = ({j: t.terms.get(j, 0.0) for j in changed} for t in (one, other))
    return _sum(ours), _sum(theirs)


def _path_words(one: NeutralTendon, other: NeutralTendon, error: float) -> str:
    """The difference of two paths in words: shapes, number of sites, points, or the length."""
    length = f"length {100 * error:.3g} % apart"
    if one.shapes != other.shapes:
        return _shapes_words(one.shapes, other.shapes)
    if len(one.path) != len(other.path):
        return f"another number of sites, {length}"
    return _points_words(one.path, other.path) or length


def _shapes_words(*stated: tuple[str, ...]) -> str:
    """The difference of what two paths go around, in words."""
    ours, theirs = (
        [name for name in names if name not in PLACES and "pulley" not in name] for names in stated
    )
    if ours != theirs:
        return "around other shapes" if ours and theirs else "around a shape in one file only"
    pulleys = [[name for name in names if "pulley" in name] for names in stated]
    return "other pulleys" if pulleys[0] != pulleys[1] else "on another side of a shape"


def _points_words(ours: tuple[Point, ...], theirs: tuple[Point, ...]) -> str:
    words = []
    for k, (p, q) in enumerate(zip(ours, theirs, strict=True)):
        gap = float(np.linalg.norm(p.xyz - q.xyz))
        if p.part != q.part:
            words.append(f"point {k + 1} on another body")
        elif gap > FRAMES:
            words.append(f"point {k + 1} moved {1e3 * gap:.4g} mm")
    return ", ".join(words)


# -- actuators -------------------------------------------------------------------------------------


def _called(tendons: Pairs) -> dict[str, str]:
    """A's names of B's tendons."""
    return {other.name: one.name for one, other in tendons if one is not None and other is not None}


def _paired_motors(a: Neutral, b: Neutral, tendons: Pairs, turns: Turns) -> Pairs:
    """Actuators by their targets, and by names where several have one; then by names alone."""
    called = _called(tendons)

    def target(motor: Motor, robot: Neutral) -> str:
        word, _, name = _on_joint(motor, robot).target.partition(":")
        return f"{word}:{plain_name(called.get(name, name) if robot is b else name)}"

    def unlike(one: Motor, other: Motor) -> tuple[bool, bool, float]:
        _, _, joint = one.target.partition("joint:")
        gear = turns.get(joint, (1.0, 0.0))[0] * other.gear
        names = plain_name(one.name) != plain_name(other.name)
        return one.name != other.name, names, min(differ(one.gear, gear), 2.0)

    ends = {id(m): target(m, robot) for robot in (a, b) for m in robot.motors}
    left, found = list(b.motors), {}
    for named in (True, False):  # a name first, so that it is not taken by another of its target
        for one in (m for m in a.motors if id(m) not in found):
            like = [m for m in left if ends[id(m)] == ends[id(one)]]
            like = [m for m in like if not named or not unlike(one, m)[1]]
            if like:
                found[id(one)] = min(like, key=lambda m: unlike(one, m))
                left.remove(found[id(one)])
    rest = _paired(tuple(m for m in a.motors if id(m) not in found), tuple(left))
    by_name = {id(one): other for one, other in rest if one is not None}
    pairs = [(one, found.get(id(one), by_name.get(id(one)))) for one in a.motors]
    return pairs + [pair for pair in rest if pair[0] is None]


def _order(a: Neutral, b: Neutral, pairs: Pairs) -> Iterator[Finding]:
    """Finding on the order of the actuators that both files have, and so of the inputs."""
    both = [(one, other) for one, other in pairs if one is not None and other is not None]
    numbers = [b.motors.index(other) for _, other in both]
    if numbers != sorted(numbers):
        names = [one.name for one, _ in both]
        others = [b.motors[k].name for k in sorted(numbers)]
        yield Finding(
            "order", both[0][0].name, (names, others), "actuators in another order",
            lambda robot: robot, 1.0, a.format != b.format,
        )  # fmt: skip


def _strength(motor: Motor) -> float:
    """The largest force on the target, in N or N m; infinite for an unknown law."""
    if motor.law and "actuator_forcerange" in motor.more:
        return abs(motor.gear) * max(map(abs, motor.more["actuator_forcerange"]))
    if motor.law:
        return np.inf
    return abs(motor.gear) * max(abs(motor.lower), abs(motor.upper)) if motor.gear else 0.0


def largest_force(robot: Neutral, k: int, states: States) -> float:
    """The largest force of all actuators on a part's joint at some states (N, N m)."""
    part = robot.parts[k]
    direct = (m for m in robot.motors if m.end == ("joint", part.name))
    total = sum(_strength(motor) for motor in direct)
    pulls = {c.name: [m for m in robot.motors if m.target == f"tendon:{c.name}"]
             for c in robot.cables}  # fmt: skip
    if any(pulls.values()):
        arms = np.abs(evaluate(robot, states).arms).max(axis=0)
        first = sum(FREEDOMS[part.kind] for part in robot.parts[:k])
        for cable, row in zip(robot.cables, arms[:, first : first + FREEDOMS[part.kind]],
                              strict=True):  # fmt: skip
            for motor in pulls[cable.name] if row.any() else ():
                total += _strength(motor) * float(row.max())
    return total


def _pulls_at_rest(motor: Motor) -> bool:
    """Whether an actuator makes a force without an input: a servo does, a motor does not."""
    return "command" in motor.rig or "actuator_biastype" in motor.more


def _motors(
    a: Neutral, b: Neutral, pairs: Pairs, called: dict[str, str], turns: Turns
) -> Iterator[Finding]:
    urdf = with_urdf(a, b)
    for one, other in pairs:
        if one is None or other is None:
            item = other if one is None else one
            ours, theirs = (None if m is None else _motor_words(m) for m in (one, other))
            yield Finding(
                "actuator", item.name, (ours, theirs), ONLY, lambda robot: robot, 1.0, True,
                acts=_pulls_at_rest(item),
            )  # fmt: skip
            continue
        word, _, name = other.target.partition("tendon:")
        first, second = (
            one,
            other if word else replace(other, target=f"tendon:{called.get(name, name)}"),
        )
        if plain_name(one.target) != plain_name(second.target):
            first, second = _on_joint(one, a), _on_joint(other, b)
        alone = _of_one_format(one, other) if a.format != b.format else ()
        for name in alone:
            p, q = (motor.rig.get(name) for motor in (first, second))
            if p != q:
                yield Finding(
                    "actuator", one.name, (p, q), name, lambda robot: robot, 1.0, True, acts=True
                )
        found = _motor_differences(first, second, turns, urdf)
        found += _rig_differences(first, second, alone)
        if found:
            ours, theirs = ("; ".join(filter(None, words)) for words in zip(
                *((p, q) for _, p, q, _ in found), strict=True
            ))  # fmt: skip
            yield Finding(
                "actuator", one.name, (ours, theirs),
                ", ".join(dict.fromkeys(word for word, *_ in found)),
                _with_motor(other.name, one), max(size for *_, size in found),
            )  # fmt: skip


def _motor_differences(
    one: Motor, other: Motor, turns: Turns, urdf: bool
) -> list[tuple[str, str, str, float]]:
    """The differences: name, both values in words, and relative difference."""
    _, _, joint = one.target.partition("joint:")
    sense = turns.get(joint, (1.0, 0.0))[0]
    found = []
    if plain_name(one.target) != plain_name(other.target):
        found.append(("acts on another target", one.target, other.target, 1.0))
    if min(differ(one.gear, other.gear), differ(one.gear, sense * other.gear)) > SAME:
        size = differ(one.gear, other.gear)
        found.append(("gear", f"gear {one.gear:.9g}", f"gear {other.gear:.9g}", size))
    if (size := apart(one.axes, other.axes)) > SAME:
        found.append(("gear's axes", _row("gear", one.axes), _row("gear", other.axes), size))
    if (size := apart((one.lower, one.upper), (other.lower, other.upper))) > SAME:
        found.append(("range", _range(one), _range(other), size))
    for p, q in zip(one.frames, other.frames, strict=False):
        turned = float(np.abs(p.pose.rotation - q.pose.rotation).max())
        moved = float(np.linalg.norm(p.pose.translation - q.pose.translation))
        if p.part != q.part or moved > FRAMES or turned > FRAMES:
            found.append(("site", "", f"site {1e3 * moved:.4g} mm, {turned:.3g} apart", 1.0))
    for field, values, size in told_apart(one.more, other.more, urdf=urdf):
        name = field.removeprefix("actuator_")
        ours, theirs = (_row(name, value) for value in values)
        found.append(("another law" if name in LAW else name, ours, theirs, size))
    return found


def _rig_differences(
    one: Motor, other: Motor, alone: tuple[str, ...]
) -> Iterator[tuple[str, str, str, float]]:
    """As `_motor_differences`, of two rigs; without the parts `alone`, which one format states.

    A winch's cable and its bounds are compared only if both are winches of one kind.
    """
    commands = [motor.rig.get("command", "force") for motor in (one, other)]
    if commands[0] != commands[1]:
        yield "command", f"command {commands[0]}", f"command {commands[1]}", 1.0
    for name in TIMING if commands[0] != commands[1] else (*TIMING, *CABLE):
        p, q = (motor.rig.get(name, ABSENT.get(name, 0.0)) for motor in (one, other))
        if (size := differ(p, q)) > SAME and name not in alone:
            yield name, f"{name} {p:.9g}", f"{name} {q:.9g}", size
    grown = [(*m.rig.get(GROWTH, ()), m.rig.get("area_length", 0.0)) for m in (one, other)]
    if grown[0] != grown[1] and GROWTH not in alone:
        p, q = (_row(f"{GROWTH} and area_length", values) for values in grown)
        yield GROWTH, p, q, 1.0


def _of_one_format(one: Motor, other: Motor) -> tuple[str, ...]:
    """A URDF's rates, lags before an integrator and changing areas, an MJCF's unit of a winch."""
    commands = one.rig.get("command"), other.rig.get("command")
    lag = ("lag",) if "velocity" in commands else ()
    return ("rate", GROWTH, *lag, *(("unit",) if commands[0] == commands[1] else ()))


def _on_joint(motor: Motor, robot: Neutral) -> Motor:
    """The motor as one on the joint itself, if its tendon only goes over this joint."""
    for tendon in robot.cables:
        if motor.target == f"tendon:{tendon.name}" and len(tendon.terms) == 1:
            ((joint, coefficient),) = tendon.terms.items()
            rig = about_joint(motor.rig, coefficient)
            return replace(motor, target=f"joint:{joint}", gear=motor.gear * coefficient, rig=rig)
    return motor


def _with_motor(name: str, motor: Motor) -> Callable[[Neutral], Neutral]:
    def repair(robot: Neutral) -> Neutral:
        motors = tuple(replace(motor, name=m.name) if m.name == name else m for m in robot.motors)
        return replace(robot, motors=motors)

    return repair


def _row(name: str, values: Any) -> str:
    """A field in words, without trailing zeros."""
    if values is None:
        return ""
    row = np.trim_zeros(np.atleast_1d(values), "b")
    return f"{name} {' '.join(f'{x:.9g}' for x in row) or '0'}"


def _range(motor: Motor) -> str:
    return f"input {motor.lower:.9g} … {motor.upper:.9g}"


def _motor_words(motor: Motor) -> str:
    words = f"{motor.target}, gear {motor.gear:g}, {_range(motor)}"
    return f"{words}, {motor.law}" if motor.law else words


# -- couplings and equalities ----------------------------------------------------------------------


def _uncoupled(robot: Neutral, other: Neutral) -> Neutral:
    """The robot, where a coupling that has higher powers in the other file becomes an equality."""
    ends = {tie.ends for tie in other.equalities if tie.kind == "joint"}
    bent = [c for c in robot.couplings if (c.joint, c.leader) in ends]
    ties = tuple(
        Equality("joint", (c.joint, c.leader), (c.offset, c.multiplier, 0.0, 0.0, 0.0), (), c.more)
        for c in bent
    )
    left = tuple(c for c in robot.couplings if c not in bent)
    return replace(robot, couplings=left, equalities=(*robot.equalities, *ties))


def _couplings(a: Neutral, b: Neutral, turns: Turns) -> Iterator[Finding]:
    def by_pair(robot: Neutral) -> dict[tuple[str, ...], Coupling]:
        return {tuple(sorted((c.joint, c.leader))): c for c in robot.couplings}

    urdf = with_urdf(a, b)
    ours, theirs = by_pair(a), by_pair(b)
    for pair in {**ours, **theirs}:
        one, other = ours.get(pair), theirs.get(pair)
        first, second = (None if c is None else [c.multiplier, c.offset] for c in (one, other))
        if one is None or other is None:
            yield Finding(
                "coupling", " and ".join(pair), (first, second), ONLY, lambda robot: robot, 1.0,
                True, acts=True,
            )  # fmt: skip
            continue
        solved = other
        if other.joint != one.joint and other.multiplier:  # solved for the other joint
            solved = Coupling(
                other.leader, other.joint, 1 / other.multiplier, -other.offset / other.multiplier
            )
        size = min(_coupled_apart(one, reading) for reading in _readings(solved, turns))
        if size > 0.0:
            yield Finding(
                "coupling", one.joint, (first, second), f"to {one.leader}", lambda robot: robot,
                size,
            )  # fmt: skip
        for field, values, away in told_apart(one.more, other.more, urdf=urdf):
            yield Finding(
                "coupling", one.joint, values, field, lambda robot: robot, away, urdf,
                acts=changes_motion(field),
            )  # fmt: skip


def _readings(tie: Coupling, turns: Turns) -> Iterator[Coupling]:
    """Readings of a coupling of B: in A's coordinates, unchanged, and with only the senses."""
    (s, z), (t, w) = (turns.get(joint, (1.0, 0.0)) for joint in (tie.joint, tie.leader))
    yield tie
    yield replace(tie, multiplier=s * t * tie.multiplier, offset=s * tie.offset)
    slope = s * t * tie.multiplier
    yield replace(tie, multiplier=slope, offset=s * tie.offset + z - slope * w)


def _coupled_apart(one: Coupling, other: Coupling) -> float:
    """Difference of two couplings of the same joints; 0 within the tolerances."""
    slope, offset = differ(one.multiplier, other.multiplier), abs(one.offset - other.offset)
    return max(slope, offset) if slope > SAME or offset > LIMITS else 0.0


def _equalities(a: Neutral, b: Neutral) -> Iterator[Finding]:
    def by_ends(robot: Neutral) -> dict[tuple[str, ...], Equality]:
        return {(tie.kind, *map(plain_name, tie.ends)): tie for tie in robot.equalities}

    ours, theirs = by_ends(a), by_ends(b)
    for key in {**ours, **theirs}:
        one, other = ours.get(key), theirs.get(key)
        item = one if one is not None else other
        assert item is not None
        where = " and ".join(item.ends)
        if one is None or other is None:
            values = tuple(None if tie is None else tie.kind for tie in (one, other))
            yield Finding(
                "coupling", where, (values[0], values[1]), ONLY, lambda robot: robot, 1.0, True,
                acts=True,
            )  # fmt: skip
            continue
        found = {"": one.data, **one.more}, {"": other.data, **other.more}
        for field, values, size in told_apart(*found, urdf=False):
            detail = field or f"of {item.kind}"
            yield Finding("coupling", where, values, detail, lambda robot: robot, size)
        if words := _points_words(one.points, other.points):
            yield Finding("coupling", where, (None, None), words, lambda robot: robot, 1.0)
