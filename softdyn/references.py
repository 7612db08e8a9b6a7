"""References: the tip's desired y, ẏ, ÿ as a function of time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from softdyn.checks import array, number
from softdyn.copies import Frozen
from softdyn.exceptions import InputError

_ZERO = np.zeros(3)
_ZERO.flags.writeable = False


@dataclass(frozen=True, eq=False)
class Reference(Frozen):
    """The tip's desired motion at one instant.

    Attributes
    ----------
    y : ndarray, (3,)
        Position in the world (m).
    ydot, yddot : ndarray, (3,)
        Velocity (m/s) and acceleration (m/s²); zero when omitted.

    Raises
    ------
    InputError
        For another shape, text, NaN or an infinity. The arrays are read-only copies.
    """

    y: np.ndarray
    ydot: np.ndarray = field(default_factory=lambda: _ZERO)
    yddot: np.ndarray = field(default_factory=lambda: _ZERO)

    def __post_init__(self) -> None:
        for name in ("y", "ydot", "yddot"):
            value = getattr(self, name)
            if value is not _ZERO:
                object.__setattr__(self, name, array(name, value, (3,)))


class SetPoint(Reference):
    """A point to reach and hold: a constant reference, which can be called with t.

    Parameters
    ----------
    y : array_like, (3,)
        Position in the world (m).
    """

    def __init__(self, y: Any) -> None:
        super().__init__(y)

    def __call__(self, t: float) -> SetPoint:
        """The reference at time `t` (s), always the same."""
        return self


@dataclass(frozen=True)
class Ellipse:
    """The paper's ellipse in the xz-plane (section Experiments), with a constant rate of θ.

        x = a cos θ cos φ - (b sin θ - c) sin φ
        z = a cos θ sin φ + (b sin θ - c) cos φ,      θ(t) = π (start + ω t)

    Attributes
    ----------
    a, b : float
        Semi-axes (m).
    c : float
        Distance from the robot's base, the origin, to the ellipse's centre (m).
    phi : float
        Tilt about the y-axis (rad).
    omega : float
        Angular rate ω in multiples of π (rad/s); 0 rests at `start`.
    start : float
        θ(0) in multiples of π.

    Raises
    ------
    InputError
        For a number that is not finite, a semi-axis that is not positive, or numbers so large that
        the position or its derivatives overflow.
    """

    a: float
    b: float
    c: float
    phi: float = math.pi / 4
    omega: float = 0.0
    start: float = 0.0
    _terms: tuple[float, ...] = field(default=(), init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in ("a", "b", "c", "phi", "omega", "start"):
            above = 0.0 if name in ("a", "b") else -math.inf
            object.__setattr__(self, name, number(name, getattr(self, name), above=above))
        rate = math.pi * self.omega
        size = self.a + self.b + abs(self.c)
        if not math.isfinite(2 * size + 2 * rate * rate * size + self.start * math.pi):
            raise InputError("ellipse", "a size and a rate with finite derivatives", repr(self))
        sin, cos = math.sin(self.phi), math.cos(self.phi)
        # y = centre + p cos θ + s sin θ; each of the three has an x and a z part.
        terms = (
            self.c * sin, -self.c * cos,
            self.a * cos, self.a * sin,
            -self.b * sin, self.b * cos,
            rate, math.pi * self.start,
        )  # fmt: skip
        object.__setattr__(self, "_terms", terms)

    def __call__(self, t: float) -> Reference:
        """Reference with exact derivatives at time `t` (s)."""
        cx, cz, px, pz, sx, sz, rate, start = self._terms
        try:
            angle = start + rate * t
            cos, sin = math.cos(angle), math.sin(angle)
        except (TypeError, ValueError):  # math.cos refuses text, NaN's cause inf, arrays
            raise InputError("t", "a finite time in seconds", repr(t)) from None
        if angle != angle:
            raise InputError("t", "a finite time in seconds", repr(t))
        x, z = px * cos + sx * sin, pz * cos + sz * sin  # from the centre
        vx, vz = rate * (sx * cos - px * sin), rate * (sz * cos - pz * sin)
        square = rate * rate
        rows = np.array(
            ((cx + x, 0.0, cz + z), (vx, 0.0, vz), (-square * x, 0.0, -square * z)),
        )
        rows.flags.writeable = False
        # The numbers are finite by construction, and Reference's checks would cost more than this.
        reference = object.__new__(Reference)
        reference.__dict__.update(y=rows[0], ydot=rows[1], yddot=rows[2])
        return reference

    def point(self, theta: float) -> np.ndarray:
        """The point (3,) of the ellipse at `theta`, in multiples of π.

        Raises
        ------
        InputError
            When `theta` is not a finite number.
        """
        theta = number("theta", theta)
        return Ellipse(self.a, self.b, self.c, self.phi, 0.0, theta)(0.0).y
