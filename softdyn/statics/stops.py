"""Joint limits at rest: stops that hold a joint pressed against them, or repel it smoothly.

All functions take joint coordinates (nv,), `SoftModel.coordinates` of a configuration (rad, m).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softdyn.checks import array, length
from softdyn.dynamics.model import SoftModel, check_model

TOUCHING = 1e-9  # a joint this close to a limit is at it (rad, m)


@dataclass(frozen=True, eq=False)
class HardStops:
    """Stops that take whatever presses a joint against them.

    Attributes
    ----------
    lower, upper : ndarray, (nv,)
        The joint limits (rad, m).
    """

    lower: np.ndarray
    upper: np.ndarray

    @classmethod
    def of(cls, model: SoftModel) -> HardStops:
        """Those of a robot."""
        return cls(check_model(model).lower, model.upper)

    def within(self, at: np.ndarray) -> np.ndarray:
        """The closest coordinates (nv,) that the stops allow."""
        return np.clip(at, self.lower, self.upper)

    def clip(self, at: np.ndarray, step: np.ndarray) -> np.ndarray:
        """The part of a step (nv,) that they allow."""
        return np.clip(step, np.minimum(self.lower - at, 0), np.maximum(self.upper - at, 0))

    def push(self, at: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Force on each joint (nv,) that balances the residual r (nv,); the joints held by one."""
        held = (at <= self.lower + TOUCHING) & (r > 0) | (at >= self.upper - TOUCHING) & (r < 0)
        return np.where(held, r, 0.0), held

    def stiffness(self, at: np.ndarray) -> np.ndarray:
        """Stiffness (nv,) that they add to the joints that they do not hold: none."""
        return np.zeros_like(at)


@dataclass(frozen=True, eq=False)
class SoftStops:
    """Joint limits as smooth repulsion μ / gap: the stops without their corners.

    With exact stops, ∂q/∂u jumps where a joint meets or leaves one; a search among equilibria
    gets stuck there. It follows the smooth branch instead, for falling μ.

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
        """The closest coordinates (nv,) a little off the limits."""
        margin = np.minimum(1e-4 * (self.upper - self.lower), 1e-4)
        return np.clip(at, self.lower + margin, self.upper - margin)

    def clip(self, at: np.ndarray, step: np.ndarray) -> np.ndarray:
        """The part of a step (nv,) that uses up at most nine tenths of each gap."""
        return np.clip(step, 0.9 * (self.lower - at), 0.9 * (self.upper - at))

    def push(self, at: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Force on each joint (nv,), whatever the residual r; no joint is held."""
        return self.weight / (at - self.lower) - self.weight / (self.upper - at), r != r

    def stiffness(self, at: np.ndarray) -> np.ndarray:
        """Stiffness (nv,) that they add to each joint."""
        return self.weight / (self.upper - at) ** 2 + self.weight / (at - self.lower) ** 2
