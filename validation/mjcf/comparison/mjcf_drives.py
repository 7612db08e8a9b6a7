"""Tendons, actuators and equalities of a compiled MJCF in the neutral form, at qpos = 0."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.polynomial import Polynomial

from softdyn.validation.mjcf.comparison.neutral import (
    WORLD,
    Coupling,
    Equality,
    Frame,
    Motor,
    NeutralTendon,
    Numbers,
    Point,
    shape_points,
)
from softdyn.validation.mjcf.compiled_fields import value_of
from softdyn.validation.mjcf.compiled_rig import bound, rig_of, slack_of, spring_of
from softdyn.validation.mjcf.transform import Transform

ROUNDING = 1e-9  # m, and for numbers after rotations
# as returned by `compiled_fields.unread_fields`
UnreadFields = dict[tuple[str, int], dict[str, Numbers]]
Shares = dict[tuple[str, int], tuple[float, np.ndarray]]  # armature, damping coefficients (3,)
OBJECTS, SORTS, KINDS = mujoco.mjtObj, mujoco.mjtTrn, mujoco.mjtEq
TARGETS = {
    int(SORTS.mjTRN_JOINT): ("joint", OBJECTS.mjOBJ_JOINT),
    int(SORTS.mjTRN_JOINTINPARENT): ("joint in its parent", OBJECTS.mjOBJ_JOINT),
    int(SORTS.mjTRN_TENDON): ("tendon", OBJECTS.mjOBJ_TENDON),
    int(SORTS.mjTRN_SITE): ("site", OBJECTS.mjOBJ_SITE),
    int(SORTS.mjTRN_SLIDERCRANK): ("crank", OBJECTS.mjOBJ_SITE),
    int(SORTS.mjTRN_BODY): ("body", OBJECTS.mjOBJ_BODY),
}
SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


@dataclass(frozen=True, eq=False)
class Places:
    """A model at qpos = 0, and the part that carries each body."""

    model: mujoco.MjModel
    data: mujoco.MjData
    carrier: tuple[int, ...]

    def name(self, kind: int, k: int) -> str:
        """The name of an object, or its kind and number."""
        return mujoco.mj_id2name(self.model, kind, k) or f"{mujoco.mju_type2Str(kind)} {k}"

    def body(self, k: int) -> Frame:
        """The frame of a body."""
        pose = Transform(self.data.xmat[k].reshape(3, 3).copy(), self.data.xpos[k].copy())
        return Frame(self.carrier[k], pose)

    def site(self, k: int) -> Frame:
        """The frame of a site."""
        rotation = self.data.site_xmat[k].reshape(3, 3).copy()
        part = self.carrier[self.model.site_bodyid[k]]
        return Frame(part, Transform(rotation, self.data.site_xpos[k].copy()))


def pair_of(row: np.ndarray) -> tuple[float, float]:
    """The two numbers of a row."""
    return float(row[0]), float(row[1])


def shares_of(model: mujoco.MjModel) -> Shares:
    """Armature and damping that actuators add to joints and tendons, by kind and number."""
    found: Shares = {}
    sorts = {int(sort): word for sort, word in (
        (SORTS.mjTRN_JOINT, "joint"), (SORTS.mjTRN_JOINTINPARENT, "joint"),
        (SORTS.mjTRN_TENDON, "tendon"),
    )}  # fmt: skip
    for k in range(model.nactuator):
        key = sorts.get(int(model.actuator_trntype[k]), ""), int(model.actuator_trnid[k, 0])
        square = value_of(model, "actuator_gear", k)[0] ** 2
        damping = np.array([model.actuator_damping[k], *model.actuator_dampingpoly[k]])
        armature, before = found.get(key, (0.0, np.zeros(3)))
        armature += square * float(model.actuator_armature[k])
        found[key] = armature, before + square * damping
    return found


def efforts_of(model: mujoco.MjModel) -> dict[int, float]:
    """The largest force on each joint, stated by an actuator or the joint itself."""
    found: dict[int, float] = {}
    for joint in range(model.njnt):
        if model.jnt_actfrclimited[joint]:
            found[joint] = float(np.abs(model.jnt_actfrcrange[joint]).max())
    for k in range(model.nactuator):
        if model.actuator_trntype[k] != SORTS.mjTRN_JOINT:
            continue
        gear = abs(value_of(model, "actuator_gear", k)[0])
        force = math.inf
        if model.actuator_forcelimited[k]:
            force = float(np.abs(model.actuator_forcerange[k]).max()) * gear
        elif value_of(model, "actuator_ctrllimited", k)[0] and not _law(model, k):
            gain = abs(float(model.actuator_gainprm[k, 0]))
            force = max(map(abs, value_of(model, "actuator_ctrlrange", k))) * gear * gain
        if force > 0:
            joint = int(model.actuator_trnid[k, 0])
            found[joint] = min(found.get(joint, math.inf), force)
    return found


# -- actuators -------------------------------------------------------------------------------------


def motors_of(place: Places, unread: UnreadFields) -> tuple[Motor, ...]:
    """All actuators but those of `slack_of`, with their fields from `told`."""
    pulls = slack_of(place.model).values()
    for k in pulls:
        unread.pop(("actuator", k), None)
    return tuple(
        _motor(place, k, unread.pop(("actuator", k), {}))
        for k in range(place.model.nactuator)
        if k not in pulls
    )


def _motor(place: Places, k: int, more: dict[str, Numbers]) -> Motor:
    model, law, rig = place.model, "", rig_of(place.model, k, more)
    if rig is None:
        rig, law = {}, _law(place.model, k)
    lower, upper = -math.inf, math.inf
    if value_of(model, "actuator_ctrllimited", k)[0]:
        lower, upper, *others = value_of(model, "actuator_ctrlrange", k)
        if others:  # of several inputs
            more |= {"actuator_ctrlrange": (lower, upper, *others)}
    gear = value_of(model, "actuator_gear", k)
    force = gear[0]
    if "command" in rig:
        bound(rig, more, (lower, upper))
        more.pop("actuator_gainprm", None)
        lower, upper = more.pop("actuator_forcerange", (-math.inf, math.inf))
    elif not law:  # the input is the force, so its range is combined with the force's
        gain = more.pop("actuator_gainprm", (1.0,))[0]
        force *= gain
        if "lag" not in rig and (limits := more.pop("actuator_forcerange", ())) and gain:
            ends = sorted(limit / gain for limit in limits)
            lower, upper = max(lower, ends[0]), min(upper, ends[1])
    group = int(model.actuator_group[k])
    if 0 <= group < 31 and int(model.opt.disableactuator) >> group & 1:
        more |= {"opt.disableactuator": (1.0,)}
    target, axes, frames = _target(place, k, np.reshape(gear, (-1, 6)))
    name = place.name(OBJECTS.mjOBJ_ACTUATOR, k)
    return Motor(name, target, force, lower, upper, law, axes, frames, more, rig, k)


def _law(model: mujoco.MjModel, k: int) -> str:
    """An actuator's force as a function of its input, in words; empty if they are equal."""
    fixed = model.actuator_gaintype[k] == mujoco.mjtGain.mjGAIN_FIXED
    plain = model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_NONE
    still = model.actuator_dyntype[k] == mujoco.mjtDyn.mjDYN_NONE
    if fixed and plain and still:
        return ""
    gain = ", ".join(f"{value:.6g}" for value in model.actuator_gainprm[k, :3])
    bias = ", ".join(f"{value:.6g}" for value in model.actuator_biasprm[k, :3])
    text = f"gain {gain}; bias {bias}" + ("" if still else "; with dynamics")
    if model.actuator_gaintype[k] == mujoco.mjtGain.mjGAIN_MUSCLE:
        return f"muscle, whose force depends on length, speed and activation: {text}"
    return text


