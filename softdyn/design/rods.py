"""The parts of an arm as frozen data: material, sections, cables, plates, payload, mount.

Units are SI and radians. The arm's axis is +x, from base to tip. Angles about it are right-handed:
from +z towards -y.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from softdyn.checks import array, flag, instance, instances, length, number, whole
from softdyn.design.quadrature import Rule, gauss_legendre
from softdyn.exceptions import InputError

Profile = float | Sequence[float] | Callable[[float], float]
"""A constant; values at even places from end to end, linear in between; or f(s / length)."""
MAX_SEGMENTS = 256  # the limit of a file's degrees of freedom


def along(profile: Profile, at: float) -> float:
    """The value of a profile at s / length = `at`."""
    if callable(profile):
        return float(profile(at))
    values = np.atleast_1d(np.asarray(profile, float))
    return float(np.interp(at, np.linspace(0, 1, len(values)), values))


@dataclass(frozen=True)
class Material:
    """An isotropic, linearly elastic material.

    Attributes
    ----------
    youngs_modulus : float
        E (Pa).
    poissons_ratio : float
        ν; the shear modulus is G = E / (2 (1 + ν)).
    density : float
        kg/m³.
    """

    youngs_modulus: float
    poissons_ratio: float = 0.49
    density: float = 1070.0

    def __post_init__(self) -> None:
        _positive(self, "youngs_modulus", "density")
        if not -1 < number("poissons_ratio", self.poissons_ratio) <= 0.5:
            raise InputError("poissons_ratio", "a number > -1 and <= 0.5", self.poissons_ratio)


@dataclass(frozen=True)
class Damping:
    """Kelvin–Voigt damping in one of three forms: each joint's damping is τ times its stiffness.

    Attributes
    ----------
    ratio : float, optional
        Damping ratio ζ of the first natural frequency of the straight, weightless arm: τ = 2 ζ / ω.
    time_constant : float, optional
        τ (s).
    viscosity : float, optional
        η of the material (Pa s): τ = η / E.
    """

    ratio: float | None = None
    time_constant: float | None = None
    viscosity: float | None = None

    def __post_init__(self) -> None:
        given = [f.name for f in fields(self) if getattr(self, f.name) is not None]
        if len(given) != 1:
            names = " or ".join(f.name for f in fields(self))
            raise InputError("damping", f"one of {names}", " and ".join(given) or "none")
        number(given[0], getattr(self, given[0]), lower=0.0)


@dataclass(frozen=True)
class Plate:
    """A rigid round plate: radius and thickness (m), mass (kg)."""

    radius: float
    thickness: float
    mass: float

    def __post_init__(self) -> None:
        _positive(self, "radius", "thickness", "mass")


@dataclass(frozen=True)
class Section:
    """A piece of rod with a round cross-section, solid or hollow, constant or tapered.

    Attributes
    ----------
    length : float
        Length (m).
    radius, inner_radius : Profile
        Outer and inner radius (m).
    material : Material
        If `bending_stiffness` is given, only ν and the density of the material are used.
    segments : int
        Number of joints of this section.
    freedoms : tuple of str
        Degrees of freedom of each joint: names of `softdyn.design.layout.FREEDOMS`.
    bending_stiffness, torsional_stiffness : Profile, optional
        Measured EI and GJ (N m²).
    mass : float, optional
        Measured mass (kg); it is distributed like the area of the cross-section.
    rest : mapping of str to float
        Strain at rest by freedom (1/m for bends and twist), for a rod that is curved unloaded.
    discs : int
        Number of discs that lead cables, evenly spaced; the last one is at the far end.
    disc : Plate, optional
        The size and mass of each disc; its thickness does not make the rod longer.
    plate : Plate, optional
        A rigid plate behind the far end; its thickness makes the arm longer.
    name : str
    """

    length: float
    radius: Profile
    material: Material
    segments: int = 10
    freedoms: tuple[str, ...] = ("bend_y", "bend_z")
    inner_radius: Profile = 0.0
    bending_stiffness: Profile | None = None
    torsional_stiffness: Profile | None = None
    mass: float | None = None
    rest: Mapping[str, float] = field(default_factory=dict)
    discs: int = 0
    disc: Plate | None = None
    plate: Plate | None = None
    name: str = "section"

    def __post_init__(self) -> None:
        check_name(self.name)
        instance("material", self.material, Material, "a Material")
        _positive(self, "length")
        if self.mass is not None:
            _positive(self, "mass")
        if not (isinstance(self.segments, int) and 0 < self.segments <= MAX_SEGMENTS):
            expected = f"a whole number from 1 to {MAX_SEGMENTS}"
            raise InputError("segments", expected, self.segments)
        if not instances("freedoms", self.freedoms, str, "the name of a freedom"):
            raise InputError("freedoms", "at least one", "none")
        if not isinstance(self.rest, Mapping):
            raise InputError("rest", "strains by freedom", repr(self.rest))
        for name, strain in self.rest.items():
            number(f"rest[{name!r}]", strain)
        whole("discs", self.discs)
        for name in ("disc", "plate"):
            instance(name, getattr(self, name), (Plate, type(None)), "a Plate")
        outer = check_profile("radius", self.radius, above=0.0)
        inner = check_profile("inner_radius", self.inner_radius, lower=0.0)
        for name in ("bending_stiffness", "torsional_stiffness"):
            if getattr(self, name) is not None:
                check_profile(name, getattr(self, name), above=0.0)
        if not (inner < outer).all():
            k = int(np.argmax(inner >= outer))
            raise InputError("inner_radius", f"less than the radius, {outer[k]:g} m", inner[k])

    def area(self, at: float) -> float:
        """A (m²) at s / length."""
        return math.pi * (along(self.radius, at) ** 2 - along(self.inner_radius, at) ** 2)

    def second_moment(self, at: float) -> float:
        """I (m⁴); the polar moment of a round section is 2 I."""
        return math.pi / 4 * (along(self.radius, at) ** 4 - along(self.inner_radius, at) ** 4)

    def bending(self, at: float) -> float:
        """EI (N m²)."""
        if self.bending_stiffness is not None:
            return along(self.bending_stiffness, at)
        return self.material.youngs_modulus * self.second_moment(at)

    def torsion(self, at: float) -> float:
        """GJ (N m²)."""
        if self.torsional_stiffness is not None:
            return along(self.torsional_stiffness, at)
        return self.bending(at) / (1 + self.material.poissons_ratio)

    def stretching(self, at: float) -> float:
        """EA (N)."""
        return self.bending(at) * self.area(at) / self.second_moment(at)

    def shearing(self, at: float) -> float:
        """κ GA (N), with the shear coefficient of a round section (Cowper, 1966)."""
        nu = self.material.poissons_ratio
        m = (along(self.inner_radius, at) / along(self.radius, at)) ** 2
        wide = (1 + m) ** 2
        kappa = 6 * (1 + nu) * wide / ((7 + 6 * nu) * wide + (20 + 12 * nu) * m)
        return kappa * self.stretching(at) / (2 * (1 + nu))


@dataclass(frozen=True)
class Cable:
    """A cable that one input pulls, from the start of a section to the end of a section.

    Attributes
    ----------
    angle : float
        Its angle about the arm's axis (rad).
    offset : Profile
        Distance from the axis (m), from the cable's start to its end.
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
    """

    angle: float
    offset: Profile
    straight: bool
    max_tension: float
    start: int = 0
    end: int = -1
    turns: float = 0.0
    name: str = "cable"

    def __post_init__(self) -> None:
        check_name(self.name)
        _positive(self, "max_tension")
        for name in ("angle", "turns"):
            number(name, getattr(self, name))
        for name in ("start", "end"):
            instance(name, getattr(self, name), (int, np.integer), "a whole number")
        flag("straight", self.straight)
        check_profile("offset", self.offset, above=0.0)

    def place(self, at: float) -> np.ndarray:
        """Position (3,) in the cross-section (x = 0) at the share `at` of the cable's length."""
        angle, r = self.angle + 2 * math.pi * self.turns * at, along(self.offset, at)
        return np.array([0.0, -r * math.sin(angle), r * math.cos(angle)])


