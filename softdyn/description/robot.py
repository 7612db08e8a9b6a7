"""An annotated URDF as frozen data, and the tree that its joints span.

All poses are at q = 0. Nothing here uses an engine. `softdyn.description.urdf` reads robots.
"""

from __future__ import annotations

import hashlib
import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from softdyn.checks import number, read_only
from softdyn.copies import content
from softdyn.description.inertia import IDENTITY, ZERO, Inertia, Origin, Vector, symmetric
from softdyn.description.rig import Actuator, Sensor
from softdyn.description.stated_task import StatedTask

EARTH: Vector = (0.0, 0.0, -9.81)  # m/s²
MOVING = ("revolute", "continuous", "prismatic")
MOST_BRANCHES = 3  # Maxwell branches of a joint: a measured decay tells no more apart
MOST_FRICTION = 10.0  # a larger coefficient of a cable leaves no pull behind a guide


@dataclass(frozen=True)
class Link:
    """A rigid link, massless by default.

    `mass` is in kg. `moments` are ixx, ixy, ixz, iyy, iyz and izz (kg·m²) about the centre of mass,
    in the axes of `origin`, which places the centre of mass in the link frame. `looks` are the
    link's ``<visual>`` and ``<collision>`` elements as XML, in the file's order. `gravcomp` is the
    share of its weight that buoyancy carries; see `softdyn.dynamics.buoyancy`.
    """

    name: str
    mass: float = 0.0
    moments: tuple[float, ...] = (0.0,) * 6
    origin: Origin = IDENTITY
    looks: tuple[str, ...] = ()
    gravcomp: float = 0.0

    @property
    def about_com(self) -> Inertia:
        """The inertia in the axes of `origin`, with its centre of mass at zero."""
        return Inertia(self.mass, np.zeros(3), symmetric(self.moments))

    @cached_property
    def inertia(self) -> Inertia:
        """The inertia in the link frame."""
        return self.about_com.moved(self.origin.rotation, self.origin.translation)


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another: q = multiplier · q_leader + offset (rad, m).

    The leader follows no other joint: a chain of followers in the file is composed.
    """

    leader: str
    multiplier: float = 1.0
    offset: float = 0.0


Pair = tuple[float, float]


@dataclass(frozen=True)
class Joint:
    """A joint with its compliance; SI units, radians or metres.

    `origin` places the joint in the parent link's frame. `direction` is its axis in its own frame,
    of any length. Only the plant has the dry `friction`; the model omits it. `effort` and
    `velocity` are the file's limits. Nothing here uses them; they are infinite if a continuous
    joint has no ``<limit>``. A joint with a `mimic` follows another joint: it is no degree of
    freedom of its own, and its limits are not used. `stiffness_poly` and `damping_poly` are the
    further coefficients of a spring and a damper that are not linear: see
    `softdyn.dynamics.curves`. `relaxation` has the stiffness (N m/rad, N/m) and the time (s) of
    each Maxwell branch beside the spring: see `softdyn.dynamics.relaxation`.
    """

    name: str
    kind: str
    parent: str = ""
    child: str = ""
    origin: Origin = IDENTITY
    direction: Vector = ZERO
    lower: float = -math.inf
    upper: float = math.inf
    effort: float = 0.0
    velocity: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    damping: float = 0.0
    armature: float = 0.0
    friction: float = 0.0
    mimic: Mimic | None = None
    stiffness_poly: Pair = (0.0, 0.0)
    damping_poly: Pair = (0.0, 0.0)
    relaxation: tuple[Pair, ...] = ()

    @property
    def moves(self) -> bool:
        """Whether the joint is not fixed; a follower moves too."""
        return self.kind in MOVING

    @cached_property
    def axis(self) -> np.ndarray:
        """Unit vector (3,) in the joint's own frame; zero if the joint is fixed."""
        return read_only(np.array(self.direction) / (np.linalg.norm(self.direction) or 1.0))


@dataclass(frozen=True)
class JointTerm:
    """One term ``coef · q_joint`` of a fixed tendon's length."""

    joint: str
    coef: float


@dataclass(frozen=True)
class Site:
    """A point of a spatial tendon's path, `xyz` (m) in the frame of `link`."""

    link: str
    xyz: Vector