def _target(place: Places, k: int, gear: np.ndarray) -> tuple[str, Numbers, tuple[Frame, ...]]:
    """The target of an actuator, the axes of its gear if there are any, and its sites' frames."""
    model, sort = place.model, int(place.model.actuator_trntype[k])
    ends = [int(end) for end in model.actuator_trnid[k] if end >= 0]
    if sort == SORTS.mjTRN_SO3:
        word = "orientation"
        kind = OBJECTS.mjOBJ_SITE if len(ends) > 1 else OBJECTS.mjOBJ_JOINT
    else:
        word, kind = TARGETS.get(sort, ("other", OBJECTS.mjOBJ_UNKNOWN))
    names = " from ".join(place.name(kind, end) for end in ends)
    if kind == OBJECTS.mjOBJ_SITE:
        frames = tuple(place.site(end) for end in ends)
        return f"{word}:{names}", () if word == "crank" else _clean(gear), frames
    if kind != OBJECTS.mjOBJ_JOINT:
        return f"{word}:{names}", (), ()
    joint = ends[0]
    if int(model.jnt_type[joint]) in SCALAR:
        return f"joint:{names}", (), ()
    body = int(model.jnt_bodyid[joint])
    child, parent = (place.body(b).pose.rotation for b in (body, int(model.body_parentid[body])))
    free = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
    turn = parent if sort == SORTS.mjTRN_JOINTINPARENT else child
    if free:  # a force in the world's axes, then a torque in the body's
        gear = np.hstack((gear[:, :3], gear[:, 3:] @ turn.T))
    else:
        gear = np.hstack((gear[:, :3] @ turn.T, gear[:, 3:]))
    return f"{word}:{names}", _clean(gear), ()


def _clean(values: np.ndarray) -> Numbers:
    """Numbers with rounding errors set to zero."""
    return tuple(float(x) if abs(x) > ROUNDING else 0.0 for x in np.ravel(values))


# -- tendons ---------------------------------------------------------------------------------------


