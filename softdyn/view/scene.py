"""A robot as the viewer draws it: links, joints, shapes and cables as plain data.

The page computes all poses from the coordinates (`SoftModel.coordinates`), and the cables from
their sites. A frame therefore holds little more than (q, u).
"""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, TypedDict

import numpy as np
import pinocchio as pin

from softdyn.description.rig import PASCAL, Actuator
from softdyn.description.robot import (
    Joint,
    Robot,
    Tendon,
    Wrap,
    input_units,
    levels,
    moving_bodies,
    moving_link_of,
    poses,
)
from softdyn.description.task_mark import TaskMark
from softdyn.description.visuals import BoxShape, CylinderShape, Mesh, SphereShape, Visual, visuals
from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.wraps import RoundBodies, body_of, courses
from softdyn.safety import Surroundings
from softdyn.tasks.frames import make_tasks
from softdyn.tasks.marks import marks_of
from softdyn.view.skin import skins
from softdyn.view.tendon_paths import Path, fixed_path

# Colours of a cable over its tension: dark blue for full tension of one sign, grey for slack, dark
# red for full tension of the other sign. They differ in lightness, for every kind of colour vision.
TENSION = (
    (-1.0, (8, 48, 107)), (-0.5, (43, 123, 186)), (0.0, (150, 162, 176)), (0.5, (239, 138, 43)),
    (1.0, (150, 20, 30)),
)  # fmt: skip
ROUND = (0.62, 0.64, 0.68, 1.0)  # colour of pulleys and pins
WORLD = ""  # the link of shapes around the robot
EMPTY = np.zeros((0, 3))
ARC = 17  # points of a drawn arc
STICK = (0.45, 0.52, 0.6, 1.0)


@dataclass(frozen=True, eq=False)
class DrawnCable:
    """A polyline over `sites`, each a link and a point (3,) in its frame.

    Its tension is ``weights · u``, positive if it pulls, at most `limit`. A signed input may stand
    for two antagonists. Each of them shows one sign of the tension: `side` is +1 or -1, else 0.

    A cable with `slackens` is drawn slack while no input pulls it and its length is at most `rest`.
    The length is that of the polyline, or Σ coef · q over `terms`, pairs (index of q, coef). A
    winch's cable has no spring of its own, and no `rest`.

    `wraps` are the round bodies between its sites. The page's script draws the arcs itself.

    A chamber is a tube of `radius_m` (m); 0 is a cable. Its "tension" is its force p A along the
    path, which reddens it.
    """

    name: str
    sites: Path
    weights: np.ndarray
    limit: float
    side: int
    slackens: bool = False
    rest: float | None = None
    terms: tuple[tuple[int, float], ...] = ()
    wraps: tuple[Wrap, ...] = ()
    radius_m: float = 0.0

    def part(self, u: np.ndarray) -> float:
        """Tension over full tension, in [-1, 1], under the input u (nu,)."""
        force = float(self.weights @ u)
        if self.side:
            force = self.side * max(0.0, self.side * force)
        return force / self.limit if self.limit > 0 else 0.0

    def points(self, poses: Mapping[str, np.ndarray]) -> np.ndarray:
        """Its polyline (k, 3) in the world, with the arcs, at poses (4, 4) of the links."""
        sites = [poses[link][:3, :3] @ xyz + poses[link][:3, 3] for link, xyz in self.sites]
        arcs = {wrap.after: _arc(wrap, poses[wrap.link], sites[wrap.after :][:2])
                for wrap in self.wraps}  # fmt: skip
        parts = [np.vstack((site, arcs.get(k, EMPTY))) for k, site in enumerate(sites)]
        return np.concatenate(parts)


def _arc(wrap: Wrap, pose: np.ndarray, ends: list[np.ndarray]) -> np.ndarray:
    """The points (k, 3) in the world of a cable on a round body, none if it is straight."""
    body, axes = body_of(wrap)
    axes, centre = pose[:3, :3] @ axes, pose[:3, :3] @ wrap.xyz + pose[:3, 3]
    course = courses(RoundBodies.of([body]), (np.array([ends]) - centre) @ axes)
    points = course.points(ARC)[0] @ axes.T + centre
    return points[np.isfinite(points).all(axis=1)]


class ShapeData(TypedDict):
    """Shapes, each with the number of its link (-1: the world), and the meshes that they share."""

    meshes: list[dict[str, Any]]
    shapes: list[dict[str, Any]]


