"""Springs and dampers of joints and tendons that are not linear.

At the deflection s and the rate r, a spring and a damper with polynomial coefficients give

    k₀ s + k₁ s² + k₂ s³,    b₀ r + b₁ r |r| + b₂ r³.

This is MuJoCo's law. The damper is odd in r. The spring is not odd in s: k₁ makes it stiffer on one
side. Here are the parts beyond the linear ones, k₀ and b₀, as a secant (force by s or r) and as a
tangent (the derivative).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from softdyn.checks import read_only
from softdyn.description.robot import Joint, Tendon


class Curves(NamedTuple):
    """The coefficients of several springs and dampers.

    Attributes
    ----------
    spring, damper : ndarray, (2, k)
        k₁ and k₂; b₁ and b₂.
    """

    spring: np.ndarray
    damper: np.ndarray

    def secants(self, s: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """k₁ s + k₂ s² and b₁ |r| + b₂ r² (k,): what the deflection and the rate are times."""
        (k1, k2), (b1, b2) = self.spring, self.damper
        return (k1 + k2 * s) * s, (b1 + b2 * np.abs(r)) * np.abs(r)

    def tangents(self, s: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """2 k₁ s + 3 k₂ s² and 2 b₁ |r| + 3 b₂ r² (k,): the forces' derivatives."""
        (k1, k2), (b1, b2) = self.spring, self.damper
        return (2 * k1 + 3 * k2 * s) * s, (2 * b1 + 3 * b2 * np.abs(r)) * np.abs(r)

    def energy(self, s: np.ndarray) -> float:
        """Σ k₁ s³ / 3 + k₂ s⁴ / 4 (J)."""
        k1, k2 = self.spring
        return float(np.sum((k1 / 3 + k2 * s / 4) * s**3))


def curves_of(parts: Iterable[Joint | Tendon]) -> Curves | None:
    """The coefficients of joints or tendons; None if all are linear."""
    found = [(part.stiffness_poly, part.damping_poly) for part in parts]
    spring, damper = np.array(found, float).reshape(-1, 2, 2).transpose(1, 2, 0)
    return Curves(read_only(spring), read_only(damper)) if np.any(found) else None
