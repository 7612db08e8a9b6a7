"""The twin: the same robot in MuJoCo, built from the file by a path of its own.

Strict parse for the annotations, yourdfpy for the tree, the inertias and the geometry, then
`mujoco.MjSpec`. No number comes from Pinocchio: what the two engines agree on, they agree on for
independent reasons. MuJoCo's own URDF importer is not used, since it refuses massless links and
drops tendons.

Every link that a joint moves is one body, massless or not. MuJoCo's compiler refuses a moving body
without mass, but its engine has no trouble with one: only the sums beyond a joint count. So bodies
are compiled with a placeholder, and their masses and moments are written afterwards, exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from softdyn.checks import array, number
from softdyn.description.library import find
from softdyn.description.robot import Joint, Robot
from softdyn.description.urdf import parse
from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import InputError, SoftdynError, UrdfError
from softdyn.validation.twin.bodies import STATIC, Body, Freedom, Shape, Tree, read_bodies

INTEGRATORS = {
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
}
# MuJoCo's default stops are so soft that a hanging arm sinks centimetres through them, and its
# default dry friction creeps.
STIFF_SOLREF = (0.002, 1.0)
STIFF_SOLIMP = (0.99, 0.999, 1e-4, 0.5, 2.0)
LARGEST = 1e10  # mjMAXVAL: beyond it MuJoCo calls a state bad
TASK_SITE = "task"
WARNINGS = {
    "BADQPOS": "a position that is not finite or beyond 1e10",
    "BADQVEL": "a velocity that is not finite or beyond 1e10",
    "BADQACC": "an acceleration that is not finite or beyond 1e10",
    "BADCTRL": "an input that is not finite",
    "INERTIA": "a mass matrix that is close to singular",
    "CONTACTFULL": "more contacts than fit in memory",
    "CNSTRFULL": "more constraints than fit in memory",
}


class SimulationError(SoftdynError, ArithmeticError):
    """MuJoCo reported a state it cannot go on from.

    Attributes
    ----------
    time : simulated time (s) at which it was noticed.
    reason : what MuJoCo warned of.
    """

    def __init__(self, time: float, reason: str) -> None:
        self.time, self.reason = time, reason
        super().__init__(f"simulation stopped at t = {time:.6g} s: {reason}")


class Twin:
    """A MuJoCo model of an annotated URDF with its data.

    Parameters
    ----------
    source : a model, a parsed robot, or whatever `softdyn.load` takes.
    timestep : integration step (s).
    integrator : ``implicitfast``, ``implicit``, ``euler`` or ``rk4``.
    limits : whether joint limits act, as stiff stops.
    contacts : whether the links' collision primitives touch; neighbours never do.
    friction : whether the joints' dry friction acts.

    Attributes
    ----------
    model, data : MuJoCo's; the state may be read and written there.
    robot : the parsed description.
    followers : by name, the mimic joints, which MuJoCo holds as joints of their own: stiff equality
        constraints tie them to their leaders.
    floating : whether the first body moves freely.
    joint_names : order of qpos and qvel: depth first, siblings in the file's order.
    skipped : collision shapes left out, each with the reason.

    Raises
    ------
    UrdfError
        When yourdfpy or MuJoCo refuses the file.
    InputError
        For an unknown integrator or a step that is not positive.
    """

    def __init__(
        self,
        source: SoftModel | Robot | str | Path,
        *,
        timestep: float = 5e-4,
        integrator: str = "implicitfast",
        limits: bool = True,
        contacts: bool = False,
        friction: bool = False,
    ) -> None:
        if integrator not in INTEGRATORS:
            raise InputError("integrator", " or ".join(INTEGRATORS), repr(integrator))
        silence()
        self.robot = _robot(source)
        self.floating = self.robot.floating
        tree = read_bodies(self.robot.path, mended=self.robot.mended, floating=self.floating)
        self.skipped = tree.skipped
        moved = [body.joint for body in tree.bodies if body.joint is not None]
        self.followers = {joint.name: joint for joint in moved if joint.leader is not None}
        spec = _specify(self.robot, tree)
        spec.option.timestep = number("timestep", timestep, above=0.0)
        spec.option.integrator = INTEGRATORS[integrator]
        spec.option.disableflags = disabled(limits=limits, contacts=contacts, friction=friction)
        try:
            self.model = spec.compile()
        except ValueError as error:
            path = self.robot.path
            raise UrdfError(path, "<robot>", "a robot that MuJoCo compiles", error) from error
        self.data = mujoco.MjData(self.model)
        self._rest = _finish(self.model, self.data, self.robot, tree)
        self.joint_names = tuple(self.model.joint(i).name for i in range(self.model.njnt))
        self.task_site = self.model.site(TASK_SITE).id
        self.reset()

    @property
    def qpos(self) -> np.ndarray:
        """Joint coordinates (nq,), a copy; a continuous joint's angle is not wrapped."""
        return self.data.qpos.copy()

    @property
    def qvel(self) -> np.ndarray:
        """Joint velocities (nv,), a copy."""
        return self.data.qvel.copy()

    @property
    def time(self) -> float:
        """Simulated time (s)."""
        return float(self.data.time)

    @property
    def tip(self) -> np.ndarray:
        """Position (3,) of the task frame in the world (m) in the present state."""
        mujoco.mj_kinematics(self.model, self.data)
        return self.data.site_xpos[self.task_site].copy()

    def reset(self) -> None:
        """Back to q = 0 at rest and t = 0, solver memory and warnings forgotten."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self._rest
        mujoco.mj_forward(self.model, self.data)

    def set_state(self, qpos: np.ndarray, qvel: np.ndarray, time: float = 0.0) -> None:
        """Start from a state, solver memory and warnings forgotten.

        Parameters
        ----------
        qpos, qvel : (nq,), (nv,) in the order of `joint_names`; nq is nv but with a floating base.
        time : clock (s).

        Raises
        ------
        InputError
            Wrong shape, a number that is not finite, or one beyond ±1e10: MuJoCo by itself would
            silently start from another state.
        """
        qpos = self._vector("qpos", qpos, self.model.nq)
        qvel = self._vector("qvel", qvel, self.model.nv)
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:], self.data.time = qpos, qvel, time
        mujoco.mj_forward(self.model, self.data)
        check_warnings(self.data)

    def advance(self, u: np.ndarray, steps: int = 1) -> None:
        """Integrate `steps` steps under the held input `u` (nu,), clamped to its bounds by MuJoCo.

        What else is in `data` when it returns belongs to the state one step before: MuJoCo computes
        it at the start of a step.

        Raises
        ------
        InputError
            An input of the wrong shape or not finite.
        SimulationError
            MuJoCo warned: the state blew up, or contacts did not fit. `data` is left as it is.
        """
        self.data.ctrl[:] = array("u", u, (self.model.nu,))
        mujoco.mj_step(self.model, self.data, steps)
        check_warnings(self.data)

    def _vector(self, name: str, value: np.ndarray, size: int) -> np.ndarray:
        vector = array(name, value, (size,))
        if np.abs(vector).max(initial=0.0) > LARGEST:
            raise InputError(name, f"numbers within ±{LARGEST:g}", vector)
        return vector


def disabled(*, limits: bool, contacts: bool, friction: bool) -> int:
    """MuJoCo's disable flags; it never resets a state by itself."""
    flags = mujoco.mjtDisableBit
    off = int(flags.mjDSBL_AUTORESET)
    off |= 0 if limits else int(flags.mjDSBL_LIMIT)
    off |= 0 if contacts else int(flags.mjDSBL_CONTACT)
    off |= 0 if friction else int(flags.mjDSBL_FRICTIONLOSS)
    return off


