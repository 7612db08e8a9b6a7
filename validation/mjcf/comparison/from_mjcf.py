"""The neutral form of an MJCF, from MuJoCo's compiled model, at qpos = 0."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from lxml import etree

from softdyn.description.inertia import Inertia, symmetric
from softdyn.description.strict_xml import LARGEST
from softdyn.exceptions import UrdfError
from softdyn.validation.mjcf.comparison.mjcf_drives import (
    Places,
    UnreadFields,
    efforts_of,
    equalities_of,
    motors_of,
    pair_of,
    shares_of,
    tendons_of,
)
from softdyn.validation.mjcf.comparison.neutral import (
    FREEDOMS,
    WORLD,
    Frame,
    Neutral,
    Numbers,
    Part,
)
from softdyn.validation.mjcf.compiled_fields import unread_fields
from softdyn.validation.mjcf.mjcf_file import Mjcf
from softdyn.validation.mjcf.transform import Transform
from softdyn.validation.twin.settings import silence

MAX_BODIES = 1024
Pieces = tuple[tuple[str, Inertia], ...]
KINDS = {
    int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
    int(mujoco.mjtJoint.mjJNT_BALL): "ball",
    int(mujoco.mjtJoint.mjJNT_FREE): "free",
}


def compile_mjcf(file: Mjcf) -> mujoco.MjModel:
    """Compile a strictly read file with MuJoCo.

    Raises
    ------
    UrdfError
        MuJoCo refuses it, or its numbers are not finite.
    """
    silence()
    try:
        with warnings.catch_warnings():  # so that a parent's options override its models'
            warnings.simplefilter("ignore", UserWarning)
            model = _specify(file).compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        got = f"{_hint(file.text, str(error))}{error}"
        raise UrdfError(file.path, "<mujoco>", "a file that MuJoCo compiles", got) from None
    if model.nbody > MAX_BODIES:
        raise UrdfError(file.path, "<worldbody>", f"at most {MAX_BODIES} bodies", model.nbody)
    for name in (
        "body_mass", "body_inertia", "body_ipos", "body_pos", "jnt_pos", "jnt_axis", "dof_armature"
    ):  # fmt: skip
        largest = float(np.abs(getattr(model, name)).max(initial=0.0))
        if not largest <= LARGEST:
            expected = f"numbers within ±{LARGEST:g}"
            raise UrdfError(file.path, "<worldbody>", expected, f"{largest:g} in {name}")
    return model


def _hint(text: str, error: str) -> str:
    """Words about what the inertias look like that MuJoCo refuses; empty if nothing is known."""
    if "mjMINVAL" in error:
        return "below 1e-15 kg or kg m², in other units? "
    for node in etree.fromstring(text).iter("inertial"):
        words = (node.get("fullinertia") or "").split()
        if len(words) != 6:
            continue
        xx, yy, zz, xy, xz, yz = numbers = [float(word) for word in words]
        if min(np.linalg.eigvalsh(symmetric((xx, xy, xz, yy, yz, zz)))) > 0:
            continue
        if not Inertia(1.0, np.zeros(3), symmetric(numbers)).defect():
            return "fullinertia in the order xx xy xz yy yz zz, not xx yy zz xy xz yz? "
    return ""


def _specify(file: Mjcf) -> mujoco.MjSpec:
    """MuJoCo's specification, with attached models."""
    spec = mujoco.MjSpec.from_string(file.text, assets=file.meshes)
    compiler = spec.compiler
    # Fusing loses names. But if the compiler changes masses, it changes those of fused bodies.
    limits = compiler.settotalmass, compiler.boundmass, compiler.boundinertia
    compiler.fusestatic &= max(limits) > 0 or bool(compiler.balanceinertia)
    compiler.discardvisual = False
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
    mujoco.mj_kinematics(model, data)  # it turns zeros into unit quaternions
    parts: list[Part] = []
    carrier = [WORLD] * model.nbody
    efforts, found, shares = efforts_of(model), unread_fields(model), shares_of(model)
    for body in range(1, model.nbody):
        parent = carrier[model.body_parentid[body]]
        pose = Transform(_matrix(data.xmat[body]), data.xpos[body].copy())
        name = model.body(body).name or f"body {body}"
        pieces = _pieces(model, data, body, name)
        lifted = {name: share} if (share := _gravcomp(model, body)) else {}
        count = model.body_jntnum[body]
        for k in range(count):
            joint = model.body_jntadr[body] + k
            last = k == count - 1
            own = pieces if last else ()
            part = _part(model, data, joint, parent, own, pose, name if last else "")
            dof = int(model.jnt_dofadr[joint])
            armature, damping = shares.get(("joint", joint), (0.0, np.zeros(3)))
            more = found.pop(("jnt", joint), {})
            for other in range(dof, dof + FREEDOMS[part.kind]):
                more |= found.pop(("dof", other), {})
            if part.kind == "free" and (part.stiffness or any(part.stiffness_curve)):
                start = model.jnt_qposadr[joint]
                more["qpos_spring"] = tuple(map(float, model.qpos_spring[start : start + 7]))
            parts.append(
                replace(
                    part, effort=efforts.get(joint, math.inf), armature=part.armature + armature,
                    damping=part.damping + float(damping[0]),
                    damping_curve=pair_of(model.dof_dampingpoly[dof] + damping[1:]),
                    gravcomp=lifted if last else {},
                    more=more,
                )
            )  # fmt: skip
            parent = len(parts) - 1
        carrier[body] = parent
        if not count and parent != WORLD:
            above = parts[parent]
            parts[parent] = replace(
                above, pieces=above.pieces + pieces, gravcomp=above.gravcomp | lifted
            )
    names = [part.name for part in parts]
    frames = {
        model.body(b).name: Frame(carrier[b], Transform(_matrix(data.xmat[b]), data.xpos[b].copy()))
        for b in range(1, model.nbody)
        if model.body(b).name and not model.body_jntnum[b]
    }
    place = Places(model, data, tuple(carrier))
    routed = {*model.wrap_objid[model.wrap_type == mujoco.mjtWrap.mjWRAP_SITE].tolist()}
    around = (mujoco.mjtWrap.mjWRAP_SPHERE, mujoco.mjtWrap.mjWRAP_CYLINDER)
    routed |= {*model.wrap_prm[np.isin(model.wrap_type, around)].astype(int).tolist()}  # sides
    cables = {model.tendon(k).name for k in range(model.ntendon)}
    on_cables: dict[str, Frame] = {}
    for site in range(model.nsite):
        label = model.site(site).name
        # a site that `export --mjcf` makes for a cable has the cable's name and a number
        ours = label.rpartition(":")[0] in cables
        if label and site not in routed:
            frames.setdefault(label, place.site(site))
        elif label and not ours:
            on_cables[label] = place.site(site)
    couplings, equalities = equalities_of(place, found)
    tendons, motors = tendons_of(place, shares, found), motors_of(place, found)
    return Neutral(
        path, "mjcf", tuple(parts), frames, tendons, motors, couplings, equalities,
        _features(model, found), _gravity(model), (tuple(names),), cable_sites=on_cables,
    )  # fmt: skip


