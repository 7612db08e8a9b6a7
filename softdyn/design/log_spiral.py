"""A log-spiral arm: similar segments, each smaller than the one before, on compliant joints."""

from __future__ import annotations

import math
from dataclasses import dataclass

from softdyn.checks import instance, instances, number
from softdyn.description.inertia import Inertia
from softdyn.description.robot import ZERO, Joint, Site, Tendon, Vector
from softdyn.description.urdf_writer import write
from softdyn.design.chain import (
    GENERATED,
    X_TO_Z,
    Chain,
    Input,
    collision,
    cylinder,
    mesh,
    site,
    vector,
    visual,
)  # fmt: skip
from softdyn.design.layout import FREEDOMS
from softdyn.design.rods import MAX_SEGMENTS, Mount
from softdyn.exceptions import InputError

COLORS = {"mount": (0.2, 0.22, 0.26), "even": (0.08, 0.42, 0.48), "odd": (0.3, 0.64, 0.62)}
MOUNT = (visual(cylinder(0.04, 0.012), "mount", (0.0, 0.0, 0.006)),)
"""A plate behind the base of an arm that hangs from the origin."""
PULL = Input(-1.0, (0, 10))
HANGING = Mount()
BLOCKS = 2
"""Blocks drawn per segment."""


@dataclass(frozen=True)
class LogSpiral:
    """Similar segments with joints between them; a segment's mass goes with its length cubed.

    Attributes
    ----------
    length, mass : float
        Length and mass of the whole arm (m, kg).
    segments : int
        One more than joints.
    ratio : float
        Length of a segment over that of the one before.
    radius : float
        Distance of the cables from the backbone at the base (m). A segment's inertia is that of a
        cylinder with the cables' distance at the segment as its radius.
    stiffness, damping, armature : float
        The value for every degree of freedom (N m/rad, N m s/rad, kg m²).
    freedoms : tuple of str
        Degrees of freedom of each joint, in the order of the file: rotations of
        `softdyn.design.layout.FREEDOMS`.
    cable_angles : tuple of float
        Directions of the cables from the backbone: degrees from +z towards -y.
    site_fractions : tuple of float
        Positions of the cables' sites along each segment, as shares of its length.
    cable : Input
        Gear and bounds of every cable.
    mount : Mount
    name : str
    """

    length: float
    mass: float
    segments: int
    ratio: float
    radius: float
    stiffness: float
    damping: float
    armature: float = 0.0
    freedoms: tuple[str, ...] = ("bend_z", "bend_y", "twist")
    cable_angles: tuple[float, ...] = (0.0, 120.0, 240.0)
    site_fractions: tuple[float, ...] = (0.23, 0.93)
    cable: Input = PULL
    mount: Mount = HANGING
    name: str = "log_spiral"

    def __post_init__(self) -> None:
        for name in ("length", "mass", "ratio", "radius", "stiffness"):
            number(name, getattr(self, name), above=0.0)
        for name in ("damping", "armature"):
            number(name, getattr(self, name), lower=0.0)
        if not (isinstance(self.segments, int) and 2 <= self.segments <= MAX_SEGMENTS):
            raise InputError("segments", f"a whole number from 2 to {MAX_SEGMENTS}", self.segments)
        instance("cable", self.cable, Input, "an Input")
        instance("mount", self.mount, Mount, "a Mount")
        instance("name", self.name, str, "a text")
        for name in ("cable_angles", "site_fractions"):
            given = instances(name, getattr(self, name), object, "a number")
            if not given:
                raise InputError(name, "at least one number", "none")
            for k, value in enumerate(given):
                number(f"{name}[{k}]", value)
        names = instances("freedoms", self.freedoms, str, "the name of a rotation")
        if not all(name in FREEDOMS and FREEDOMS[name].turns for name in names):
            turns = [name for name, freedom in FREEDOMS.items() if freedom.turns]
            raise InputError("freedoms", " or ".join(turns), ", ".join(self.freedoms))


