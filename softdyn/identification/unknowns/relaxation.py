"""Maxwell branches of joints in a fit: shares and times, and the torques' derivatives by both.

The share g of a branch is that of the instantaneous stiffness k₀ = k∞ + Σ k, as in a Prony series.
The number k = g k∞ / (1 - Σ g) follows the joint's other unknowns. So a spring of another stiffness
keeps its shares.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from softdyn.description.robot import Joint, Robot
from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.relaxation import Branches

SHARE, TIME = "relaxation_share", "relaxation_time"
MOST = 0.99  # sum of a joint's shares; a fit on its way may ask for more


def shares(robot: Robot) -> dict[str, float]:
    """The share of each branch, by ``joint.k``."""
    return {
        name: k / (joint.stiffness + sum(one for one, _ in joint.relaxation))
        for joint in robot.joints
        for name, (k, _) in zip(_names(joint), joint.relaxation, strict=True)
    }


def times(robot: Robot) -> dict[str, float]:
    """The time (s) of each branch, by ``joint.k``."""
    return {
        name: time
        for joint in robot.joints
        for name, (_, time) in zip(_names(joint), joint.relaxation, strict=True)
    }


def with_shares(robot: Robot, values: dict[str, float]) -> Robot:
    """The robot with other shares of branches."""
    wanted = shares(robot) | values

    def changed(joint: Joint) -> Joint:
        own = [max(wanted[name], 0.0) for name in _names(joint)]
        factor = min(1.0, MOST / sum(own)) if any(own) else 1.0
        left = 1.0 - factor * sum(own)
        branches = zip(own, joint.relaxation, strict=True)
        found = tuple((factor * g * joint.stiffness / left, time) for g, (_, time) in branches)
        return replace(joint, relaxation=found)

    return _each(robot, changed)


def with_times(robot: Robot, values: dict[str, float]) -> Robot:
    """The robot with other times of branches."""
    wanted = times(robot) | values

    def changed(joint: Joint) -> Joint:
        branches = zip(_names(joint), joint.relaxation, strict=True)
        return replace(joint, relaxation=tuple((k, wanted[name]) for name, (k, _) in branches))

    return _each(robot, changed)


def with_stiffness(robot: Robot, values: dict[str, float]) -> Robot:
    """The robot with other springs, whose branches keep their shares."""

    def changed(joint: Joint) -> Joint:
        if joint.name not in values:
            return joint
        value = values[joint.name]
        factor = value / joint.stiffness if joint.stiffness else 1.0
        branches = tuple((factor * k, time) for k, time in joint.relaxation)
        return replace(joint, stiffness=value, relaxation=branches)

    return replace(robot, joints=tuple(changed(joint) for joint in robot.joints))


def _each(robot: Robot, changed: Callable[[Joint], Joint]) -> Robot:
    joints = (changed(joint) if joint.relaxation else joint for joint in robot.joints)
    return replace(robot, joints=tuple(joints))


def _names(joint: Joint) -> list[str]:
    return [f"{joint.name}.{number}" for number in range(1, len(joint.relaxation) + 1)]


@dataclass(frozen=True, eq=False)
class CreepingSprings:
    """The branches of a model at θ, with their derivatives by all P unknowns.

    Attributes
    ----------
    branches : Branches
    stiffness_by, time_by : ndarray, (nz, P)
        ∂k/∂θ and ∂τ/∂θ.
    """

    branches: Branches
    stiffness_by: np.ndarray
    time_by: np.ndarray

    @classmethod
    def of(
        cls, model: SoftModel, unknowns: Iterable[tuple[str, np.ndarray]], count: int
    ) -> CreepingSprings | None:
        """Those of the model with the unknowns' values; None if its springs do not creep.

        Parameters
        ----------
        model : SoftModel
        unknowns : iterable of (str, ndarray)
            Kind and weights (members,) of the first unknowns.
        count : int
            P.
        """
        branches = Branches.of(model)
        k, size = branches.stiffness, len(branches.names)
        if not size:
            return None
        spring = branches.rates @ model.stiffness
        same = (branches.rates @ branches.rates.T) > 0
        left = spring / (spring + same @ k)  # 1 - Σ g
        share = k * left / spring
        by_share = (spring / left)[:, None] * (np.eye(size) + same * (share / left)[:, None])
        by_k, by_time = np.zeros((2, size, count))
        for p, (kind, weights) in enumerate(unknowns):
            if kind == SHARE:
                by_k[:, p] = by_share @ weights
            elif kind == TIME:
                by_time[:, p] = weights
            elif kind == "stiffness":
                by_k[:, p] = k / spring * (branches.rates @ weights)
        return cls(branches, by_k, by_time)

    def along(self, t: np.ndarray, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The torques (nz,) at the end of a measured path (N, n) from rest, and ∂z/∂θ (nz, P)."""
        k, time = self.branches.stiffness, self.branches.time
        z, by = np.zeros(len(k)), np.zeros_like(self.stiffness_by)
        moves = np.diff(path, axis=0) @ self.branches.rates.T
        for h, move in zip(np.diff(t), moves, strict=True):
            left, gain = self.branches.decay(h), self.branches.gain(h)
            slope = k / h * (1.0 - left) - k * left / time  # of the gain by τ
            by = (
                left[:, None] * by + (z * left * h / time**2 + slope * move)[:, None] * self.time_by
            )
            by += (gain / k * move)[:, None] * self.stiffness_by
            z = left * z + gain * move
        return z, by