def silence() -> None:
    """Stop MuJoCo from printing and from writing MUJOCO_LOG.TXT into the working directory.

    For the whole process, since its log is the process's. Every message about a state is counted in
    ``data.warning`` too, see `check_warnings`; the rest, like a line search that met a plateau of
    its cost, says nothing about the result.
    """
    log = mujoco.MjLogConfig.get()
    log.logto_console = log.logto_file = False
    log.set()


def check_warnings(data: mujoco.MjData) -> None:
    """Raise `SimulationError` when MuJoCo has warned since the data was last reset."""
    raised = data.warning.number
    if np.count_nonzero(raised):
        kinds = list(mujoco.mjtWarning.__members__)
        name = kinds[int(np.argmax(raised > 0))].removeprefix("mjWARN_")
        raise SimulationError(float(data.time), WARNINGS.get(name, name))


def _robot(source: SoftModel | Robot | str | Path) -> Robot:
    if isinstance(source, SoftModel):
        return source.robot
    return source if isinstance(source, Robot) else parse(find(source))


def _specify(robot: Robot, tree: Tree) -> mujoco.MjSpec:
    """Everything but the numbers that MuJoCo's compiler would refuse or reinterpret."""
    spec = mujoco.MjSpec()
    spec.modelname = robot.name
    compiler, option = spec.compiler, spec.option
    compiler.degree = False
    compiler.autolimits = False
    compiler.boundmass = compiler.boundinertia = 0.0
    compiler.balanceinertia = compiler.fusestatic = compiler.discardvisual = False
    compiler.alignfree = False
    compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    option.gravity = (0.0, 0.0, -9.81)
    option.density = option.viscosity = 0.0
    option.wind = (0.0, 0.0, 0.0)
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.iterations, option.tolerance = 100, 1e-12
    option.ls_iterations, option.ls_tolerance = 50, 1e-3
    option.enableflags = int(mujoco.mjtEnableBit.mjENBL_ENERGY)

    bodies = [spec.worldbody]
    joints = {joint.name: joint for joint in robot.joints}
    for index, body in enumerate(tree.bodies):
        if body.joint is not None:
            bodies.append(_add_body(bodies[body.parent or STATIC], body))
            if body.joint.kind == "free":
                bodies[index].add_freejoint().name = body.joint.name
            else:
                _add_joint(bodies[index], body.joint, joints[body.joint.name])
            if body.joint.leader is not None:
                _tie(spec, body.joint)
        for shape in body.shapes:
            _add_geom(bodies[index], shape)
    for a, b in _neighbours(tree.bodies):
        exclude = spec.add_exclude()
        exclude.bodyname1, exclude.bodyname2 = bodies[a].name, bodies[b].name
    _add_tendons(spec, robot, tree, bodies)
    _add_site(bodies, tree, robot.task, np.zeros(3), TASK_SITE)
    return spec