@dataclass(frozen=True)
class Wrap:
    """A round body that a spatial tendon's path may touch between two of its sites.

    It is a cylinder about `axis`, or a sphere if that is None. The cylinder has no ends for the
    cable. `side` is a point of the link. Outside the body it decides on which side the cable runs;
    inside the body it makes the cable run inside: see `softdyn.dynamics.wraps`.

    Attributes
    ----------
    link : str
        The link that carries the body.
    xyz : tuple of float
        Its centre in the frame of `link` (m).
    radius : float
        Its radius (m).
    after : int
        Index of the site before it: the body lies between ``sites[after]`` and the next.
    axis : tuple of float or None
        The axis of a cylinder in the frame of `link`, of any length.
    side : tuple of float or None
        The side point in the frame of `link` (m).
    friction : float or None
        The cable's coefficient of friction here; None takes the tendon's.
    length : float or None
        Length of a cylinder, for drawing and export only; None is four radii.
    """

    link: str
    xyz: Vector
    radius: float
    after: int
    axis: Vector | None = None
    side: Vector | None = None
    friction: float | None = None
    length: float | None = None

    @property
    def direction(self) -> np.ndarray:
        """Unit vector (3,) of a cylinder's axis in the link's frame; that of z for a sphere."""
        axis = np.array((0.0, 0.0, 1.0) if self.axis is None else self.axis)
        return axis / np.linalg.norm(axis)

    def across(self, point: Sequence[float] | np.ndarray) -> np.ndarray:
        """The vector (3,) from the centre to a point in the link's frame, normal to the axis.

        For a sphere it is the whole vector.
        """
        offset = np.asarray(point, float) - self.xyz
        if self.axis is None:
            return offset
        return offset - (offset @ self.direction) * self.direction

    @property
    def inside(self) -> bool:
        """Whether the side point lies inside the body."""
        return self.side is not None and float(np.linalg.norm(self.across(self.side))) < self.radius


class PathEnd(Enum):
    """An end of a tendon's path, in the file's order."""

    FIRST = "first"
    LAST = "last"


@dataclass(frozen=True)
class Tendon:
    """A cable or coupling: fixed (`terms`) or spatial (`sites`), never both.

    Between two sites a spatial tendon may run around one of its `wraps`.

    The force ``stiffness · (ℓ - rest) + damping · ℓ̇`` pulls or pushes. If `rest` is None, the
    length at q = 0 is used. With `slack` the tendon only pulls, and a negative force is zero.
    `stiffness_poly` and `damping_poly` are as those of a `Joint`.

    The cable rubs on its guides with the coefficient `friction`: see `softdyn.actuation.capstan`.
    Its actuators, its spring and its damper pull at the end `driven`. If that is None, they pull at
    the end nearer to the base: see `driven_end`.

    `armature` (kg) is the inertia of its motor's rotor: I N²/r² for a rotor of the inertia I behind
    a gear of the ratio N and a drum of the radius r. A tendon with wraps has none.
    """

    name: str
    terms: tuple[JointTerm, ...] = ()
    sites: tuple[Site, ...] = ()
    stiffness: float = 0.0
    damping: float = 0.0
    rest: float | None = None
    slack: bool = False
    friction: float = 0.0
    driven: PathEnd | None = None
    wraps: tuple[Wrap, ...] = ()
    stiffness_poly: Pair = (0.0, 0.0)
    damping_poly: Pair = (0.0, 0.0)
    armature: float = 0.0

    @property
    def path(self) -> tuple[JointTerm | Site | Wrap, ...]:
        """All elements of the path, in the file's order."""
        between = {wrap.after: wrap for wrap in self.wraps}
        found: list[JointTerm | Site | Wrap] = [*self.terms]
        for k, site in enumerate(self.sites):
            found += [site, between[k]] if k in between else [site]
        return tuple(found)

    def friction_at(self, wrap: Wrap) -> float:
        """The coefficient of friction at one of its wraps."""
        return self.friction if wrap.friction is None else wrap.friction

    @property
    def rubs(self) -> bool:
        """Whether the cable rubs somewhere."""
        return self.friction > 0 or any(self.friction_at(wrap) > 0 for wrap in self.wraps)


@dataclass(frozen=True)
class Fluid:
    """The fluid around a robot: density (kg/m³) and viscosity (Pa s); see `softdyn.dynamics.fluid`.

    Raises
    ------
    InputError
        For a number below zero or not finite.
    """

    density: float = 0.0
    viscosity: float = 0.0

    def __post_init__(self) -> None:
        number("density", self.density, lower=0.0)
        number("viscosity", self.viscosity, lower=0.0)

    def __bool__(self) -> bool:
        """Whether it acts."""
        return self.density > 0 or self.viscosity > 0


