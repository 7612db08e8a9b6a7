"""A MuJoCo model of a robot, from its bodies and its annotations.

Every link that a joint moves is one body, massless or not. MuJoCo's compiler refuses a moving body
without mass. Its engine accepts one, because only the total mass beyond a joint counts. So bodies
are compiled with a placeholder mass, and the exact masses and moments are written afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from softdyn.description.inertia import IDENTITY, Origin, Vector
from softdyn.description.robot import Joint, Robot, Tendon, Wrap
from softdyn.exceptions import UrdfError
from softdyn.validation.twin import drives
from softdyn.validation.twin.bodies import STATIC, Body, Shape, Tree, TwinJoint
from softdyn.validation.twin.cable_friction import add_guides
from softdyn.validation.twin.settings import STIFF_SOLIMP, STIFF_SOLREF, Settings

TASK_SITE = "task"
WRAP_GROUP = 4  # of geoms; MuJoCo's viewer hides it
# Sites this near to a surface, as a share of the radius, stand this far off it. The length then
# changes by 1e-18 m and the site's own direction by 1e-6, but not as seen by any joint.
ON_SURFACE, OFF_SURFACE = 1e-9, 1e-12
ROUNDING = 1e-12  # m, and of a quaternion: frames this close are the same


def build(
    robot: Robot,
    tree: Tree,
    settings: Settings,
    amend: Callable[[mujoco.MjSpec], None],
    *,
    rig: bool = False,
    rubs: bool = False,
) -> tuple[mujoco.MjModel, np.ndarray]:
    """Compile a robot for MuJoCo.

    Parameters
    ----------
    robot : Robot
        The description: springs, dampers, tendons, actuators, the task frame.
    tree : Tree
        Its bodies, from `read_bodies`.
    settings : Settings
        MuJoCo's options.
    amend : Callable[[mujoco.MjSpec], None]
        Changes what is compiled, after everything else.
    rig : bool
        Whether the inputs are those of the file's rig, and its sensors are there.
    rubs : bool
        Whether there are the tendons beyond the guides of cables that rub.

    Returns
    -------
    tuple[mujoco.MjModel, np.ndarray]
        The model, and qpos (nq,) at q = 0, where followers are at their offset.

    Raises
    ------
    UrdfError
        When MuJoCo refuses the robot.
    """
    spec = _specify(robot, tree, settings.timestep if rig else None)
    if rubs:
        add_guides(spec, robot, settings.timestep)
    settings.apply(spec)
    amend(spec)
    try:
        model = spec.compile()
    except ValueError as error:
        raise UrdfError(robot.path, "<robot>", "a robot that MuJoCo compiles", error) from error
    return model, _finish(model, robot, tree, rig)


def _specify(robot: Robot, tree: Tree, timestep: float | None) -> mujoco.MjSpec:
    """Specify the robot, except the numbers that MuJoCo's compiler would refuse or change.

    A `timestep` (s) adds the rig of the robot's file.
    """
    spec = mujoco.MjSpec()
    spec.modelname = robot.name

    shares = {tree.place[link.name][0]: link.gravcomp for link in robot.buoyant}
    bodies = [spec.worldbody]
    joints = {joint.name: joint for joint in robot.joints}
    for index, body in enumerate(tree.bodies):
        if body.joint is not None:
            name = body_name(robot, body.link)
            bodies.append(_add_body(bodies[body.parent or STATIC], body, name))
            bodies[index].gravcomp = shares.get(index, 0.0)
            if body.joint.kind == "free":
                bodies[index].add_freejoint().name = body.joint.name
            else:
                _add_joint(bodies[index], body.joint, joints[body.joint.name])
            if body.joint.leader is not None:
                _tie(spec, body.joint)
        for shape in body.shapes:
            _add_geom(bodies[index], shape)
    for a, b in neighbours(tree.bodies):
        exclude = spec.add_exclude()
        exclude.bodyname1, exclude.bodyname2 = bodies[a].name, bodies[b].name
    for tendon in robot.tendons:
        drives.add_tendon(spec, tendon)
        for k, site in enumerate(tendon.sites):
            place = Origin(_off_surfaces(tree, tendon, k))
            _add_site(bodies, tree, site.link, place, drives.site_name(tendon, k))
        for wrap in tendon.wraps:
            _add_wrap(bodies, tree, wrap, drives.wrap_name(tendon, wrap))
            if tendon.rubs:
                place = Origin(wrap.xyz)
                _add_site(bodies, tree, wrap.link, place, drives.anchor_name(tendon, wrap))
    _add_site(bodies, tree, robot.task, IDENTITY, TASK_SITE)
    drives.add_inputs(spec, robot, timestep)
    if timestep is not None:
        for sensor in robot.sensors:
            for name, (link, origin) in drives.sensor_frames(sensor).items():
                _add_site(bodies, tree, link, origin, name)
            drives.add_sensor(spec, robot, sensor, timestep)
    return spec


def body_name(robot: Robot, link: str) -> str:
    """Name of a moving link's body in the twin: the link's, except `world`, which is MuJoCo's."""
    taken = {"world"} | {other.name for other in robot.links if other.name != link}
    while link in taken:
        link = f"link:{link}"
    return link


