"""Springs and dampers of ball joints in the twin, computed from MuJoCo's own kinematics.

The twin has the three hinges of a ball. The torque between the two bodies is MuJoCo's own law of a
ball joint, -φ (k₀ + k₁ θ + k₂ θ²) - d ω, with the rotation vector φ by ``mju_subQuat`` and the
relative angular velocity ω by ``mj_jacBody``. No number comes from `softdyn.dynamics.balls`.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from softdyn.description.robot import Ball


class TwinBalls:
    """The balls of a MuJoCo model.

    Parameters
    ----------
    balls : sequence of Ball
        The balls of the robot.
    model : mujoco.MjModel
        Its MuJoCo model, with the hinges by name.
    rest : np.ndarray, (MuJoCo's nq,)
        qpos at q = 0.
    """

    def __init__(self, balls: Sequence[Ball], model: mujoco.MjModel, rest: np.ndarray) -> None:
        self._balls, self._model, self._data = balls, model, mujoco.MjData(model)
        joints = [[model.joint(name) for name in (b.joints[0], b.joints[2])] for b in balls]
        self._outer = [int(model.body_parentid[first.bodyid[0]]) for first, _ in joints]
        self._inner = [int(last.bodyid[0]) for _, last in joints]
        self._place(rest)
        self._zeros = [self._between(k) for k in range(len(balls))]

    def force(self, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
        """The joint force (MuJoCo's nv,) of all balls."""
        self._place(qpos)
        found = np.zeros(self._model.nv)
        for k, ball in enumerate(self._balls):
            phi, J = np.zeros(3), self._turning(k)
            mujoco.mju_subQuat(phi, self._between(k), self._zeros[k])
            found -= J.T @ (ball.damping * (J @ qvel) + _spring(ball, phi)[0] * phi)
        return found

    def damping(self) -> np.ndarray:
        """-∂force/∂q̇ (MuJoCo's nv, MuJoCo's nv) at the last state."""
        found = np.zeros((self._model.nv,) * 2)
        for k, ball in enumerate(self._balls):
            J = self._turning(k)
            found += ball.damping * J.T @ J
        return found

    def stiffness(self) -> np.ndarray:
        """-∂force/∂q (MuJoCo's nv, MuJoCo's nv) at the last state, without the turning of E."""
        found = np.zeros((self._model.nv,) * 2)
        for k, ball in enumerate(self._balls):
            phi, J = np.zeros(3), self._turning(k)
            mujoco.mju_subQuat(phi, self._between(k), self._zeros[k])
            found += max(_spring(ball, phi)) * J.T @ J
        return found

    def _place(self, qpos: np.ndarray) -> None:
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)

    def _between(self, k: int) -> np.ndarray:
        """The quaternion (4,) of a ball's body in the body that carries it."""
        back, found = np.zeros(4), np.zeros(4)
        mujoco.mju_negQuat(back, self._data.xquat[self._outer[k]])
        mujoco.mju_mulQuat(found, back, self._data.xquat[self._inner[k]])
        return found

    def _turning(self, k: int) -> np.ndarray:
        """The relative angular velocity in the body's axes by q̇ (3, MuJoCo's nv)."""
        inner, outer = np.zeros((3, self._model.nv)), np.zeros((3, self._model.nv))
        mujoco.mj_jacBody(self._model, self._data, None, inner, self._inner[k])
        mujoco.mj_jacBody(self._model, self._data, None, outer, self._outer[k])
        axes = self._data.xmat[self._inner[k]].reshape(3, 3)
        found: np.ndarray = axes.T @ (inner - outer)
        return found


def _spring(ball: Ball, phi: np.ndarray) -> tuple[float, float]:
    """Secant and tangent stiffness (N m/rad) at a rotation vector."""
    theta, (k1, k2) = float(np.linalg.norm(phi)), ball.stiffness_poly
    secant = ball.stiffness + theta * (k1 + theta * k2)
    return secant, secant + theta * (k1 + 2 * theta * k2)
