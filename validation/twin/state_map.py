"""The convention map between a model and its twin; docs/conventions.md writes it out."""

from __future__ import annotations

import mujoco
import numpy as np

from softdyn.checks import array
from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import InputError
from softdyn.validation.twin.bodies import FREE
from softdyn.validation.twin.twin import Twin

WXYZ = [3, 0, 1, 2]  # MuJoCo's quaternion from Pinocchio's (x, y, z, w)
XYZW = [1, 2, 3, 0]


class StateMap:
    """The convention map between a model and its twin, joint by joint *by name*.

    Both engines hold one coordinate a joint, measured along the same axis from the same zero, in
    rad or m; the velocities are their derivatives. Four things differ:

    - order: Pinocchio sorts siblings by name, MuJoCo keeps the order in which they were added;
    - a continuous joint is (cos q, sin q) in Pinocchio's q, so that nq = nv + 1 a joint of it, and
      the angle q itself in MuJoCo's qpos, where it may grow beyond ±π;
    - a mimic joint is left out of the model's q and v; the twin holds it as a joint;
    - a floating base: the model has the quaternion as (x, y, z, w) and the velocity of the base's
      origin in the base's own axes; MuJoCo has (w, x, y, z) and that velocity in the world's axes.
      Angular velocities are in the base's own axes in both.

    So ``qvel = P(q) v``, and with Ṗ its time derivative ``qacc = P v̇ + Ṗ v``. Forces go the other
    way, ``f = Pᵀ f_twin``. P is constant but for the rotation of a floating base.

    Attributes
    ----------
    dofs : np.ndarray, (nv,)
        The twin's index of each of the model's degrees of freedom; of a robot without a floating
        base ``v = qvel[dofs]``.
    floating : bool
        Whether the base is.
    ties : np.ndarray, (twin's nv, nv)
        P without the rotation of a floating base: order and followers alone.

    Raises
    ------
    InputError
        When the two do not have the same joints.
    """

    def __init__(self, model: SoftModel, twin: Twin) -> None:
        floating = model.robot.floating
        names = model.joint_names[6:] if floating else model.joint_names
        own = [name for name in twin.joint_names if name not in twin.followers and name != FREE]
        if sorted(names) != sorted(own) or floating != twin.floating:
            raise InputError("twin", f"joints {model.joint_names}", twin.joint_names)
        kinds = {joint.name: joint.kind for joint in model.robot.joints}
        circular = [kinds[name] == "continuous" for name in names]
        self._circular = np.array(circular, bool)
        # Each joint takes one number of q, a continuous one two, a floating base seven.
        self._start = np.cumsum([7 if floating else 0, *(1 + c for c in circular)], dtype=int)[:-1]
        self._positions, dofs = _addresses(twin, names)
        self.floating = floating
        self._base, self._frame = np.arange(0), np.arange(0)
        if floating:
            positions, base = _addresses(twin, [FREE])
            self._base, self._frame = base[0] + np.arange(6), positions[0] + np.arange(7)
        self.dofs = np.concatenate((self._base, dofs))
        followers = list(twin.followers.values())
        self._followers, follower_dofs = _addresses(twin, [joint.name for joint in followers])
        self._leaders = np.array([names.index(joint.leader) for joint in followers], int)
        self._multipliers = np.array([joint.multiplier for joint in followers])
        self._offsets = np.array([joint.offset for joint in followers])
        self._nq, self._nv = model.nq, model.nv
        self._twin_nq, self._twin_nv = twin.model.nq, twin.model.nv
        self.ties = np.zeros((self._twin_nv, self._nv))
        self.ties[self.dofs, np.arange(self._nv)] = 1.0
        self.ties[follower_dofs, self._leaders + len(self._base)] = self._multipliers

    def to_twin(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """qpos (twin's nq,), qvel (twin's nv,) of a model state q (nq,), v (nv,).

        Angles are in (-π, π] but for those of followers.
        """
        q, v = array("q", q, (self._nq,)), array("v", v, (self._nv,))
        first = q[self._start]
        # the number after the cosine; of other joints, whatever stands there: not used
        second = q[np.minimum(self._start + 1, self._nq - 1)]
        coordinates = np.where(self._circular, np.arctan2(second, first), first)
        qpos = np.empty(self._twin_nq)
        qpos[self._positions] = coordinates
        qpos[self._followers] = self._multipliers * coordinates[self._leaders] + self._offsets
        if self.floating:
            qpos[self._frame[:3]], qpos[self._frame[3:]] = q[:3], q[3:7][WXYZ]
        return qpos, self.velocity_map(qpos) @ v

    def from_twin(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Model state q (nq,), v (nv,) of a twin state; followers are left out."""
        qpos, qvel = np.asarray(qpos, float), np.asarray(qvel, float)
        coordinates = qpos[self._positions]
        if self._nq == len(self.dofs):  # one number a coordinate: neither circular nor floating
            return coordinates, qvel[self.dofs]
        q = np.empty(self._nq)
        q[self._start] = np.where(self._circular, np.cos(coordinates), coordinates)
        q[self._start[self._circular] + 1] = np.sin(coordinates[self._circular])
        v = qvel[self.dofs]
        if self.floating:
            q[:3], q[3:7] = qpos[self._frame[:3]], qpos[self._frame[3:]][XYZW]
            v[:3] = self._rotation(qpos).T @ v[:3]
        return q, v

    def coordinates(self, qpos: np.ndarray) -> np.ndarray:
        """(nv,) as `SoftModel.coordinates`, but that angles are not wrapped."""
        joints = qpos[self._positions]
        if not self.floating:
            return joints
        turned = np.empty(3)
        mujoco.mju_quat2Vel(turned, qpos[self._frame[3:]], 1.0)
        return np.concatenate((qpos[self._frame[:3]], turned, joints))

    def velocity_map(self, qpos: np.ndarray) -> np.ndarray:
        """P (twin's nv, nv) with qvel = P v at the twin's qpos."""
        if not self.floating:
            return self.ties
        found = self.ties.copy()
        found[self._base[:3], :3] = self._rotation(qpos)
        return found

    def velocity_map_rate(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """Ṗ (twin's nv, nv): R [ω]× of a floating base, zero elsewhere."""
        found = np.zeros((self._twin_nv, self._nv))
        if self.floating:
            cross = np.cross(np.eye(3), qvel[self._base[3:]])  # row i is e_i × ω, the matrix [ω]×
            found[self._base[:3], :3] = self._rotation(qpos) @ cross
        return found

    def _rotation(self, qpos: np.ndarray) -> np.ndarray:
        """Rotation (3, 3) of a floating base."""
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, np.asarray(qpos)[self._frame[3:]])
        return rotation.reshape(3, 3)


def _addresses(twin: Twin, names: list[str] | tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Where the joints of these names begin in the twin's qpos and qvel."""
    joints = [twin.model.joint(name) for name in names]
    return (
        np.array([joint.qposadr[0] for joint in joints], int),
        np.array([joint.dofadr[0] for joint in joints], int),
    )