class FigureData(ShapeData):
    """A robot as JSON, with every member that the page's script (figure.js) reads.

    Links are numbers, matrices lists column by column, meshes in base64. `tip` and `root` are
    links, `dof` is the number of coordinates in a frame, `numbers` that of the targets' numbers.
    """

    name: str
    size: float
    links: int
    tip: int
    dof: int
    marks: list[dict[str, Any]]
    numbers: int
    floating: bool
    root: int
    joints: list[dict[str, Any]]
    inputs: list[dict[str, Any]]
    coordinates: list[dict[str, Any]]
    skins: list[list[dict[str, Any]]]
    cables: list[dict[str, Any]]


@dataclass(frozen=True, eq=False)
class Figure:
    """All data that the viewer needs of a robot; `problems` name the shapes left out.

    `scenery` are shapes around the robot, on the link `WORLD`; `marks` are its tasks, whose targets
    are in the frames.
    """

    model: SoftModel
    shapes: tuple[Visual, ...]
    cables: tuple[DrawnCable, ...]
    problems: tuple[str, ...]
    scenery: tuple[Visual, ...] = ()
    marks: tuple[TaskMark, ...] = ()

    @classmethod
    def of(cls, model: SoftModel, marks: tuple[TaskMark, ...] = ()) -> Figure:
        """The figure of a robot with these tasks.

        Raises
        ------
        UrdfError
            For a shape with an invalid number.
        """
        shapes, problems = visuals(model.robot)
        shapes += tuple(_sticks(model.robot, shapes))
        shapes += tuple(_round_bodies(model.robot))
        return cls(model, shapes, tuple(_cables(model, shapes)), problems, marks=marks)

    @classmethod
    def with_stated_tasks(cls, model: SoftModel) -> Figure:
        """The figure of a robot with the tasks that its file states."""
        return cls.of(model, marks_of(make_tasks(model)) if model.robot.tasks else ())

    def with_scenery(
        self, surroundings: Surroundings | None, scenery: Sequence[Visual] = ()
    ) -> Figure:
        """The figure with shapes of the world around it: obstacles, and other scenery."""
        obstacles = () if surroundings is None else surroundings.visuals(self.size)
        return replace(self, scenery=(*self.scenery, *scenery, *obstacles))

    @property
    def numbers(self) -> int:
        """How many numbers the targets of all `marks` have."""
        return sum(len(mark.columns) for mark in self.marks)

    @property
    def size(self) -> float:
        """The robot's size (m): from the base to the tip, or to the farthest link at q = 0."""
        farthest = max(float(np.linalg.norm(t)) for _, t in poses(self.model.robot).values())
        return max(self.model.robot.length, farthest) or 0.1

    def link_poses(self, q: np.ndarray) -> dict[str, np.ndarray]:
        """Pose (4, 4) in the world of every link at the configuration q (nq,)."""
        return self.model.link_poses(q)

    @property
    def links(self) -> list[str]:
        """The links in the order of `data`: level by level from the root."""
        return list(chain(*levels(self.model.robot.root, self.model.robot.joints)))

    @property
    def data(self) -> FigureData:
        """The figure as JSON."""
        robot, model = self.model.robot, self.model
        links = {WORLD: -1} | {name: i for i, name in enumerate(self.links)}
        order = {name: i for i, name in enumerate(model.joint_names)}
        joints = sorted(robot.joints, key=lambda joint: links[joint.child])
        return {
            "name": robot.name,
            "size": self.size,
            "links": len(self.links),
            "tip": links[robot.task],
            "dof": model.nv,
            "marks": [{**mark.table, "link": links[mark.link]} for mark in self.marks],
            "numbers": self.numbers,
            "floating": robot.floating,
            "root": links[robot.root],
            "joints": [
                {
                    "parent": links[joint.parent],
                    "child": links[joint.child],
                    "pose": columns(_pose(joint.origin.rotation, joint.origin.translation)),
                    "axis": joint.axis.tolist(),
                    "slides": joint.kind == "prismatic",
                    "turns": joint.kind == "continuous",
                    **_coordinate(joint, order),
                }
                for joint in joints
            ],
            "inputs": [
                {"name": a.name, "lower": a.lower, "upper": a.upper} | _shown(unit)
                for a, unit in zip(robot.actuators, input_units(robot), strict=True)
            ],
            "coordinates": _coordinates(model, self.size),
            **shape_data((*self.shapes, *self.scenery), links),
            "skins": [
                [
                    {"link": links[ring.link], "pose": columns(ring.pose)}
                    | {"radius": ring.radius, "rgba": list(ring.rgba)}
                    for ring in rings
                ]
                for rings in skins(robot, self.shapes)
            ],
            "cables": [
                vars(cable)
                | {
                    "sites": [[links[link], *xyz.tolist()] for link, xyz in cable.sites],
                    "weights": cable.weights.tolist(),
                    "wraps": [wrap_data(wrap, links) for wrap in cable.wraps],
                }
                for cable in self.cables
            ],
        }


