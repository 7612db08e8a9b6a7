"""The convention map between a model and its twin; docs/conventions.md writes it out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import mujoco
import numpy as np

from softdyn.checks import FLOAT, array, did_you_mean, length, number, whole
from softdyn.description.robot import Robot
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.exceptions import InputError
from softdyn.validation.twin.bodies import FREE, TwinJoint

WXYZ = [3, 0, 1, 2]  # MuJoCo's quaternion from Pinocchio's (x, y, z, w)
XYZW = [1, 2, 3, 0]


class MujocoPlant(Protocol):
    """A MuJoCo model with a state that can be set and integrated under an input, such as `Twin`."""

    @property
    def model(self) -> mujoco.MjModel:
        """MuJoCo's model."""

    @property
    def data(self) -> mujoco.MjData:
        """MuJoCo's data, with the present state."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """In MuJoCo's order."""

    @property
    def followers(self) -> dict[str, TwinJoint]:
        """Mimic joints, by our names."""

    @property
    def floating(self) -> bool:
        """Whether the robot's base moves freely."""

    @property
    def rest(self) -> np.ndarray:
        """Positions (nq,) of all joints that are not in the map."""

    def set_state(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Start from a state."""

    def advance(self, u: np.ndarray, steps: int = 1) -> None:
        """Integrate under a held input (nu,)."""


@runtime_checkable
class MappedPlant(MujocoPlant, Protocol):
    """A plant from a user's file, with its own settings and convention map."""

    timestep: float  # s

    @property
    def path(self) -> Path:
        """The file."""

    @property
    def robot(self) -> Robot:
        """The robot whose states and inputs the plant takes."""

    @property
    def contacts(self) -> bool:
        """Whether anything can touch."""

    @property
    def states(self) -> StateMap:
        """The model's states ↔ MuJoCo's."""


class StateMap:
    """The convention map between a model and its twin, joint by joint *by name*.

    Both engines have one coordinate per joint, measured along the same axis from the same zero, in
    rad or m. The velocities are its derivatives. Four things differ:

    - order: Pinocchio sorts siblings by name, MuJoCo keeps the order in which they were added;
    - a continuous joint is (cos q, sin q) in Pinocchio's q, so that each adds one to nq - nv. In
      MuJoCo's qpos it is the angle q itself, which may grow beyond ±π;
    - a mimic joint is left out of the model's q and v; the twin holds it as a joint;
    - a floating base: the model has the quaternion as (x, y, z, w) and the velocity of the base's
      origin in the base's own axes; MuJoCo has (w, x, y, z) and that velocity in the world's axes.
      Angular velocities are in the base's own axes in both.

    So ``qvel = P(q) v``, and with Ṗ its time derivative ``qacc = P v̇ + Ṗ v``. Forces go the other
    way, ``f = Pᵀ f_twin``. P is constant except for the rotation of a floating base. In a user's
    MJCF (`softdyn.validation.mjcf.scene`) joints may have other names, signs and zero positions.
    Joints that the model does not have stay at rest.

    Parameters
    ----------
    model : SoftModel
        The analytic model.
    twin : MujocoPlant
        A `Twin`, or another `MujocoPlant`.
    called : dict[str, int], optional
        The twin's joint for each of our joint names; joints of the same name by default.
    turns : dict[str, tuple[float, float]], optional
        Sense and zero for each of our joint names: ``q = sense · qpos + zero``.

    Attributes
    ----------
    dofs : np.ndarray, (nv,)
        The twin's index of each degree of freedom of the model. Without a floating base, ``v =
        qvel[dofs]``.
    signs : np.ndarray, (nv,)
        -1 where a joint of the twin turns the other way, else 1.
    floating : bool
        Whether the base floats.
    ties : np.ndarray, (twin's nv, nv)
        P without the rotation of a floating base: only order and mimic joints.

    Raises
    ------
    InputError
        When the two do not have the same joints, and for a map of others.
    """

    def __init__(
        self,
        model: SoftModel,
        twin: MujocoPlant,
        called: dict[str, int] | None = None,
        turns: dict[str, tuple[float, float]] | None = None,
    ) -> None:
        floating = check_model(model).robot.floating
        if not all(hasattr(twin, name) for name in ("joint_names", "followers", "rest")):
            raise InputError("twin", "a Twin", repr(twin))
        names = model.joint_names[6:] if floating else model.joint_names
        free = {FREE} if floating else set()
        own = [name for name in twin.joint_names if name not in {*twin.followers, *free}]
        if called is None:
            if sorted(names) != sorted(own) or floating != twin.floating:
                raise InputError("twin", f"joints {model.joint_names}", twin.joint_names)
            called = {joint: k for k, joint in enumerate(twin.joint_names)}
        _check_joints(called, {*names, *twin.followers, *free}, twin.model.njnt)
        kinds = {joint.name: joint.kind for joint in model.robot.joints}
        circular = [kinds[name] == "continuous" for name in names]
        self._circular = np.array(circular, bool)
        # In q a joint takes one number, a continuous joint two, a floating base seven.
        self._start = np.cumsum([7 if floating else 0, *(1 + c for c in circular)], dtype=int)[:-1]
        self._positions, dofs = _addresses(twin, called, names)
        self.floating = floating
        self._base, self._frame = np.arange(0), np.arange(0)
        if floating:
            positions, base = _addresses(twin, called, [FREE])
            self._base, self._frame = base[0] + np.arange(6), positions[0] + np.arange(7)
        self.dofs = np.concatenate((self._base, dofs))
        followers = list(twin.followers.values())
        follows = [joint.name for joint in followers]
        self._followers, follower_dofs = _addresses(twin, called, follows)
        self._leaders = np.array([names.index(joint.leader) for joint in followers], int)
        self._multipliers = np.array([joint.multiplier for joint in followers])
        self._offsets = np.array([joint.offset for joint in followers])
        self._nq, self._nv = model.nq, model.nv
        self._twin_nq, self._twin_nv = twin.model.nq, twin.model.nv
        self._rest = twin.rest.copy()
        _check_turns({} if turns is None else turns, {*names, *twin.followers})
        self._sense, self._zero = _turns(turns or {}, list(names))
        self._follower_sense, self._follower_zero = _turns(turns or {}, follows)
        self._turned = bool(turns)
        self.signs = np.concatenate((np.ones(len(self._base)), self._sense))
        self.ties = np.zeros((twin.model.nv, self._nv))
        self.ties[self.dofs, np.arange(self._nv)] = self.signs
        carried = self._follower_sense * self._multipliers
        self.ties[follower_dofs, self._leaders + len(self._base)] = carried

    def to_twin(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """qpos (twin's nq,), qvel (twin's nv,) of a model state q (nq,), v (nv,).

        Angles are in (-π, π], except those of mimic joints.
        """
        q, v = array("q", q, (self._nq,)), array("v", v, (self._nv,))
        first = q[self._start]
        # the number after the cosine; not used for other joints
        second = q[np.minimum(self._start + 1, self._nq - 1)]
        coordinates = np.where(self._circular, np.arctan2(second, first), first)
        qpos = self._rest.copy()
        qpos[self._positions] = self._sense * (coordinates - self._zero)
        followers = self._multipliers * coordinates[self._leaders] + self._offsets
        qpos[self._followers] = self._follower_sense * (followers - self._follower_zero)
        if self.floating:
            qpos[self._frame[:3]], qpos[self._frame[3:]] = q[:3], q[3:7][WXYZ]
        return qpos, self.velocity_map(qpos) @ v

    def from_twin(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Model state q (nq,), v (nv,) of a twin state, without mimic joints."""
        qpos, qvel = _sized("qpos", qpos, self._twin_nq), _sized("qvel", qvel, self._twin_nv)
        coordinates, v = qpos[self._positions], qvel[self.dofs]
        if self._turned:
            coordinates, v = self._sense * coordinates + self._zero, self.signs * v
        # one number per coordinate: no continuous joint, no floating base
        if self._nq == len(self.dofs):
            return coordinates, v
        q = np.empty(self._nq)
        q[self._start] = np.where(self._circular, np.cos(coordinates), coordinates)
        q[self._start[self._circular] + 1] = np.sin(coordinates[self._circular])
        if self.floating:
            q[:3], q[3:7] = qpos[self._frame[:3]], qpos[self._frame[3:]][XYZW]
            v[:3] = self._rotation(qpos).T @ v[:3]
        return q, v

    def coordinates(self, qpos: np.ndarray) -> np.ndarray:
        """Coordinates (nv,) as in `SoftModel.coordinates`, but angles are not wrapped."""
        qpos = _sized("qpos", qpos, self._twin_nq)
        joints = self._sense * qpos[self._positions] + self._zero
        if not self.floating:
            return joints
        turned = np.empty(3)
        mujoco.mju_quat2Vel(turned, qpos[self._frame[3:]], 1.0)
        return np.concatenate((qpos[self._frame[:3]], turned, joints))

    def velocity_map(self, qpos: np.ndarray) -> np.ndarray:
        """P (twin's nv, nv) with qvel = P v at the twin's qpos."""
        qpos = _sized("qpos", qpos, self._twin_nq)
        if not self.floating:
            return self.ties
        found = self.ties.copy()
        found[self._base[:3], :3] = self._rotation(qpos)
        return found

    def velocity_map_rate(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Ṗ (twin's nv, nv): R [ω]× for a floating base, zero elsewhere."""
        qpos, qvel = _sized("qpos", qpos, self._twin_nq), _sized("qvel", qvel, self._twin_nv)
        found = np.zeros_like(self.ties)
        if self.floating:
            cross = np.cross(np.eye(3), qvel[self._base[3:]])  # row i is e_i × ω, the matrix [ω]×
            found[self._base[:3], :3] = self._rotation(qpos) @ cross
        return found

    def _rotation(self, qpos: np.ndarray) -> np.ndarray:
        """Rotation (3, 3) of a floating base."""
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, np.asarray(qpos)[self._frame[3:]])
        return rotation.reshape(3, 3)


def _sized(name: str, value: Any, size: int) -> np.ndarray:
    """`value` (size,), which need not be finite: a plant may diverge."""
    if type(value) is np.ndarray and value.dtype is FLOAT and value.shape == (size,):
        return value
    return array(name, value, (size,), finite=False)


def _check_joints(called: Any, names: set[str], count: int) -> None:
    """Refuse what does not give one of the twin's joints for each name."""
    if not isinstance(called, Mapping) or not names <= set(called):
        raise InputError("called", f"a joint for each of {', '.join(sorted(names))}", repr(called))
    for name in names:
        if whole(f"called[{name!r}]", called[name]) >= count:
            raise InputError(f"called[{name!r}]", f"one of {count} joints", called[name])


def _check_turns(turns: Any, names: set[str]) -> None:
    """Refuse what does not give a sense and a zero to some of the names."""
    if not isinstance(turns, Mapping):
        raise InputError("turns", "(sense, zero) by joint", repr(turns))
    for name, pair in turns.items():
        where = f"turns[{name!r}]"
        if name not in names:
            raise InputError("turns", "joints of the robot", did_you_mean(str(name), names))
        if length(where, pair) != 2:
            raise InputError(where, "(sense, zero)", repr(pair))
        for value in pair:
            number(where, value)


def _addresses(
    twin: MujocoPlant, called: dict[str, int], names: Sequence[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Addresses of our joints in the twin's qpos and qvel."""
    joints = [called[name] for name in names]
    model = twin.model
    return model.jnt_qposadr[joints].astype(int), model.jnt_dofadr[joints].astype(int)


def _turns(
    turns: dict[str, tuple[float, float]], names: Sequence[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Senses and zeros of joints."""
    found = np.array([turns.get(name, (1.0, 0.0)) for name in names]).reshape(-1, 2)
    return found[:, 0], found[:, 1]
