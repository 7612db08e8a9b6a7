"""Joint forces of the twin that remember the motion: Maxwell branches, and hysteresis.

MuJoCo has neither. Each element has a torque z that resists its joint. It acts through
``qfrc_applied``, held over a step, and then follows the joint's change Δq in the step. Two kinds of
elements have an exact solution for a q that is linear in the step.

A Maxwell branch k, τ (`softdyn.dynamics.relaxation`): z⁺ = e^(-h/τ) z + k (τ/h) (1 - e^(-h/τ)) Δq.

Hysteresis (Dahl, A solid friction model, Aerospace Corporation TOR-0158(3107-18)-1, 1968, with the
exponent 1): dz/dq = σ (1 - sgn(q̇) z / F) with the stiffness σ at a reversal and the limit F, so
z⁺ = s F + (z - s F) e^(-σ |Δq| / F), s = sgn(Δq). It does not depend on the rate.

The held torque makes MuJoCo's implicit schemes, which take the springs at the begin of a step too,
no less stable than a spring of this stiffness would. Their error is of first order. With
Runge-Kutta the branches are part of the state that its stages see; hysteresis is held.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from softdyn.description.robot import Robot


class MotionMemory:
    """The torques of a twin's Maxwell branches and of its hysteresis.

    Parameters
    ----------
    model : mujoco.MjModel
        The twin's model.
    robot : Robot
        The description, with the branches.

    Attributes
    ----------
    torque : np.ndarray, (elements,)
        The torque z of each element (N m, N).
    stiffness : np.ndarray, (elements,)
        k of a branch, σ of hysteresis (N m/rad, N/m).
    """

    def __init__(self, model: mujoco.MjModel, robot: Robot) -> None:
        self._model = model
        parts = [
            (model.joint(joint.name).id, *branch)
            for joint in robot.moving_joints
            for branch in joint.relaxation
        ]
        self._set([part[0] for part in parts], [part[1] for part in parts])
        self._time = np.array([part[2] for part in parts], float)
        self._limit = np.zeros(0)
        self._span = np.nan

    def _set(self, joints: Sequence[int], stiffness: Sequence[float]) -> None:
        self.joints = np.array(joints, int)
        self.stiffness = np.array(stiffness, float)
        self._q = self._model.jnt_qposadr[self.joints]
        self._v = self._model.jnt_dofadr[self.joints]
        self.torque = np.zeros(len(self.joints))

    def __bool__(self) -> bool:
        """Whether there are elements."""
        return bool(len(self.torque))

    def add_hysteresis(self, limit: np.ndarray) -> None:
        """Add an element beside each spring whose limit F (joints,) is not zero; its σ is k."""
        stiffness = self._model.jnt_stiffness
        own = np.flatnonzero((limit > 0) & (stiffness > 0))
        self._set([*self.joints, *own], [*self.stiffness, *stiffness[own]])
        self._limit = np.append(self._limit, limit[own])

    def clear(self) -> None:
        """Return to rest: a robot that has been held for long has relaxed."""
        self.torque[:] = 0.0

    def force(self, torque: np.ndarray | None = None) -> np.ndarray:
        """The joint forces (MuJoCo's nv,) of all elements, of other torques if given."""
        own = self.torque if torque is None else torque
        return -np.bincount(self._v, own, self._model.nv)

    def places(self, qpos: np.ndarray) -> np.ndarray:
        """The coordinate (elements,) of each element's joint, a copy."""
        found: np.ndarray = qpos[self._q]
        return found

    def rate(self, qvel: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """ż (elements,) of the branches at torques z; zero of hysteresis."""
        found, n = np.zeros(len(torque)), len(self._time)
        found[:n] = self.stiffness[:n] * qvel[self._v[:n]] - torque[:n] / self._time
        return found

    def follow(self, before: np.ndarray, qpos: np.ndarray, *, branches: bool = True) -> None:
        """Move the torques over a step that began at `places` (elements,)."""
        moved, n, h = qpos[self._q] - before, len(self._time), self._model.opt.timestep
        if branches and n:
            if h != self._span:
                self._span, left = h, np.expm1(-h / self._time)
                self._decay = 1.0 + left
                self._gain = -self.stiffness[:n] * (self._time / h) * left
            self.torque[:n] = self._decay * self.torque[:n] + self._gain * moved[:n]
        if len(self._limit):
            end = np.copysign(self._limit, moved[n:])
            left = np.exp(-self.stiffness[n:] * np.abs(moved[n:]) / self._limit)
            self.torque[n:] = end + (self.torque[n:] - end) * left

    def scale(self, factors: np.ndarray) -> None:
        """Multiply the stiffness of the branches by the factors (joints,) of their springs."""
        self.stiffness = self.stiffness * factors[self.joints]
        self._span = np.nan
