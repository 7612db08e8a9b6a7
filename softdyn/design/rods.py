"""The parts of an arm as frozen data: material, sections, plates, payload, mount.

Units are SI and radians. The arm's axis is +x, from base to tip. Angles about it are right-handed:
from +z towards -y.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from softdyn.checks import (
    array,
    beyond,
    did_you_mean,
    flag,
    instance,
    instances,
    length,
    number,
    whole,
)
from softdyn.description.rig import CommandKind
from softdyn.description.robot import EARTH, MOST_BRANCHES, NO_FLUID, Fluid
from softdyn.description.stated_task import StatedTask
from softdyn.design.cables import (
    ArmSensor,
    Cable,
    CableMotor,
    Chamber,
    Path,
    Profile,
    along,
    check_name,
    check_profile,
    positive,
)
from softdyn.design.quadrature import Rule, gauss_legendre
from softdyn.exceptions import InputError

INSTANTANEOUS = "instantaneous"
MODULI = (INSTANTANEOUS, "relaxed")
MEASURED = ("bending_stiffness", "torsional_stiffness", "axial_stiffness", "shear_stiffness")
MAX_SEGMENTS = 256  # the limit of a file's degrees of freedom


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
    relaxation : tuple of (float, float)
        A Prony series: the share g of the instantaneous modulus and the time τ (s) of each branch,
        at most three (`softdyn.dynamics.relaxation`).
    modulus : str
        ``instantaneous`` or ``relaxed``: which modulus E is, and which a section's measured
        stiffnesses are. It has no default beside a Prony series.
    """

    youngs_modulus: float
    poissons_ratio: float = 0.49
    density: float = 1070.0
    relaxation: tuple[tuple[float, float], ...] = ()
    modulus: str = ""

    def __post_init__(self) -> None:
        positive(self, "youngs_modulus", "density")
        if not -1 < number("poissons_ratio", self.poissons_ratio) <= 0.5:
            raise InputError("poissons_ratio", "a number > -1 and <= 0.5", self.poissons_ratio)
        branches = instances("relaxation", self.relaxation, tuple, "a share and a time")
        if len(branches) > MOST_BRANCHES:
            raise InputError("relaxation", f"at most {MOST_BRANCHES} branches", len(branches))
        for branch in branches:
            share, time = array("relaxation", branch, (2,))
            number("relaxation: share", share, above=0.0)
            number("relaxation: time", time, above=0.0)
        if not self.left > 0:
            raise InputError("relaxation", "shares whose sum is below 1", f"{1 - self.left:g}")
        if branches and self.modulus not in MODULI:
            raise InputError("modulus", " or ".join(MODULI), repr(self.modulus or "none"))
        if self.modulus and not branches:
            raise InputError("modulus", "a relaxation beside it", "none")

    @property
    def left(self) -> float:
        """The share 1 - Σ g of the instantaneous modulus that does not relax."""
        return 1.0 - sum(share for share, _ in self.relaxation)

    @property
    def relaxed(self) -> float:
        """The relaxed modulus over E."""
        return self.left if self.modulus == INSTANTANEOUS else 1.0

    def branches(self, stiffness: float) -> tuple[tuple[float, float], ...]:
        """The Maxwell branches (k_i, τ_i) of a spring with this relaxed stiffness."""
        return tuple((share * stiffness / self.left, time) for share, time in self.relaxation)


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
        positive(self, "radius", "thickness", "mass")


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
        E gives EI, EA and κ GA where none is measured.
    segments : int
        Number of joints of this section.
    freedoms : tuple of str
        Degrees of freedom of each joint: names of `softdyn.design.layout.FREEDOMS`.
    bending_stiffness, torsional_stiffness : Profile, optional
        Measured EI and GJ (N m²). GJ is EI / (1 + ν) where only EI is measured.
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
    axial_stiffness, shear_stiffness : Profile, optional
        Measured EA and κ GA (N). A measured EI says nothing of them: a rod may have a thin core.
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
    axial_stiffness: Profile | None = None
    shear_stiffness: Profile | None = None

    def __post_init__(self) -> None:
        check_name(self.name)
        instance("material", self.material, Material, "a Material")
        positive(self, "length")
        if self.mass is not None:
            positive(self, "mass")
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
        for name in MEASURED:
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
        """EI (N m²), relaxed as all that follow."""
        if self.bending_stiffness is not None:
            return self.material.relaxed * along(self.bending_stiffness, at)
        return self.material.relaxed * self.material.youngs_modulus * self.second_moment(at)

    def torsion(self, at: float) -> float:
        """GJ (N m²)."""
        if self.torsional_stiffness is not None:
            return self.material.relaxed * along(self.torsional_stiffness, at)
        return self.bending(at) / (1 + self.material.poissons_ratio)

    def stretching(self, at: float) -> float:
        """EA (N)."""
        if self.axial_stiffness is not None:
            return self.material.relaxed * along(self.axial_stiffness, at)
        return self.material.relaxed * self.material.youngs_modulus * self.area(at)

    def shearing(self, at: float) -> float:
        """κ GA (N), with the shear coefficient of a round section (Cowper, 1966)."""
        if self.shear_stiffness is not None:
            return self.material.relaxed * along(self.shear_stiffness, at)
        nu = self.material.poissons_ratio
        m = (along(self.inner_radius, at) / along(self.radius, at)) ** 2
        wide = (1 + m) ** 2
        kappa = 6 * (1 + nu) * wide / ((7 + 6 * nu) * wide + (20 + 12 * nu) * m)
        E = self.material.relaxed * self.material.youngs_modulus
        return kappa * E * self.area(at) / (2 * (1 + nu))