def _gravity(model: mujoco.MjModel) -> np.ndarray:
    off = int(mujoco.mjtDisableBit.mjDSBL_GRAVITY) & int(model.opt.disableflags)
    return np.zeros(3) if off else model.opt.gravity.copy()


def _gravcomp(model: mujoco.MjModel, body: int) -> float:
    """The part of a body's weight that is compensated: a passive force, which two flags disable."""
    off = int(mujoco.mjtDisableBit.mjDSBL_SPRING | mujoco.mjtDisableBit.mjDSBL_DAMPER)
    passive = int(model.opt.disableflags) & off != off
    return float(model.body_gravcomp[body]) * passive


def _features(model: mujoco.MjModel, unread: UnreadFields) -> dict[str, Numbers]:
    """Features that belong to no joint, tendon, actuator or equality, by field and object."""
    features: dict[str, Numbers] = {}
    for (sort, k), values in unread.items():
        name = f"{sort} {k}"
        if sort == "geom":
            name = model.geom(k).name or f"{name} of {model.body(model.geom_bodyid[k]).name}"
        elif sort == "body":
            name = model.body(k).name or name
        where = "" if sort == "opt" else f" of {name}"
        features |= {field + where: value for field, value in values.items()}
    return features


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
        float(model.jnt_stiffness[joint]), rest, pair_of(model.jnt_stiffnesspoly[joint]),
    )  # fmt: skip


def _matrix(row: np.ndarray) -> np.ndarray:
    return np.array(row, float).reshape(3, 3)


def _pieces(model: mujoco.MjModel, data: mujoco.MjData, body: int, name: str) -> Pieces:
    if not model.body_mass[body] and not model.body_inertia[body].any():
        return ()
    axes = _matrix(data.ximat[body])
    tensor = (axes * model.body_inertia[body]) @ axes.T
    return ((name, Inertia(float(model.body_mass[body]), data.xipos[body].copy(), tensor)),)