@dataclass(frozen=True)
class Payload:
    """A solid ball welded to the tip's end: mass (kg), radius and its centre beyond the end (m)."""

    mass: float
    radius: float
    ahead: float = 0.0

    def __post_init__(self) -> None:
        _positive(self, "mass", "radius")
        number("ahead", self.ahead)


@dataclass(frozen=True)
class Mount:
    """The arm's base: position (m), direction of its axis, turn about that axis (rad)."""

    position: Sequence[float] = (0.0, 0.0, 0.0)
    direction: Sequence[float] = (0.0, 0.0, -1.0)
    roll: float = 0.0

    def __post_init__(self) -> None:
        for name in ("position", "direction"):
            values = getattr(self, name)
            if (given := length(name, values)) != 3:
                raise InputError(name, "three numbers", f"{given}")
            array(name, values, (3,))
        number("roll", self.roll)
        if not np.linalg.norm(self.direction) > 0:
            raise InputError("direction", "a vector that is not zero", self.direction)

    @property
    def angles(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw (rad) that turn +x into the direction."""
        x, y, z = self.direction
        return self.roll, math.atan2(-z, math.hypot(x, y)), math.atan2(y, x) if x or y else 0.0


@dataclass(frozen=True)
class Arm:
    """An arm of one or several sections.

    Attributes
    ----------
    sections : tuple of Section
        From base to tip.
    damping : Damping
    cables : tuple of Cable
    mount : Mount
    payload : Payload, optional
    tip : sequence of float, (3,)
        The controlled point, from the end of the arm and in its axes (m).
    rule : Rule
        Quadrature rule that places the joints in a section.
    unusual : bool
        Whether to accept numbers that no soft arm has.
    name : str
    """

    sections: tuple[Section, ...]
    damping: Damping = Damping(ratio=0.1)
    cables: tuple[Cable, ...] = ()
    mount: Mount = Mount()
    payload: Payload | None = None
    tip: Sequence[float] = (0.0, 0.0, 0.0)
    rule: Rule = gauss_legendre
    unusual: bool = False
    name: str = "arm"

    def __post_init__(self) -> None:
        kinds: dict[str, tuple[Any, str]] = {
            "damping": (Damping, "a Damping"),
            "mount": (Mount, "a Mount"),
            "payload": ((Payload, type(None)), "a Payload"),
            "name": (str, "a text"),
        }
        for name, (kind, expected) in kinds.items():
            instance(name, getattr(self, name), kind, expected)
        instances("cables", self.cables, Cable, "a Cable")
        array("tip", self.tip, (3,))
        flag("unusual", self.unusual)
        if not callable(self.rule):
            raise InputError("rule", "a rule such as gauss_legendre", repr(self.rule))
        if not instances("sections", self.sections, Section, "a Section"):
            raise InputError("sections", "at least one section", "none")
        for cable in self.cables:
            count = len(self.sections)
            if not (cable.end in range(-count, count) and 0 <= cable.start <= cable.end % count):
                expected = f"a start and an end among the {count} sections, in this order"
                raise InputError(f"cable {cable.name!r}", expected, (cable.start, cable.end))

    @property
    def length(self) -> float:
        """Length from the base to the end of the last section or plate (m)."""
        return float(self.starts[-1])

    @property
    def starts(self) -> np.ndarray:
        """The start of each section, and the end of the arm (sections + 1,) (m)."""
        lengths = [s.length + (s.plate.thickness if s.plate else 0.0) for s in self.sections]
        return np.concatenate([[0.0], np.cumsum(lengths)])

    def way(self, cable: Cable) -> tuple[float, float]:
        """Start and end of a cable along the arm (m)."""
        last = cable.end % len(self.sections)
        return self.starts[cable.start], self.starts[last] + self.sections[last].length


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


def _positive(value: object, *names: str) -> None:
    for name in names:
        number(name, getattr(value, name), above=0.0)
