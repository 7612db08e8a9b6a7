"""Joint limits at rest: hard stops hold a joint, soft stops repel it smoothly.

All functions take joint coordinates (nv,), `SoftModel.coordinates` of a configuration (rad, m).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softdyn.checks import array, length
from softdyn.copies import Frozen
from softdyn.dynamics.model import SoftModel, check_model

TOUCHING = 1e-9  # a joint this close to a limit counts as at it (rad, m)


@dataclass(frozen=True, eq=False)
class HardStops(Frozen):
    """Stops that balance any force that presses a joint against them.

    Attributes
    ----------
    lower, upper : ndarray, (nv,)
        The joint limits (rad, m).
    """

    lower: np.ndarray
    upper: np.ndarray

    @classmethod
    def of(cls, model: SoftModel) -> HardStops:
        """The stops of a robot."""
        return cls(check_model(model).lower, model.upper)

    def within(self, at: np.ndarray) -> np.ndarray:
        """The closest coordinates (nv,) that the stops allow."""
        return np.clip(at, self.lower, self.upper)

    def clip(self, at: np.ndarray, step: np.ndarray) -> np.ndarray:
        """The part of a step (nv,) that the stops allow."""
        return np.clip(step, np.minimum(self.lower - at, 0), np.maximum(self.upper - at, 0))

    def push(self, at: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces of the stops (nv,) that balance the residual r (nv,); held joints (nv,) bool."""
        held = (at <= self.lower + TOUCHING) & (r > 0) | (at >= self.upper - TOUCHING) & (r < 0)
        return np.where(held, r, 0.0), held

    def stiffness(self, at: np.ndarray) -> np.ndarray:
        """Stiffness (nv,) that the stops add to free joints: zero."""
        return np.zeros_like(at)


@dataclass(frozen=True, eq=False)
class SoftStops(Frozen):
    """Joint limits as a smooth repulsion μ / gap.

    With exact stops ∂q/∂u jumps when a joint reaches or leaves one, and a search for equilibria
    gets stuck there. With soft stops the branch is smooth. The search follows it with falling μ.

    Attributes
    ----------
    weight : ndarray, (nv,)
        μ (N m rad, N m); a force f keeps a joint μ / f away from its limit.
    lower, upper : ndarray, (nv,)
        The joint limits (rad, m).
    """

    weight: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    def __post_init__(self) -> None:
        shape = (length("weight", self.weight),)
        object.__setattr__(self, "weight", array("weight", self.weight, shape))
        for name in ("lower", "upper"):
            limits = array(name, getattr(self, name), shape, finite=False)
            object.__setattr__(self, name, limits)

    def within(self, at: np.ndarray) -> np.ndarray:
        """The closest coordinates (nv,) slightly inside the limits."""
        margin = np.minimum(1e-4 * (self.upper - self.lower), 1e-4)
        return np.clip(at, self.lower + margin, self.upper - margin)

    def clip(self, at: np.ndarray, step: np.ndarray) -> np.ndarray:
        """The part of a step (nv,) that takes at most nine tenths of each gap."""
        return np.clip(step, 0.9 * (self.lower - at), 0.9 * (self.upper - at))

    def push(self, at: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces of the stops (nv,), for any residual r; no joint is held."""
        return self.weight / (at - self.lower) - self.weight / (self.upper - at), r != r

    def stiffness(self, at: np.ndarray) -> np.ndarray:
        """Stiffness (nv,) that the stops add to each joint."""
        return self.weight / (self.upper - at) ** 2 + self.weight / (at - self.lower) ** 2