@dataclass(frozen=True)
class Payload:
    """A solid ball welded to the tip's end: mass (kg), radius and its centre beyond the end (m)."""

    mass: float
    radius: float
    ahead: float = 0.0

    def __post_init__(self) -> None:
        positive(self, "mass", "radius")
        number("ahead", self.ahead)


@dataclass(frozen=True)
class Mount:
    """The arm's base, and gravity there.

    Attributes
    ----------
    position : sequence of float, (3,)
        In the world (m).
    direction : sequence of float, (3,)
        Direction of its axis.
    roll : float
        Turn about this axis (rad).
    gravity : sequence of float, (3,)
        Acceleration of gravity in the world's axes (m/s²).
    """

    position: Sequence[float] = (0.0, 0.0, 0.0)
    direction: Sequence[float] = (0.0, 0.0, -1.0)
    roll: float = 0.0
    gravity: Sequence[float] = EARTH

    def __post_init__(self) -> None:
        for name in ("position", "direction", "gravity"):
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
    motors : tuple of CableMotor
        No cable and no chamber has two.
    sensors : tuple of ArmSensor
    tasks : tuple of StatedTask
        Of the links "tip" and "segment_k", and of `frames`; the position of the tip if there are
        none.
    chambers : tuple of Chamber
        Their inputs follow those of the cables.
    fluid : Fluid
        The fluid around the arm, by default none.
    frames : tuple of (str, float, sequence of float)
        Links without a mass at a distance along the arm (m), with an offset (3,) from its middle
        line in the axes of the straight arm (m).
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
    motors: tuple[CableMotor, ...] = ()
    sensors: tuple[ArmSensor, ...] = ()
    tasks: tuple[StatedTask, ...] = ()
    chambers: tuple[Chamber, ...] = ()
    fluid: Fluid = NO_FLUID
    frames: tuple[tuple[str, float, Sequence[float]], ...] = ()

    def __post_init__(self) -> None:
        kinds: dict[str, tuple[Any, str]] = {
            "damping": (Damping, "a Damping"),
            "mount": (Mount, "a Mount"),
            "fluid": (Fluid, "a Fluid"),
            "payload": ((Payload, type(None)), "a Payload"),
            "name": (str, "a text"),
        }
        for name, (kind, expected) in kinds.items():
            instance(name, getattr(self, name), kind, expected)
        instances("cables", self.cables, Cable, "a Cable")
        instances("chambers", self.chambers, Chamber, "a Chamber")
        array("tip", self.tip, (3,))
        flag("unusual", self.unusual)
        if not callable(self.rule):
            raise InputError("rule", "a rule such as gauss_legendre", repr(self.rule))
        if not instances("sections", self.sections, Section, "a Section"):
            raise InputError("sections", "at least one section", "none")
        for cable in self.paths:
            count = len(self.sections)
            if not (cable.end in range(-count, count) and 0 <= cable.start <= cable.end % count):
                expected = f"a start and an end among the {count} sections, in this order"
                where = f"{type(cable).__name__.lower()} {cable.name!r}"
                raise InputError(where, expected, (cable.start, cable.end))
        for name, s, offset in self.frames:
            array(f"frame {name!r}: offset", offset, (3,))
            if beyond(number(f"frame {name!r}", s, lower=0.0), self.length):
                raise InputError(f"frame {name!r}", f"a place up to {self.length:g} m", f"{s:g} m")
        self._check_rig()

    def _check_rig(self) -> None:
        """Refuse unknown cables, two motors of a cable, and sensors beyond the arm."""
        instances("motors", self.motors, CableMotor, "a CableMotor")
        instances("sensors", self.sensors, ArmSensor, "an ArmSensor")
        instances("tasks", self.tasks, StatedTask, "a StatedTask")
        known = {cable.name for cable in self.paths}
        groups = [part.cables for part in self.motors] + [part.cables for part in self.sensors]
        for name in (name for group in groups for name in group):
            if name not in known:
                raise InputError("cables", "the name of a cable", did_you_mean(name, known))
        chambers = {chamber.name for chamber in self.chambers}
        for motor in self.motors:
            wound = motor.command is not CommandKind.FORCE
            if wound and (pushed := sorted(chambers.intersection(motor.cables))):
                raise InputError("motors", f"a valve of chamber {pushed[0]!r}", "a winch")
            if motor.armature and (pushed := sorted(chambers.intersection(motor.cables))):
                raise InputError("motors", f"a valve of chamber {pushed[0]!r}", "an armature")
        driven = [name for motor in self.motors for name in motor.cables]
        if twice := sorted({name for name in driven if driven.count(name) > 1}):
            raise InputError("motors", f"one motor of cable {twice[0]!r}", driven.count(twice[0]))
        names = [name for sensor in self.sensors for name in sensor.names]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise InputError("sensors", "a unique name of each sensor", ", ".join(twice))
        for sensor in self.sensors:
            for point in sensor.points:
                if beyond(point, self.length):
                    where = f"sensor {sensor.reading.name!r}"
                    raise InputError(where, f"a place up to {self.length:g} m", f"{point:g} m")

    @property
    def paths(self) -> tuple[Path, ...]:
        """The cables, then the chambers, in the order of the inputs."""
        return (*self.cables, *self.chambers)

    @property
    def length(self) -> float:
        """Length from the base to the end of the last section or plate (m)."""
        return float(self.starts[-1])

    @property
    def starts(self) -> np.ndarray:
        """The start of each section, and the end of the arm (sections + 1,) (m)."""
        return starts(self.sections)

    def way(self, cable: Path) -> tuple[float, float]:
        """Start and end of a cable or a chamber along the arm (m)."""
        last = cable.end % len(self.sections)
        return self.starts[cable.start], self.starts[last] + self.sections[last].length


def starts(sections: Sequence[Section]) -> np.ndarray:
    """The start of each section, and the end of the last one (sections + 1,) (m)."""
    lengths = [s.length + (s.plate.thickness if s.plate else 0.0) for s in sections]
    return np.concatenate([[0.0], np.cumsum(lengths)])
