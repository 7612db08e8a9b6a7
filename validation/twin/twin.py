"""The twin: the same robot in MuJoCo, built from the file independently of the model.

The strict parser reads the annotations, yourdfpy reads the tree, the inertias and the geometry, and
`mujoco.MjSpec` builds the model. No number comes from Pinocchio, so that an agreement of the two
engines is independent evidence. MuJoCo's own URDF importer is not used, because it refuses massless
links and drops tendons.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from softdyn.checks import array
from softdyn.copies import Separate
from softdyn.description.library import find
from softdyn.description.robot import Robot
from softdyn.description.urdf import parse
from softdyn.dynamics.mimic import build as build_model
from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import InputError, SoftdynError
from softdyn.safety.obstacles import Obstacle
from softdyn.validation.twin.bodies import read_bodies
from softdyn.validation.twin.build import TASK_SITE, build
from softdyn.validation.twin.cable_friction import CableFriction
from softdyn.validation.twin.chamber_areas import ChamberAreas
from softdyn.validation.twin.integrators import Integrator, integrator_of
from softdyn.validation.twin.memory import MotionMemory
from softdyn.validation.twin.obstacles import Contacts, add_obstacles
from softdyn.validation.twin.own_forces import OwnForces
from softdyn.validation.twin.rotors import coupling_tendons
from softdyn.validation.twin.settings import Settings, silence
from softdyn.validation.twin.state_map import StateMap

LARGEST = 1e10  # mjMAXVAL: beyond it MuJoCo calls a state bad
WARNINGS = {
    "BADQPOS": "a position that is not finite or beyond 1e10",
    "BADQVEL": "a velocity that is not finite or beyond 1e10",
    "BADQACC": "an acceleration that is not finite or beyond 1e10",
    "BADCTRL": "an input that is not finite",
    "INERTIA": "a mass matrix that is close to singular, or below MuJoCo's floor of 1e-15 kg m²",
    "CONTACTFULL": "more contacts than fit in memory",
    "CNSTRFULL": "more constraints than fit in memory",
}


class SimulationError(SoftdynError, ArithmeticError):
    """MuJoCo reported a state from which it cannot continue.

    Attributes
    ----------
    time : float
        Simulated time (s) at which it was noticed.
    reason : str
        MuJoCo's warning.
    """

    def __init__(self, time: float, reason: str) -> None:
        self.time, self.reason = time, reason
        super().__init__(f"simulation stopped at t = {time:.6g} s: {reason}")


class Twin(Separate):
    """A MuJoCo model of an annotated URDF with its data.

    Parameters
    ----------
    source : SoftModel or Robot or str or Path
        A model, a parsed robot, or any argument of `softdyn.load`.
    timestep : float
        Integration step (s).
    integrator : Integrator or str
        ``implicitfast``, ``implicit``, ``euler`` or ``rk4``.
    limits : bool
        Whether joint limits act, as stiff stops.
    contacts : bool
        Whether the links' collision primitives can touch; neighbours never touch.
    friction : bool
        Whether the joints' dry friction acts, and the friction of cables on their guides.
    rig : bool
        Whether the file's rig is there: commands of lengths, lag and delay of the inputs, friction
        of cables, sensors. Without it every input is a force that acts at once.
    obstacles : sequence of Obstacle
        Obstacles in the world; links touch those with `contact`.

    Attributes
    ----------
    model, data : mujoco.MjModel, mujoco.MjData
        The state may be read and written in `data`.
    robot : Robot
        The parsed description.
    followers : dict[str, TwinJoint]
        The mimic joints by name. They are joints of their own in MuJoCo, and stiff equality
        constraints tie them to their leaders.
    floating : bool
        Whether the first body moves freely.
    rest : np.ndarray, (nq,)
        qpos at q = 0.
    joint_names : tuple[str, ...]
        Order of qpos and qvel: depth first, siblings in the file's order.
    task : tuple[int, np.ndarray]
        Body that carries the task frame, and its origin there (3,).
    inputs : np.ndarray, (MuJoCo's nu, nu)
        MuJoCo's inputs for unit inputs of the robot.
    slack : np.ndarray
        MuJoCo's actuators that are the springs and dampers of slack tendons.
    tendons : np.ndarray, (tendons,)
        Index of each tendon of the robot among MuJoCo's tendons.
    cable_friction : CableFriction or None
        The friction of the robot's cables, if it acts.
    areas : ChamberAreas or None
        The areas of chambers that change with their stretch, if there are any.
    skipped : tuple[str, ...]
        Collision shapes left out, each with the reason.
    touching : Contacts or None
        The contacts with solid obstacles, if there are any.
    memory : MotionMemory
        The Maxwell branches of the joints. Every start is at rest: their torques are zero.

    Raises
    ------
    UrdfError
        yourdfpy or MuJoCo refuses the file.
    InputError
        The integrator is unknown, or the step is not positive.
    """

    def __init__(
        self,
        source: SoftModel | Robot | str | Path,
        *,
        timestep: float = 5e-4,
        integrator: Integrator | str = Integrator.IMPLICITFAST,
        limits: bool = True,
        contacts: bool = False,
        friction: bool = False,
        rig: bool = False,
        obstacles: Sequence[Obstacle] = (),
    ) -> None:
        silence()
        self.obstacles = tuple(obstacles)
        self.robot = _robot(source)
        rubs = (rig or friction) and any(tendon.rubs for tendon in self.robot.tendons)
        scheme = integrator_of(integrator)
        settings = Settings(
            timestep,
            scheme,
            limits,
            contacts,
            friction or rubs,
            self.robot.gravity,
            self.robot.fluid,
        )
        self.floating = self.robot.floating
        text = self.robot.text if self.robot.mended else ""
        tree = read_bodies(self.robot.path, mended=text, floating=self.floating)
        self.skipped, self._tree = tree.skipped, tree
        moved = [body.joint for body in tree.bodies if body.joint is not None]
        self.followers = {joint.name: joint for joint in moved if joint.leader is not None}
        self.model, self.rest = build(self.robot, tree, settings, self._amend, rig=rig, rubs=rubs)
        self.data = mujoco.MjData(self.model)
        self.joint_names = tuple(self.model.joint(i).name for i in range(self.model.njnt))
        site = self.model.site(TASK_SITE)
        self.task_site = site.id
        self.task: tuple[int, np.ndarray] = int(self.model.site_bodyid[site.id]), site.pos.copy()
        self.nu = len(self.robot.actuators)
        self.inputs = np.eye(self.model.nu, self.nu)
        self.slack = np.arange(self.nu, self.model.nu)
        self.tendons = np.arange(len(self.robot.tendons))
        touched = Contacts(self.model, self.obstacles)
        self.touching = touched if touched.solid else None
        self.cable_friction: CableFriction | None = None
        if rubs:
            self.cable_friction = CableFriction(self.model, self.robot)
            if not friction:
                self.model.dof_frictionloss[:] = 0.0
        changing = any(one.area_growth for one in self.robot.actuators)
        self.areas = ChamberAreas(self.robot, self.model) if changing else None
        self._own: OwnForces | None = None
        self.memory = MotionMemory(self.model, self.robot)
        staged = scheme is Integrator.RK4 and (self.memory or changing)
        if self.robot.forces or self.robot.balls or staged:
            self._own = OwnForces(
                self.robot, self.model, self.data, StateMap(build_model(self.robot), self),
                self.rest, self.memory, self.areas,
            )  # fmt: skip
        self._lost = coupling_tendons(self.model)
        self.reset()

    def amend(self, spec: mujoco.MjSpec) -> None:
        """Change the specification before compiling; a plant with other shapes overrides it."""

    def _amend(self, spec: mujoco.MjSpec) -> None:
        self.amend(spec)
        if self.obstacles:
            add_obstacles(spec, self.obstacles, self.robot, self._tree)

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
        """Return to q = 0 at rest and t = 0, and clear the solver's warm start and warnings."""
        self._reset()
        self.data.qpos[:] = self.rest
        self._forward()

    def set_state(self, qpos: np.ndarray, qvel: np.ndarray, time: float = 0.0) -> None:
        """Set a state, and clear the solver's warm start and warnings.

        Parameters
        ----------
        qpos, qvel : np.ndarray, (nq,), (nv,)
            In the order of `joint_names`; nq = nv without a floating base.
        time : float
            Clock (s).

        Raises
        ------
        InputError
            The shape is wrong, or a number is not finite or beyond ±1e10. MuJoCo itself would
            silently start from another state. The armature of a tendon couples branches: see
            `softdyn.validation.twin.rotors`.
        """
        self._check_rotors()
        qpos = self._vector("qpos", qpos, self.model.nq)
        qvel = self._vector("qvel", qvel, self.model.nv)
        self._reset()
        self.data.qpos[:], self.data.qvel[:], self.data.time = qpos, qvel, time
        self._forward()
        check_warnings(self.data)

    def hold(self, commands: np.ndarray, lengths: np.ndarray) -> None:
        """Begin with commands that have been held for long.

        Parameters
        ----------
        commands : np.ndarray, (nu,)
            The commands that are on their way and in the lags, in the file's units.
        lengths : np.ndarray, (nu,)
            Free length (m) of each winch that a velocity commands.
        """
        model, data = self.model, self.data
        data.ctrl[: self.nu] = commands
        for k in range(self.nu):
            samples = model.actuator_history[k, 0]
            if samples:
                values = np.full((samples, 1), commands[k])
                mujoco.mj_initCtrlHistory(model, data, k, None, values)
            if model.actuator_actadr[k] >= 0:
                integrates = model.actuator_dyntype[k] == mujoco.mjtDyn.mjDYN_INTEGRATOR
                data.act[model.actuator_actadr[k]] = (lengths if integrates else commands)[k]
        self._hold_readings()
        self.refresh()

    def _hold_readings(self) -> None:
        """Late sensors have read the present state for long; MuJoCo's would have read zeros."""
        model, data = self.model, self.data
        delays = model.sensor_delay.copy()
        model.sensor_delay[:] = 0
        self.refresh()
        now = data.sensordata.copy()
        model.sensor_delay[:] = delays
        for k, (samples, _) in enumerate(model.sensor_history):
            if samples:
                values = now[model.sensor_adr[k] :][: model.sensor_dim[k]]
                phase = data.history[model.sensor_historyadr[k]]
                held = np.tile(values, (samples, 1))
                mujoco.mj_initSensorHistory(model, data, k, None, held, phase)

    def refresh(self) -> None:
        """Compute the derived quantities of the present state; the next step is not changed."""
        start = self.data.qacc_warmstart.copy()
        self._forward()
        self.data.qacc_warmstart[:] = start

    @property
    def free_lengths(self) -> np.ndarray:
        """Free length (m) of each winch that a velocity commands, (nu,); NaN of other inputs."""
        model, found = self.model, np.full(self.nu, np.nan)
        for k in range(self.nu):
            if model.actuator_dyntype[k] == mujoco.mjtDyn.mjDYN_INTEGRATOR:
                found[k] = self.data.act[model.actuator_actadr[k]]
        return found

    def advance(self, u: np.ndarray, steps: int = 1) -> None:
        """Integrate under a held input.

        Afterwards `data` holds the new state. Its derived quantities belong to the state one step
        before, because MuJoCo computes them at the start of a step.

        Parameters
        ----------
        u : np.ndarray, (nu,)
            The input, clamped to its bounds by MuJoCo.
        steps : int
            Number of integration steps.

        Raises
        ------
        InputError
            The input has the wrong shape or is not finite; a force of one's own cannot be used, or
            is too stiff for the step; the armature of a tendon couples branches.
        SimulationError
            MuJoCo warned that the state diverged or that contacts did not fit. `data` is left as it
            is.
        """
        self._check_rotors()
        self.data.ctrl[: self.nu] = array("u", u, (self.nu,))
        plain = self.cable_friction is None and self._own is None
        if plain and self.areas is None and not self.memory:
            mujoco.mj_step(self.model, self.data, steps)
        else:
            if self._own is not None:
                self._own.check_step()
            for _ in range(steps):
                if self.cable_friction is not None:
                    self.cable_friction.update(self.data)
                self._step()
        check_warnings(self.data)

    def _check_rotors(self) -> None:
        """Refuse to move a robot whose mass matrix MuJoCo does not hold."""
        if self._lost:
            expected = "joints of one branch with an armature: MuJoCo couples no others"
            raise InputError(f"tendon {self._lost[0]!r}", expected, 'others; plant="model" does')

    def _step(self) -> None:
        """One step with one's own forces, branches and hysteresis."""
        memory, data = self.memory, self.data
        if memory:
            before = memory.places(data.qpos)
        if self._own is None:
            self._act()
            mujoco.mj_step(self.model, data)
        else:
            self._own.step()
        if memory:
            memory.follow(before, data.qpos, branches=self._own is None or not self._own.staged)

    def _act(self) -> None:
        """Let areas and remembered torques of the present state act."""
        if self.areas is not None:
            self.areas.update(self.data)
        if self.memory:
            self.data.qfrc_applied[:] = self.memory.force()

    def _forward(self) -> None:
        """Compute the derived quantities of the present state."""
        if self._own is not None:
            self._own.update()
        else:
            self._act()
        mujoco.mj_forward(self.model, self.data)

    def _reset(self) -> None:
        mujoco.mj_resetData(self.model, self.data)
        if self._own is not None:
            self._own.forget()
        self.memory.clear()
        if self.cable_friction is not None:
            self.cable_friction.clear()

    def _vector(self, name: str, value: np.ndarray, size: int) -> np.ndarray:
        vector = array(name, value, (size,))
        if np.abs(vector).max(initial=0.0) > LARGEST:
            raise InputError(name, f"numbers within ±{LARGEST:g}", vector)
        return vector


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
