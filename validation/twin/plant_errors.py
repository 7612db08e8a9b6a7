"""Differences between the plant and the model that the controller has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from softdyn import InputError
from softdyn.checks import did_you_mean, instance, number
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

    def __post_init__(self) -> None:
        for name, usual in (("contacts", False), ("friction", False), ("soft_stops", False)):
            instance(name, getattr(self, name), type(usual), "true or false")
        for name in ("dry_friction", "payload"):
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
        return twin


def multiplied(factors: Factors, by: float) -> Factors:
    """`factors` of `PlantErrors`, all multiplied by a number."""
    if isinstance(factors, Mapping):
        return {name: by * factor for name, factor in ({EACH: 1.0} | dict(factors)).items()}
    return by * factors


def _by_joint(name: str, factors: Factors, model: mujoco.MjModel) -> tuple[np.ndarray, float]:
    """The factor of each joint (joints,), and that of everything else."""
    if not isinstance(factors, Mapping):
        return np.full(model.njnt, factors), factors
    joints = [model.joint(k).name for k in range(model.njnt)]
    for joint in factors:
        if joint != EACH and joint not in joints:
            raise InputError(name, "names of joints", did_you_mean(joint, joints))
    other = factors.get(EACH, 1.0)
    return np.array([factors.get(joint, other) for joint in joints]), other


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
