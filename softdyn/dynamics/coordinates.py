"""The place of each joint coordinate in a configuration q."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from softdyn.exceptions import InputError

OFF = 1e-6  # of the unit circle's radius, and of a quaternion's length; digits of a file are finer


@dataclass(frozen=True, eq=False)
class Coordinates:
    """The numbers of each joint in q.

    A continuous joint holds (cos, sin). A floating base holds its position and the quaternion
    (x, y, z, w). Every other joint holds its coordinate.

    Attributes
    ----------
    nq : int
        Size of q.
    first : ndarray of int, (nv,)
        Index in q of each degree of freedom's first number.
    continuous : ndarray of bool, (nv,)
        Whether each degree of freedom is a continuous joint.
    floating : bool
        Whether a floating base comes first.
    """

    nq: int
    first: np.ndarray
    continuous: np.ndarray
    floating: bool

    def of(self, q: np.ndarray) -> np.ndarray:
        """Coordinates (nv,) of a configuration (nq,), angles of continuous joints in (-π, π]."""
        if self.nq == len(self.first):
            return q
        values = q[self.first]
        if self.floating:
            values[3:6] = pin.log3(pin.Quaternion(q[3:7]).matrix())
        sines = self.first[self.continuous] + 1
        values[self.continuous] = np.arctan2(q[sines], values[self.continuous])
        return values

    def check(self, q: np.ndarray, names: Sequence[str]) -> None:
        """Refuse a (cos, sin) that is off the unit circle, and a quaternion of another length.

        Parameters
        ----------
        q : ndarray, (nq,)
            A configuration.
        names : sequence of str, (nv,)
            Names of the degrees of freedom.

        Raises
        ------
        InputError
            It names the joint.
        """
        for k in map(int, np.flatnonzero(self.continuous)):
            pair = q[self.first[k] : self.first[k] + 2]
            if not abs(math.hypot(*pair) - 1) <= OFF:
                at = f"q[{self.first[k]}:{self.first[k] + 2}]"
                expected = f"cos, sin of joint {names[k]!r}, a point of the unit circle"
                raise InputError(at, expected, ", ".join(f"{x:g}" for x in pair))
        if self.floating and not abs(math.hypot(*q[3:7]) - 1) <= OFF:
            expected = "a quaternion (x, y, z, w) of length 1"
            raise InputError("q[3:7]", expected, ", ".join(f"{x:g}" for x in q[3:7]))

    def configuration(self, values: np.ndarray) -> np.ndarray:
        """Configuration q (nq,) of coordinates (nv,): the inverse of `of`."""
        q = np.empty(self.nq)
        q[self.first] = np.where(self.continuous, np.cos(values), values)
        q[self.first[self.continuous] + 1] = np.sin(values[self.continuous])
        if self.floating:
            q[3:7] = pin.Quaternion(pin.exp3(values[3:6])).coeffs()
        return q

    def numbers_of(self, chosen: np.ndarray) -> np.ndarray:
        """Indices in q of the numbers that belong to the chosen joints (nv,) bool."""
        return np.concatenate((self.first[chosen], self.first[chosen & self.continuous] + 1))
