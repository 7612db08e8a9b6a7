"""A model whose coordinates determine those of a tree: the tree's dynamics, projected.

The coordinates are q. S (tree, n) is constant and of full rank. Then

    q_tree = S q + offset,    v_tree = S v,    a_tree = S a,

and d'Alembert's principle gives every term from those of the tree:

    M = Sᵀ M_tree S,  C = Sᵀ C_tree S,  D = Sᵀ D_tree S,
    h = Sᵀ h_tree,    B = Sᵀ B_tree,    J = J_tree S,    F = Sᵀ F_tree.

S is constant, so Ṁ - 2C stays skew and forces stay gradients: every identity of the tree holds.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace

import numpy as np

from softdyn.checks import read_only, vector
from softdyn.dynamics.model import SoftModel, State
from softdyn.dynamics.tree import TreeModel, tree_of


class Projection(SoftModel):
    """Every term of a tree's dynamics, projected; a subclass maps q to the tree's coordinates.

    Attributes
    ----------
    tree : TreeModel
        The model of the tree.
    S : ndarray, (tree.nv, nv)
        It maps the robot's velocities to the tree's.
    """

    tree: TreeModel
    S: np.ndarray

    @abstractmethod
    def expand(self, q: np.ndarray) -> np.ndarray:
        """Configuration (tree.nq,) of the tree at q (nq,)."""

    def state(self, q: np.ndarray, v: np.ndarray) -> State:
        """Every term of the dynamics at (q, v): the tree's, projected."""
        q, v = vector("q", q, self.nq), vector("v", v, self.nv)
        full, S = self.tree.state(self.expand(q), self.S @ v), self.S
        found = {
            "q": q, "v": v, "M": S.T @ full.M @ S, "bias": S.T @ full.bias, "K": S.T @ full.K,
            "D": S.T @ full.D @ S, "B": S.T @ full.B, "h": S.T @ full.h, "J": full.J @ S,
            "Jdot": full.Jdot @ S, "moment_arms": full.moment_arms @ S,
        }  # fmt: skip
        state = replace(full, model=self, **found)
        if self.forced:
            vars(state)["F"] = read_only(S.T @ full.F)
        return state

    def coriolis(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Coriolis matrix C (n, n) with Ṁ - 2C skew-symmetric."""
        v = vector("v", v, self.nv)
        return read_only(self.S.T @ self.tree.coriolis(self.expand(q), self.S @ v) @ self.S)

    def gravity(self, q: np.ndarray) -> np.ndarray:
        """Gravity force g (n,), the gradient of `gravity_energy`."""
        return read_only(self.S.T @ self.tree.gravity(self.expand(q)))

    def forward_dynamics(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Acceleration q̈ (n,) under the input u (m,), of M q̈ = B u - h."""
        state = self.state(q, v)
        return np.linalg.solve(state.M, state.B @ vector("u", u, self.nu) - state.h)

    def kinetic_energy(self, q: np.ndarray, v: np.ndarray) -> float:
        """½ q̇ᵀ M q̇ (J), armature included."""
        v = vector("v", v, self.nv)
        return self.tree.kinetic_energy(self.expand(q), self.S @ v)

    def gravity_energy(self, q: np.ndarray) -> float:
        """Potential energy of gravity (J), zero at the world's origin."""
        return self.tree.gravity_energy(self.expand(q))

    def elastic_energy(self, q: np.ndarray) -> float:
        """Energy of joint springs and elastic tendons (J)."""
        return self.tree.elastic_energy(self.expand(q))

    def forces_at(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """F (n,), the sum of one's own forces (N m, N): that of the tree, projected."""
        v = vector("v", v, self.nv)
        return read_only(self.S.T @ self.tree.forces_at(self.expand(q), self.S @ v))

    def force_derivatives(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """∂F/∂(q ⊕ dq) and ∂F/∂q̇ (n, n) of one's own forces."""
        S, v = self.S, vector("v", v, self.nv)
        by_q, by_v = self.tree.force_derivatives(self.expand(q), S @ v)
        return S.T @ by_q @ S, S.T @ by_v @ S

    @property
    def conserves(self) -> bool:
        """Whether each force of one's own has a potential."""
        return self.tree.conserves

    def forces_energy(self, q: np.ndarray) -> float:
        """Energy of those forces of one's own that have a potential (J)."""
        return self.tree.forces_energy(self.expand(q))

    def tendon_lengths(self, q: np.ndarray) -> np.ndarray:
        """Lengths (tendons,) of all tendons, in the file's order."""
        return self.tree.tendon_lengths(self.expand(q))

    def tendon_moment_arms(self, q: np.ndarray) -> np.ndarray:
        """Moment arms ∂ℓ/∂q (tendons, nv)."""
        return self.tree.tendon_moment_arms(self.expand(q)) @ self.S

    def tendon_hessians(self, q: np.ndarray) -> np.ndarray:
        """Gradients of the moment arms ∂²ℓ/∂q² (tendons, nv, nv)."""
        return self.S.T @ self.tree.tendon_hessians(self.expand(q)) @ self.S

    def tangent_stiffness(self, q: np.ndarray, v: np.ndarray | None = None) -> np.ndarray:
        """∂K/∂q (nv, nv): the tree's, projected."""
        v = None if v is None else self.S @ vector("v", v, self.nv)
        return self.S.T @ self.tree.tangent_stiffness(self.expand(q), v) @ self.S

    def link_poses(self, q: np.ndarray) -> dict[str, np.ndarray]:
        """Pose (4, 4) in the world of every link."""
        return self.tree.link_poses(self.expand(q))

    def link_jacobian(self, q: np.ndarray, link: str) -> np.ndarray:
        """Jacobian (6, n) of a link's frame, in the world's axes at the frame's origin."""
        return self.tree.link_jacobian(self.expand(q), link) @ self.S


def underlying_tree(model: SoftModel) -> tuple[TreeModel, np.ndarray | None]:
    """The tree that computes the model's terms, and S; S is None if the model is the tree."""
    if isinstance(model, Projection):
        return model.tree, model.S
    return tree_of(model), None


def project(S: np.ndarray | None, matrix: np.ndarray) -> np.ndarray:
    """Sᵀ A S, or A if S is None."""
    return matrix if S is None else S.T @ matrix @ S