def _add_body(parent: mujoco.MjsBody, body: Body, name: str) -> mujoco.MjsBody:
    added = parent.add_body()
    added.name = name
    added.pos, added.quat = body.pose[:3, 3], _quaternion(body.pose[:3, :3])
    # The frame of the inertia is the body's own; mass and moments follow in _finish, since the
    # compiler refuses massless bodies, point masses, and plates whose a + b is c up to rounding.
    added.explicitinertial = True
    added.mass, added.inertia = 1.0, (1.0, 1.0, 1.0)
    added.ipos, added.iquat = body.com, _quaternion(body.principal[1])
    return added


def _add_joint(body: mujoco.MjsBody, twin_joint: TwinJoint, joint: Joint) -> None:
    slides = twin_joint.kind == "slide"
    added = body.add_joint()
    added.name = twin_joint.name
    added.type = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
    added.pos, added.axis = (0.0, 0.0, 0.0), twin_joint.axis
    added.stiffness = [joint.stiffness, *joint.stiffness_poly]  # of q, q² and q³
    added.damping = [joint.damping, *joint.damping_poly]
    added.springref, added.ref = joint.rest, 0.0
    added.armature, added.frictionloss = joint.armature, joint.friction
    added.limited = int(np.isfinite(joint.lower) and twin_joint.leader is None)
    added.range = (-1.0, 1.0)  # the file's range may be a single point: see _finish
    added.margin = 0.0
    added.solref_limit, added.solimp_limit = STIFF_SOLREF, STIFF_SOLIMP
    added.solref_friction, added.solimp_friction = STIFF_SOLREF, STIFF_SOLIMP


def _tie(spec: mujoco.MjSpec, twin_joint: TwinJoint) -> None:
    """Hold a follower at multiplier · leader + offset, as stiffly as the stops."""
    tie = spec.add_equality()
    tie.type, tie.objtype = mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtObj.mjOBJ_JOINT
    tie.name1, tie.name2 = twin_joint.name, twin_joint.leader
    tie.data[:] = 0.0
    tie.data[:2] = twin_joint.offset, twin_joint.multiplier
    tie.solref, tie.solimp = STIFF_SOLREF, STIFF_SOLIMP


def _add_geom(body: mujoco.MjsBody, shape: Shape) -> None:
    kinds = mujoco.mjtGeom
    geom = body.add_geom()
    geom.type = {
        "box": kinds.mjGEOM_BOX,
        "capsule": kinds.mjGEOM_CAPSULE,
        "cylinder": kinds.mjGEOM_CYLINDER,
        "sphere": kinds.mjGEOM_SPHERE,
    }[shape.kind]
    geom.size = (*shape.size, 0.0, 0.0)[:3]
    geom.pos, geom.quat = shape.pose[:3, 3], _quaternion(shape.pose[:3, :3])
    geom.mass = 0.0
    geom.contype = geom.conaffinity = 1


def neighbours(bodies: Sequence[Body]) -> list[tuple[int, int]]:
    """Pairs of bodies that a joint connects; they overlap at the joint, so they never collide.

    A massless body without shapes is part of the joint, not a neighbour.
    """
    pairs = []
    for index, body in enumerate(bodies):
        parent = body.parent
        while parent is not None and not bodies[parent].mass and not bodies[parent].shapes:
            if parent == STATIC:
                break
            parent = bodies[parent].parent
        if parent is not None and body.shapes and bodies[parent].shapes:
            pairs.append((parent, index))
    return pairs


def _add_site(
    bodies: list[mujoco.MjsBody], tree: Tree, link: str, origin: Origin, name: str
) -> None:
    """A frame of a link as a site of the body that carries the link."""
    index, pose = tree.place[link]
    site = bodies[index].add_site()
    site.name, site.pos = name, pose[:3, :3] @ origin.xyz + pose[:3, 3]
    site.quat = _quaternion(pose[:3, :3] @ origin.rotation)


