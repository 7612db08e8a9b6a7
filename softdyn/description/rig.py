"""A robot's rig as its file states it: motors and winches, and sensors.

The defaults are those of an ideal robot: an input is a force that acts at once. Nothing here uses
an engine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from enum import Enum
from functools import cached_property

import numpy as np

from softdyn.description.inertia import ZERO, Origin, Vector

LONGEST_DELAY = 10.0  # s
PASCAL = "Pa"
MOST_GROWTH = 4  # coefficients of a chamber's area
SMALLEST_WINCH = 1e-9  # gear, and stiffness (N/m), of a winch: its inverse stays finite


class CommandKind(Enum):
    """The quantity that a motor's driver regulates."""

    FORCE = "force"
    """The input u itself. The force ``gear · u`` acts along the tendon."""
    LENGTH = "length"
    """A winch's free length of cable."""
    VELOCITY = "velocity"
    """The rate of change of a winch's free length."""


@dataclass(frozen=True, repr=False)
class Actuator:
    """An input u in [lower, upper] that acts with force ``gear · u`` along a tendon.

    The command ``length`` or ``velocity`` makes it a winch. The winch sets the free length ℓ_cmd of
    its cable, or the rate of ℓ_cmd. With the tendon's length ℓ its tension is
    T = max(0, stiffness · (ℓ - ℓ_cmd) + damping · ℓ̇), and u = -T / gear, clipped to [lower, upper].
    A winch, and any input on a slack tendon, must only pull: gear · u ≤ 0 within the bounds. The
    tendon's own spring acts beside the winch.

    A command passes first through the `delay`, then through the bound on its `rate`, then through
    the `lag`. A winch that commands a length then adds its `offset`: ℓ_cmd = command + offset.

    The unit ``Pa`` makes it a chamber under the gauge pressure u: its `gear` is the area of its
    cross-section (m²). With the length ℓ of its tendon the chamber has the volume V = gear · ℓ, so
    u · dV is the pressure's work, and gear · u is the force along the tendon. A valve has the
    command `force`, because it regulates u itself.

    The coefficients g₁, g₂, … of `area_growth` make the area change with the stretch λ of the
    chamber: A(λ) = gear · (1 + g₁ (λ - 1) + g₂ (λ - 1)² + …), with dV = A dℓ. A chamber over sites
    has λ = ℓ / area_length. The length of joint terms is 0 at q = 0, so their chamber has
    λ = 1 + ℓ / area_length.

    Attributes
    ----------
    name : str
        Unique. The order in the file is the order of u.
    tendon : str
        The tendon it acts on. Several actuators may share a tendon.
    gear : float
        Force along the tendon per unit of u.
    lower, upper : float
        Bounds of u, for every kind of command.
    command : CommandKind
        The quantity that the motor regulates: u (a force), or a winch's free length ℓ_cmd, or the
        rate of ℓ_cmd.
    stiffness : float
        Stiffness of a winch's cable (N/m). Positive for a winch.
    damping : float
        Damping of a winch's cable (N s/m).
    length_lower, length_upper : float
        Bounds of ℓ_cmd (m).
    lag : float
        Time constant of a first-order lag of the command (s).
    rate : float
        Largest rate of change of the command, in the command's unit per second.
    delay : float
        Time from a command to its effect (s), at most 10 s.
    offset : float
        Free length ℓ_cmd at the command 0 (m); only with the command `length`. `softdyn drive
        --zero` measures it.
    unit : str
        The unit of u: ``Pa`` of a chamber. Without it u is a force, in units of the gear (N).
    area_growth : tuple of float
        Coefficients g of a chamber whose area changes with its stretch, at most four.
    area_length : float
        Length ℓ₀ (m) of such a chamber at the stretch 1, where its area is `gear`.
    """

    name: str
    tendon: str
    gear: float
    lower: float
    upper: float
    command: CommandKind = CommandKind.FORCE
    stiffness: float = 0.0
    damping: float = 0.0
    length_lower: float = -math.inf
    length_upper: float = math.inf
    lag: float = 0.0
    rate: float = math.inf
    delay: float = 0.0
    offset: float = 0.0
    unit: str = ""
    area_growth: tuple[float, ...] = ()
    area_length: float = 0.0

    @property
    def is_chamber(self) -> bool:
        """Whether the input is the pressure in a chamber."""
        return self.unit == PASCAL

    @property
    def is_winch(self) -> bool:
        """Whether the command is a free length or its rate."""
        return self.command is not CommandKind.FORCE

    @property
    def is_speed(self) -> bool:
        """Whether the command is the rate of a free length."""
        return self.command is CommandKind.VELOCITY

    @property
    def zero(self) -> float:
        """The offset (m) of a length command; 0 for other commands."""
        return self.offset if self.command is CommandKind.LENGTH else 0.0

    @property
    def pushes(self) -> bool:
        """Whether some input within the bounds lengthens the tendon."""
        return max(self.gear * self.lower, self.gear * self.upper) > 0

    @property
    def ideal(self) -> Actuator:
        """The same actuator with an input that acts at once."""
        return Actuator(
            self.name, self.tendon, self.gear, self.lower, self.upper, unit=self.unit,
            area_growth=self.area_growth, area_length=self.area_length,
        )  # fmt: skip

    @property
    def is_ideal(self) -> bool:
        """Whether the input acts at once."""
        return self == self.ideal

    def __repr__(self) -> str:
        """Name the five required fields, and the others if they differ from their default.

        `Robot.digest` uses this text. Ideal robots therefore keep their digest when a field is
        added.
        """
        words = (
            f"{part.name}={getattr(self, part.name)!r}"
            for i, part in enumerate(fields(self))
            if i < 5 or getattr(self, part.name) != part.default
        )
        return f"Actuator({', '.join(words)})"


