"""The neutral form of a robot: joints as screws and bodies as lumps, all at zero in one frame.

Every vector has the axes and the origin of the root at q = 0, so that it does not depend on link
frames. Two files of the same robot give the same numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from softdyn.description.inertia import Inertia
from softdyn.description.robot import PathEnd
from softdyn.validation.mjcf.compiled_rig import NeutralSensor
from softdyn.validation.mjcf.transform import Transform

Numbers = tuple[float, ...]
FLUID = ("opt.density", "opt.viscosity")  # names of a fluid's numbers among the features
RELAXATION = "relaxation"  # name of the Maxwell branches among a part's other properties
WORLD = -1  # the parent of parts on the fixed root
FREEDOMS = {"hinge": 1, "slide": 1, "ball": 3, "free": 6}
STRAIGHT = 1e-9  # relative excess of a way that still counts as straight
GRAVITY = np.array([0.0, 0.0, -9.81])
AXIS = 0.1  # m along a cylinder's axis to the second point, which gives its direction


@dataclass(frozen=True, eq=False)
class Part:
    """A joint and the body that it moves, including links fixed to it.

    Attributes
    ----------
    name, link : str
        Name of the joint, and of the link whose frame is `pose`; empty for a massless intermediate
        part.
    kind : str
        ``hinge``, ``slide``, ``ball`` or ``free``.
    parent : int
        Index of the part that carries it, or `WORLD`.
    axis, point : np.ndarray, (3,)
        Unit vector, and a point on the axis (m).
    pieces : tuple of (str, Inertia)
        The pieces of the body: its own link and those fixed to it, by name.
    lower, upper, effort : float
        Limits (rad, m) and the largest force (N, N·m); infinite where the file states none.
    armature, damping : float
        Including those of actuators that act on the joint.
    stiffness_curve, damping_curve : tuple of two
        Coefficients of the second and third power of displacement and speed.
    gravcomp : dict[str, float]
        Link → share of its weight that is compensated.
    more : dict[str, Numbers]
        Other properties of the joint in the file, by MuJoCo's name of the field.
    """

    name: str
    link: str
    kind: str
    parent: int
    axis: np.ndarray
    point: np.ndarray
    pieces: tuple[tuple[str, Inertia], ...]
    pose: Transform
    lower: float = -math.inf
    upper: float = math.inf
    effort: float = math.inf
    armature: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    stiffness_curve: Numbers = (0.0, 0.0)
    damping_curve: Numbers = (0.0, 0.0)
    gravcomp: dict[str, float] = field(default_factory=dict)
    more: dict[str, Numbers] = field(default_factory=dict)

    @cached_property
    def inertia(self) -> Inertia:
        """Inertia of the whole body."""
        return sum((piece for _, piece in self.pieces), Inertia.zero())

    @property
    def buoyancy(self) -> float | None:
        """The share of the body's weight that is compensated; None if its pieces differ in it."""
        shares = {self.gravcomp.get(name, 0.0) for name, piece in self.pieces if piece.mass}
        return None if len(shares) > 1 else (shares or {0.0}).pop()

    @property
    def uplift(self) -> np.ndarray:
        """The mass with compensated weight, and its first moment (4,)."""
        share = ((self.gravcomp.get(name, 0.0), piece) for name, piece in self.pieces)
        return sum((s * p.mass * np.array([1.0, *p.com]) for s, p in share), np.zeros(4))

    def moved(self, by: Transform, *, joint: bool = True) -> Part:
        """The displaced part; with `joint` False its axis stays."""
        pieces = tuple(
            (name, piece.moved(by.rotation, by.translation)) for name, piece in self.pieces
        )
        found = replace(self, pieces=pieces, pose=by @ self.pose)
        if joint:
            found = replace(found, axis=by.rotation @ self.axis, point=by.at(self.point))
        return found


@dataclass(frozen=True, eq=False)
class Frame:
    """A named frame or site on a part, or on the root.

    `of_joint` is whether it is the link of a joint, which the file or the comparison holds still.
    """

    part: int
    pose: Transform
    of_joint: bool = False


@dataclass(frozen=True, eq=False)
class Point:
    """A point (3,) of a cable's path on a part, or on the root.

    `around` is a wrapped shape: its kind and `radius` at its centre, then ``its axis`` for a second
    point on a cylinder's axis, then ``its side`` for its side point.
    """

    part: int
    xyz: np.ndarray
    around: str = ""
    radius: float = 0.0