NO_FLUID = Fluid()


@dataclass(frozen=True)
class Ball:
    """A ball joint's spring and damper on three hinges in one point; see `softdyn.dynamics.balls`.

    Attributes
    ----------
    name : str
        Its name.
    joints : tuple of str, (3,)
        The hinges, parents first. Their axes are orthogonal at q = 0.
    stiffness : float
        Torque by the angle of the whole rotation (N m/rad).
    damping : float
        Torque by the relative angular velocity (N m s/rad).
    stiffness_poly : tuple of float, (2,)
        Coefficients of the second and third power of the angle.
    """

    name: str
    joints: tuple[str, str, str]
    stiffness: float = 0.0
    damping: float = 0.0
    stiffness_poly: Pair = (0.0, 0.0)

    def inner_links(self, joints: Iterable[Joint]) -> list[str]:
        """The two links between its hinges, among all joints of a robot."""
        return [joint.child for joint in joints if joint.name in self.joints[:2]]


@dataclass(frozen=True)
class Robot:
    """One robot: the tree, its compliance and its annotations, each number as its file states it.

    Two robots are equal if these agree. The comparison leaves out `comment`, `path`, `overlay`,
    the texts and the warnings. `softdyn.description.urdf_writer.write` writes a robot as text,
    from which an equal robot is read.

    Attributes
    ----------
    name : str
        The robot's name in the file.
    links, joints, tendons, actuators, sensors : tuple
        In the file's order.
    task : str
        The link whose origin is the tip: the frame of the first task.
    tasks : tuple of StatedTask
        The file's tasks, in its order; empty if it states the tip's position alone.
    others : tuple of str
        The other elements as XML, in the file's order: materials, other tools' elements, and
        ``<gazebo>`` without its spring.
    floating : bool
        Whether the root link moves freely, with six degrees of freedom.
    comment : str
        The first words of the file.
    path : Path
        The file.
    warnings : tuple of str
        A line for each repair, for each impossible inertia of a link whose moving body is physical,
        and for what only old releases of Gazebo read.
    ignored : tuple of str
        Other tools' elements and attributes that softdyn ignores, each with its number.
    xml : str
        The tree with its inertias as plain URDF, every number spelled as in the file. Engines get
        this text, because it holds only elements that were checked.
    text, annotations : str
        The whole file with repaired inertias, and the file with the ``<softdyn>`` block. The second
        is empty if the URDF holds the block. Both are empty if the robot was not read from a file.
    mended : bool
        Whether an engine must read `text` instead of the file.
    overlay : Path or None
        The file with the ``<softdyn>`` block, if it is not `path`.
    gravity : tuple of float, (3,)
        Acceleration of gravity in the world's axes (m/s²), which a tilted base turns.
    fluid : Fluid
        The fluid around the robot, by default none.
    balls : tuple of Ball
        Springs and dampers of ball joints, each on three hinges.
    forces : tuple of softdyn.dynamics.Force
        Forces of a user's own, which no file holds; see `SoftModel.with_forces`.
    adopted : tuple of str
        A line for each number of another tool's element that softdyn reads, such as a rotor's
        inertia.
    root_folder : Path or None
        A folder below which meshes may lie, beside the folder of `path`.
    """

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    tendons: tuple[Tendon, ...] = ()
    actuators: tuple[Actuator, ...] = ()
    task: str = ""
    others: tuple[str, ...] = ()
    floating: bool = False
    sensors: tuple[Sensor, ...] = ()
    tasks: tuple[StatedTask, ...] = ()
    comment: str = field(default="", compare=False)
    path: Path = field(default=Path(), compare=False)
    warnings: tuple[str, ...] = field(default=(), compare=False)
    ignored: tuple[str, ...] = field(default=(), compare=False)
    xml: str = field(default="", compare=False)
    text: str = field(default="", compare=False)
    annotations: str = field(default="", compare=False)
    mended: bool = field(default=False, compare=False)
    overlay: Path | None = field(default=None, compare=False)
    forces: tuple[Any, ...] = field(default=(), compare=False)
    gravity: Vector = EARTH
    fluid: Fluid = NO_FLUID
    adopted: tuple[str, ...] = field(default=(), compare=False)
    root_folder: Path | None = field(default=None, compare=False)
    balls: tuple[Ball, ...] = ()

    @property
    def moving_joints(self) -> tuple[Joint, ...]:
        """Joints that move, followers included, in the file's order."""
        return tuple(joint for joint in self.joints if joint.moves)

    @property
    def followers(self) -> tuple[Joint, ...]:
        """Mimic joints, in the file's order."""
        return tuple(joint for joint in self.joints if joint.mimic is not None)

    @property
    def speeds(self) -> np.ndarray:
        """Actuators (nu,) bool whose commands are the rates of free lengths."""
        return np.array([actuator.is_speed for actuator in self.actuators], bool)

    @property
    def root(self) -> str:
        """The one link without a parent."""
        moved = {joint.child for joint in self.joints}
        return next(link.name for link in self.links if link.name not in moved)

    def chain(self, link: str) -> tuple[Joint, ...]:
        """The joints from the root to `link`, root first."""
        above = {joint.child: joint for joint in self.joints}
        path: deque[Joint] = deque()
        while link in above:
            path.appendleft(above[link])
            link = path[0].parent
        return tuple(path)

    @cached_property
    def buoyant(self) -> tuple[Link, ...]:
        """The links that buoyancy lifts."""
        return tuple(link for link in self.links if link.gravcomp)

    @property
    def dry(self) -> Robot:
        """The robot without fluid, buoyancy and springs of ball joints; itself if it has none."""
        if not (self.fluid or self.buoyant or self.balls):
            return self
        links = tuple(replace(link, gravcomp=0.0) for link in self.links)
        return replace(self, fluid=NO_FLUID, links=links, balls=())

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all numbers and names that dynamics and rig depend on; copies share it.

        A robot without sensors, slack tendons, friction of cables, forces of one's own and another
        gravity has the digest of releases that knew none of them. A force counts with its class's
        name and fields.
        """
        joints = [(j.name, j.kind, j.stiffness, j.rest, j.damping, j.armature, j.lower, j.upper,
                   j.friction, j.mimic) for j in self.joints]  # fmt: skip
        paths = [(t.name, t.terms, [(s.link, list(s.xyz)) for s in t.sites], t.stiffness,
                  t.damping, t.rest) for t in self.tendons]  # fmt: skip
        parts: tuple[object, ...] = (self.xml, self.floating, self.task, joints, paths)
        parts += (self.actuators,)
        slack = [tendon.name for tendon in self.tendons if tendon.slack]
        if slack or self.sensors:
            parts += (slack, self.sensors)
        rubbing = [(t.name, t.friction, t.driven) for t in self.tendons if t.friction]
        if rubbing:
            parts += (rubbing,)
        if self.tasks:
            parts += (self.tasks,)
        springs: list[Joint | Tendon] = [*self.joints, *self.tendons]
        curved = [(one.name, one.stiffness_poly, one.damping_poly) for one in springs
                  if any((*one.stiffness_poly, *one.damping_poly))]  # fmt: skip
        if curved:
            parts += (curved,)
        turning = [(one.name, one.armature) for one in self.tendons if one.armature]
        if turning:
            parts += (turning,)
        wraps = [(tendon.name, tendon.wraps) for tendon in self.tendons if tendon.wraps]
        if wraps:
            parts += (wraps,)
        if self.gravity != EARTH:
            parts += (("gravity", self.gravity),)
        if self.fluid:
            parts += (self.fluid,)
        if self.buoyant:
            parts += (("gravcomp", [(one.name, one.gravcomp) for one in self.buoyant]),)
        if creeping := [(j.name, j.relaxation) for j in self.joints if j.relaxation]:
            parts += (creeping,)
        if self.balls:
            parts += (self.balls,)
        if self.forces:
            parts += ([content(force) for force in self.forces],)
        return hashlib.sha256(repr(parts).encode()).hexdigest()

    @property
    def length(self) -> float:
        """Summed joint offsets from the base to the tip (m), the robot's size."""
        return float(sum(np.linalg.norm(joint.origin.xyz) for joint in self.chain(self.task)))