XYZ = (".x", ".y", ".z")


@dataclass(frozen=True)
class SensorForm:
    """The form of the readings of one kind of sensor.

    Attributes
    ----------
    place : tuple of str
        The attributes of `Sensor` that place it. The first one names the part that it is on:
        ``tendon``, ``link`` or ``joint``.
    quantities : tuple of str, (k,)
        The quantity of each component: ``length``, ``angle``, ``force``, ``angular speed``,
        ``acceleration`` or ``pressure``. On a joint that turns, or a tendon that sums angles, a
        length is an angle and a force a torque.
    suffixes : tuple of str, (k,)
        The suffix of each component's name.
    rotation : int, optional
        The first of the three components of a rotation vector.
    of_place : bool
        Whether the readings depend on q alone.
    linear : bool
        Whether the reading is linear in q, on a tendon only if it is a fixed one.
    turns : bool
        Whether the reading is an angle in (-π, π], whose errors go the short way round.
    feels_inputs : bool
        Whether the readings depend on the inputs.
    """

    place: tuple[str, ...]
    quantities: tuple[str, ...]
    suffixes: tuple[str, ...] = ("",)
    rotation: int | None = None
    of_place: bool = False
    linear: bool = False
    feels_inputs: bool = False
    turns: bool = False

    @property
    def size(self) -> int:
        """The number k of components."""
        return len(self.quantities)


