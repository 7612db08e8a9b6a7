"""An MJCF in the neutral form, from what MuJoCo compiles, at qpos = 0."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from softdyn.description.inertia import Inertia
from softdyn.exceptions import UrdfError
from softdyn.validation.mjcf.comparison.mjcf_file import Mjcf
from softdyn.validation.mjcf.comparison.neutral import (
    WORLD,
    Coupling,
    Frame,
    Motor,
    Neutral,
    NeutralTendon,
    Part,
    Point,
    Transform,
)
from softdyn.validation.twin.settings import silence

MAX_BODIES = 1024
AXIS = 0.1  # m along a cylinder's axis to the second point that tells how it lies
Pieces = tuple[tuple[str, Inertia], ...]
KINDS = {
    int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
    int(mujoco.mjtJoint.mjJNT_BALL): "ball",
    int(mujoco.mjtJoint.mjJNT_FREE): "free",
}


def compile_mjcf(file: Mjcf) -> mujoco.MjModel:
    """What MuJoCo makes of a file that was read strictly.

    Raises
    ------
    UrdfError
        When MuJoCo refuses it, or finds numbers that are not finite.
    """
    silence()
    try:
        with warnings.catch_warnings():  # that a parent's options go before its models'
            warnings.simplefilter("ignore", UserWarning)
            model = _specify(file).compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        raise UrdfError(file.path, "<mujoco>", "a file that MuJoCo compiles", error) from None
    if model.nbody > MAX_BODIES:
        raise UrdfError(file.path, "<worldbody>", f"at most {MAX_BODIES} bodies", model.nbody)
    for name in ("body_mass", "body_inertia", "body_ipos", "body_pos", "jnt_pos", "jnt_axis"):
        if not np.isfinite(getattr(model, name)).all():
            raise UrdfError(file.path, "<worldbody>", "finite numbers", f"{name} that are not")
    return model


def _specify(file: Mjcf) -> mujoco.MjSpec:
    """MuJoCo's own specification, with what is attached to it."""
    spec = mujoco.MjSpec.from_string(file.text, assets=file.meshes)
    spec.compiler.fusestatic = False  # it would lose the names of what is fused
    spec.compiler.discardvisual = False
    for part in file.attached:
        child, frame = _specify(part.model), spec.frame(part.frame)
        if frame is None:
            raise ValueError(f"{part.model.path.name} is attached to no body")
        if not part.body:
            spec.attach(child, frame=frame, prefix=part.prefix)
        elif (body := child.body(part.body)) is None:
            raise ValueError(f"{part.model.path.name} has no body {part.body!r}")
        else:
            frame.attach_body(body, part.prefix, "")
        spec.assets.update(child.assets)
    return spec


def from_mjcf(path: Path, model: mujoco.MjModel) -> Neutral:
    """The neutral form of a compiled MJCF."""
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)  # it makes unit quaternions of zeros
    parts: list[Part] = []
    carrier = [WORLD] * model.nbody
    efforts = _efforts(model)
    for body in range(1, model.nbody):
        parent = carrier[model.body_parentid[body]]
        pose = Transform(_matrix(data.xmat[body]), data.xpos[body].copy())
        name = model.body(body).name or f"body {body}"
        pieces = _pieces(model, data, body, name)
        count = model.body_jntnum[body]
        for k in range(count):
            joint = model.body_jntadr[body] + k
            last = k == count - 1
            own = pieces if last else ()
            part = _part(model, data, joint, parent, own, pose, name if last else "")
            parts.append(replace(part, effort=efforts.get(joint, math.inf)))
            parent = len(parts) - 1
        carrier[body] = parent
        if not count and parent != WORLD:
            parts[parent] = replace(parts[parent], pieces=parts[parent].pieces + pieces)
    names = [part.name for part in parts]
    frames = {
        model.body(b).name: Frame(carrier[b], Transform(_matrix(data.xmat[b]), data.xpos[b].copy()))
        for b in range(1, model.nbody)
        if model.body(b).name and not model.body_jntnum[b]
    }
    routed = {*model.wrap_objid[model.wrap_type == mujoco.mjtWrap.mjWRAP_SITE].tolist()}
    around = (mujoco.mjtWrap.mjWRAP_SPHERE, mujoco.mjtWrap.mjWRAP_CYLINDER)
    routed |= {*model.wrap_prm[np.isin(model.wrap_type, around)].astype(int).tolist()}  # sides
    for site in range(model.nsite):
        if (label := model.site(site).name) and site not in routed:
            pose = Transform(_matrix(data.site_xmat[site]), data.site_xpos[site].copy())
            frames.setdefault(label, Frame(carrier[model.site_bodyid[site]], pose))
    return Neutral(
        path, "mjcf", tuple(parts), frames, _cables(model, data, carrier), _motors(model),
        _couplings(model), model.opt.gravity.copy(), (tuple(names),), tuple(_notes(model)),
    )  # fmt: skip