def children(joints: Iterable[Joint]) -> dict[str, list[Joint]]:
    """The joints that leave each link."""
    below: dict[str, list[Joint]] = {}
    for joint in joints:
        below.setdefault(joint.parent, []).append(joint)
    return below


def levels(root: str, joints: Iterable[Joint]) -> Iterator[list[str]]:
    """Links level by level from the root; a link on a cycle is not reached."""
    below = children(joints)
    level = [root]
    while level:
        yield level
        level = [joint.child for link in level for joint in below.get(link, ())]


def deepest_leaf(robot: Robot) -> str:
    """The link with the most joints between it and the root; of equals, the first in the file."""
    *_, deepest = levels(robot.root, robot.joints)
    return next(link.name for link in robot.links if link.name in deepest)


def poses(robot: Robot) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Pose (rotation, translation) of every link in the root's frame at q = 0."""
    below = children(robot.joints)
    front = [robot.root]
    placed = {front[0]: (np.eye(3), np.zeros(3))}
    while front:
        link = front.pop()
        rotation, translation = placed[link]
        for joint in below.get(link, ()):
            placed[joint.child] = (
                rotation @ joint.origin.rotation,
                rotation @ joint.origin.translation + translation,
            )
            front.append(joint.child)
    return placed


def moving_link_of(robot: Robot) -> dict[str, str]:
    """For each link, the link that carries it: one that a joint moves, or the root.

    A link that a joint moves carries itself.
    """
    above = {joint.child: joint for joint in robot.joints}
    found = {}
    for link in robot.links:
        name = link.name
        while name in above and not above[name].moves:
            name = above[name].parent
        found[link.name] = name
    return found


