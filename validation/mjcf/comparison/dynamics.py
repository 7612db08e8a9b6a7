"""Dynamics of the neutral form at random states, measured by MuJoCo: M, bias, g, J, lengths.

A neutral form is rebuilt for MuJoCo as the twin is: its compiler sees a placeholder mass for every
body, and the exact masses and moments are written afterwards. So MuJoCo refuses no form for its
inertias. Compensated weight is in neither bias nor g. M is completed where a tendon's armature
couples branches, which MuJoCo leaves out (`softdyn.validation.twin.rotors`).
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from softdyn.description.inertia import Inertia
from softdyn.validation.mjcf.comparison.neutral import FREEDOMS, WORLD, Neutral
from softdyn.validation.twin.integrators import Integrator
from softdyn.validation.twin.rotors import mass_matrix
from softdyn.validation.twin.settings import Settings, silence

QUANTITIES = ("M", "bias", "g", "J")
PLAIN = Settings(1e-3, Integrator.EULER, limits=False, contacts=False, friction=False)
SCALARS = ("hinge", "slide")
KINDS = {
    "hinge": mujoco.mjtJoint.mjJNT_HINGE,
    "slide": mujoco.mjtJoint.mjJNT_SLIDE,
    "ball": mujoco.mjtJoint.mjJNT_BALL,
    "free": mujoco.mjtJoint.mjJNT_FREE,
}


@dataclass(frozen=True, eq=False)
class States:
    """Random states: q (samples, freedoms) of each part, and v (samples, nv).

    A ball's q is a rotation vector, a free base's a translation and a rotation vector. Angular
    velocities are in the body's own axes, a free base's linear one is in the world's.
    """

    q: tuple[np.ndarray, ...]
    v: np.ndarray


@dataclass(frozen=True, eq=False)
class Terms:
    """The dynamics at the states.

    Attributes
    ----------
    M : np.ndarray, (samples, nv, nv)
    bias, g : np.ndarray, (samples, nv)
    J : np.ndarray, (samples, tips, 3, nv)
    tips : np.ndarray, (samples, tips, 3)
        Link origins of the parts that carry no other.
    lengths : np.ndarray, (samples, cables)
        Lengths of the tendons; a wrapped shape counts as a point.
    arms : np.ndarray, (samples, cables, nv)
        Their derivatives by the coordinates.
    """

    M: np.ndarray
    bias: np.ndarray
    g: np.ndarray
    J: np.ndarray
    tips: np.ndarray
    lengths: np.ndarray
    arms: np.ndarray


def random_states(robot: Neutral, samples: int, seed: int) -> States:
    """States inside the limits, within ±π rad and ±1 m where there are none."""
    rng = np.random.default_rng(seed)
    q = []
    for part in robot.parts:
        reach = np.pi if part.kind == "hinge" else 1.0
        lower, upper = max(part.lower, -reach), min(part.upper, reach)
        if not lower <= upper or part.kind in ("ball", "free"):
            lower, upper = -1.0, 1.0
        q.append(rng.uniform(lower, upper, (samples, FREEDOMS[part.kind])))
    return States(tuple(q), rng.uniform(-1.0, 1.0, (samples, robot.nv)))


def evaluate(robot: Neutral, states: States) -> Terms:
    """Every term of a rebuilt robot at the states."""
    model = rebuild(robot)
    joints = [model.joint(str(k)).id for k in range(len(robot.parts))]
    tips = [model.body(f"tip {k}").id for k in _leaves(robot)]
    return _measure(robot, model, joints, tips, [np.eye(3)] * len(joints), states)


def evaluate_compiled(robot: Neutral, model: mujoco.MjModel, states: States) -> Terms:
    """Every term of the compiled MJCF from which a neutral form was read, at the states.

    The neutral form's parts are the model's joints, in the same order.
    """
    model = copy.copy(model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    tips = [int(model.jnt_bodyid[k]) for k in _leaves(robot)]
    axes = [part.pose.rotation for part in robot.parts]
    return _measure(robot, model, list(range(model.njnt)), tips, axes, states)


def misreading(robot: Neutral, model: mujoco.MjModel, states: States) -> dict[str, float]:
    """Errors of M, bias, g and J of an MJCF's neutral form, against MuJoCo's own compiled model.

    They are relative to the largest entry of each; for bias and g, or of M times 1 rad/s².
    """
    return relative_errors(evaluate(robot, states), evaluate_compiled(robot, model, states))


def relative_errors(found: Terms, right: Terms) -> dict[str, float]:
    """Errors of M, bias, g and J, relative as in `misreading`."""
    inertia, errors = float(np.abs(right.M).max(initial=0.0)), {}
    for name in QUANTITIES:
        ours, theirs = getattr(found, name), getattr(right, name)
        scale = float(np.abs(theirs).max(initial=0.0 if name == "J" else inertia)) or 1.0
        errors[name] = float(np.abs(ours - theirs).max(initial=0.0)) / scale
    return errors


def rebuild(robot: Neutral) -> mujoco.MjModel:
    """MuJoCo's model of a neutral form.

    Each part is a body whose frame at zero has its joint's point and the root's axes, and each
    piece is a body welded to it. Joints are named by the numbers of their parts. The tips are
    bodies of their own.
    """
    silence()
    spec = mujoco.MjSpec()
    PLAIN.apply(spec)
    spec.option.gravity = robot.gravity
    bodies = {WORLD: spec.worldbody}
    pieces: dict[str, Inertia] = {}
    for k, part in enumerate(robot.parts):
        above = np.zeros(3) if part.parent == WORLD else robot.parts[part.parent].point
        body = bodies[k] = _add_body(bodies[part.parent], part.point - above)
        joint = body.add_joint()
        joint.name, joint.type, joint.armature = str(k), KINDS[part.kind], part.armature
        if part.kind in SCALARS:
            joint.axis = part.axis
        for number, (name, piece) in enumerate(part.pieces):
            held = _add_body(body, piece.com - part.point)
            held.name, held.gravcomp = f"{k}:{number}", part.gravcomp.get(name, 0.0)
            pieces[held.name] = piece
    for k in _leaves(robot):
        part = robot.parts[k]
        _add_body(bodies[k], part.pose.translation - part.point).name = f"tip {k}"
    _add_tendons(spec, robot, bodies)
    model = spec.compile()
    numbers = [model.body(name).id for name in pieces]
    model.body_mass[:], model.body_inertia[:] = 0.0, 0.0
    model.body_mass[numbers] = [piece.mass for piece in pieces.values()]
    tensors = np.array([piece.tensor for piece in pieces.values()]).reshape(-1, 3, 3)
    model.body_inertia[numbers], axes = np.linalg.eigh(tensors)
    axes[:, :, 2] *= np.linalg.det(axes)[:, None]
    model.body_quat[numbers] = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    # a site that is closer than 1e-6 m to its body's frame would count as that frame
    model.site_sameframe[:] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)
    # MuJoCo's spatial vectors stand at the centre of mass that these masses give
    model.body_subtreemass[:] = model.body_mass
    for body in range(model.nbody - 1, 0, -1):
        model.body_subtreemass[model.body_parentid[body]] += model.body_subtreemass[body]
    return model


def _add_body(parent: mujoco.MjsBody, place: np.ndarray) -> mujoco.MjsBody:
    """A body with a placeholder mass at a place (3,) in its parent."""
    body = parent.add_body()
    body.pos = place
    body.explicitinertial = True
    body.mass, body.inertia = 1.0, (1.0, 1.0, 1.0)
    body.ipos, body.iquat = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    return body


def _add_tendons(spec: mujoco.MjSpec, robot: Neutral, bodies: dict[int, mujoco.MjsBody]) -> None:
    joints = {part.name: str(k) for k, part in enumerate(robot.parts)}
    for number, cable in enumerate(robot.cables):
        tendon = spec.add_tendon()
        tendon.name, tendon.armature = str(number), cable.armature
        for name, coefficient in cable.terms.items():
            tendon.wrap_joint(joints[name], coefficient)
        for index, point in enumerate(cable.path):
            if point.around.startswith("pulley"):
                tendon.wrap_pulley(float(point.around.split()[1]))
                continue
            origin = np.zeros(3) if point.part == WORLD else robot.parts[point.part].point
            site = bodies[point.part].add_site()
            site.name, site.pos = f"{number}:{index}", point.xyz - origin
            tendon.wrap_site(site.name)


def _leaves(robot: Neutral) -> list[int]:
    """The parts that carry no other."""
    return [k for k in range(len(robot.parts)) if not robot.children(k)]


def _measure(
    robot: Neutral,
    model: mujoco.MjModel,
    joints: list[int],
    tips: list[int],
    axes: list[np.ndarray],
    states: States,
) -> Terms:
    """Terms of a model whose joints are a robot's parts.

    Parameters
    ----------
    joints, tips : list of int
        MuJoCo's joint of each part, and the body at each tip.
    axes : list of np.ndarray, (3, 3)
        The axes of each part's body at zero, in which MuJoCo states its angular velocity.
    """
    data, turn = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    first = 0
    for part, joint, own in zip(robot.parts, joints, axes, strict=True):
        at, free = model.jnt_dofadr[joint], FREEDOMS[part.kind]
        block = np.eye(free)
        if part.kind not in SCALARS:
            block[-3:, -3:] = own.T
        turn[at : at + free, first : first + free] = block
        first += free
    rows: list[list[np.ndarray]] = [[] for _ in range(7)]
    jacobian = np.empty((3, model.nv))
    for k, v in enumerate(states.v):
        for part, joint, own, q in zip(robot.parts, joints, axes, states.q, strict=True):
            at = model.jnt_qposadr[joint]
            if part.kind in SCALARS:
                data.qpos[at] = q[k, 0]
                continue
            turned = Rotation.from_rotvec(own.T @ q[k, -3:]).as_quat(scalar_first=True)
            data.qpos[at : at + FREEDOMS[part.kind] + 1] = *q[k, :-3], *turned
        mujoco.mj_fwdPosition(model, data)
        M = mass_matrix(model, data)
        forces = []
        for velocity in (turn @ v, 0.0):
            data.qvel[:] = velocity
            mujoco.mj_fwdVelocity(model, data)
            forces.append(turn.T @ (data.qfrc_bias - data.qfrc_gravcomp))
        ways = np.empty((len(tips), 3, model.nv))
        for row, body in zip(ways, tips, strict=True):
            mujoco.mj_jacBody(model, data, jacobian, None, body)
            row[:] = jacobian @ turn
        arms = np.zeros((model.ntendon, model.nv))
        sparse = model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind
        if model.ntendon:
            mujoco.mju_sparse2dense(arms, data.ten_J, *sparse)
        tips_at, lengths = data.xpos[tips], data.ten_length.copy()
        found = (turn.T @ M @ turn, *forces, ways, tips_at, lengths, arms @ turn)
        for row, value in zip(rows, found, strict=True):
            row.append(value)
    return Terms(*map(np.array, rows))