def shape_points(
    part: int, centre: np.ndarray, radius: float, axis: np.ndarray | None, side: Point | None
) -> Iterator[Point]:
    """The points of a wrapped sphere, or of a cylinder about the unit vector `axis`."""
    kind = "sphere" if axis is None else "cylinder"
    yield Point(part, centre, f"{kind} of radius {radius:.6g}", radius)
    if axis is not None:
        # both senses give the same cylinder: take that whose first nonzero component is > 0
        sense = np.sign(axis[np.abs(axis) > 1e-6][0])
        yield Point(part, centre + AXIS * sense * axis, "its axis")
    if side is not None:
        yield replace(side, around="its side")


@dataclass(frozen=True, eq=False)
class NeutralTendon:
    """A tendon: fixed (`terms`: joint → coefficient) or along `path`; other fields as in `Part`.

    The spring acts outside the lengths `rest`. If the tendon is `slack`, spring and damper act in
    tension only. `friction` is the cable's on its guides, and the stated driven end.
    """

    name: str
    terms: dict[str, float]
    path: tuple[Point, ...]
    stiffness: float = 0.0
    damping: float = 0.0
    rest: tuple[float, float] = (0.0, 0.0)
    armature: float = 0.0
    stiffness_curve: Numbers = (0.0, 0.0)
    damping_curve: Numbers = (0.0, 0.0)
    more: dict[str, Numbers] = field(default_factory=dict)
    slack: bool = False
    friction: tuple[float, PathEnd | None] = (0.0, None)

    @property
    def shapes(self) -> tuple[str, ...]:
        """Wrapped shapes, their axes and sides, and pulleys, along the path."""
        return tuple(point.around for point in self.path if point.around)


@dataclass(frozen=True, eq=False)
class Motor:
    """An actuator.

    Attributes
    ----------
    target : str
        Its target: ``tendon:name``, ``joint:name``, …
    gear, lower, upper : float
        Force of a unit input, and the input's range; of a winch its force's.
    law : str
        The force as a function of the input, if they are not equal, for what `rig` cannot state.
    axes : Numbers
        The full gear if it has directions: in the root's axes for a joint, in its own for a site.
    frames : tuple of Frame
        Frames of the sites on which it acts.
    more : dict[str, Numbers]
        Its other properties in the file, by MuJoCo's name of the field.
    rig : dict[str, Any]
        Its command, lag, …: fields of `Actuator` that are not those of an ideal one. A ``unit``
        other than 1 is the command of a winch per metre, and ``input_unit`` is `Actuator.unit`.
    number : int
        Its number among MuJoCo's actuators.
    """

    name: str
    target: str
    gear: float
    lower: float
    upper: float
    law: str = ""
    axes: Numbers = ()
    frames: tuple[Frame, ...] = ()
    more: dict[str, Numbers] = field(default_factory=dict)
    rig: dict[str, Any] = field(default_factory=dict)
    number: int = -1

    @property
    def takes_force(self) -> bool:
        """Whether its input is a force; `gear` then contains the gain."""
        return not self.law and "command" not in self.rig

    @property
    def end(self) -> tuple[str, str]:
        """Kind and name of its target."""
        word, _, name = self.target.partition(":")
        return "joint" if word.startswith(("joint", "orientation")) else word, name