def _part(
    model: mujoco.MjModel, data: mujoco.MjData, joint: int, parent: int, pieces: Pieces,
    pose: Transform, link: str,
) -> Part:  # fmt: skip
    kind = KINDS[int(model.jnt_type[joint])]
    dof = model.jnt_dofadr[joint]
    lower, upper = model.jnt_range[joint] if model.jnt_limited[joint] else (-math.inf, math.inf)
    scalar = kind in ("hinge", "slide")
    rest = float(model.qpos_spring[model.jnt_qposadr[joint]]) if scalar else 0.0
    return Part(
        model.joint(joint).name or f"joint {joint}", link, kind, parent,
        data.xaxis[joint].copy() if scalar else np.zeros(3),
        np.zeros(3) if kind == "free" else data.xanchor[joint].copy(), pieces, pose,
        float(lower), float(upper), math.inf, float(model.dof_armature[dof]),
        float(model.dof_damping[dof]), float(model.dof_frictionloss[dof]),
        float(model.jnt_stiffness[joint]), rest,
    )  # fmt: skip


def _matrix(row: np.ndarray) -> np.ndarray:
    return np.array(row, float).reshape(3, 3)


def _pieces(model: mujoco.MjModel, data: mujoco.MjData, body: int, name: str) -> Pieces:
    if not model.body_mass[body]:
        return ()
    axes = _matrix(data.ximat[body])
    tensor = (axes * model.body_inertia[body]) @ axes.T
    return ((name, Inertia(float(model.body_mass[body]), data.xipos[body].copy(), tensor)),)


def _efforts(model: mujoco.MjModel) -> dict[int, float]:
    """The largest force on each joint that an actuator or the joint itself states."""
    found: dict[int, float] = {}
    for joint in range(model.njnt):
        if model.jnt_actfrclimited[joint]:
            found[joint] = float(np.abs(model.jnt_actfrcrange[joint]).max())
    for k in range(model.nu):
        if model.actuator_trntype[k] != mujoco.mjtTrn.mjTRN_JOINT:
            continue
        gear = abs(float(model.actuator_gear[k, 0]))
        force = math.inf
        if model.actuator_forcelimited[k]:
            force = float(np.abs(model.actuator_forcerange[k]).max()) * gear
        elif model.actuator_ctrllimited[k] and not _law(model, k):
            gain = abs(float(model.actuator_gainprm[k, 0]))
            force = float(np.abs(model.actuator_ctrlrange[k]).max()) * gear * gain
        if force > 0:
            joint = int(model.actuator_trnid[k, 0])
            found[joint] = min(found.get(joint, math.inf), force)
    return found


def _law(model: mujoco.MjModel, k: int) -> str:
    """How an actuator's force follows from its input; nothing where it is the input."""
    fixed = model.actuator_gaintype[k] == mujoco.mjtGain.mjGAIN_FIXED
    plain = model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_NONE
    still = model.actuator_dyntype[k] == mujoco.mjtDyn.mjDYN_NONE
    if fixed and plain and still:
        return ""
    gain = ", ".join(f"{value:.6g}" for value in model.actuator_gainprm[k, :3])
    bias = ", ".join(f"{value:.6g}" for value in model.actuator_biasprm[k, :3])
    return f"gain {gain}; bias {bias}" + ("" if still else "; with dynamics")


