"""Fewer coordinates for a robot: `reduce` restricts its dynamics to a subspace of joint motions.

The only assumption is kinematic: ideal constraints keep the joints at q = S ξ. With a basis of
piecewise constant strains (`softdyn.design.strain_basis`), a rod's chain of joints becomes its PCC
or PCS model, up to the chain's own discretisation.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from softdyn.checks import array, instances, read_only, vector
from softdyn.description.robot import Robot
from softdyn.dynamics.mimic import build
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.dynamics.projection import Projection
from softdyn.dynamics.tree import tree_of
from softdyn.exceptions import InputError


@dataclass(frozen=True, eq=False)
class Basis:
    """The motions of the joints that a reduced model keeps.

    Attributes
    ----------
    matrix : ndarray, (joints, n)
        S: the joints' coordinates (rad, m) for one unit of each reduced coordinate.
    joints : tuple of str
        Names of the rows.
    names : tuple of str
        Names of the columns, the reduced coordinates.
    """

    matrix: np.ndarray
    joints: tuple[str, ...]
    names: tuple[str, ...]


def reduce(model: SoftModel, basis: Basis | np.ndarray | Sequence[Sequence[float]]) -> ReducedModel:
    """The model of a robot on a subspace of its joints' motions, q = S ξ.

    Parameters
    ----------
    model : SoftModel
        A model of a robot with a fixed base, without mimic and continuous joints.
    basis : Basis or array_like, (nv, n)
        S, of full rank.

    Raises
    ------
    InputError
        For any other robot, for a basis of other joints, and for a matrix of the wrong shape or of
        lower rank.
    """
    check_model(model)
    if not isinstance(basis, Basis):
        columns = np.shape(basis)[1] if np.ndim(basis) == 2 else 0
        names = tuple(f"xi_{k + 1}" for k in range(columns))
        basis = Basis(array("basis", basis, (model.nv, columns)), model.joint_names, names)
    for name in ("joints", "names"):
        instances(f"basis.{name}", getattr(basis, name), str, "a name")
    if sorted(basis.joints) != sorted(model.joint_names):
        other = sorted(set(basis.joints) ^ set(model.joint_names))
        raise InputError("basis", f"a row for each joint of {model.name!r}", f"of others: {other}")
    rows = [basis.joints.index(name) for name in model.joint_names]
    matrix = array("basis", basis.matrix, (model.nv, len(basis.names)))[rows]
    return ReducedModel(model, replace(basis, matrix=matrix, joints=model.joint_names))


def rebuild(model: SoftModel, robot: Robot) -> SoftModel:
    """The model of another description of the same tree, on the same basis if it is a reduced one.

    Parameters
    ----------
    model : SoftModel
        A model.
    robot : Robot
        Its `robot` with other numbers.
    """
    if not isinstance(model, ReducedModel):
        return build(robot, model.bundled)
    if robot.xml == model.robot.xml:  # without the mark of the basis
        robot = replace(robot, xml=model.full.robot.xml)
    return reduce(rebuild(model.full, robot), model.basis)


class ReducedModel(Projection):
    """A robot's dynamics in fewer coordinates; made by `reduce`.

    `stiffness`, `damping` and `armature` are the diagonals of Sᵀ diag(·) S. They are the whole
    matrices if columns share no joint, as with constant strains. K, D and M of a State are always
    complete. A reduced coordinate has the limits of the joints that only it moves.

    Attributes
    ----------
    full : SoftModel
        The model that was reduced.
    basis : Basis
        Rows in the order of its joints.
    gear : ndarray, (m,)
        Force of each input along its tendon for u = 1.
    actuated : ndarray of int, (m,)
        The tendon of each input.
    """

    def __init__(self, full: SoftModel, basis: Basis) -> None:
        self.full, self.basis = full, basis
        tree = self.tree = tree_of(full)
        if tree.nq != tree.nv:
            expected = "a fixed base and no continuous joint"
            raise InputError("model", expected, full.name)
        S = self.S = basis.matrix
        self.nq = self.nv = S.shape[1]
        # NumPy 2.0 cannot compute the rank of a matrix without columns
        rank = int(np.linalg.matrix_rank(S / np.abs(S).max())) if S.any() else 0
        if rank < self.nv or self.nv == 0:
            raise InputError("basis", "a matrix of full column rank", f"rank {rank} of {S.shape}")
        # a new xml lets a controller's guard see another robot, because States have other shapes
        kind = hashlib.sha256(S.tobytes() + repr(basis.names).encode()).hexdigest()
        self.robot = replace(full.robot, xml=f"{full.robot.xml}<!-- on the basis {kind} -->")
        self.bundled, self.name, self.nu = None, f"{full.name}, reduced", full.nu
        self.joint_names = basis.names
        self.q0 = read_only(np.zeros(self.nq))
        self.u_min, self.u_max = full.u_min, full.u_max
        self.lower, self.upper = (read_only(x) for x in self._limits())
        self.stiffness, self.damping, self.armature = (
            read_only(np.square(S).T @ getattr(full, name))
            for name in ("stiffness", "damping", "armature")
        )
        pull = S.T @ (full.stiffness * full.rest)
        self.rest = read_only(pull / np.where(self.stiffness > 0, self.stiffness, 1.0))
        self.tendons, self.tendon_rest = full.tendons, full.tendon_rest
        self.tendon_slack = full.tendon_slack
        self.gear, self.actuated = tree.gear, tree.actuated
        self.tendon_stiffness, self.tendon_damping = full.tendon_stiffness, full.tendon_damping
        # for the ξ nearest to q, measured by the springs' energy
        weight = full.stiffness if (full.stiffness > 0).all() else np.ones(full.nv)
        self._nearest = np.linalg.solve(S.T @ (weight[:, None] * S), S.T * weight)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.full, self.basis)

    def with_forces(self, *forces: Any) -> ReducedModel:
        """A new model on the same basis, on whose whole robot further forces act."""
        return ReducedModel(self.full.with_forces(*forces), self.basis)

    def _limits(self) -> tuple[np.ndarray, np.ndarray]:
        lower, upper = np.full(self.nv, -np.inf), np.full(self.nv, np.inf)
        for row, low, high in zip(self.S, self.full.lower, self.full.upper, strict=True):
            (moving,) = np.nonzero(row)
            if len(moving) == 1:
                k = int(moving[0])
                ends = sorted((low / row[k], high / row[k]))
                lower[k], upper[k] = max(lower[k], ends[0]), min(upper[k], ends[1])
        return lower, upper

    def expand(self, q: np.ndarray) -> np.ndarray:
        """Configuration (tree.nq,) of the robot at the reduced coordinates (nq,)."""
        return self.S @ vector("q", q, self.nq)

    def project(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Reduced coordinates and velocities nearest to those of the robot.

        They minimise the springs' energy of the difference.

        Parameters
        ----------
        q, v : array_like, (full.nq,), (full.nv,)
            The robot's configuration and velocity.
        """
        full = self.full
        return self._nearest @ vector("q", q, full.nq), self._nearest @ vector("v", v, full.nv)

    def coordinates(self, q: np.ndarray) -> np.ndarray:
        """Return the reduced coordinates (nv,) unchanged."""
        return np.asarray(q, float)

    def configuration(self, coordinates: np.ndarray) -> np.ndarray:
        """Return the coordinates unchanged, as a configuration (nq,)."""
        return vector("coordinates", coordinates, self.nv)

    def integrate(self, q: np.ndarray, dv: np.ndarray) -> np.ndarray:
        """q + dv (nq,)."""
        return vector("q", q, self.nq) + vector("dv", dv, self.nv)