@dataclass(frozen=True, eq=False)
class Coupling:
    """A joint that follows another: q = multiplier · q_leader + offset."""

    joint: str
    leader: str
    multiplier: float
    offset: float
    more: dict[str, Numbers] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Equality:
    """Any other equality: its kind, its objects, and its numbers.

    Attributes
    ----------
    kind, ends : str, tuple of str
        ``connect``, ``weld``, ``joint``, ``tendon`` …; names of bodies, sites, joints or tendons.
    data : Numbers
        Coefficients, or for a weld the displacement of the second body at zero.
    points : tuple of Point
        The points that coincide.
    """

    kind: str
    ends: tuple[str, ...]
    data: Numbers
    points: tuple[Point, ...] = ()
    more: dict[str, Numbers] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Neutral:
    """A robot in the neutral form; parents come before their children.

    Attributes
    ----------
    format : str
        ``urdf`` or ``mjcf``.
    orders : tuple of tuple of str
        The orders in which the joints of the file may be read. An MJCF has one; without any, the
        order is unknown.
    frames : dict[str, Frame]
        Links and sites by name, except the parts' own links.
    features : dict[str, Numbers]
        Other features that influence the motion, by MuJoCo's names of field and object.
    notes : tuple of str
        Parts of the file that were left out.
    sensors : dict[str, NeutralSensor]
        Sensors by name.
    cable_sites : dict[str, Frame]
        Named sites on the paths of cables, which are compared with the cables.
    rounded : bool
        Whether the file prints at most six significant digits, as MuJoCo does.
    """

    path: Path
    format: str
    parts: tuple[Part, ...]
    frames: dict[str, Frame] = field(default_factory=dict)
    cables: tuple[NeutralTendon, ...] = ()
    motors: tuple[Motor, ...] = ()
    couplings: tuple[Coupling, ...] = ()
    equalities: tuple[Equality, ...] = ()
    features: dict[str, Numbers] = field(default_factory=dict)
    gravity: np.ndarray = field(default_factory=lambda: GRAVITY)
    orders: tuple[tuple[str, ...], ...] = ()
    notes: tuple[str, ...] = ()
    sensors: dict[str, NeutralSensor] = field(default_factory=dict)
    rounded: bool = False
    cable_sites: dict[str, Frame] = field(default_factory=dict)

    @property
    def size(self) -> float:
        """Extent of the robot at zero (m), never zero."""
        points = [point for part in self.parts for point in (part.point, part.inertia.com)]
        return (float(np.linalg.norm(np.ptp(points, axis=0))) if points else 0.0) or 1.0

    @property
    def nv(self) -> int:
        """Degrees of freedom."""
        return sum(FREEDOMS[part.kind] for part in self.parts)

    def extent(self, index: int) -> float:
        """The largest offset on a part (m): of its joint, centres of mass, frames, cables."""
        if index == WORLD:
            return self.size
        part = self.parts[index]
        above = np.zeros(3) if part.parent == WORLD else self.parts[part.parent].point
        points = [above, part.pose.translation, *(piece.com for _, piece in part.pieces)]
        points += [frame.pose.translation for frame in self.frames.values() if frame.part == index]
        points += [p.xyz for cable in self.cables for p in cable.path if p.part == index]
        return float(np.linalg.norm(np.array(points) - part.point, axis=1).max())

    def children(self, index: int) -> list[int]:
        """Parts that a part, or the root, carries."""
        return [k for k, part in enumerate(self.parts) if part.parent == index]

    def subtree(self, index: int) -> list[int]:
        """A part and all beyond it; all parts for the root."""
        found = {index}
        for k, part in enumerate(self.parts):
            if part.parent in found:
                found.add(k)
        return sorted(found - {WORLD})

    def with_part(self, index: int, part: Part) -> Neutral:
        """The robot with one part replaced."""
        return replace(self, parts=(*self.parts[:index], part, *self.parts[index + 1 :]))

    def displaced(self, index: int, by: Transform, *, joint: bool = True) -> Neutral:
        """Displace a part and all that it carries; with `joint` False its own axis stays."""
        moving = set(self.subtree(index)) | {index}

        def place(part: int, pose: Transform) -> Transform:
            return by @ pose if part in moving else pose

        parts = tuple(
            part.moved(by, joint=part.kind != "free" and (joint or k != index))
            if k in moving
            else part
            for k, part in enumerate(self.parts)
        )

        def points(path: tuple[Point, ...]) -> tuple[Point, ...]:
            return tuple(replace(p, xyz=by.at(p.xyz)) if p.part in moving else p for p in path)

        frames = {n: replace(f, pose=place(f.part, f.pose)) for n, f in self.frames.items()}
        cables = tuple(replace(cable, path=points(cable.path)) for cable in self.cables)
        equalities = tuple(replace(tie, points=points(tie.points)) for tie in self.equalities)
        motors = tuple(
            replace(m, frames=tuple(replace(f, pose=place(f.part, f.pose)) for f in m.frames))
            for m in self.motors
        )
        return replace(
            self, parts=parts, frames=frames, cables=cables, motors=motors, equalities=equalities
        )

    def without_idle_sites(self) -> Neutral:
        """The robot without sites that do not bend or lengthen their cables."""
        cables = tuple(replace(cable, path=_without_idle(cable.path)) for cable in self.cables)
        return replace(self, cables=cables)

    def arranged(self, kept: list[int], welded: set[int]) -> Neutral:
        """The robot with the parts `kept`, in this order; parts `welded` join their parent.

        `kept` has parents before children. Parts that are welded or left out have no joint.
        """
        lumps = {k: self.parts[k].pieces for k in kept}
        lifted = {k: self.parts[k].gravcomp for k in kept}
        carrier = {WORLD: WORLD}
        for k, part in enumerate(self.parts):
            carrier[k] = k if k in lumps else carrier[part.parent]
            if k in welded and carrier[k] in lumps:
                lumps[carrier[k]] += part.pieces
                lifted[carrier[k]] = lifted[carrier[k]] | part.gravcomp
        place = {old: new for new, old in enumerate(kept)} | {WORLD: WORLD}
        names = {self.parts[k].name for k in kept}

        def on(index: int) -> int:
            return place[carrier[index]]

        parts = tuple(
            replace(
                self.parts[k], pieces=lumps[k], gravcomp=lifted[k], parent=on(self.parts[k].parent)
            )
            for k in kept
        )
        gone = set(range(len(self.parts))) - set(kept) - welded
        held = {n: f for n, f in self.frames.items() if f.part not in gone}
        frames = {name: replace(f, part=on(f.part)) for name, f in held.items()}
        solid = [(k, self.parts[k]) for k in welded if self.parts[k].link]
        frames |= {part.link: Frame(on(k), part.pose, of_joint=True) for k, part in solid}
        cables = tuple(
            replace(cable, path=tuple(replace(p, part=on(p.part)) for p in cable.path))
            for cable in self.cables
            if set(cable.terms) <= names and not gone.intersection(p.part for p in cable.path)
        )
        led = tuple(c for c in self.couplings if {c.joint, c.leader} <= names)
        lost = {("joint", part.name) for part in self.parts if part.name not in names}
        left = {cable.name for cable in cables}
        lost |= {("tendon", cable.name) for cable in self.cables if cable.name not in left}
        motors = tuple(
            replace(m, frames=tuple(replace(f, part=on(f.part)) for f in m.frames))
            for m in self.motors
            if m.end not in lost and not gone.intersection(f.part for f in m.frames)
        )
        ties = tuple(
            replace(tie, points=tuple(replace(p, part=on(p.part)) for p in tie.points))
            for tie in self.equalities
            if not lost.intersection((tie.kind, end) for end in tie.ends)
            and not gone.intersection(p.part for p in tie.points)
        )
        robot = replace(self, parts=parts, frames=frames, cables=cables, motors=motors)
        return replace(robot, couplings=led, equalities=ties)

    def renamed(self, names: dict[str, str]) -> Neutral:
        """Rename joints; those not in `names` keep their names."""

        def new(name: str) -> str:
            return names.get(name, name)

        def target(motor: Motor) -> str:
            word, name = motor.target.partition(":")[0], motor.end[1]
            return f"{word}:{new(name)}" if motor.end[0] == "joint" else motor.target

        def read(sensor: NeutralSensor) -> NeutralSensor:
            word, _, name = sensor.target.partition(":")
            return replace(sensor, target=f"joint:{new(name)}") if word == "joint" else sensor

        return replace(
            self,
            parts=tuple(replace(part, name=new(part.name)) for part in self.parts),
            cables=tuple(
                replace(t, terms={new(j): c for j, c in t.terms.items()}) for t in self.cables
            ),
            motors=tuple(replace(motor, target=target(motor)) for motor in self.motors),
            couplings=tuple(
                replace(c, joint=new(c.joint), leader=new(c.leader)) for c in self.couplings
            ),
            equalities=tuple(
                replace(tie, ends=tuple(map(new, tie.ends))) if tie.kind == "joint" else tie
                for tie in self.equalities
            ),
            orders=tuple(tuple(map(new, order)) for order in self.orders),
            sensors={name: read(sensor) for name, sensor in self.sensors.items()},
        )


def _without_idle(path: tuple[Point, ...]) -> tuple[Point, ...]:
    """A path without sites between two others of one part on a straight line."""
    found = list(path[:1])
    for point, after in pairwise(path[1:]):
        before = found[-1]
        same = {before.part} == {point.part, after.part}
        if same and not (before.around or point.around or after.around):
            ways = [float(np.linalg.norm(q.xyz - p.xyz)) for p, q in (
                (before, point), (point, after), (before, after)
            )]  # fmt: skip
            if ways[0] + ways[1] <= ways[2] * (1 + STRAIGHT):
                continue
        found.append(point)
    return (*found, *path[1:][-1:])


Repair = Callable[[Neutral], Neutral]