def tendons_of(place: Places, shares: Shares, unread: UnreadFields) -> tuple[NeutralTendon, ...]:
    """All tendons, with the armature and damping of the actuators that pull them."""
    model, wraps, pulls = place.model, mujoco.mjtWrap, slack_of(place.model)
    found = []
    for t in range(model.ntendon):
        terms: dict[str, float] = {}
        path: list[Point] = []
        for w in range(model.tendon_adr[t], model.tendon_adr[t] + model.tendon_num[t]):
            kind, which = model.wrap_type[w], int(model.wrap_objid[w])
            if kind == wraps.mjWRAP_JOINT:
                terms[place.name(OBJECTS.mjOBJ_JOINT, which)] = float(model.wrap_prm[w])
            elif kind == wraps.mjWRAP_SITE:
                path.append(_point(place.site(which)))
            elif kind == wraps.mjWRAP_PULLEY:
                path.append(Point(WORLD, np.zeros(3), f"pulley {float(model.wrap_prm[w])!r}"))
            else:
                path += _wrapped(place, w)
        armature, damping = shares.get(("tendon", t), (0.0, np.zeros(3)))
        stiffness, own, rest, slack = spring_of(model, t, pulls, bool(damping.any()))
        damping = damping + np.array([own, *model.tendon_dampingpoly[t]])
        found.append(
            NeutralTendon(
                place.name(OBJECTS.mjOBJ_TENDON, t), terms, tuple(path),
                stiffness, float(damping[0]), rest, float(model.tendon_armature[t]) + armature,
                pair_of(model.tendon_stiffnesspoly[t]), pair_of(damping[1:]),
                unread.pop(("tendon", t), {}), slack,
            )
        )  # fmt: skip
    return tuple(found)


def _point(frame: Frame) -> Point:
    return Point(frame.part, frame.pose.translation)


def _wrapped(place: Places, w: int) -> Iterator[Point]:
    """The shape that a path wraps: centre, second point on a cylinder's axis, side site."""
    model, data = place.model, place.data
    geom, side = int(model.wrap_objid[w]), int(model.wrap_prm[w])
    round_ = model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_CYLINDER
    return shape_points(
        place.carrier[model.geom_bodyid[geom]],
        data.geom_xpos[geom].copy(),
        float(model.geom_size[geom, 0]),
        data.geom_xmat[geom].reshape(3, 3)[:, 2] if round_ else None,
        _point(place.site(side)) if side >= 0 else None,
    )


# -- equalities ------------------------------------------------------------------------------------


def equalities_of(
    place: Places, unread: UnreadFields
) -> tuple[tuple[Coupling, ...], tuple[Equality, ...]]:
    """Joints that follow another linearly, and all other initially active equalities."""
    couplings, others = [], []
    for k in range(place.model.neq):
        more = unread.pop(("eq", k), {})
        if not place.model.eq_active0[k]:
            continue
        tie = _equality(place, k, more)
        if tie.kind == "joint" and len(tie.ends) == 2 and not any(tie.data[2:]):
            couplings.append(Coupling(*tie.ends, tie.data[1], tie.data[0], more))
        else:
            others.append(tie)
    return tuple(couplings), tuple(others)


def _equality(place: Places, k: int, more: dict[str, Numbers]) -> Equality:
    model = place.model
    kind = mujoco.mjtEq(model.eq_type[k])
    word = kind.name.removeprefix("mjEQ_").lower()
    pair = [int(end) for end in (model.eq_obj1id[k], model.eq_obj2id[k]) if end >= 0]
    own = {KINDS.mjEQ_JOINT: OBJECTS.mjOBJ_JOINT, KINDS.mjEQ_TENDON: OBJECTS.mjOBJ_TENDON}
    ends = tuple(place.name(own.get(kind, model.eq_objtype[k]), end) for end in pair)
    data = model.eq_data[k]
    if kind == KINDS.mjEQ_JOINT:  # about the joints' references
        zeros = [float(model.qpos0[model.jnt_qposadr[end]]) for end in pair]
        x = Polynomial([-zeros[1], 1.0]) if len(pair) > 1 else Polynomial([0.0])
        found = (zeros[0] + Polynomial(data[:5])(x)).coef
        return Equality(word, ends, _clean(np.pad(found, (0, 5 - len(found)))), (), more)
    if kind not in (KINDS.mjEQ_CONNECT, KINDS.mjEQ_WELD):
        return Equality(word, ends, tuple(map(float, data)), (), more)
    weld, sites = kind == KINDS.mjEQ_WELD, model.eq_objtype[k] == OBJECTS.mjOBJ_SITE
    frames = [place.site(end) if sites else place.body(end) for end in pair]
    first, second = (frame.pose for frame in frames)
    points = [(frames[0], np.zeros(3)), (frames[1], np.zeros(3))]
    if not sites:
        points = [(frames[0], data[:3]), (frames[1], data[3:6])]
        points = [(frames[1], data[:3])] if weld else points
    numbers: Numbers = ()
    if weld:
        asked = first
        if not sites:
            rotation = np.empty(9)
            mujoco.mju_quat2Mat(rotation, data[6:10])
            asked = first @ Transform(rotation.reshape(3, 3), data[3:6].copy())
        asked = asked @ second.inverse
        numbers = _clean(np.array([*asked.rotation.ravel(), *asked.translation, data[10]]))
    return Equality(
        word, ends, numbers, tuple(Point(f.part, f.pose.at(xyz)) for f, xyz in points), more
    )
