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
        joints = np.where(moves, joint_tree(engine)[:, 0], -1)
        self._moves = moves.astype(float)[:, None]
        # for degrees of freedom k (rows) and j: whether j is of k's joint or nearer, or is nearer
        self._near = (joints <= joints[:, None]).astype(float)
        self._nearer = (joints < joints[:, None]).astype(float)

    def at(self, S: np.ndarray, rotations: np.ndarray, translations: np.ndarray) -> PointMotion:
        """The point in the `softdyn.dynamics.tree.TreeModel.kinematics`."""
        y = translations[self.body] + rotations[self.body] @ self.offset
        turning = self._moves * S[:, 3:]
        return PointMotion(y, (self._moves * S[:, :3] + _crossed(turning, y)).T, turning.T)

    def curvature(self, motion: PointMotion, force: np.ndarray) -> np.ndarray:
        """∂(Jᵀ f)/∂q (nv, nv) for a constant force f (3,)."""
        # f · (ω_j × J_k) = ω_j · (J_k × f)
        by_pairs = _crossed(motion.J.T, force) @ motion.turning
        bend: np.ndarray = self._near * by_pairs + (self._nearer * by_pairs).T
        return bend

    def turning_curvature(self, motion: PointMotion, torque: np.ndarray) -> np.ndarray:
        """∂(J_ωᵀ τ)/∂q (nv, nv) for a constant torque τ (3,)."""
        # ∂ω_k/∂q_j = ω_j × ω_k if joint j is joint k or nearer, else 0; τ · that = ω_j · (ω_k × τ)
        bend: np.ndarray = self._near * (_crossed(motion.turning.T, torque) @ motion.turning)
        return bend

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
        motion = self.at(S, rotations, translations)
        residual -= force @ motion.J
        by_force -= motion.J.T
        by_q -= self.curvature(motion, force)


def _crossed(rows: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Rows (n, 3), each times the vector y (3,)."""
    return rows @ np.array([[0.0, -y[2], y[1]], [y[2], 0.0, -y[0]], [-y[1], y[0], 0.0]])