def _add_body(parent: mujoco.MjsBody, body: Body) -> mujoco.MjsBody:
    added = parent.add_body()
    # MuJoCo's own body is called world; a moving link may not be
    added.name = body.link if body.link != "world" else "link:world"
    added.pos, added.quat = body.pose[:3, 3], _quaternion(body.pose[:3, :3])
    # The frame of the inertia is the body's own; mass and moments follow in _finish, since the
    # compiler refuses massless bodies, point masses, and plates whose a + b is c up to rounding.
    added.explicitinertial = True
    added.mass, added.inertia = 1.0, (1.0, 1.0, 1.0)
    added.ipos, added.iquat = body.com, _quaternion(body.principal[1])
    return added


def _add_joint(body: mujoco.MjsBody, freedom: Freedom, joint: Joint) -> None:
    slides = freedom.kind == "slide"
    added = body.add_joint()
    added.name = freedom.name
    added.type = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
    added.pos, added.axis = (0.0, 0.0, 0.0), freedom.axis
    added.stiffness = [joint.stiffness, 0.0, 0.0]  # linear; then the coefficients of q² and q³
    added.damping = [joint.damping, 0.0, 0.0]
    added.springref, added.ref = joint.rest, 0.0
    added.armature, added.frictionloss = joint.armature, joint.friction
    added.limited = int(np.isfinite(joint.lower) and freedom.leader is None)
    added.range = (-1.0, 1.0)  # the file's may be a single point: see _finish
    added.margin = 0.0
    added.solref_limit, added.solimp_limit = STIFF_SOLREF, STIFF_SOLIMP
    added.solref_friction, added.solimp_friction = STIFF_SOLREF, STIFF_SOLIMP