def moving_bodies(robot: Robot) -> dict[str, Inertia]:
    """Inertia of every moving body in its own frame, keyed by the link that its joint moves.

    Links fixed to a moving link are lumped into it. Links fixed to a fixed base are left out.
    """
    placed = poses(robot)
    bodies = {joint.child: Inertia.zero() for joint in robot.joints if joint.moves}
    if robot.floating:
        bodies = {robot.root: Inertia.zero()} | bodies
    carrier = moving_link_of(robot)
    for link in robot.links:
        name = carrier[link.name]
        if name in bodies:
            (body_rotation, body_translation), (rotation, translation) = (
                placed[name],
                placed[link.name],
            )
            bodies[name] += link.inertia.moved(
                body_rotation.T @ rotation, body_rotation.T @ (translation - body_translation)
            )
    return bodies


def driven_end(robot: Robot, tendon: Tendon) -> PathEnd:
    """The end of a tendon's path at which its actuators pull.

    If the file does not name it, it is the one with fewer moving joints between it and the root; of
    equals, the first.
    """
    if tendon.driven is not None:
        return tendon.driven
    link_of = {joint.name: joint.child for joint in robot.joints}
    links = [site.link for site in tendon.sites] or [link_of[t.joint] for t in tendon.terms]
    first, last = (sum(one.moves for one in robot.chain(link)) for link in (links[0], links[-1]))
    return PathEnd.LAST if last < first else PathEnd.FIRST


def sliding(robot: Robot, names: Iterable[str]) -> list[bool]:
    """Whether each of these joints is prismatic; a floating base's coordinates are no joints."""
    slides = {joint.name for joint in robot.joints if joint.kind == "prismatic"}
    return [name in slides for name in names]


def sums_angles(robot: Robot, tendon: Tendon) -> bool:
    """Whether a fixed tendon's coefficients are factors of angles, not moment arms (m).

    They count as moment arms if all are shorter than a metre and than the robot.
    """
    turns = {joint.name for joint in robot.joints if joint.kind != "prismatic"}
    longest = max((abs(t.coef) for t in tendon.terms if t.joint in turns), default=0.0)
    return longest >= min(1.0, robot.length) and longest > 0


def input_units(robot: Robot) -> tuple[str, ...]:
    """The unit of each u: Pa of a chamber, else the gear in N.

    The gear is in N m if the tendon's length is a sum of angles.
    """
    tendons = {tendon.name: tendon for tendon in robot.tendons}
    units = []
    for actuator in robot.actuators:
        if actuator.is_chamber:
            units.append(actuator.unit)
            continue
        unit = "N m" if sums_angles(robot, tendons[actuator.tendon]) else "N"
        gear = abs(actuator.gear)
        units.append(unit if gear == 1 else f"{gear:g} {unit}")
    return tuple(units)


def input_unit(robot: Robot) -> str:
    """The units of u, each once."""
    return ", ".join(dict.fromkeys(input_units(robot)))
