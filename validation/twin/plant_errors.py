"""Differences between the plant and the model that the controller has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from softdyn import InputError
from softdyn.checks import did_you_mean, instance, number
from softdyn.description.inertia import Inertia, Origin
from softdyn.description.rig import Actuator
from softdyn.description.robot import Robot, moving_link_of
from softdyn.validation.twin.twin import Twin

Factors = float | Mapping[str, float]
BY_JOINT = ("mass", "stiffness", "damping")  # fields that may have factors by joint
EACH = "each"  # in such factors: every other joint

# MuJoCo's own defaults of solref and solimp
SOFT_SOLREF, SOFT_SOLIMP = (0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0)


@dataclass(frozen=True)
class PlantErrors:
    """Differences between the plant and the model that the controller has.

    Attributes
    ----------
    contacts, friction : bool
        Whether links can touch, and whether the file's dry friction acts.
    dry_friction : float
        Dry friction of every joint (N m or N). It replaces the file's unless it is 0.
    soft_stops : bool
        Whether joint limits and dry friction are as soft as MuJoCo's defaults.
    mass, stiffness, damping : float or mapping of str to float
        Factors on all masses and moments of inertia (armature apart), on all springs, on all
        damping. A mapping has a factor for each joint that it names: on its spring, on its damping,
        on what moves with its link. Its key ``each`` is for everything else.
    payload : float
        A point mass at the tip (kg).
    hysteresis : float
        Width of the loop of torque over angle that the springs of driven joints have (Dahl 1968,
        `softdyn.validation.twin.memory`), over the largest torque that one input alone has there at
        q = 0. Data sheets of sensors state hysteresis like this, in parts of the full scale.

    Raises
    ------
    InputError
        A value of the wrong kind, a negative one, or a mass of 0.
    """

    contacts: bool = False
    friction: bool = False
    dry_friction: float = 0.0
    soft_stops: bool = False
    mass: Factors = 1.0
    stiffness: Factors = 1.0
    damping: Factors = 1.0
    payload: float = 0.0
    hysteresis: float = 0.0

    def __post_init__(self) -> None:
        for name, usual in (("contacts", False), ("friction", False), ("soft_stops", False)):
            instance(name, getattr(self, name), type(usual), "true or false")
        for name in ("dry_friction", "payload", "hysteresis"):
            number(name, getattr(self, name), lower=0.0)
        for name in BY_JOINT:
            value = getattr(self, name)
            for joint, factor in value.items() if isinstance(value, Mapping) else [("", value)]:
                part = f"{name}.{joint}".rstrip(".")
                if name == "mass":
                    number(part, factor, above=0.0)
                else:
                    number(part, factor, lower=0.0)

    @property
    def rubs(self) -> bool:
        """Whether there is dry friction."""
        return self.friction or self.dry_friction > 0

    def twin(self, *arguments: Any, **options: Any) -> Twin:
        """`Twin` with these differences; its own options may add contacts and friction."""
        for name, own in (("contacts", self.contacts), ("friction", self.rubs)):
            options[name] = options.get(name, False) or own
        return self.applied(Twin(*arguments, **options))

    def applied(self, twin: Twin) -> Twin:
        """A twin with these numbers, changed in place."""
        model = twin.model
        if self.dry_friction:
            model.dof_frictionloss[:] = self.dry_friction
        if self.soft_stops:
            model.jnt_solref[:], model.jnt_solimp[:] = SOFT_SOLREF, SOFT_SOLIMP
            model.dof_solref[:], model.dof_solimp[:] = SOFT_SOLREF, SOFT_SOLIMP
        if (self.mass, self.stiffness, self.damping) != (1.0, 1.0, 1.0):
            masses, weight = _by_joint("mass", self.mass, model)
            springs, stiffness = _by_joint("stiffness", self.stiffness, model)
            dampers, damping = _by_joint("damping", self.damping, model)
            bodies = np.full(model.nbody, weight)
            bodies[model.jnt_bodyid] = masses  # of several joints of a body the last moves it
            model.body_mass[:] *= bodies
            model.body_inertia[:] *= bodies[:, None]
            model.jnt_stiffness[:] *= springs
            model.jnt_stiffnesspoly[:] *= springs[:, None]
            twin.memory.scale(springs)
            model.tendon_stiffness[:] *= stiffness
            model.tendon_stiffnesspoly[:] *= stiffness
            model.dof_damping[:] *= dampers[model.dof_jntid]
            model.dof_dampingpoly[:] *= dampers[model.dof_jntid, None]
            model.tendon_damping[:] *= damping
            model.tendon_dampingpoly[:] *= damping
            pulls = [*twin.slack, *np.flatnonzero(model.actuator_biasprm[: twin.nu, 1])]
            model.actuator_gainprm[pulls, 0] *= stiffness
            model.actuator_biasprm[pulls, :2] *= stiffness
            model.actuator_biasprm[pulls, 2] *= damping
        if self.payload:
            _load(model, *twin.task, self.payload)
        if (self.mass, self.stiffness, self.damping, self.payload) != (1.0, 1.0, 1.0, 0.0):
            mujoco.mj_setConst(model, twin.data)
            twin.reset()
        if self.hysteresis:
            twin.memory.add_hysteresis(self.hysteresis / 2 * _full_torques(twin))
        return twin


def altered_robot(errors: PlantErrors, robot: Robot) -> Robot:
    """A robot with the masses, springs and dampers, and the payload of these errors.

    The other differences are not numbers of a file. Stops, contacts and friction stay.

    Raises
    ------
    InputError
        A factor of a joint that the robot does not have.
    """
    if (errors.mass, errors.stiffness, errors.damping, errors.payload) == (1.0, 1.0, 1.0, 0.0):
        return robot
    joints = [joint.name for joint in robot.moving_joints]
    (masses, weight), (springs, stiffness), (dampers, damping) = (
        _factors(name, getattr(errors, name), joints) for name in BY_JOINT
    )
    moved_by = {joint.child: joint.name for joint in robot.moving_joints}
    carrier = moving_link_of(robot)
    load = Inertia(errors.payload, np.zeros(3), np.zeros((3, 3)))
    links = []
    for link in robot.links:
        factor = masses.get(moved_by.get(carrier[link.name], ""), weight)
        moments = tuple(factor * moment for moment in link.moments)
        volume = link.mass * link.gravcomp  # other masses displace no more
        link = replace(link, mass=factor * link.mass, moments=moments)
        if errors.payload and link.name == robot.task:
            body = link.inertia + load
            x, y, z = body.com.tolist()
            about = Origin((x, y, z))
            link = replace(link, mass=body.mass, moments=body.moments, origin=about)
        links.append(replace(link, gravcomp=volume / link.mass) if volume else link)
    return replace(
        robot,
        links=tuple(links),
        joints=tuple(
            replace(
                joint, stiffness=springs.get(joint.name, stiffness) * joint.stiffness,
                damping=dampers.get(joint.name, damping) * joint.damping,
                relaxation=tuple(
                    (springs.get(joint.name, stiffness) * k, time) for k, time in joint.relaxation
                ),
            )
            for joint in robot.joints
        ),
        tendons=tuple(
            replace(one, stiffness=stiffness * one.stiffness, damping=damping * one.damping)
            for one in robot.tendons
        ),
    )  # fmt: skip


def altered_motor(errors: PlantErrors, one: Actuator) -> Actuator:
    """A motor whose cable has the springs and dampers of these errors."""
    stiffness, damping = (
        factors.get(EACH, 1.0) if isinstance(factors, Mapping) else factors
        for factors in (errors.stiffness, errors.damping)
    )
    return replace(one, stiffness=stiffness * one.stiffness, damping=damping * one.damping)


def multiplied(factors: Factors, by: float) -> Factors:
    """`factors` of `PlantErrors`, all multiplied by a number."""
    if isinstance(factors, Mapping):
        return {name: by * factor for name, factor in ({EACH: 1.0} | dict(factors)).items()}
    return by * factors


def _by_joint(name: str, factors: Factors, model: mujoco.MjModel) -> tuple[np.ndarray, float]:
    """The factor of each joint (joints,), and that of everything else."""
    joints = [model.joint(k).name for k in range(model.njnt)]
    found, other = _factors(name, factors, joints)
    return np.array([found.get(joint, other) for joint in joints]), other


def _factors(name: str, factors: Factors, joints: list[str]) -> tuple[Mapping[str, float], float]:
    """The factors by joint, and that of everything else."""
    if not isinstance(factors, Mapping):
        return {}, factors
    for joint in factors:
        if joint != EACH and joint not in joints:
            raise InputError(name, "names of joints", did_you_mean(joint, joints))
    return factors, factors.get(EACH, 1.0)


def _full_torques(twin: Twin) -> np.ndarray:
    """The largest torque (joints,) that one input alone has at q = 0 (N m, N).

    Raises
    ------
    InputError
        A motor that commands a length, whose largest torque depends on the way.
    """
    model, data = twin.model, twin.data
    for actuator in twin.robot.actuators:
        if actuator.is_winch:
            raise InputError("hysteresis", "inputs that are forces or pressures", actuator.name)
    arms = np.zeros((model.nu, model.nv))
    mujoco.mju_sparse2dense(
        arms, data.actuator_moment.ravel(), data.moment_rownnz, data.moment_rowadr,
        data.moment_colind.ravel(),
    )  # fmt: skip
    own = range(twin.nu)
    most = [max(abs(one.lower), abs(one.upper)) for one in twin.robot.actuators]
    torques = np.abs(arms[own]) * np.array(most)[:, None]
    found: np.ndarray = torques.max(axis=0, initial=0.0)[model.jnt_dofadr]
    return found


def _load(model: mujoco.MjModel, body: int, point: np.ndarray, mass: float) -> None:
    """Add a point mass (kg) at a point (3,) of a body."""
    before, com = float(model.body_mass[body]), model.body_ipos[body].copy()
    total = before + mass
    centre = (before * com + mass * point) / total
    turned = np.empty(9)
    mujoco.mju_quat2Mat(turned, model.body_iquat[body])
    axes = turned.reshape(3, 3)
    inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
    for m, at in ((before, com), (mass, point)):
        d = at - centre
        inertia += m * (d @ d * np.eye(3) - np.outer(d, d))
    moments, axes = np.linalg.eigh(inertia)
    axes *= np.linalg.det(axes)  # eigenvectors of a right-handed frame
    model.body_mass[body], model.body_ipos[body] = total, centre
    model.body_inertia[body] = np.maximum(moments, 0.0)
    mujoco.mju_mat2Quat(model.body_iquat[body], np.ascontiguousarray(axes).ravel())