def shape_data(shapes: Sequence[Visual], links: dict[str, int]) -> ShapeData:
    """Shapes and their meshes as JSON; `links` gives the number of each link."""
    meshes = {id(s.shape): s.shape for s in shapes if isinstance(s.shape, Mesh)}
    number = {key: i for i, key in enumerate(meshes)}
    return {
        "meshes": [_packed(mesh) for mesh in meshes.values()],
        "shapes": [
            {
                "link": links[shape.link],
                "pose": columns(shape.pose),
                "rgba": list(shape.rgba),
                "skin": shape.skin,
                **_size(shape, number),
            }
            for shape in shapes
        ],
    }


def tension_colour(part: float) -> tuple[float, float, float]:
    """RGB in 0 … 1 of a tension over full tension.

    The scale is a cube root, because most tensions are a few per cent of full.
    """
    at = float(np.cbrt(np.clip(part, -1, 1)))
    stops = [stop for stop, _ in TENSION]
    red, green, blue = (np.interp(at, stops, [rgb[k] for _, rgb in TENSION]) for k in range(3))
    return float(red) / 255, float(green) / 255, float(blue) / 255


def _shown(unit: str) -> dict[str, Any]:
    """The unit in which the page shows an input, and its factor; pressures are in kPa."""
    return {"unit": "kPa", "factor": 1e-3} if unit == PASCAL else {"unit": unit, "factor": 1.0}


