"""Creep: generalised Maxwell branches beside the springs of joints.

A branch is a spring k in series with a damper k τ, in parallel with the joint's own spring k∞. Its
torque z resists the joint, M q̈ + h + z = B u, and follows (Christensen, Theory of Viscoelasticity,
1982, section 1.6)

    ż = -z / τ + k q̇.

A sudden motion meets the stiffness k₀ = k∞ + Σ k. At rest z is zero, so that a `State`, its K and
all statics are those of the relaxed spring k∞. Over a step h in which q is linear,

    z⁺ = e^(-h/τ) z + k (τ / h) (1 - e^(-h/τ)) Δq,

which is exact. A Prony series of the modulus, E(t) = E₀ (1 - Σ g + Σ g e^(-t/τ)), has the shares
g = k / k₀, so k = g k∞ / (1 - Σ g).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.projection import underlying_tree
from softdyn.dynamics.reduced import rebuild


@dataclass(frozen=True, eq=False)
class Branches:
    """The Maxwell branches of a robot, joint by joint.

    Attributes
    ----------
    names : tuple of str
        ``joint.k``, with the branch's number k in its joint from 1.
    stiffness, time : ndarray, (nz,)
        k (N m/rad, N/m) and τ (s).
    rates : ndarray, (nz, n)
        Each branch's q̇ by the model's velocities.
    """

    names: tuple[str, ...]
    stiffness: np.ndarray
    time: np.ndarray
    rates: np.ndarray

    @classmethod
    def of(cls, model: SoftModel) -> Branches:
        """The branches of a model's joints."""
        tree, S = underlying_tree(model)
        parts = [
            (f"{joint.name}.{number}", *branch, tree.joint_names.index(joint.name))
            for joint in model.robot.joints
            for number, branch in enumerate(joint.relaxation, 1)
        ]
        S = np.eye(tree.nv) if S is None else S
        return cls(
            tuple(part[0] for part in parts),
            np.array([part[1] for part in parts], float),
            np.array([part[2] for part in parts], float),
            S[np.array([part[3] for part in parts], int)],
        )

    def decay(self, step: float) -> np.ndarray:
        """Factor (nz,) of z over a step (s)."""
        return np.exp(-step / self.time)

    def gain(self, step: float) -> np.ndarray:
        """Change (nz,) of z by the joint's change over a step (s), at a constant rate."""
        found: np.ndarray = -self.stiffness * self.time / step * np.expm1(-step / self.time)
        return found

    @property
    def matrix(self) -> np.ndarray:
        """Stiffness (n, n) that they add to the springs in a sudden motion."""
        return (self.rates.T * self.stiffness) @ self.rates


def without_branches(model: SoftModel) -> SoftModel:
    """The model of the same robot without Maxwell branches; the model itself if it has none."""
    if not any(joint.relaxation for joint in model.robot.joints):
        return model
    joints = tuple(replace(joint, relaxation=()) for joint in model.robot.joints)
    return rebuild(model, replace(model.robot, joints=joints))
