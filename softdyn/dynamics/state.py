"""Everything the dynamics say at one (q, v), computed once and never changed."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from softdyn.checks import array

if TYPE_CHECKING:
    from softdyn.dynamics.model import SoftModel


@dataclass(frozen=True, eq=False)
class State:
    """Terms of M q̈ + C q̇ + D q̇ + K + g = B u at (q, v); paper, eq. (1). Arrays are read-only.

    Attributes
    ----------
    q, v : (nq,), (nv,) configuration and velocity (rad, m; per second).
    M : (n, n) mass matrix, armature included.
    bias : (n,) C q̇ + g.
    K : (n,) forces of joint springs and elastic tendons.
    D : (n, n) damping of joints and tendons.
    B : (n, m) input matrix, Σ gear · (∂ℓ/∂q)ᵀ.
    h : (n,) C q̇ + D q̇ + K + g.
    J, Jdot : (3, n) linear Jacobian of the tip in the world's axes and its time derivative, so
        that ÿ = J q̈ + J̇ q̇ is the classical acceleration.
    y, ydot : (3,) tip position and velocity in the world (m, m/s).
    lengths : (tendons,) tendon lengths.
    moment_arms : (tendons, n) ∂ℓ/∂q.

    `SoftModel.state` makes them. Made by hand, or by `dataclasses.replace`, the arrays become
    read-only copies of the shapes above; they need not be finite.

    Raises
    ------
    InputError
        For arrays of other shapes, text, complex numbers and the like.
    """

    model: SoftModel
    q: np.ndarray
    v: np.ndarray
    M: np.ndarray
    bias: np.ndarray
    K: np.ndarray
    D: np.ndarray
    B: np.ndarray
    h: np.ndarray
    J: np.ndarray
    Jdot: np.ndarray
    y: np.ndarray
    ydot: np.ndarray
    lengths: np.ndarray
    moment_arms: np.ndarray

    def __post_init__(self) -> None:
        # Compiled kernels trust shapes and layouts: with others they would read beyond an array,
        # or stop to be compiled anew.
        for name, shape in _shapes(self.model).items():
            value = array(name, getattr(self, name), shape, finite=False)
            if name == "B" and self.model.tendons.spatial:
                value = np.asfortranarray(value)  # as the model hands it out
                value.flags.writeable = False
            object.__setattr__(self, name, value)

    @staticmethod
    def trusted(model: SoftModel, *arrays: np.ndarray, **known: np.ndarray) -> State:
        """A State of read-only arrays in the order of the fields, which are right as they are.

        `known` is what else need not be computed on first use.
        """
        state = object.__new__(State)
        state.__dict__.update(zip(_FIELDS, (model, *arrays), strict=True), **known)
        return state

    @cached_property
    def C(self) -> np.ndarray:
        """(n, n) Coriolis matrix with Ṁ - 2C skew, computed on first use."""
        return self.model.coriolis(self.q, self.v)

    @cached_property
    def g(self) -> np.ndarray:
        """(n,) gravity force; where `SoftModel.state` does not know it, computed on first use."""
        return self.model.gravity(self.q)


_FIELDS = tuple(field.name for field in fields(State))


def _shapes(model: SoftModel) -> dict[str, tuple[int, ...]]:
    n, m, tendons = model.nv, model.nu, len(model.robot.tendons)
    vectors = dict.fromkeys(("v", "bias", "K", "h"), (n,))
    return {
        "q": (model.nq,), **vectors, "M": (n, n), "D": (n, n), "B": (n, m),
        "J": (3, n), "Jdot": (3, n), "y": (3,), "ydot": (3,),
        "lengths": (tendons,), "moment_arms": (tendons, n),
    }  # fmt: skip