def _pose(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    return pose


def _coordinate(joint: Joint, order: dict[str, int]) -> dict[str, Any]:
    """The coordinate that moves a joint: q_joint = gain · q[index] + offset."""
    if joint.mimic is None:
        return {"index": order.get(joint.name, -1), "gain": 1, "offset": 0}
    follows = joint.mimic
    return {"index": order[follows.leader], "gain": follows.multiplier, "offset": follows.offset}


def _coordinates(model: SoftModel, size: float) -> list[dict[str, Any]]:
    """Names of the joint coordinates and the ends of their sliders.

    The ends are the limits, but at most ±π or ± the robot's size.
    """
    strokes = {joint.name for joint in model.robot.joints if joint.kind == "prismatic"}
    if model.robot.floating:
        strokes |= set(model.joint_names[:3])
    found = []
    for name, lower, upper in zip(model.joint_names, model.lower, model.upper, strict=True):
        far = size if name in strokes else np.pi
        found.append({"name": name, "lower": max(lower, -far), "upper": min(upper, far)})
    return found


def columns(matrix: np.ndarray) -> list[float]:
    """A matrix column by column, as the page needs it."""
    return [round(float(x), 9) for x in matrix.T.ravel()]


def _size(shape: Visual, number: dict[int, int]) -> dict[str, Any]:
    form = shape.shape
    if isinstance(form, BoxShape):
        return {"box": list(form.size)}
    if isinstance(form, CylinderShape):
        return {"cylinder": [form.radius, form.length]}
    if isinstance(form, SphereShape):
        return {"sphere": form.radius}
    return {"mesh": number[id(form)]}


def _packed(mesh: Mesh) -> dict[str, Any]:
    """Vertices as 16-bit fractions of the bounding box, to 1/65535; faces as 16 or 32 bit."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    span = np.where(high > low, high - low, 1)
    vertices = np.round((mesh.vertices - low) / span * 65535).astype("<u2")
    faces = mesh.faces.astype("<u2" if len(vertices) < 65536 else "<u4")
    return {
        "low": low.tolist(),
        "span": span.tolist(),
        "vertices": base64.b64encode(vertices.tobytes()).decode(),
        "faces": base64.b64encode(faces.tobytes()).decode(),
        "bytes": faces.itemsize,
    }


def _cables(model: SoftModel, shapes: Sequence[Visual]) -> Iterator[DrawnCable]:
    robot = model.robot
    for tendon in robot.tendons:
        yield from _chamber(model, tendon, shapes)
        spatial, slackness = bool(tendon.sites), _slackness(model, tendon)
        pulling = [a.tendon == tendon.name and not a.is_chamber for a in robot.actuators]
        if not any(pulling) and any(a.tendon == tendon.name for a in robot.actuators):
            continue  # chambers alone
        # A spatial tendon pulls with -gear u. A fixed one is drawn on the side where gear u pulls.
        gears = np.array([a.gear for a in robot.actuators]) * pulling
        weights = -gears if spatial else gears
        ends = np.array([weights * model.u_min, weights * model.u_max]).reshape(2, -1)
        low, high = float(ends.min(axis=0).sum()), float(ends.max(axis=0).sum())
        limit = max(-low, high)
        if spatial:
            path = [(site.link, np.array(site.xyz)) for site in tendon.sites]
            yield DrawnCable(tendon.name, path, weights, limit, 0, *slackness, tendon.wraps)
            continue
        for side in (1, -1):
            if (limit == 0 and side < 0) or (side > 0 and high <= 0 < limit) or (side < 0 <= low):
                continue  # no input pulls on that side
            pair = low < 0 < high  # two antagonists; of one cable the pull is positive
            pull = weights if pair else side * weights
            for path in fixed_path(robot, tendon, shapes, side):
                yield DrawnCable(tendon.name, path, pull, limit, side if pair else 0, *slackness)


def _chamber(model: SoftModel, tendon: Tendon, shapes: Sequence[Visual]) -> Iterator[DrawnCable]:
    """A tube where a cable with the tendon's moment arms would run, if it has a chamber."""
    robot = model.robot

    def here(a: Actuator) -> bool:
        return a.is_chamber and a.tendon == tendon.name

    areas = np.array([a.gear * here(a) for a in robot.actuators])
    if not areas.any():
        return
    limit = float(areas @ np.maximum(-model.u_min, model.u_max))
    radius = float(np.sqrt(areas.max() / np.pi))
    sites = [(site.link, np.array(site.xyz)) for site in tendon.sites]
    for path in [sites] if sites else fixed_path(robot, tendon, shapes, -1):
        yield DrawnCable(tendon.name, path, areas, limit, 0, wraps=tendon.wraps, radius_m=radius)


def _slackness(
    model: SoftModel, tendon: Tendon
) -> tuple[bool, float | None, tuple[tuple[int, float], ...]]:
    """`slackens`, `rest` and `terms` of a tendon's `DrawnCable`."""
    robot = model.robot
    winds = any(a.is_winch and a.tendon == tendon.name for a in robot.actuators)
    if not tendon.slack:
        return winds and not tendon.stiffness, None, ()
    rest = tendon.rest
    if rest is None:
        rest = float(model.tendon_lengths(model.q0)[robot.tendons.index(tendon)])
    order = {name: i for i, name in enumerate(model.joint_names)}
    joints, terms = {joint.name: joint for joint in robot.joints}, []
    for term in tendon.terms:
        turned = _coordinate(joints[term.joint], order)
        terms.append((turned["index"], term.coef * turned["gain"]))
        rest -= term.coef * turned["offset"]
    return True, rest, tuple(terms)


def wrap_data(wrap: Wrap, links: dict[str, int]) -> dict[str, Any]:
    """A round body as JSON, in a frame whose z is a cylinder's axis."""
    body, axes = body_of(wrap)
    return {
        "after": wrap.after,
        "link": links[wrap.link],
        "pose": columns(_pose(axes, np.array(wrap.xyz))),
        "radius": body.radius,
        "sphere": body.sphere,
        "side": None if body.side is None else body.side.tolist(),
        "inside": body.inside,
    }


def _round_bodies(robot: Robot) -> Iterator[Visual]:
    """Pulleys and pins of cables; one with a cable inside is translucent."""
    for tendon in robot.tendons:
        for wrap in tendon.wraps:
            _, axes = body_of(wrap)
            size = 4.0 * wrap.radius if wrap.length is None else wrap.length
            round_ = CylinderShape(wrap.radius, size)
            shape = SphereShape(wrap.radius) if wrap.axis is None else round_
            rgba = (*ROUND[:3], 0.3) if wrap.inside else ROUND
            yield Visual(wrap.link, _pose(axes, np.array(wrap.xyz)), shape, rgba)


def _sticks(robot: Robot, shapes: Sequence[Visual]) -> Iterator[Visual]:
    """A cylinder from a link's origin to each of its joints, and a ball at each joint.

    If the robot has shapes, these stand for the bodies with a mass and without a shape.
    """
    size, carrier = max(robot.length, 1e-3), moving_link_of(robot)
    seen = {carrier[shape.link] for shape in shapes}
    if seen:
        seen |= {link for link, body in moving_bodies(robot).items() if not body.mass}
        seen.add(robot.root)
    for joint in robot.joints:
        if carrier[joint.parent] in seen:
            continue
        end = joint.origin.translation
        length = float(np.linalg.norm(end))
        if length > 0:
            along = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end)
            pose = _pose(along.matrix(), end / 2)
            yield Visual(joint.parent, pose, CylinderShape(0.018 * size, length), STICK)
        if joint.moves or joint.child == robot.task:
            yield Visual(joint.child, np.eye(4), SphereShape(0.03 * size), STICK)
