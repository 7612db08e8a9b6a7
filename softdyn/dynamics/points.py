"""A point of a moving body: its position, its Jacobian, and the derivative of the Jacobian by q.

Joint Jacobian columns S_k = (v_k; ω_k) are in the world's axes about its origin. A point y that
joint k moves has J_k = v_k + ω_k × y. A turn about joint j carries J_k if joint j is joint k or
nearer to the base. With the symmetry of the second derivatives of y,

    ∂J_k/∂q_j = ω_j × J_k if joint j is joint k or nearer to the base, else ω_k × J_j.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from softdyn.compiled import compiled
from softdyn.dynamics.engine import joint_tree, moved_bodies


class PointMotion(NamedTuple):
    """A point at one configuration.

    Attributes
    ----------
    y : ndarray, (3,)
        Its position, from the world's or a floating base's origin.
    J, turning : ndarray, (3, nv)
        Jacobians of the position, and of its body's angular velocity in the world's axes.
    """

    y: np.ndarray
    J: np.ndarray
    turning: np.ndarray


class BodyPoint:
    """A point of a moving body, ready for evaluation.

    Parameters
    ----------
    engine : pinocchio.Model
        The tree.
    body : int
        The body.
    offset : ndarray, (3,)
        The point in the body's frame.
    """

    def __init__(self, engine: pin.Model, body: int, offset: np.ndarray) -> None:
        self.body, self.offset = body, np.array(offset, float)
        moves = moved_bodies(engine)[:, body]
        # the joint of each degree of freedom that moves the point, else -1
        self._joints = np.where(moves, joint_tree(engine)[:, 0], -1)

    def at(self, S: np.ndarray, rotations: np.ndarray, translations: np.ndarray) -> PointMotion:
        """The point in the `softdyn.dynamics.tree.TreeModel.kinematics`."""
        rotation, translation = rotations[self.body], translations[self.body]
        return PointMotion(*_motion(S, rotation, translation, self.offset, self._joints))

    def curvature(self, motion: PointMotion, force: np.ndarray) -> np.ndarray:
        """∂(Jᵀ f)/∂q (nv, nv) for a constant force f (3,)."""
        return _curvature(motion.J, motion.turning, force, self._joints)

    def subtract_force(
        self,
        residual: np.ndarray,
        by_q: np.ndarray,
        by_force: np.ndarray,
        force: np.ndarray,
        S: np.ndarray,
        rotations: np.ndarray,
        translations: np.ndarray,
    ) -> None:
        """Subtract Jᵀ f of a force (3,) from residual (nv,) and its Jacobians (nv, nv), (nv, 3)."""
        rotation, translation = rotations[self.body], translations[self.body]
        _subtract(
            residual, by_q, by_force, force, S, rotation, translation, self.offset, self._joints
        )


@compiled
def _subtract(residual, by_q, by_force, force, S, rotation, translation, offset, joints):
    _, J, turning = _motion(S, rotation, translation, offset, joints)
    bend = _curvature(J, turning, force, joints)
    for k in range(len(residual)):
        for x in range(3):
            residual[k] -= J[x, k] * force[x]
            by_force[k, x] -= J[x, k]
        for j in range(len(residual)):
            by_q[k, j] -= bend[k, j]


@compiled
def _motion(S, rotation, translation, offset, joints):
    n = len(S)
    y, J, turning = np.empty(3), np.zeros((3, n)), np.zeros((3, n))
    for x in range(3):
        y[x] = translation[x]
        for i in range(3):
            y[x] += rotation[x, i] * offset[i]
    for k in range(n):
        if joints[k] >= 0:
            for x in range(3):
                turning[x, k] = S[k, 3 + x]
            J[0, k] = S[k, 0] + S[k, 4] * y[2] - S[k, 5] * y[1]
            J[1, k] = S[k, 1] + S[k, 5] * y[0] - S[k, 3] * y[2]
            J[2, k] = S[k, 2] + S[k, 3] * y[1] - S[k, 4] * y[0]
    return y, J, turning


@compiled
def _curvature(J, turning, force, joints):
    n = len(joints)
    bend = np.zeros((n, n))
    for k in range(n):
        a, b, c = J[0, k], J[1, k], J[2, k]
        # J_k × f, so that f · (ω_j × J_k) = ω_j · (J_k × f)
        x, y, z = (
            b * force[2] - c * force[1],
            c * force[0] - a * force[2],
            a * force[1] - b * force[0],
        )
        for j in range(n):
            value = turning[0, j] * x + turning[1, j] * y + turning[2, j] * z
            if joints[j] <= joints[k]:
                bend[k, j] = value
            if joints[j] < joints[k]:
                bend[j, k] = value
    return bend
