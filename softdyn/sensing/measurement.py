"""The readings of all sensors at one state, with their Jacobians."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from softdyn.checks import vector
from softdyn.copies import Frozen, freeze


@dataclass(frozen=True, eq=False)
class Components:
    """The components of all sensors, in the file's order.

    Attributes
    ----------
    names : tuple of str, (k,)
        The sensor's name, followed by ``.x``, ``.y`` and ``.z`` if it has three components. A pose
        has ``.rx``, ``.ry`` and ``.rz`` as well.
    rotations : tuple of int
        The first of the three components of each rotation vector.
    angles : tuple of int
        The components that are angles of continuous joints, in (-π, π].
    """

    names: tuple[str, ...]
    rotations: tuple[int, ...]
    angles: tuple[int, ...]

    def disturbed(self, values: np.ndarray, errors: np.ndarray) -> np.ndarray:
        """Readings (k,) with errors: R exp(e) for a rotation, the sum for the others.

        Parameters
        ----------
        values, errors : array_like, (k,)
            Values without errors, and the errors, in the same units.

        Raises
        ------
        InputError
            For a wrong shape or a number that is not finite.
        """
        values = vector("values", values, len(self.names))
        errors = vector("errors", errors, len(self.names))
        readings: np.ndarray = values + errors
        for k in self.rotations:
            turn = pin.exp3(values[k : k + 3]) @ pin.exp3(errors[k : k + 3])
            readings[k : k + 3] = pin.log3(turn)
        return self._wrapped(readings)

    def errors(self, values: np.ndarray, readings: np.ndarray) -> np.ndarray:
        """Errors (k,) of readings: the inverse of `disturbed`.

        Parameters
        ----------
        values, readings : array_like, (k,)
            Values without errors, and the readings.

        Raises
        ------
        InputError
            For a wrong shape or a number that is not finite.
        """
        values = vector("values", values, len(self.names))
        readings = vector("readings", readings, len(self.names))
        errors: np.ndarray = readings - values
        for k in self.rotations:
            turn = pin.exp3(values[k : k + 3]).T @ pin.exp3(readings[k : k + 3])
            errors[k : k + 3] = pin.log3(turn)
        return self._wrapped(errors)

    def _wrapped(self, values: np.ndarray) -> np.ndarray:
        for k in self.angles:
            values[k] = math.remainder(values[k], 2 * math.pi)
        return values


@dataclass(frozen=True, eq=False)
class Measurement(Frozen):
    """The readings of all sensors without errors; its arrays become read-only.

    NumPy takes a measurement as the array of its values. The orientation R of a pose is its
    rotation vector log R (rad, angle at most π). Its Jacobian and all errors are small rotations e
    in the sensor's own frame, from R to R exp(e), because log R jumps at the angle π.

    Attributes
    ----------
    values : ndarray, (k,)
        The readings, in the units of `softdyn.description.rig.SensorKind`.
    jacobian : ndarray, (k, 2 nv)
        Their derivatives by q ⊕ dq and by v.
    jacobian_u : ndarray, (k, nu)
        Their derivatives by u.
    components : Components
        Names of the values, and the values that are rotations or angles.
    """

    values: np.ndarray
    jacobian: np.ndarray
    jacobian_u: np.ndarray
    components: Components

    def __post_init__(self) -> None:
        freeze(vars(self).values())

    @property
    def names(self) -> tuple[str, ...]:
        """Names (k,) of the values."""
        return self.components.names

    def __len__(self) -> int:
        return len(self.values)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.values, dtype, copy=copy)

    def errors_of(self, readings: np.ndarray) -> np.ndarray:
        """Errors (k,) of readings (k,), the innovation of a filter: see `Components.errors`."""
        return self.components.errors(self.values, readings)