def _add_wrap(bodies: list[mujoco.MjsBody], tree: Tree, wrap: Wrap, name: str) -> None:
    """A round body as a geom without mass and contacts, and its side point as a site.

    MuJoCo takes a side site for an inner one if its distance from the geom's centre is less than
    the radius, so the site stands across the axis.
    """
    index, pose = tree.place[wrap.link]
    kinds, size = mujoco.mjtGeom, 4.0 * wrap.radius if wrap.length is None else wrap.length
    geom = bodies[index].add_geom()
    geom.name = name
    geom.type = kinds.mjGEOM_SPHERE if wrap.axis is None else kinds.mjGEOM_CYLINDER
    geom.size = (wrap.radius, 0.0 if wrap.axis is None else size / 2, 0.0)
    geom.pos = pose[:3, :3] @ wrap.xyz + pose[:3, 3]
    mujoco.mju_quatZ2Vec(geom.quat, pose[:3, :3] @ wrap.direction)
    geom.mass, geom.contype, geom.conaffinity, geom.group = 0.0, 0, 0, WRAP_GROUP
    if wrap.side is not None:
        across = np.zeros(3) if wrap.inside else wrap.across(np.array(wrap.side))
        place = Origin(tuple((wrap.xyz + across).tolist()))
        _add_site(bodies, tree, wrap.link, place, name)


def _off_surfaces(tree: Tree, tendon: Tendon, k: int) -> Vector:
    """A site's position in its link, moved off the surface of a round body of the same body.

    MuJoCo wraps nothing if a site is inside by rounding.
    """
    site = tendon.sites[k]
    index, pose = tree.place[site.link]
    point = start = pose[:3, :3] @ site.xyz + pose[:3, 3]
    for wrap in tendon.wraps:
        carrier, frame = tree.place[wrap.link]
        if carrier != index or wrap.after not in (k - 1, k):
            continue
        across = frame[:3, :3] @ wrap.across(frame[:3, :3].T @ (point - frame[:3, 3]))
        distance = float(np.linalg.norm(across))
        if abs(distance / wrap.radius - 1.0) < ON_SURFACE:
            point = point + across * ((1.0 + OFF_SURFACE) * wrap.radius / distance - 1.0)
    if point is start:
        return site.xyz
    x, y, z = (pose[:3, :3].T @ (point - pose[:3, 3])).tolist()
    return x, y, z


def _finish(model: mujoco.MjModel, robot: Robot, tree: Tree, rig: bool) -> np.ndarray:
    """Write the numbers that the compiler would have refused, and recompute MuJoCo's constants.

    Returns qpos (nq,) at q = 0, where followers are at their offset.
    """
    for body in tree.bodies:
        if body.joint is None:
            continue
        index = model.jnt_bodyid[model.joint(body.joint.name).id]
        model.body_mass[index] = body.mass
        model.body_inertia[index] = body.principal[0]
    for joint in robot.moving_joints:
        if np.isfinite(joint.lower) and joint.mimic is None:
            model.jnt_range[model.joint(joint.name).id] = joint.lower, joint.upper
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    keep_small_offsets(model)
    start = model.qpos0.copy()
    for body in tree.bodies:
        if body.joint is not None and body.joint.leader is not None:
            start[model.joint(body.joint.name).qposadr[0]] = body.joint.offset
    data.qpos[:] = start
    mujoco.mj_fwdPosition(model, data)
    drives.finish(model, robot, data.ten_length, rig)
    return start


def keep_small_offsets(model: mujoco.MjModel) -> None:
    """Let offsets and turns of sites and inertias count, however small.

    `mj_setConst` marks a frame within 1e-6 of its body's, or of its inertia's, as the same. The
    engine then ignores the difference.
    """
    same = mujoco.mjtSameFrame
    rotation_only = {
        same.mjSAMEFRAME_BODY: same.mjSAMEFRAME_BODYROT,
        same.mjSAMEFRAME_INERTIA: same.mjSAMEFRAME_INERTIAROT,
    }
    own = np.zeros((model.nbody, 3)), np.tile((1.0, 0.0, 0.0, 0.0), (model.nbody, 1))
    inertial = model.body_ipos, model.body_iquat
    for codes, frame, bodies in (
        (model.site_sameframe, (model.site_pos, model.site_quat), model.site_bodyid),
        (model.geom_sameframe, (model.geom_pos, model.geom_quat), model.geom_bodyid),
        (model.body_sameframe, inertial, np.arange(model.nbody)),
    ):
        for k, (code, body) in enumerate(zip(codes.tolist(), bodies, strict=True)):
            other = own if code in (same.mjSAMEFRAME_BODY, same.mjSAMEFRAME_BODYROT) else inertial
            moved, turned = (
                np.abs(a[k] - b[body]).max() > ROUNDING for a, b in zip(frame, other, strict=True)
            )
            if turned:
                codes[k] = same.mjSAMEFRAME_NONE
            elif moved:
                codes[k] = rotation_only.get(code, code)


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
    return quaternion
