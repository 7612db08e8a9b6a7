"""An arm's cables and chambers, their motors and sensors, profiles along a rod, as frozen data."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import Any

import numpy as np

from softdyn.checks import flag, instance, instances, number
from softdyn.description.rig import LONGEST_DELAY, MOST_GROWTH, SMALLEST_WINCH, CommandKind, Sensor
from softdyn.description.robot import MOST_FRICTION
from softdyn.exceptions import InputError

Profile = float | Sequence[float] | Callable[[float], float]
"""A constant; values at even places from end to end, linear in between; or f(s / length)."""


def along(profile: Profile, at: float) -> float:
    """The value of a profile at s / length = `at`."""
    if callable(profile):
        return float(profile(at))
    if isinstance(profile, int | float):
        return float(profile)
    values = np.atleast_1d(np.asarray(profile, float))
    return float(np.interp(at, _even(len(values)), values))


@cache
def _even(count: int) -> np.ndarray:
    return np.linspace(0, 1, count)


@dataclass(frozen=True)
class Cable:
    """A cable that one input pulls, from the start of a section to the end of a section.

    Attributes
    ----------
    angle : float
        Its angle about the arm's axis (rad).
    offset : Profile
        Distance from the axis (m), from the cable's start to its end; 0 on the axis itself.
    straight : bool
        Whether it runs straight from disc to disc; else it lies in a channel along its whole
        length. The same tension bends an arm more through straight cables.
    max_tension : float
        Largest tension (N).
    start, end : int
        Index of the first and the last section.
    turns : float
        Number of turns of a helical cable about the axis.
    name : str
    stiffness, damping : float
        A spring (N/m) and a damper (N s/m) along the whole cable, beside its motor.
    rest : float, optional
        Length (m) at which the spring is unloaded; by default the length in the straight arm. The
        length of a cable in a channel is 0 there.
    slack : bool
        Whether the spring and the damper only pull.
    friction : float
        Coefficient of friction at the discs, or along the channel.
    """

    angle: float
    offset: Profile
    straight: bool
    max_tension: float
    start: int = 0
    end: int = -1
    turns: float = 0.0
    name: str = "cable"
    stiffness: float = 0.0
    damping: float = 0.0
    rest: float | None = None
    slack: bool = False
    friction: float = 0.0

    def __post_init__(self) -> None:
        check_name(self.name)
        positive(self, "max_tension")
        for name in ("angle", "turns"):
            number(name, getattr(self, name))
        for name in ("start", "end"):
            instance(name, getattr(self, name), (int, np.integer), "a whole number")
        for name in ("stiffness", "damping"):
            number(name, getattr(self, name), lower=0.0)
        number("friction", self.friction, lower=0.0, upper=MOST_FRICTION)
        if self.rest is not None:
            number("rest", self.rest, lower=0.0 if self.straight else -math.inf)
        flag("straight", self.straight)
        if flag("slack", self.slack) and self.stiffness == 0:
            raise InputError("stiffness", "a number > 0 of a slack cable", self.stiffness)
        check_profile("offset", self.offset, lower=0.0)

    def place(self, at: float) -> np.ndarray:
        """Position (3,) in the cross-section (x = 0) at the share `at` of the cable's length."""
        return _across(self.angle + 2 * math.pi * self.turns * at, along(self.offset, at))

    @property
    def largest_force(self) -> float:
        """The largest force along the cable (N)."""
        return self.max_tension


def _across(angle: float, r: float) -> np.ndarray:
    """The point (3,) of the cross-section at an angle about the axis (rad) and a distance (m)."""
    return np.array([0.0, -r * math.sin(angle), r * math.cos(angle)])


