"""Robots with mimic joints: the dynamics of the tree, projected on the independent joints.

A follower's coordinate is multiplier · leader + offset. The model is therefore a `Projection` with
one entry in each row of S. It is exact and includes armature, springs, dampers and tendons of
followers. Robots without mimic joints do not use it, so it costs them nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from softdyn.checks import instance, read_only, vector
from softdyn.description.robot import Robot
from softdyn.dynamics.engine import BASE
from softdyn.dynamics.forces import check_forces, copied_forces
from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.projection import Projection
from softdyn.dynamics.tree import TreeModel
from softdyn.exceptions import UrdfError


def build(robot: Robot, bundled: str | None = None, *, forces: Iterable[Any] = ()) -> SoftModel:
    """The model of any robot: a `TreeModel`, or with mimic joints a `MimicModel`.

    Parameters
    ----------
    robot : Robot
        The parsed description.
    bundled : str, optional
        Name among the bundled robots, None for any other file.
    forces : iterable of Force, optional
        Further forces of one's own, as for `SoftModel.with_forces`.

    Raises
    ------
    InputError
        For a force that does not meet the contract, and for two forces of one name.
    UrdfError
        If Pinocchio refuses the file, if it reads another robot than the strict parse, or if the
        mass matrix is singular.
    """
    followers = instance("robot", robot, Robot, "a Robot, from softdyn.parse(…)").followers
    if added := copied_forces(forces):
        robot = replace(robot, forces=check_forces((*robot.forces, *added)))
    model: SoftModel = (MimicModel if followers else TreeModel)(robot, bundled)
    M = model.state(model.q0, np.zeros(model.nv)).M
    scale = np.sqrt(np.maximum(np.diag(M), 0.0))  # rounding may make a zero moment negative
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


class MimicModel(Projection):
    """The model of a robot with mimic joints; `q`, `v` and all columns leave followers out.

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
        They map the robot's coordinates to the tree's.

    Raises
    ------
    UrdfError
        If Pinocchio refuses the file or reads another robot than the strict parse.
    """

    def __init__(self, robot: Robot, bundled: str | None = None) -> None:
        free = replace(robot, joints=tuple(replace(joint, mimic=None) for joint in robot.joints))
        tree = TreeModel(free)
        self.robot, self.bundled, self.name = robot, bundled, robot.name
        followers = {joint.name: joint.mimic for joint in robot.followers}
        # the base's coordinates come first; one of the file's joints may share a name with them
        base = len(BASE) if robot.floating else 0
        names = enumerate(tree.joint_names)
        mimics = [None if k < base else followers.get(name) for k, name in names]
        self._own = np.array([mimic is None for mimic in mimics])
        self.joint_names = tuple(np.array(tree.joint_names, object)[self._own])
        column = {name: k for k, name in enumerate(self.joint_names) if k >= base}
        self.nv, self.nu = len(self.joint_names), tree.nu
        self.S, self.offset = np.zeros((tree.nv, self.nv)), np.zeros(tree.nv)
        self.S[np.flatnonzero(self._own), np.arange(self.nv)] = 1.0
        for row, mimic in enumerate(mimics):
            if mimic is not None:
                self.S[row, column[mimic.leader]] = mimic.multiplier
                self.offset[row] = mimic.offset
        # indices of q in the tree's q: all but the followers'
        self._slots = np.delete(np.arange(tree.nq), tree.chart.numbers_of(~self._own))
        self.nq = len(self._slots)
        self.q0 = read_only(tree.q0[self._slots])
        self.tree = self._at_rest(tree, free)
        self.u_min, self.u_max = tree.u_min, tree.u_max
        self.lower, self.upper = (read_only(x[self._own]) for x in (tree.lower, tree.upper))
        # S has one entry in each row, so diagonal matrices of the tree stay diagonal
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
        self.tendon_slack = self.tree.tendon_slack

    def _at_rest(self, tree: TreeModel, robot: Robot) -> TreeModel:
        """The tree with omitted rest lengths taken at q = 0, with followers at their offsets."""
        if not self.offset.any():
            return tree
        self.tree = tree
        lengths = tree.tendon_lengths(self.expand(self.q0))
        tendons = (
            replace(tendon, rest=float(length)) if tendon.rest is None else tendon
            for tendon, length in zip(robot.tendons, lengths, strict=True)
        )
        return TreeModel(replace(robot, tendons=tuple(tendons)))

    def with_forces(self, *forces: Any) -> MimicModel:
        """A new model of the robot, on whose tree further forces act; it shares the engine."""
        other = object.__new__(type(self))
        tree = self.tree.with_forces(*forces)
        vars(other).update(vars(self), tree=tree, robot=replace(self.robot, forces=tree.forces))
        return other

    def expand(self, q: np.ndarray) -> np.ndarray:
        """Configuration (tree.nq,) of the tree at q (nq,)."""
        q = vector("q", q, self.nq)
        full = self.tree.q0.copy()
        full[self._slots] = q
        values = self.S @ self.tree.coordinates(full)[self._own] + self.offset
        expanded = self.tree.configuration(values)
        expanded[self._slots] = q
        return expanded

    def coordinates(self, q: np.ndarray) -> np.ndarray:
        """Coordinates (nv,) of the independent joints."""
        return self.tree.coordinates(self.expand(q))[self._own]

    def configuration(self, coordinates: np.ndarray) -> np.ndarray:
        """Configuration q (nq,) of joint coordinates (nv,): the inverse of `coordinates`."""
        values = vector("coordinates", coordinates, self.nv)
        return self.tree.configuration(self.S @ values + self.offset)[self._slots]

    def integrate(self, q: np.ndarray, dv: np.ndarray) -> np.ndarray:
        """q ⊕ dv (nq,): the configuration after the displacement dv (nv,)."""
        return self.tree.integrate(self.expand(q), self.S @ dv)[self._slots]
