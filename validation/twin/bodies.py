"""Rigid bodies of a URDF, read by yourdfpy, a parser independent of the model's.

Nothing here comes from Pinocchio or from softdyn's own reading of geometry and inertia. Links fixed
to one another are lumped into one body, whose frame is the frame of the link that its joint moves.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path

import numpy as np
import yourdfpy

from softdyn.exceptions import UrdfError
from softdyn.validation.twin.plain_urdf import PlainUrdf, plain_urdf

STATIC = 0  # index of the body that never moves: the root link's, unless the base floats
FREE = "floating base"
KINDS = {"revolute": "hinge", "continuous": "hinge", "prismatic": "slide"}


@dataclass(frozen=True, eq=False)
class TwinJoint:
    """A joint at a body's origin: hinge, slide or free; `axis` is a unit vector in its frame.

    The coordinate of a follower is multiplier · (its leader's coordinate) + offset.
    """

    name: str
    kind: str
    axis: np.ndarray
    leader: str | None = None
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, eq=False)
class Shape:
    """A collision primitive: box (half sizes), cylinder or capsule (radius, half length), sphere.

    A capsule's length is that of its cylinder.
    """

    link: str
    kind: str
    size: tuple[float, ...]
    pose: np.ndarray


@dataclass(eq=False)
class Body:
    """Links that are fixed to one another and move as one body.

    Attributes
    ----------
    link : str
        The link whose frame is the body's.
    parent : int or None
        Index of the parent body; None for the static body.
    pose : np.ndarray, (4, 4)
        In the parent body's frame at q = 0.
    joint : TwinJoint or None
        The joint that moves it; None for the static body.
    mass, moment, second : float, np.ndarray, (3,), (3, 3)
        Mass (kg), Σ m c (kg·m) and Σ of the inertia about the frame's origin (kg·m²), both in the
        body's frame. Links are added to these sums without a division.
    shapes : list[Shape]
        Its collision primitives.
    """

    link: str
    parent: int | None
    pose: np.ndarray
    joint: TwinJoint | None = None
    mass: float = 0.0
    moment: np.ndarray = field(default_factory=lambda: np.zeros(3))
    second: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    shapes: list[Shape] = field(default_factory=list)

    def add(self, inertial: yourdfpy.Inertial, pose: np.ndarray) -> None:
        """Weld a link's inertia to the body; `pose` (4, 4) is the link's in the body's frame."""
        frame = pose if inertial.origin is None else pose @ inertial.origin
        rotation, com = frame[:3, :3], frame[:3, 3]
        mass = float(inertial.mass or 0.0)
        self.mass += mass
        self.moment += mass * com
        self.second += rotation @ np.asarray(inertial.inertia, float) @ rotation.T
        self.second += mass * (com @ com * np.eye(3) - np.outer(com, com))

    @property
    def com(self) -> np.ndarray:
        """Centre of mass (3,) in the body's frame; the origin of a massless body."""
        return self.moment / self.mass if self.mass > 0 else np.zeros(3)

    @property
    def principal(self) -> tuple[np.ndarray, np.ndarray]:
        """Principal moments (3,) about the centre of mass and their axes (3, 3), right-handed."""
        com = self.com
        tensor = self.second - self.mass * (com @ com * np.eye(3) - np.outer(com, com))
        moments, axes = np.linalg.eigh((tensor + tensor.T) / 2)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        return moments, axes


@dataclass(frozen=True, eq=False)
class Tree:
    """All bodies, the static one first and parents before children, in the file's order.

    `place` maps a link to its body and its pose (4, 4) there; `skipped` lists the collision shapes
    that were left out, each with the reason.
    """

    bodies: tuple[Body, ...]
    place: dict[str, tuple[int, np.ndarray]]
    skipped: tuple[str, ...]


def read_bodies(path: Path, *, floating: bool, mended: str = "") -> Tree:
    """Read and lump the bodies of a URDF that has already passed the strict parse.

    Parameters
    ----------
    path : Path
        The file.
    floating : bool
        Whether the root link moves freely.
    mended : str
        Text to read instead of the file's; none by default.

    Raises
    ------
    UrdfError
        When yourdfpy cannot read the file, or a collision shape has a wrong number.
    """
    plain = plain_urdf(path, mended)
    try:
        robot = yourdfpy.URDF.load(
            BytesIO(plain.text),
            build_scene_graph=False,
            load_meshes=False,
            filename_handler=yourdfpy.filename_handler_null,
        ).robot
    except Exception as error:  # yourdfpy raises many kinds of exceptions
        raise UrdfError(path, "<robot>", "a URDF that yourdfpy reads", error) from error
    for joint in robot.joints:
        joint.origin = plain.turned.get(joint.name, joint.origin)
    links = {link.name: link for link in robot.links}
    below: dict[str, list[yourdfpy.Joint]] = {}
    for joint in robot.joints:
        below.setdefault(joint.parent, []).append(joint)
    children = {joint.child for joint in robot.joints}
    root = next(name for name in links if name not in children)

    bodies = [Body(root, None, np.eye(4))]
    if floating:
        bodies = [Body("", None, np.eye(4))]
        bodies.append(Body(root, STATIC, np.eye(4), TwinJoint(FREE, "free", np.zeros(3))))
    place = {root: (len(bodies) - 1, np.eye(4))}
    front = [root]
    while front:
        name = front.pop()
        index, pose = place[name]
        _attach(bodies[index], links[name], pose, plain)
        for joint in below.get(name, ()):
            frame = pose if joint.origin is None else pose @ joint.origin
            if joint.type in KINDS:
                place[joint.child] = (len(bodies), np.eye(4))
                bodies.append(_moving(joint, index, frame))
            else:
                place[joint.child] = (index, frame)
        front += [joint.child for joint in reversed(below.get(name, ()))]
    _tie_to_the_first(bodies)
    return Tree(tuple(bodies), place, tuple(plain.skipped))


def _tie_to_the_first(bodies: list[Body]) -> None:
    """Let each follower of a follower follow the first leader of the chain."""
    joints = {body.joint.name: body.joint for body in bodies if body.joint is not None}
    for body in bodies:
        joint = body.joint
        while joint is not None and joint.leader and (above := joints[joint.leader]).leader:
            # m (n q + p) + o
            offset = joint.multiplier * above.offset + joint.offset
            multiplier = joint.multiplier * above.multiplier
            joint = replace(joint, leader=above.leader, multiplier=multiplier, offset=offset)
        body.joint = joint


def _moving(joint: yourdfpy.Joint, parent: int, pose: np.ndarray) -> Body:
    axis = np.asarray(joint.axis, float)
    moved_by = TwinJoint(joint.name, KINDS[joint.type], axis / np.linalg.norm(axis))
    if joint.mimic is not None:
        multiplier, offset = float(joint.mimic.multiplier), float(joint.mimic.offset)
        moved_by = replace(moved_by, leader=joint.mimic.joint, multiplier=multiplier, offset=offset)
    return Body(joint.child, parent, pose, moved_by)


def _attach(body: Body, link: yourdfpy.Link, pose: np.ndarray, plain: PlainUrdf) -> None:
    """Add a link's inertia and collision shapes to its body."""
    if link.inertial is not None:
        link.inertial.origin = plain.turned.get((link.name, -1), link.inertial.origin)
        body.add(link.inertial, pose)
    for number, collision in enumerate(link.collisions):
        key = link.name, number
        origin = plain.turned.get(key, collision.origin)
        kind, size = _primitive(collision.geometry)
        kind = "capsule" if key in plain.capsules else kind
        body.shapes.append(Shape(link.name, kind, size, pose if origin is None else pose @ origin))


def _primitive(geometry: yourdfpy.Geometry) -> tuple[str, tuple[float, ...]]:
    """Kind and MuJoCo's sizes of a geometry."""
    if geometry.box is not None:
        return "box", tuple(float(size) / 2 for size in geometry.box.size)
    if geometry.cylinder is not None:
        return "cylinder", (float(geometry.cylinder.radius), float(geometry.cylinder.length) / 2)
    return "sphere", (float(geometry.sphere.radius),)