def _motors(model: mujoco.MjModel) -> tuple[Motor, ...]:
    objects = {
        int(mujoco.mjtTrn.mjTRN_JOINT): ("joint", mujoco.mjtObj.mjOBJ_JOINT),
        int(mujoco.mjtTrn.mjTRN_JOINTINPARENT): ("joint", mujoco.mjtObj.mjOBJ_JOINT),
        int(mujoco.mjtTrn.mjTRN_TENDON): ("tendon", mujoco.mjtObj.mjOBJ_TENDON),
        int(mujoco.mjtTrn.mjTRN_SITE): ("site", mujoco.mjtObj.mjOBJ_SITE),
        int(mujoco.mjtTrn.mjTRN_BODY): ("body", mujoco.mjtObj.mjOBJ_BODY),
    }
    found = []
    for k in range(model.nu):
        word, kind = objects.get(int(model.actuator_trntype[k]), ("other", None))
        name = mujoco.mj_id2name(model, kind, model.actuator_trnid[k, 0]) if kind else ""
        law = _law(model, k)
        gain = 1.0 if law else float(model.actuator_gainprm[k, 0])
        lower, upper = (-math.inf, math.inf)
        if model.actuator_ctrllimited[k]:
            lower, upper = map(float, model.actuator_ctrlrange[k])
        gear = float(model.actuator_gear[k, 0]) * gain
        label = model.actuator(k).name or f"actuator {k}"
        found.append(Motor(label, f"{word}:{name or ''}", gear, lower, upper, law))
    return tuple(found)


def _cables(
    model: mujoco.MjModel, data: mujoco.MjData, carrier: list[int]
) -> tuple[NeutralTendon, ...]:
    wraps = mujoco.mjtWrap
    found = []
    for t in range(model.ntendon):
        terms: dict[str, float] = {}
        path: list[Point] = []
        for w in range(model.tendon_adr[t], model.tendon_adr[t] + model.tendon_num[t]):
            kind, which = model.wrap_type[w], int(model.wrap_objid[w])
            if kind == wraps.mjWRAP_JOINT:
                terms[model.joint(which).name or f"joint {which}"] = float(model.wrap_prm[w])
            elif kind == wraps.mjWRAP_SITE:
                part = carrier[model.site_bodyid[which]]
                path.append(Point(part, data.site_xpos[which].copy()))
            elif kind == wraps.mjWRAP_PULLEY:
                path.append(Point(WORLD, np.zeros(3), f"pulley {model.wrap_prm[w]:g}"))
            else:
                path += _wrapped(model, data, carrier, w)
        rest = (float(model.tendon_lengthspring[t, 0]), float(model.tendon_lengthspring[t, 1]))
        found.append(
            NeutralTendon(
                model.tendon(t).name or f"tendon {t}", terms, tuple(path),
                float(model.tendon_stiffness[t]), float(model.tendon_damping[t]), rest,
            )
        )  # fmt: skip
    return tuple(found)


def _wrapped(
    model: mujoco.MjModel, data: mujoco.MjData, carrier: list[int], w: int
) -> Iterator[Point]:
    """What a path goes around: the centre, a second point on a cylinder's axis, the side's site."""
    geom = int(model.wrap_objid[w])
    part, centre = carrier[model.geom_bodyid[geom]], data.geom_xpos[geom].copy()
    size = f"radius {model.geom_size[geom, 0]:.6g}"
    if model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_CYLINDER:
        axis = _matrix(data.geom_xmat[geom])[:, 2]
        # either sense is the same cylinder: the one whose first component that is not zero is > 0
        sense = np.sign(axis[np.abs(axis) > 1e-6][0])
        yield Point(part, centre, f"cylinder of {size}")
        yield Point(part, centre + AXIS * sense * axis, "its axis")
    else:
        yield Point(part, centre, f"sphere of {size}")
    if (side := int(model.wrap_prm[w])) >= 0:
        yield Point(carrier[model.site_bodyid[side]], data.site_xpos[side].copy(), "its side")


def _couplings(model: mujoco.MjModel) -> tuple[Coupling, ...]:
    """Equalities between two joints that are linear."""
    found = []
    for k in range(model.neq):
        pair = model.eq_obj1id[k], model.eq_obj2id[k]
        linear = not model.eq_data[k, 2:5].any()
        joints = model.eq_type[k] == mujoco.mjtEq.mjEQ_JOINT and min(pair) >= 0
        if joints and linear and model.eq_active0[k]:
            joint, leader = (model.joint(int(which)).name for which in pair)
            offset, multiplier = map(float, model.eq_data[k, :2])
            found.append(Coupling(joint, leader, multiplier, offset))
    return tuple(found)


def _notes(model: mujoco.MjModel) -> list[str]:
    others = model.neq - len(_couplings(model))
    notes = [f"{others} equality constraints that are no linear coupling of two joints"] * (
        others > 0
    )
    if model.body_gravcomp.any():
        notes.append("gravity compensation of some bodies")
    return notes
