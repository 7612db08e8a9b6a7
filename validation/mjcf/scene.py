"""A user's MJCF with its scene, as the plant of a controller on the URDF's analytic model."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from softdyn.checks import array
from softdyn.controllers.controller import KnownRig
from softdyn.copies import KeepsMaking, Separate
from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import InputError
from softdyn.files import existing_folder
from softdyn.toml_table import TomlTable
from softdyn.validation.loop.settings import SCENE
from softdyn.validation.mjcf.comparison.comparison import compare_neutral
from softdyn.validation.mjcf.comparison.from_mjcf import from_mjcf
from softdyn.validation.mjcf.comparison.from_urdf import from_urdf
from softdyn.validation.mjcf.comparison.neutral import WORLD, Neutral
from softdyn.validation.mjcf.comparison.side import Side
from softdyn.validation.mjcf.mjcf_file import Contents
from softdyn.validation.mjcf.scene_inputs import map_cables, map_inputs
from softdyn.validation.mjcf.servos import Servos, obstacle
from softdyn.validation.mjcf.transform import Transform
from softdyn.validation.twin.bodies import TwinJoint
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import check_warnings

# kinds of causes; what only the scene has of them moves it, and the model knows nothing of it
UNKNOWN = ("feature", "fluid", "wrench", "gravity", "friction", "armature", "coupling")
FIELDS = ("feature", "fluid")  # whose `where` is a field of MuJoCo's


class Scene(KeepsMaking, Separate):
    """A MuJoCo model from a user's file, driven in the coordinates of our model.

    Everything in the file acts: its contacts, objects, servos, gravity, integrator. States and
    inputs are mapped by the result of `compare`: joints by name or kinematics, with sense and zero,
    and inputs by the force that they make. Objects, and joints that the model does not have, begin
    at the file's ``qpos0``. Actuators that no input drives stay at zero. A position or velocity
    servo gets the command that makes the asked force at the state of the command; see `Servos`.

    Parameters
    ----------
    model : SoftModel
        The controller's model.
    source : str, Path or Side
        An MJCF. It is read strictly: includes and meshes from its own folder only, or from `root`.
    timestep : float, optional
        Integration step (s); the file's by default.
    mapping : Mapping[str, str], optional
        Joints of the model → joints of the scene, for joints that would be matched wrongly.
    root : str or Path, optional
        A folder below which includes and meshes may lie, too.

    Attributes
    ----------
    model, data : mujoco.MjModel, mujoco.MjData
        MuJoCo's model and data. path : Path The file.
    robot : Robot
        The model's.
    comparison : Comparison
        Differences of the model's file (A) and the scene (B).
    states : StateMap
        The model's states ↔ MuJoCo's.
    inputs : np.ndarray, (MuJoCo's nu, nu)
        ctrl = inputs @ u; for a servo without its bias.
    idle : tuple[str, ...]
        Actuators that no input drives.
    slack : np.ndarray
        Actuators that are the springs and dampers of slack tendons, as in `Twin`.
    known : KnownRig
        The longest lag and delay of the actuators that the inputs drive.
    joint_names, followers, floating, rest, task, tendons
        As in `Twin`; -1 for a tendon that the scene does not have.

    Raises
    ------
    UrdfError
        For a file that cannot be used.
    InputError
        The scene lacks joints or inputs of the model.
    """

    def __init__(
        self,
        model: SoftModel,
        source: str | Path | Side,
        *,
        timestep: float | None = None,
        mapping: Mapping[str, str] | None = None,
        root: str | Path | None = None,
    ) -> None:
        above = None if root is None else existing_folder("root", root)
        side = source if isinstance(source, Side) else Side(Path(source), Contents(root=above))
        self.path = side.path
        self.model = copy.copy(side.scene)
        ours, theirs = from_urdf(model.robot), from_mjcf(self.path, self.model)
        self.comparison = compare_neutral(
            ours, theirs, mapping=None if mapping is None else dict(mapping)
        )
        matched = self.comparison.matched
        self.robot = robot = model.robot
        needed = model.joint_names[6:] if robot.floating else model.joint_names
        gone = [joint for joint in needed if joint not in matched]
        if balls := [ball.name for ball in robot.balls if {*ball.joints} & {*gone}]:
            expected = "hinges, because a plant of your own cannot have ball joints"
            raise InputError(str(self.path), expected, ", ".join(balls))
        if gone:
            expected = f"the joints of {model.name!r}"
            raise InputError(str(self.path), expected, f"none for {', '.join(gone)}")
        self.floating = robot.floating
        self._check_base(theirs)
        self.joint_names = tuple(part.name for part in theirs.parts)
        number = {name: k for k, name in enumerate(self.joint_names)}
        self.followers = {
            joint.name: TwinJoint(
                joint.name, "", joint.axis, joint.mimic.leader, joint.mimic.multiplier,
                joint.mimic.offset,
            )
            for joint in robot.followers
            if joint.mimic is not None and joint.name in matched
        }  # fmt: skip
        self.rest = self.model.qpos0.copy()
        called = {ours: number[other] for ours, other in matched.items()}
        self._zero = model.q0
        self.states = StateMap(model, self, called, self.comparison.turns)
        self._drive(ours, theirs)
        self.known = self._known()
        self.tendons = map_cables(ours, theirs, matched, self.comparison.turns)
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        if timestep is not None:
            self.model.opt.timestep = timestep
        self.data = mujoco.MjData(self.model)
        self.task = self._find_task(ours, called)

    @property
    def unknown(self) -> tuple[str, ...]:
        """What acts in the scene and is not in the model, e.g. ``opt.density 1000``."""
        return tuple(
            f"{cause.where if cause.kind in FIELDS else f'{cause.kind} of {cause.where}'} "
            f"{_said(cause.b)}"
            for cause in self.comparison.causes
            if cause.kind in UNKNOWN and cause.a in (None, 0.0) and cause.b is not None
        )

    @property
    def timestep(self) -> float:
        """Integration step (s)."""
        return float(self.model.opt.timestep)

    @timestep.setter
    def timestep(self, value: float) -> None:
        self.model.opt.timestep = value

    @property
    def contacts(self) -> bool:
        """Whether anything can touch."""
        off = int(mujoco.mjtDisableBit.mjDSBL_CONTACT) & int(self.model.opt.disableflags)
        return not off and bool(self.model.geom_contype.any())

    def set_state(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Set a state of the whole scene, as in `Twin.set_state`."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = array("qpos", qpos, (self.model.nq,))
        self.data.qvel[:] = array("qvel", qvel, (self.model.nv,))
        mujoco.mj_forward(self.model, self.data)
        self._servos.hold(self.data, self._no_force)
        check_warnings(self.data)

    def advance(self, u: np.ndarray, steps: int = 1) -> None:
        """Integrate under a held input of the model, as in `Twin.advance`."""
        ctrl = self.inputs @ u
        self.data.ctrl[:] = self._servos.commands(self.data, ctrl, steps * self.timestep)
        mujoco.mj_step(self.model, self.data, steps)
        check_warnings(self.data)

    def to_dict(self) -> dict[str, Any]:
        """The mapping as plain data."""
        return {
            "file": str(self.path),
            "passed": self.comparison.passed,
            "comparison": self.comparison.to_dict(),
            "inputs": self.inputs.tolist(),
            "idle": list(self.idle),
        }

    def __str__(self) -> str:
        idle = f"\nactuators at zero: {', '.join(self.idle)}" if self.idle else ""
        return f"{self.comparison}{idle}"

    def _drive(self, ours: Neutral, theirs: Neutral) -> None:
        """Map the inputs."""
        model, numbers = self.model, [motor.number for motor in theirs.motors]
        found = map_inputs(
            ours, theirs, self.comparison.matched, self.comparison.turns,
            [obstacle(model, k) for k in numbers],
        )  # fmt: skip
        self.inputs, self.idle = np.zeros((model.nu, len(ours.motors))), found.idle
        self.slack = np.setdiff1d(np.arange(model.nactuator), numbers)
        driven = [k for k, row in zip(numbers, found.matrix, strict=True) if row.any()]
        for motor, row in zip(theirs.motors, found.matrix, strict=True):
            gain = (
                model.actuator_gainprm[motor.number, 0]
                if row.any() and not motor.takes_force
                else 1.0
            )
            self.inputs[model.actuator_ctrladr[motor.number]] = row / gain
        self._servos = Servos(model, np.array(driven, int))
        lower, upper = np.array([(motor.lower, motor.upper) for motor in ours.motors] or [(0, 0)]).T
        self._no_force = self.inputs @ np.clip(0.0, lower, upper)[: len(ours.motors)]

    def _known(self) -> KnownRig:
        model, driven = self.model, np.abs(self.inputs).sum(axis=1) > 0
        dynamics = mujoco.mjtDyn
        lags = np.isin(model.actuator_dyntype, (dynamics.mjDYN_FILTER, dynamics.mjDYN_FILTEREXACT))
        lag = model.actuator_dynprm[driven & lags, 0].max(initial=0.0)
        return KnownRig(float(lag), float(model.actuator_delay[driven].max(initial=0.0)))

    def _find_task(self, ours: Neutral, called: dict[str, int]) -> tuple[int, np.ndarray]:
        """The body that carries our task frame, and the frame's origin in it, found at our zero."""
        names = {part.link: k for k, part in enumerate(ours.parts)}
        part, pose = -1, Transform()
        if (task := self.robot.task) in names:
            part, pose = names[task], ours.parts[names[task]].pose
        elif task in ours.frames:
            part, pose = ours.frames[task].part, ours.frames[task].pose
        while part != WORLD and ours.parts[part].name not in called:
            part = ours.parts[part].parent
        if part == WORLD:
            return 0, pose.translation
        body = int(self.model.jnt_bodyid[called[ours.parts[part].name]])
        q = np.zeros(self.states.ties.shape[1])
        self.data.qpos[:] = self.states.to_twin(self._zero, q)[0]
        mujoco.mj_kinematics(self.model, self.data)
        there = self.data.xmat[body].reshape(3, 3).T
        return body, there @ (pose.translation - self.data.xpos[body])

    def _check_base(self, scene: Neutral) -> None:
        """Refuse a base that floats in one file only, or whose frames differ."""
        matched = self.comparison.matched
        stands = {
            scene.parts[root].kind == "free"
            for root in scene.children(WORLD)
            if any(scene.parts[k].name in matched.values() for k in scene.subtree(root))
        }
        if self.floating != (True in stands):
            kinds = ("a fixed base", "a floating one")
            raise InputError(
                str(self.path), kinds[self.floating] + ", as the model's", kinds[True in stands]
            )
        moved = [cause for cause in self.comparison.causes if cause.kind == "base"]
        if self.floating and moved:
            raise InputError(str(self.path), "the model's frame of the base", moved[0].detail)


def _said(value: Any) -> str:
    """A value of a cause as text."""
    numbers = value if isinstance(value, list | tuple) else [value]
    return " ".join(f"{x:g}" if isinstance(x, float | int) else str(x) for x in numbers)


def scene_of(model: SoftModel, given: str | Path | Mapping[str, Any]) -> Scene:
    """A user's MJCF as a plant, from its path, or from a table as `RunOptions.table` has it.

    Raises
    ------
    InputError, UrdfError
        As of `Scene`.
    """
    table = TomlTable(given if isinstance(given, Mapping) else {SCENE: given}, "plant")
    values = table.rest((SCENE, "mapping", "timestep", "root", "reads"))
    values.pop("reads", None)  # the files that a record names beside it
    return Scene(model, values.pop(SCENE), **values)
