"""Chambers whose area changes with their stretch.

A chamber of the length ℓ has the stretch λ = ℓ/ℓ₀ and the volume V, with dV = A(λ) dℓ and

    A(λ) = gear (1 + g₁ (λ - 1) + g₂ (λ - 1)² + …).

The pressure p does the work p dV. So its force along the chamber's tendon is p A(λ), and with the
moment arms a = ∂ℓ/∂q the derivative of its joint force p A a by q is

    p (A ∂²ℓ/∂q² + A′/ℓ₀ aᵀ a).

A tendon of joint terms has the length zero in the straight robot, so its λ is 1 + ℓ/ℓ₀.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softdyn.checks import read_only
from softdyn.description.robot import Robot


class Areas(NamedTuple):
    """The gears of a robot's inputs as functions of the tendons' lengths.

    An input that is no such chamber has its constant gear.

    Attributes
    ----------
    tendon : ndarray of int, (m,)
        The tendon of each input.
    gear : ndarray, (m,)
        Its gear at λ = 1.
    growth : ndarray, (m, k)
        The coefficients g, zero where an input has fewer.
    start : ndarray, (m,)
        The length of its tendon at λ = 1: ℓ₀ of a path, 0 of joint terms.
    length : ndarray, (m,)
        ℓ₀ (m).
    """

    tendon: np.ndarray
    gear: np.ndarray
    growth: np.ndarray
    start: np.ndarray
    length: np.ndarray

    def stretches(self, lengths: np.ndarray) -> np.ndarray:
        """λ - 1 (m,) at tendon lengths (tendons,)."""
        found: np.ndarray = (lengths[self.tendon] - self.start) / self.length
        return found

    def gears(self, lengths: np.ndarray) -> np.ndarray:
        """A (m,), the force of each unit input along its tendon; arguments as in `stretches`."""
        return self.gear * self.growths(lengths)

    def growths(self, lengths: np.ndarray) -> np.ndarray:
        """A over that at λ = 1 (m,); arguments as in `stretches`."""
        found: np.ndarray = 1.0 + self._powers(lengths, 1).sum(axis=1)
        return found

    def slopes(self, lengths: np.ndarray) -> np.ndarray:
        """∂A/∂ℓ (m,); arguments as in `stretches`."""
        order = np.arange(1, self.growth.shape[1] + 1)
        return self.gear / self.length * (order * self._powers(lengths, 0)).sum(axis=1)

    def volumes(self, lengths: np.ndarray) -> np.ndarray:
        """V (m,), of which the gears are the derivatives by ℓ; arguments as in `stretches`."""
        order = np.arange(1, self.growth.shape[1] + 1)
        more = (self._powers(lengths, 2) / (order + 1)).sum(axis=1)
        return self.gear * (lengths[self.tendon] + self.length * more)

    def _powers(self, lengths: np.ndarray, first: int) -> np.ndarray:
        """g_i (λ - 1)^(first + i - 1) (m, k) for i = 1, 2, …"""
        order = first + np.arange(self.growth.shape[1])
        found: np.ndarray = self.growth * self.stretches(lengths)[:, None] ** order
        return found


def areas_of(robot: Robot) -> Areas | None:
    """The gears of a robot's inputs if some chamber's area changes, else None."""
    most = max((len(one.area_growth) for one in robot.actuators), default=0)
    if most == 0:
        return None
    order = [tendon.name for tendon in robot.tendons]
    places = [order.index(one.tendon) for one in robot.actuators]
    rows = [[*one.area_growth, *[0.0] * (most - len(one.area_growth))] for one in robot.actuators]
    length = np.array([one.area_length if one.area_growth else 1.0 for one in robot.actuators])
    is_path = [bool(robot.tendons[place].sites) for place in places]
    gear = read_only([one.gear for one in robot.actuators])
    start = read_only(np.where(is_path, length, 0.0))
    return Areas(np.array(places), gear, read_only(rows), start, read_only(length))
