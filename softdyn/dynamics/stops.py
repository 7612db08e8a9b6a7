"""Joint limits as stops: where they are, which joints they hold, with which forces.

All functions take joint coordinates (nv,), `SoftModel.coordinates` of a configuration (rad, m).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from softdyn.copies import Frozen
from softdyn.dynamics.model import SoftModel, check_model

TOUCHING = 1e-9  # a joint this close to a limit counts as at it (rad, m)


@dataclass(frozen=True, eq=False)
class Stops(Frozen):
    """The stops of a robot's joints.

    Attributes
    ----------
    lower, upper : ndarray, (nv,)
        The joint limits (rad, m); ±inf for a joint without one.
    """

    lower: np.ndarray
    upper: np.ndarray

    @classmethod
    def of(cls, model: SoftModel) -> Self:
        """The stops of a robot."""
        return cls(check_model(model).lower, model.upper)

    @cached_property
    def locked(self) -> np.ndarray:
        """Joints (nv,) bool whose limits leave them one position."""
        return self.upper - self.lower <= TOUCHING

    def within(self, at: np.ndarray) -> np.ndarray:
        """The closest coordinates (nv,) that the stops allow."""
        return np.clip(at, self.lower, self.upper)

    def clip(self, at: np.ndarray, step: np.ndarray) -> np.ndarray:
        """The part of a step (nv,) that the stops allow; none away from a limit that was passed."""
        return np.clip(step, np.minimum(self.lower - at, 0), np.maximum(self.upper - at, 0))

    def hit(
        self, at: np.ndarray, margin: np.ndarray | float = TOUCHING
    ) -> tuple[np.ndarray, np.ndarray]:
        """Joints at their lower and at their upper limits (nv,) bool, up to a margin (rad, m)."""
        return at <= self.lower + margin, at >= self.upper - margin

    def held(self, at: np.ndarray, r: np.ndarray) -> np.ndarray:
        """Joints (nv,) bool that the stops hold against the forces -r (nv,).

        The complementarity of a stop is r = 0 inside the limits, r ≥ 0 at the lower limit and r ≤ 0
        at the upper one. A locked joint is always held.
        """
        lower, upper = self.hit(at)
        return lower & (r > 0) | upper & (r < 0) | self.locked