@dataclass(frozen=True)
class Chamber:
    """A chamber under pressure, from the start of a section to the end of a section.

    Its walls let it grow longer, and not wider, as those of a fibre-reinforced chamber. Over the
    length ℓ of its middle line it has the volume V = A ℓ. The gauge pressure p does the work
    p dV, so its force on the joints is p A ∂ℓ/∂q. Gas that is shut in is not modelled.

    A chamber whose walls give way has an area that depends on its stretch λ, its length over that
    in the straight arm: A(λ) = area · (1 + g₁ (λ - 1) + g₂ (λ - 1)² + …), and dV = A dℓ.

    Attributes
    ----------
    angle : float
        Its angle about the arm's axis (rad).
    offset : Profile
        Distance of its middle line from the arm's axis (m), from its start to its end.
    max_pressure, min_pressure : float
        Bounds of the gauge pressure (Pa); below 0 it is a vacuum.
    area, radius : float, optional
        Area A of the cross-section (m²), or the radius of a round one (m): one of them. With a
        `growth` it is that at the stretch 1.
    start, end : int
        Index of the first and the last section.
    straight : bool
        Whether it runs straight from disc to disc, as bellows do; else it lies in the body.
    name : str
    growth : tuple of float
        The coefficients g, at most four; none for an area that does not change.
    """

    angle: float
    offset: Profile
    max_pressure: float
    area: float | None = None
    radius: float | None = None
    start: int = 0
    end: int = -1
    min_pressure: float = 0.0
    straight: bool = False
    name: str = "chamber"
    growth: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        check_name(self.name)
        number("angle", self.angle)
        check_profile("offset", self.offset, lower=0.0)
        for name in ("start", "end"):
            instance(name, getattr(self, name), (int, np.integer), "a whole number")
        for name in ("min_pressure", "max_pressure"):
            number(name, getattr(self, name))
        if not self.min_pressure < self.max_pressure:
            bounds = f"{self.min_pressure:g} and {self.max_pressure:g} Pa"
            raise InputError("min_pressure", "less than max_pressure", bounds)
        if (self.area is None) == (self.radius is None):
            raise InputError("area", "area or radius", "neither" if self.area is None else "both")
        positive(self, "radius" if self.area is None else "area")
        for value in instances("growth", self.growth, object, "a number"):
            number("growth", value)
        if len(self.growth) > MOST_GROWTH:
            raise InputError("growth", f"at most {MOST_GROWTH} numbers", len(self.growth))
        flag("straight", self.straight)

    @property
    def section_area(self) -> float:
        """The area A (m²) of its cross-section, at the stretch 1."""
        return self.area if self.area is not None else math.pi * float(self.radius or 0.0) ** 2

    @property
    def largest_force(self) -> float:
        """The largest force along the chamber (N), of either sign."""
        return self.section_area * max(-self.min_pressure, self.max_pressure)

    def place(self, at: float) -> np.ndarray:
        """Position (3,) in the cross-section (x = 0) at the share `at` of the chamber's length."""
        return _across(self.angle, along(self.offset, at))


Path = Cable | Chamber
"""A line along an arm on which an input acts."""


@dataclass(frozen=True)
class CableMotor:
    """The motors or winches of some cables, or the valves of some chambers.

    A cable or a chamber without one has an input that acts at once. The numbers are those of
    `softdyn.description.rig.Actuator`.

    Attributes
    ----------
    cables : tuple of str
        Names of the cables, or of the chambers of valves, whose command is their pressure.
    command : CommandKind
    stiffness, damping : float
        Spring (N/m) and damper (N s/m) of a winch's cable.
    length_lower, length_upper : float
        Bounds of a winch's free length (m).
    lag, delay : float
        s.
    rate : float
        Unit of the command per second.
    armature : float
        Inertia of a motor's rotor felt along its cable (kg): see `rotor_armature`.
    """

    cables: tuple[str, ...]
    command: CommandKind = CommandKind.FORCE
    stiffness: float = 0.0
    damping: float = 0.0
    length_lower: float = -math.inf
    length_upper: float = math.inf
    lag: float = 0.0
    rate: float = math.inf
    delay: float = 0.0
    armature: float = 0.0

    def __post_init__(self) -> None:
        instances("cables", self.cables, str, "the name of a cable")
        instance("command", self.command, CommandKind, "a CommandKind")
        for name, upper in (("lag", math.inf), ("delay", LONGEST_DELAY), ("damping", math.inf)):
            number(name, getattr(self, name), lower=0.0, upper=upper)
        number("rate", self.rate, above=0.0, finite=False)
        number("armature", self.armature, lower=0.0)
        for name, open_end in (("length_lower", -math.inf), ("length_upper", math.inf)):
            if (bound := getattr(self, name)) != open_end:
                number(name, bound)
        if not self.length_lower <= self.length_upper:
            bounds = f"{self.length_lower} and {self.length_upper}"
            raise InputError("length_lower", "at most length_upper", bounds)
        if self.command is not CommandKind.FORCE:
            if self.armature:  # the rotor is behind the cable's spring, which has no mass
                raise InputError("armature", "0 of a winch", self.armature)
            number("stiffness", self.stiffness, lower=SMALLEST_WINCH)
            return
        for name in ("stiffness", "damping", "length_lower", "length_upper"):
            if getattr(self, name) != getattr(CableMotor, name):
                expected = 'a command "length" or "velocity" beside it'
                raise InputError(name, expected, f'command "{self.command.value}"')

    @property
    def words(self) -> dict[str, Any]:
        """The fields that an `Actuator` has too."""
        return {field.name: getattr(self, field.name) for field in fields(self)[1:-1]}


