"""Rigid displacements."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class Transform:
    """A rigid displacement x → rotation x + translation (3, 3), (3,), or a stack of them (n, …)."""

    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    translation: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def __matmul__(self, other: Transform) -> Transform:
        return Transform(self.rotation @ other.rotation, self.at(other.translation))

    def at(self, point: np.ndarray) -> np.ndarray:
        """The image of a point (…, 3)."""
        return (self.rotation @ point[..., None])[..., 0] + self.translation

    @property
    def inverse(self) -> Transform:
        """The inverse displacement."""
        back = self.rotation.swapaxes(-1, -2)
        return Transform(back, -(back @ self.translation[..., None])[..., 0])

    @property
    def turn(self) -> np.ndarray:
        """Twice the sine of the angle along the axis of the rotation (…, 3)."""
        skew = self.rotation - self.rotation.swapaxes(-1, -2)
        return skew[..., (2, 0, 1), (1, 2, 0)]

    @property
    def angle(self) -> Any:
        """Angle of the rotation (rad), accurate near zero."""
        trace = np.einsum("...ii->...", self.rotation)
        return np.arctan2(np.linalg.norm(self.turn, axis=-1) / 2, (trace - 1) / 2)