def _tie(spec: mujoco.MjSpec, freedom: Freedom) -> None:
    """Hold a follower at multiplier · leader + offset, as stiffly as the stops."""
    tie = spec.add_equality()
    tie.type, tie.objtype = mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtObj.mjOBJ_JOINT
    tie.name1, tie.name2 = freedom.name, freedom.leader
    tie.data[:] = 0.0
    tie.data[:2] = freedom.offset, freedom.multiplier
    tie.solref, tie.solimp = STIFF_SOLREF, STIFF_SOLIMP


def _add_geom(body: mujoco.MjsBody, shape: Shape) -> None:
    kinds = mujoco.mjtGeom
    geom = body.add_geom()
    geom.type = {
        "box": kinds.mjGEOM_BOX,
        "cylinder": kinds.mjGEOM_CYLINDER,
        "sphere": kinds.mjGEOM_SPHERE,
    }[shape.kind]
    geom.size = (*shape.size, 0.0, 0.0)[:3]
    geom.pos, geom.quat = shape.pose[:3, 3], _quaternion(shape.pose[:3, :3])
    geom.mass = 0.0
    geom.contype = geom.conaffinity = 1


def _neighbours(bodies: Sequence[Body]) -> list[tuple[int, int]]:
    """Pairs of bodies that a joint holds together: they overlap at it, so they never collide.

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


def _add_tendons(
    spec: mujoco.MjSpec, robot: Robot, tree: Tree, bodies: list[mujoco.MjsBody]
) -> None:
    for tendon in robot.tendons:
        added = spec.add_tendon()
        added.name = tendon.name
        added.stiffness = [tendon.stiffness, 0.0, 0.0]
        added.damping = [tendon.damping, 0.0, 0.0]
        added.springlength = (0.0, 0.0)  # never MuJoCo's default, which is the length at springref
        added.limited, added.frictionloss, added.armature = 0, 0.0, 0.0
        for term in tendon.terms:
            added.wrap_joint(term.joint, term.coef)
        for k, site in enumerate(tendon.sites):
            name = f"{tendon.name}:{k}"
            _add_site(bodies, tree, site.link, site.xyz, name)
            added.wrap_site(name)
    for actuator in robot.actuators:
        motor = spec.add_actuator()
        motor.name, motor.target = actuator.name, actuator.tendon
        motor.trntype = mujoco.mjtTrn.mjTRN_TENDON
        motor.set_to_motor()
        motor.gear = (actuator.gear, 0.0, 0.0, 0.0, 0.0, 0.0)
        motor.ctrllimited, motor.forcelimited = 1, 0
        motor.ctrlrange = (-1.0, 1.0)  # see _finish


def _add_site(
    bodies: list[mujoco.MjsBody], tree: Tree, link: str, point: np.ndarray, name: str
) -> None:
    """A point of a link as a site of the body that carries the link."""
    index, pose = tree.place[link]
    site = bodies[index].add_site()
    site.name, site.pos = name, pose[:3, :3] @ point + pose[:3, 3]


def _finish(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, tree: Tree) -> np.ndarray:
    """Write the numbers that the compiler would have refused; derive MuJoCo's constants anew.

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
    for actuator in robot.actuators:
        index = model.actuator(actuator.name).id
        model.actuator_ctrlrange[index] = actuator.lower, actuator.upper
    mujoco.mj_setConst(model, data)
    start = model.qpos0.copy()
    for body in tree.bodies:
        if body.joint is not None and body.joint.leader is not None:
            start[model.joint(body.joint.name).qposadr[0]] = body.joint.offset
    mujoco.mj_resetData(model, data)
    data.qpos[:] = start
    mujoco.mj_fwdPosition(model, data)
    for tendon in robot.tendons:
        index = model.tendon(tendon.name).id
        rest = data.ten_length[index] if tendon.rest is None else tendon.rest
        model.tendon_lengthspring[index] = rest
    return start


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
    return quaternion
