"""Joint limits at rest: hard stops hold a joint, soft stops repel it smoothly.

All functions take joint coordinates (nv,), `SoftModel.coordinates` of a configuration (rad, m).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from softdyn.checks import array, length
from softdyn.copies import Frozen
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.dynamics.stops import Stops

NO_ROOM = 1e-6  # of an input's bounds; a narrower range counts as none


def locked_inputs(model: SoftModel) -> np.ndarray:
    """Inputs (nu,) bool whose bounds leave them one value, such as a preload."""
    size = np.maximum(np.abs(check_model(model).u_min), np.abs(model.u_max))
    return model.u_max - model.u_min <= NO_ROOM * np.maximum(size, 1e-3)


class HardStops(Stops):
    """Stops that balance any force that presses a joint against them."""

    def push(self, at: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces of the stops (nv,) that balance the residual r (nv,); held joints (nv,) bool."""
        held = self.held(at, r)
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
        """Forces of the stops (nv,) for the residual r; held joints (nv,) bool, those locked."""
        below, above = self._gaps(at)
        return np.where(self.locked, r, self.weight / below - self.weight / above), self.locked

    def stiffness(self, at: np.ndarray) -> np.ndarray:
        """Stiffness (nv,) that the stops add to each joint."""
        below, above = self._gaps(at)
        added = self.weight / above**2 + self.weight / below**2
        return np.where(self.locked, 0.0, added)

    @cached_property
    def locked(self) -> np.ndarray:
        """Joints (nv,) bool without room between their limits; their stops are hard."""
        return Stops(self.lower, self.upper).locked

    def _gaps(self, at: np.ndarray) -> tuple[np.ndarray, ...]:
        """Distances (nv,) to both limits; 1 for a locked joint."""
        return tuple(np.where(self.locked, 1.0, gap) for gap in (at - self.lower, self.upper - at))