def urdf(
    spiral: LogSpiral,
    comment: str = f"\n  {GENERATED}\n",
) -> str:
    """The annotated URDF of a log-spiral arm; its looks are in ``meshes/spiral.stl``."""
    count, ratio = spiral.segments, spiral.ratio
    powers = [1.0]  # products, because ** rounds differently on some systems
    while len(powers) < count:
        powers.append(powers[-1] * ratio)
    first = spiral.length / sum(powers)
    heaviest = spiral.mass / sum(p * p * p for p in powers)
    chain = Chain(spiral.name, comment, COLORS, MOUNT if spiral.mount == HANGING else ())
    directions = [cable_direction(degrees) for degrees in spiral.cable_angles]
    cables: list[list[Site]] = [[] for _ in directions]
    y, z = directions[0]
    roll = (math.atan2(-y, z), 0.0, 0.0)
    joints: list[Joint] = []
    # the first segment is mounted on the base
    offset, angles = vector(spiral.mount.position), spiral.mount.angles
    for i, power in enumerate(powers):
        length, radius = first * power, spiral.radius * power
        mass = heaviest * power * power * power
        body = Inertia.cylinder(mass, radius, length, length / 2)
        shade = "odd" if i % 2 else "even"
        looks = spiral_parts(length, radius, shade, roll, BLOCKS, ratio)
        name = f"segment_{i}"
        chain.add(name, body, looks, joints, offset, angles)
        for cable, (y, z) in zip(cables, directions, strict=True):
            for fraction in spiral.site_fractions:
                r = radius * (1 + fraction * (ratio - 1))
                cable.append(site(name, (fraction * length, r * y, r * z)))
        offset, angles = (length, 0.0, 0.0), ZERO
        joints = [
            Joint(
                f"{kind}_{i + 1}", "revolute", direction=vector(FREEDOMS[kind].axis),
                lower=-math.pi, upper=math.pi, stiffness=spiral.stiffness, damping=spiral.damping,
                armature=spiral.armature,
            )
            for kind in spiral.freedoms
        ]  # fmt: skip
    for k, sites in enumerate(cables, 1):
        chain.pull(Tendon(f"cable_{k}", sites=tuple(sites)), spiral.cable)
    return write(chain.finish(offset, gravity=spiral.mount.gravity))


def cable_direction(degrees: float) -> tuple[float, float]:
    """The unit vector (y, z) from the backbone to a cable, in a segment's frame."""
    angle = math.radians(degrees)
    # 15 digits, because C libraries differ in the last bit: -0.5 stays -0.5
    return round(-math.sin(angle), 15), round(math.cos(angle), 15)


def spiral_parts(
    length: float,
    radius: float,
    shade: str,
    angles: Vector = ZERO,
    blocks: int = 1,
    taper: float = 1.0,
) -> list[str]:
    """The looks and the contact shape of one log-spiral segment.

    Parameters
    ----------
    length : float
        The segment's length along local x [m].
    radius : float
        Distance of the cables from the backbone at the segment's base [m].
    shade : str
        Material name.
    angles : sequence of float, (3,)
        Roll, pitch, yaw from the segment's frame to one with the segment along +x and the first
        cable towards +z.
    blocks : int
        Number of similar blocks drawn.
    taper : float
        Radius of the next segment relative to this one.
    """
    along = -1.0 if angles[2] else 1.0
    ratio = taper ** (1 / blocks)
    sizes = [ratio**k for k in range(blocks)]
    first = length / sum(sizes)
    starts = [along * first * sum(sizes[:k]) for k in range(blocks)]
    looks = [
        visual(mesh("spiral", (first * k, radius * k, radius * k)), shade, (x, 0.0, 0.0), angles)
        for k, x in zip(sizes, starts, strict=True)
    ]
    middle = (along * 0.58 * length, 0.0, 0.0)
    return [*looks, collision(cylinder(0.96 * radius, 0.6 * length), middle, X_TO_Z)]