def rotor_armature(inertia: float, reduction: float, radius: float) -> float:
    """Inertia I N²/r² (kg) felt along a cable: that of a rotor behind a gear and a drum.

    The cable's rate ℓ̇ turns the drum with ℓ̇/r and the rotor with N ℓ̇/r, whose kinetic energy is
    ½ I (N ℓ̇/r)².

    Parameters
    ----------
    inertia : float
        I of the rotor about its own axis (kg m²).
    reduction : float
        N, turns of the rotor for one turn of the drum.
    radius : float
        r of the drum (m).
    """
    return inertia * (reduction / radius) ** 2


@dataclass(frozen=True)
class ArmSensor:
    """Sensors of one kind: at points along the arm, on cables, or on a joint.

    Attributes
    ----------
    reading : Sensor
        The kind, the errors and, of a sensor on a joint, the joint. `xyz` and `rpy` place it in the
        axes of the arm's piece at its point. The name is completed by a cable's name or by a
        point's number, if there are several.
    cables : tuple of str
        Names of the cables and chambers.
    points : tuple of float
        Places along the straight arm, from the base (m).
    """

    reading: Sensor
    cables: tuple[str, ...] = ()
    points: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        check_name(instance("reading", self.reading, Sensor, "a Sensor").name)
        instances("cables", self.cables, str, "the name of a cable")
        for name, lower in (("noise", 0.0), ("bias", -math.inf), ("resolution", 0.0)):
            for value in getattr(self.reading, name):
                number(name, value, lower=lower)
        for name, upper in (("rate", math.inf), ("latency", LONGEST_DELAY)):
            number(name, getattr(self.reading, name), lower=0.0, upper=upper)
        for point in instances("points", self.points, object, "a number"):
            number("points", point, lower=0.0)

    @property
    def names(self) -> tuple[str, ...]:
        """The sensors' names: cables first, then points."""
        parts = [*self.cables, *map(str, range(1, 1 + len(self.points)))]
        name = self.reading.name
        return tuple(f"{name}_{part}" for part in parts) if len(parts) > 1 else (name,)


def check_name(name: str) -> None:
    """Refuse a name that a file could not hold.

    Raises
    ------
    InputError
        For anything but letters, digits and ``_ . -``.
    """
    if not (isinstance(name, str) and re.fullmatch(r"[\w.-]+", name)):
        raise InputError("name", "letters, digits, _ . and -", repr(name))


def check_profile(name: str, profile: Profile, **bounds: Any) -> np.ndarray:
    """A profile at 33 even places, all of it within bounds.

    Raises
    ------
    InputError
        For anything that is no profile, and a value out of bounds.
    """
    if not callable(profile):
        values = np.atleast_1d(np.asarray(profile, object))
        if not values.size:
            raise InputError(name, "a number, or numbers from end to end", repr(profile))
        for value in values:
            number(name, value, **bounds)
    return np.array([number(name, along(profile, x), **bounds) for x in np.linspace(0, 1, 33)])


def positive(value: object, *names: str) -> None:
    """Refuse attributes of `value` that are not positive numbers.

    Raises
    ------
    InputError
        For the first one.
    """
    for name in names:
        number(name, getattr(value, name), above=0.0)
