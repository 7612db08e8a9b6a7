"""Tasks of the whole arm: its shape, joints, reduced coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from softdyn.checks import beyond, did_you_mean, instance, instances, number
from softdyn.dynamics.model import SoftModel, State
from softdyn.dynamics.reduced import Basis
from softdyn.exceptions import InputError
from softdyn.tasks.link_motion import LinkKinematics
from softdyn.tasks.task import Task, TaskError, check_target


@dataclass(frozen=True, eq=False)
class ShapeTask(Task):
    """Points of the arm's axis along a line: e = p_i - p_r,i (m), three rows for each point.

    The axis is the chain of joint origins from the root to the tip at q = 0. Its name is "shape".

    Attributes
    ----------
    arcs : sequence of float
        Arc lengths of the points from the root (m).
    """

    arcs: Any

    kind = "shape"
    units = ("m",)

    def __post_init__(self) -> None:
        given = instances("arcs", self.arcs, object, "an arc length")
        arcs = tuple(number("arcs", s, lower=0.0) for s in given)
        if not arcs:
            raise InputError("arcs", "the arc length of a point or more", "none")
        object.__setattr__(self, "arcs", arcs)
        object.__setattr__(self, "size", 3 * len(arcs))
        super().__post_init__()

    def evaluate(self, state: State, target: Any) -> TaskError:
        """Error (3 k,) against a `Target` of shape (k, 3), the points' places."""
        check_target(self, target, "a point of each arc length", (len(self.arcs), 3))
        places, kinematics = points_of_arm(state.model, self.arcs), LinkKinematics.of(state.model)
        motions = [kinematics(state, link, point) for link, point in places]
        return TaskError(
            (np.array([at.position for at in motions]) - target.y).ravel(),
            (np.array([at.velocity[:3] for at in motions]) - target.ydot).ravel(),
            np.concatenate([at.jacobian[:3] for at in motions]),
            (np.array([at.drift[:3] for at in motions]) - target.yddot).ravel(),
        )


def points_of_arm(model: SoftModel, arcs: tuple[float, ...]) -> list[tuple[str, tuple[float, ...]]]:
    """The link and the point in it at each arc length of the arm's axis.

    Raises
    ------
    InputError
        For an arc length beyond the tip.
    """
    known = vars(model).setdefault("_points_of_arm", {})
    if arcs in known:
        found: list[tuple[str, tuple[float, ...]]] = known[arcs]
        return found
    chain = model.robot.chain(model.robot.task)
    offsets = [np.array(joint.origin.xyz) for joint in chain]
    ends = np.cumsum([np.linalg.norm(offset) for offset in offsets])
    places = []
    for s in arcs:
        if beyond(s, ends[-1]):
            raise InputError("arcs", f"at most the arm's length {ends[-1]:.6g} m", f"{s:g}")
        k = min(int(np.searchsorted(ends, s)), len(chain) - 1)
        size = float(np.linalg.norm(offsets[k]))
        share = 1 - (ends[k] - s) / size if size > 0 else 0.0
        places.append((chain[k].parent, tuple((share * offsets[k]).tolist())))
    known[arcs] = places
    return places


@dataclass(frozen=True, eq=False)
class JointTask(Task):
    """Joints at given coordinates (rad, m). Its name is "joints".

    The error of a continuous joint is the shorter way around, in (-π, π].

    Attributes
    ----------
    joints : sequence of str, optional
        Their names, by default all.
    """

    joints: Any = None

    kind = "joints"

    def __post_init__(self) -> None:
        if self.joints is not None:
            object.__setattr__(self, "joints", instances("joints", self.joints, str, "a name"))
            object.__setattr__(self, "size", len(self.joints))
        super().__post_init__()

    def evaluate(self, state: State, target: Any) -> TaskError:
        """Error against a `Target` of the joints' coordinates."""
        model = state.model
        names = model.joint_names if self.joints is None else self.joints
        if model.robot.floating:
            raise InputError("model", "a fixed base, for a task of joints", model.name)
        for name in names:
            if name not in model.joint_names:
                raise InputError("joints", "joints", did_you_mean(name, model.joint_names))
        check_target(self, target, "joint coordinates", (len(names),))
        rows = [model.joint_names.index(name) for name in names]
        kinds = {joint.name: joint.kind for joint in model.robot.joints}
        error = model.coordinates(state.q)[rows] - target.y
        around = np.array([kinds.get(name) == "continuous" for name in names])
        error[around] -= 2 * np.pi * np.ceil(error[around] / (2 * np.pi) - 0.5)
        jacobian = np.eye(model.nv)[rows]
        return TaskError(error, state.v[rows] - target.ydot, jacobian, -target.yddot)


@dataclass(frozen=True, eq=False)
class StrainTask(Task):
    """Reduced coordinates ξ at given values; q ≈ S ξ. Its name is "strains".

    ξ is the least-squares solution S⁺ q.

    Attributes
    ----------
    basis : Basis
        S, for example from `softdyn.design.strain_basis`.
    """

    basis: Basis

    kind = "strains"

    def __post_init__(self) -> None:
        instance("basis", self.basis, Basis, "a Basis, from softdyn.design.strain_basis(…)")
        object.__setattr__(self, "_inverse", np.linalg.pinv(self.basis.matrix))
        object.__setattr__(self, "size", len(self.basis.names))
        super().__post_init__()

    def evaluate(self, state: State, target: Any) -> TaskError:
        """Error against a `Target` of the reduced coordinates."""
        names = state.model.joint_names
        if set(names) != set(self.basis.joints):
            expected = f"a basis of the joints of {state.model.name!r}"
            raise InputError("basis", expected, f"one of {len(self.basis.joints)} joints")
        inverse: np.ndarray = vars(self)["_inverse"]
        inverse = inverse[:, [self.basis.joints.index(name) for name in names]]
        check_target(self, target, "reduced coordinates", (len(inverse),))
        xi = inverse @ state.model.coordinates(state.q)
        return TaskError(xi - target.y, inverse @ state.v - target.ydot, inverse, -target.yddot)
