"""Robots with mimic joints: the dynamics of the tree, projected on what moves by itself.

A follower's coordinate is multiplier · leader + offset. So with q the independent coordinates and S
(tree, n) constant,

    q_tree = S q + offset,    v_tree = S v,    a_tree = S a,

and d'Alembert's principle gives every term of the robot from those of its tree:

    M = Sᵀ M_tree S,  C = Sᵀ C_tree S,  D = Sᵀ D_tree S,
    h = Sᵀ h_tree,    B = Sᵀ B_tree,    J = J_tree S.

Armature, springs, dampers and tendons of followers are thus included. Exact, and nothing that a
robot without mimic joints would pay for.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from softdyn.checks import read_only, vector
from softdyn.description.robot import Robot
from softdyn.dynamics.model import SoftModel, State
from softdyn.dynamics.tree import TreeModel
from softdyn.exceptions import UrdfError


def build(robot: Robot, bundled: str | None = None) -> SoftModel:
    """The model of any robot: a `TreeModel`, or with mimic joints a `MimicModel`.

    Parameters
    ----------
    robot : Robot
        The parsed description.
    bundled : str, optional
        Name among the bundled robots, None for any other file.

    Raises
    ------
    UrdfError
        When Pinocchio refuses the file, reads another robot in it than the strict parse did, or
        finds a singular mass matrix.
    """
    model: SoftModel = (MimicModel if robot.followers else TreeModel)(robot, bundled)
    M = model.state(model.q0, np.zeros(model.nv)).M
    scale = np.sqrt(np.maximum(np.diag(M), 0.0))  # a moment may be zero but for rounding
    weakest = int(np.argmin(scale))
    if scale[weakest] > 0:
        values, modes = np.linalg.eigh(M / np.outer(scale, scale))
        if values[0] >= 1e-14:
            return model
        weakest = int(np.argmax(np.abs(modes[:, 0])))
    raise UrdfError(
        robot.path,
        "<robot>",
        "a positive definite mass matrix at q = 0",
        f"a singular one; joint {model.joint_names[weakest]!r} meets the least inertia",
    )


class MimicModel(SoftModel):
    """A model whose mimic joints follow others: `q`, `v` and all columns leave them out.

    Parameters
    ----------
    robot : Robot
        The parsed description.
    bundled : str, optional
        Name among the bundled robots, None for any other file.

    Attributes
    ----------
    tree : TreeModel
        The model of the same robot with all joints independent.
    S, offset : ndarray, (tree.nv, nv), (tree.nv,)
        Coordinates of the tree from those of the robot.

    Raises
    ------
    UrdfError
        When Pinocchio refuses the file or reads another robot in it than the strict parse did.
    """

    def __init__(self, robot: Robot, bundled: str | None = None) -> None:
        free = replace(robot, joints=tuple(replace(joint, mimic=None) for joint in robot.joints))
        tree = TreeModel(free)
        self.robot, self.bundled, self.name = robot, bundled, robot.name
        followers = {joint.name: joint.mimic for joint in robot.followers}
        self.joint_names = tuple(name for name in tree.joint_names if name not in followers)
        column = {name: k for k, name in enumerate(self.joint_names)}
        self.nv, self.nu = len(column), tree.nu
        self.S, self.offset = np.zeros((tree.nv, self.nv)), np.zeros(tree.nv)
        for row, name in enumerate(tree.joint_names):
            mimic = followers.get(name)
            self.S[row, column[mimic.leader if mimic else name]] = mimic.multiplier if mimic else 1
            self.offset[row] = mimic.offset if mimic else 0.0
        self._own = np.array([name in column for name in tree.joint_names])
        # where the numbers of q stand in the tree's: all but those of followers
        self._slots = np.delete(np.arange(tree.nq), tree.chart.numbers_of(~self._own))
        self.nq = len(self._slots)
        self.q0 = read_only(tree.q0[self._slots])
        self.tree = self._at_rest(tree, free)
        self.u_min, self.u_max = tree.u_min, tree.u_max
        self.lower, self.upper = (read_only(x[self._own]) for x in (tree.lower, tree.upper))
        # S has one entry a row: what is diagonal in the tree is diagonal here
        squares = self.S.T**2
        self.stiffness = read_only(squares @ tree.stiffness)
        self.damping = read_only(squares @ tree.damping)
        self.armature = read_only(squares @ tree.armature)
        pull = self.S.T @ (tree.stiffness * (tree.rest - self.offset))
        self.rest = read_only(pull / np.where(self.stiffness > 0, self.stiffness, 1.0))
        self.tendons = self.tree.tendons
        self.tendon_stiffness = self.tree.tendon_stiffness
        self.tendon_damping = self.tree.tendon_damping
        self.tendon_rest = self.tree.tendon_rest

    def _at_rest(self, tree: TreeModel, robot: Robot) -> TreeModel:
        """The tree with omitted rest lengths as at q = 0, where followers are at an offset."""
        if not self.offset.any():
            return tree
        self.tree = tree
        lengths = tree.tendon_lengths(self.expand(self.q0))
        tendons = (
            replace(tendon, rest=float(length)) if tendon.rest is None else tendon
            for tendon, length in zip(robot.tendons, lengths, strict=True)
        )
        return TreeModel(replace(robot, tendons=tuple(tendons)))

    def expand(self, q: np.ndarray) -> np.ndarray:
        """Configuration (tree.nq,) of the tree at q (nq,)."""
        q = vector("q", q, self.nq)
        full = self.tree.q0.copy()
        full[self._slots] = q
        values = self.S @ self.tree.coordinates(full)[self._own] + self.offset
        expanded = self.tree.configuration(values)
        expanded[self._slots] = q
        return expanded

    def state(self, q: np.ndarray, v: np.ndarray) -> State:
        """Every term of the dynamics at (q, v): the tree's, projected."""
        q, v = vector("q", q, self.nq), vector("v", v, self.nv)
        full, S = self.tree.state(self.expand(q), self.S @ v), self.S
        found = {
            "q": q, "v": v, "M": S.T @ full.M @ S, "bias": S.T @ full.bias, "K": S.T @ full.K,
            "D": S.T @ full.D @ S, "B": S.T @ full.B, "h": S.T @ full.h, "J": full.J @ S,
            "Jdot": full.Jdot @ S, "moment_arms": full.moment_arms @ S,
        }  # fmt: skip
        return replace(full, model=self, **found)

    def coriolis(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Coriolis matrix C (n, n) with Ṁ - 2C skew-symmetric."""
        v = vector("v", v, self.nv)
        return read_only(self.S.T @ self.tree.coriolis(self.expand(q), self.S @ v) @ self.S)

    def gravity(self, q: np.ndarray) -> np.ndarray:
        """Gravity force g (n,), the gradient of `gravity_energy`."""
        return read_only(self.S.T @ self.tree.gravity(self.expand(q)))

    def forward_dynamics(self, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Acceleration q̈ (nv,) under the input u (nu,), of M q̈ = B u - h."""
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

    def tendon_lengths(self, q: np.ndarray) -> np.ndarray:
        """Lengths (tendons,) of all tendons, in the file's order."""
        return self.tree.tendon_lengths(self.expand(q))

    def tendon_moment_arms(self, q: np.ndarray) -> np.ndarray:
        """Moment arms ∂ℓ/∂q (tendons, nv)."""
        return self.tree.tendon_moment_arms(self.expand(q)) @ self.S

    def tendon_hessians(self, q: np.ndarray) -> np.ndarray:
        """Gradients of the moment arms ∂²ℓ/∂q² (tendons, nv, nv)."""
        return self.S.T @ self.tree.tendon_hessians(self.expand(q)) @ self.S

    def coordinates(self, q: np.ndarray) -> np.ndarray:
        """Coordinates (nv,) of the independent joints."""
        return self.tree.coordinates(self.expand(q))[self._own]

    def configuration(self, coordinates: np.ndarray) -> np.ndarray:
        """Configuration q (nq,) of joint coordinates (nv,): the inverse of `coordinates`."""
        values = vector("coordinates", coordinates, self.nv)
        return self.tree.configuration(self.S @ values + self.offset)[self._slots]

    def link_poses(self, q: np.ndarray) -> dict[str, np.ndarray]:
        """Pose (4, 4) in the world of every link, followers' included."""
        return self.tree.link_poses(self.expand(q))

    def integrate(self, q: np.ndarray, dv: np.ndarray) -> np.ndarray:
        """q ⊕ dv (nq,): the configuration after the displacement dv (nv,)."""
        return self.tree.integrate(self.expand(q), self.S @ dv)[self._slots]
