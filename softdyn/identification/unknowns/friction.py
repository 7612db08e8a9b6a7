"""Dry friction of the joints: Coulomb's, made smooth near zero velocity.

The controllers' model has no dry friction. A measured robot has some, so the fitted model may have
it too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softdyn.description.robot import sliding
from softdyn.dynamics.model import SoftModel

SLOW = 0.01  # 1/s, rate over the joint's range at which friction has 76 % of its full size


class Friction(NamedTuple):
    """Sizes (n,) in N m or N, and the rates (n,) below which they fall to zero."""

    size: np.ndarray
    slow: np.ndarray

    def signs(self, v: np.ndarray) -> np.ndarray:
        """Signs of the rates (n,), rounded: from -1 to 1."""
        return np.tanh(v / self.slow)

    def slope(self, v: np.ndarray) -> np.ndarray:
        """∂force/∂v (n, n) of the force `size` · `signs`."""
        return np.diag(self.size * (1 - self.signs(v) ** 2) / self.slow)


def friction_of(model: SoftModel) -> Friction:
    """The file's friction; a joint without limits has one turn, or one metre, as its range."""
    sizes = {joint.name: joint.friction for joint in model.robot.moving_joints}
    range_ = model.upper - model.lower
    free = np.where(sliding(model.robot, model.joint_names), 1.0, 2 * np.pi)
    return Friction(
        np.array([sizes[name] for name in model.joint_names]),
        SLOW * np.where(np.isfinite(range_) & (range_ > 0), range_, free),
    )