class SensorKind(Enum):
    """The quantity that a sensor measures, with the form of its readings."""

    form: SensorForm

    LENGTH = "length", SensorForm(("tendon",), ("length",), of_place=True, linear=True)
    """A tendon's length ℓ (m)."""
    TENSION = "tension", SensorForm(("tendon",), ("force",), feels_inputs=True)
    """The tension in a tendon (N): its actuators' pull, its spring and its damper."""
    POSITION = "position", SensorForm(("link", "xyz"), ("length",) * 3, XYZ, of_place=True)
    """A link's point in the world (m), three components."""
    POSE = (
        "pose",
        SensorForm(
            ("link", "xyz", "rpy"), ("length",) * 3 + ("angle",) * 3,
            (*XYZ, ".rx", ".ry", ".rz"), rotation=3, of_place=True,
        ),
    )  # fmt: skip
    """A frame on a link in the world. The errors have six components: position (m),
    then rotation vector in the sensor's frame (rad)."""
    GYRO = "gyro", SensorForm(("link", "xyz", "rpy"), ("angular speed",) * 3, XYZ)
    """Angular velocity in the sensor's frame (rad/s), three components."""
    ACCELEROMETER = (
        "accelerometer",
        SensorForm(("link", "xyz", "rpy"), ("acceleration",) * 3, XYZ, feels_inputs=True),
    )
    """A point's acceleration minus gravity, in the sensor's frame (m/s²), three components."""
    JOINT = "joint", SensorForm(("joint",), ("length",), of_place=True, linear=True)
    """A joint's position (rad or m)."""
    BEND = "bend", SensorForm(("link", "to", "rpy"), ("angle",), of_place=True, turns=True)
    """The bend from one link to another (rad): the angle about the z axis of the sensor's frame
    from its x axis to the x axis of the frame with the same `rpy` on the link `to`."""

    PRESSURE = "pressure", SensorForm(("tendon",), ("pressure",), feels_inputs=True)
    """The gauge pressure in the chamber along a tendon (Pa)."""

    def __new__(cls, value: str, form: SensorForm) -> SensorKind:
        """A member whose value is the word in a file."""
        member = object.__new__(cls)
        member._value_, member.form = value, form
        return member

    @property
    def size(self) -> int:
        """The number of components of `Sensor.noise`, `Sensor.bias` and `Sensor.resolution`."""
        return self.form.size


@dataclass(frozen=True, repr=False)
class Sensor:
    """A sensor on a tendon, at a frame on a link, from one link to another, or on a joint.

    A reading is the true value of `latency` seconds ago, plus `bias`, plus white Gaussian noise,
    rounded to a multiple of `resolution`. On a real rig `softdyn drive` stops at a reading that is
    not within [lower, upper].

    Attributes
    ----------
    name : str
        Unique among sensors. The order in the file is the order of the readings.
    kind : SensorKind
        The measured quantity, see below.
    tendon, link, joint : str
        The part that it measures, one of the three.
    xyz : tuple of float
        Its position in the link's frame (m).
    rpy : tuple of float
        Its orientation in the link's frame: roll, pitch, yaw (rad).
    noise : tuple of float
        Standard deviation of a reading. One number for all components, or one per component.
    bias : tuple of float
        Constant error. One number or several, as in `noise`.
    rate : float
        Readings per second (Hz), held in between. 0 reads anew in every control period.
    latency : float
        Age of a reading when it arrives (s), at most 10 s.
    resolution : tuple of float
        Step between possible readings. 0 does not round. One number or several.
    lower, upper : tuple of float
        Limits of a reading, in its unit. One number or several.
    to : str
        The second link of a `bend`.
    """

    name: str
    kind: SensorKind
    tendon: str = ""
    link: str = ""
    joint: str = ""
    xyz: Vector = ZERO
    rpy: Vector = ZERO
    noise: tuple[float, ...] = (0.0,)
    bias: tuple[float, ...] = (0.0,)
    rate: float = 0.0
    latency: float = 0.0
    resolution: tuple[float, ...] = (0.0,)
    lower: tuple[float, ...] = (-math.inf,)
    upper: tuple[float, ...] = (math.inf,)
    to: str = ""

    @property
    def reading_names(self) -> tuple[str, ...]:
        """The name of each reading, such as ``camera.x``."""
        return tuple(self.name + suffix for suffix in self.kind.form.suffixes)

    @property
    def is_limited(self) -> bool:
        """Whether some reading has a limit."""
        return bool(np.isfinite((*self.lower, *self.upper)).any())

    def __repr__(self) -> str:
        """Name limits and a second link only if there are any: robots without keep their digest."""
        hidden = {"lower", "upper"} if not self.is_limited else set()
        hidden |= {"to"} if not self.to else set()
        shown = [part for part in fields(self) if part.name not in hidden]
        return f"Sensor({', '.join(f'{part.name}={getattr(self, part.name)!r}' for part in shown)})"

    @cached_property
    def origin(self) -> Origin:
        """The sensor's frame in the link's."""
        return Origin(self.xyz, self.rpy)
