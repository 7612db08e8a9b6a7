"""A drawing for the viewer of a file: of a URDF's model as in `view`, else of the neutral form."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from softdyn.description.inertia import rotation_rpy
from softdyn.description.robot import Wrap, moving_link_of
from softdyn.description.visuals import CylinderShape, Rgba, SphereShape, Visual
from softdyn.exceptions import UrdfError
from softdyn.validation.mjcf.comparison.neutral import FREEDOMS, WORLD, Neutral, Point
from softdyn.validation.mjcf.comparison.side import Side
from softdyn.validation.mjcf.scenery import geom_visuals
from softdyn.view.scene import Figure, FigureData, columns, shape_data, wrap_data

AXES = np.eye(3)


def drawing_of(side: Side, task: str = "") -> ModelDrawing | RobotDrawing:
    """The drawing of a file: a URDF as the viewer draws its model, an MJCF with its shapes.

    Parameters
    ----------
    side : Side
        The file.
    task : str
        Frame or link whose place the page states, if the file names none.
    """
    if side.is_mjcf:
        return RobotDrawing.of(side, task)
    try:
        figure = Figure.of(side.model)
    except UrdfError as error:
        return RobotDrawing.sticks(side.neutral, str(error), task)
    return ModelDrawing(side.neutral, figure, moving_link_of(side.robot))


@dataclass(frozen=True, eq=False)
class ModelDrawing:
    """A URDF's model as the viewer draws it; `carrier` names the moving link of every link.

    `colours` are those of cables by their names; `problem` says what cannot be shown.
    """

    robot: Neutral
    figure: Figure
    carrier: Mapping[str, str]
    colours: Mapping[str, Rgba] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The file's name."""
        return self.robot.path.stem

    @property
    def problem(self) -> str:
        """Which shapes are left out, and why."""
        return "; ".join(self.figure.problems)

    @property
    def drawn(self) -> frozenset[str]:
        """Names of the drawn cables."""
        return frozenset(cable.name for cable in self.figure.cables)

    def painted(
        self, colours: Mapping[int, Rgba], other: Rgba, cables: Mapping[str, Rgba]
    ) -> ModelDrawing:
        """The drawing with the given colours of its parts and cables."""
        part = {part.link: k for k, part in enumerate(self.robot.parts)}
        on = [part.get(self.carrier[shape.link], WORLD) for shape in self.figure.shapes]
        seen = _seen(self.robot, colours, frozenset(on))
        shapes = tuple(
            replace(shape, rgba=seen.get(k, other))
            for k, shape in zip(on, self.figure.shapes, strict=True)
        )
        return replace(self, figure=replace(self.figure, shapes=shapes), colours=cables)

    @property
    def size(self) -> float:
        """A length (m) into which the robot fits."""
        return max(self.figure.size, 0.1 * self.robot.size)

    @property
    def freedoms(self) -> int:
        """Number of coordinates in a frame."""
        return self.figure.model.nv

    def coordinates(self, q: Mapping[str, list[float]]) -> np.ndarray:
        """Frame (freedoms,) of the coordinates of some parts by name; the others are at zero."""
        model, row = self.figure.model, np.zeros(self.freedoms)
        base = 6 if model.robot.floating else 0
        if base:
            (free,) = (part.name for part in self.robot.parts if part.kind == "free")
            row[:base] = q.get(free, 0.0)
        for k, name in enumerate(model.joint_names[base:], base):
            row[k] = np.ravel(q.get(name, 0.0))[0]
        return row

    @property
    def data(self) -> FigureData:
        """The robot as JSON: no inputs, and cables without a tension."""
        found = self.figure.data
        still = {"weights": [], "limit": 0, "side": 0, "slackens": False, "terms": []}
        found["cables"] = [
            cable | still | {"rgba": self.colours.get(cable["name"])} for cable in found["cables"]
        ]
        found["inputs"], found["coordinates"] = [], []
        return found


@dataclass(frozen=True, eq=False)
class RobotDrawing:
    """A robot with its shapes, each on a part or on the root, in the root's axes at zero.

    `rest` are the coordinates of free bodies in the file. If the robot is drawn as sticks,
    `problem` says why. `task` names the frame or link whose place the page states; by default it is
    the last link. `colours` are those of cables by their names.
    """

    name: str
    robot: Neutral
    shapes: tuple[tuple[int, Visual], ...]
    rest: Mapping[str, list[float]]
    problem: str = ""
    task: str = ""
    colours: Mapping[str, Rgba] = field(default_factory=dict)

    @classmethod
    def of(cls, side: Side, task: str = "") -> RobotDrawing:
        """The drawing of an MJCF with its shapes, or with sticks if they cannot be read."""
        robot = side.neutral
        try:
            found = tuple(_of_mjcf(robot, side.scene)) or tuple(_sticks(robot))
            return cls(robot.path.stem, robot, found, _rest(robot, side.scene), task=task)
        except UrdfError as error:
            return cls.sticks(robot, str(error), task)

    @classmethod
    def sticks(cls, robot: Neutral, problem: str, task: str = "") -> RobotDrawing:
        """The drawing of a robot without shapes, for this reason."""
        problem = f"drawn as sticks: {problem}"
        return cls(robot.path.stem, robot, tuple(_sticks(robot)), {}, problem, task)

    @property
    def drawn(self) -> frozenset[str]:
        """Names of the drawn cables."""
        return frozenset(cable.name for cable in self.robot.cables if len(cable.path) > 1)

    def painted(
        self, colours: Mapping[int, Rgba], other: Rgba, cables: Mapping[str, Rgba]
    ) -> RobotDrawing:
        """The drawing with the given colours of its parts and cables."""
        seen = _seen(self.robot, colours, frozenset(part for part, _ in self.shapes))
        shapes = tuple(
            (part, replace(shape, rgba=seen.get(part, other))) for part, shape in self.shapes
        )
        return replace(self, shapes=shapes, colours=cables)

    @property
    def size(self) -> float:
        """A length (m) into which the robot fits."""
        far = [float(np.abs(shape.pose[:3, 3]).max()) for _, shape in self.shapes]
        return max(self.robot.size, *far, 0.1) if far else self.robot.size

    @property
    def freedoms(self) -> int:
        """Number of coordinates in a frame."""
        return self.robot.nv

    def coordinates(self, q: Mapping[str, list[float]]) -> np.ndarray:
        """Frame (freedoms,) of the coordinates of some parts by name; the others are at zero."""
        row: list[float] = []
        given = {tie.joint: tie for tie in self.robot.couplings if tie.leader in q}
        followed = {
            name: [tie.multiplier * q[tie.leader][0] + tie.offset] for name, tie in given.items()
        }
        known = {**self.rest, **q, **followed}
        for part in self.robot.parts:
            value = np.zeros(FREEDOMS[part.kind]) + known.get(part.name, 0.0)
            if part.kind in ("free", "ball"):
                turned = Rotation.from_rotvec(value[-3:]).as_matrix()
                value = np.concatenate((value[:-3], _angles(turned)))
            row += value.tolist()
        return np.array(row)

    @property
    def data(self) -> FigureData:
        """The robot as JSON: a link per degree of freedom, in the root's axes at zero."""
        origins = {WORLD: np.zeros(3)}
        joints: list[dict[str, Any]] = []
        link = {WORLD: 0}
        for k, part in enumerate(self.robot.parts):
            above = link[part.parent]
            before = origins[part.parent]
            slides, axes = _freedoms(part.kind, part.axis)
            for slide, axis in zip(slides, axes, strict=True):
                pose = np.eye(4)
                pose[:3, 3] = part.point - before
                number = len(joints) + 1
                joints.append(
                    {
                        "parent": above, "child": number, "pose": columns(pose),
                        "axis": axis.tolist(), "slides": slide, "turns": False,
                        "index": number - 1, "gain": 1, "offset": 0,
                    }
                )  # fmt: skip
                above, before = number, part.point
            link[k], origins[k] = above, part.point
        placed = []
        for carrier, shape in self.shapes:
            pose = shape.pose.copy()
            pose[:3, 3] -= origins[carrier]
            placed.append(replace(shape, link=str(carrier), pose=pose))
        last, place = self._tip()
        pose = np.eye(4)
        pose[:3, 3] = place - origins[last]
        tip = len(joints) + 1
        fixed = {
            "parent": link[last], "child": tip, "pose": columns(pose), "axis": [0, 0, 1],
            "slides": False, "turns": False, "index": -1, "gain": 0, "offset": 0,
        }  # fmt: skip
        return {
            "name": self.name, "size": self.size, "links": tip + 1, "tip": tip,
            "dof": len(joints), "floating": False, "root": 0, "joints": [*joints, fixed],
            "inputs": [],
            **shape_data(placed, {str(k): number for k, number in link.items()}),
            "cables": list(self._cables(link, origins)), "marks": [], "numbers": 0,
            "coordinates": [], "skins": [],
        }  # fmt: skip

    def _tip(self) -> tuple[int, np.ndarray]:
        """Part and place (3,) at zero of the frame or link `task`, else of the last link."""
        robot = self.robot
        if self.task in robot.frames:
            frame = robot.frames[self.task]
            return frame.part, frame.pose.translation
        links = {part.link: k for k, part in enumerate(robot.parts)}
        last = links.get(self.task, len(robot.parts) - 1)
        return (last, robot.parts[last].pose.translation) if robot.parts else (WORLD, np.zeros(3))

    def _cables(
        self, link: Mapping[int, int], origins: Mapping[int, np.ndarray]
    ) -> Iterator[dict[str, Any]]:
        """The paths as JSON, one for each strand between two pulleys."""
        numbers = {str(part): number for part, number in link.items()}
        for cable in self.robot.cables:
            for sites, wraps in _strands(cable.path):
                on = [(p.part, p.xyz - origins[p.part]) for p in sites]
                placed = [
                    replace(
                        wrap,
                        xyz=tuple(np.subtract(wrap.xyz, origins[int(wrap.link)])),
                        side=None if wrap.side is None
                        else tuple(np.subtract(wrap.side, origins[int(wrap.link)])),
                    )
                    for wrap in wraps
                ]  # fmt: skip
                yield {
                    "name": cable.name, "weights": [], "limit": 0, "side": 0,
                    "rgba": self.colours.get(cable.name),
                    "sites": [[link[part], *xyz.tolist()] for part, xyz in on],
                    "wraps": [wrap_data(wrap, numbers) for wrap in placed],
                }  # fmt: skip


def _seen(robot: Neutral, colours: Mapping[int, Rgba], shown: frozenset[int]) -> dict[int, Rgba]:
    """The colours of parts; a part without a shape gives its own to the next ones that it moves."""
    found: dict[int, Rgba] = {}
    for k, part in enumerate(robot.parts):  # parents first
        above = None if part.parent in shown else found.get(part.parent)
        if (colour := colours.get(k, above)) is not None:
            found[k] = colour
    return found | ({WORLD: colours[WORLD]} if WORLD in colours else {})


def _strands(path: Sequence[Point]) -> Iterator[tuple[list[Point], list[Wrap]]]:
    """The sites and round bodies of each strand of a path, in the root's axes at zero."""
    sites: list[Point] = []
    wraps: list[Wrap] = []
    for point in path:
        word = point.around.partition(" ")[0]
        if word == "pulley":
            if len(sites) > 1:
                yield sites, wraps
            sites, wraps = [], []
        elif not word:
            sites.append(point)
        elif word in ("sphere", "cylinder"):
            wraps.append(Wrap(str(point.part), tuple(point.xyz), point.radius, len(sites) - 1))
        else:  # the second point on the axis, or the side point, of the last round body
            last = wraps[-1]
            if point.around == "its axis":
                wraps[-1] = replace(last, axis=tuple(point.xyz - last.xyz))
            else:
                wraps[-1] = replace(last, side=tuple(point.xyz))
    if len(sites) > 1:
        yield sites, wraps


def _freedoms(kind: str, axis: np.ndarray) -> tuple[list[bool], list[np.ndarray]]:
    """Whether each freedom slides, and its axis; a free body first slides, then turns."""
    if kind in ("hinge", "slide"):
        return [kind == "slide"], [axis]
    turns = [False] * 3, list(AXES)
    return turns if kind == "ball" else ([True] * 3 + turns[0], list(AXES) + turns[1])


def _angles(rotation: np.ndarray) -> np.ndarray:
    """Angles (3,) about the successively rotated axes x, y, z: R = Rx Ry Rz."""
    y = np.arctan2(rotation[0, 2], np.hypot(rotation[0, 0], rotation[0, 1]))
    x = np.arctan2(-rotation[1, 2], rotation[2, 2])
    return np.array([x, y, np.arctan2(-rotation[0, 1], rotation[0, 0])])


def _rest(robot: Neutral, model: mujoco.MjModel) -> dict[str, list[float]]:
    """Position and rotation vector (rad) of free bodies in the file."""
    found = {}
    for k, part in enumerate(robot.parts):
        if part.kind == "free":
            pose, turned = model.qpos0[model.jnt_qposadr[k] :][:7], np.zeros(3)
            mujoco.mju_quat2Vel(turned, pose[3:], 1.0)
            found[part.name] = [*pose[:3].tolist(), *turned.tolist()]
    return found


def _of_mjcf(robot: Neutral, model: mujoco.MjModel) -> Iterator[tuple[int, Visual]]:
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    carrier = [WORLD] * model.nbody
    for body in range(1, model.nbody):
        last = model.body_jntadr[body] + model.body_jntnum[body] - 1
        own = model.body_jntnum[body] > 0
        carrier[body] = int(last) if own else carrier[model.body_parentid[body]]
    for geom, shape in geom_visuals(model, data):
        yield carrier[model.geom_bodyid[geom]], shape


def _sticks(robot: Neutral) -> Iterator[tuple[int, Visual]]:
    """A ball at every joint, and a rod from it to each next joint, or to the tip's origin."""
    size, grey = robot.size, (0.6, 0.6, 0.6, 1.0)
    for k, part in enumerate(robot.parts):
        pose = np.eye(4)
        pose[:3, 3] = start = part.point if part.kind != "free" else part.pose.translation
        yield k, Visual("", pose, SphereShape(0.02 * size), grey)
        below = [robot.parts[child].point for child in robot.children(k)]
        for end in below or [part.inertia.com if part.inertia.mass else start]:
            along = end - start
            length = float(np.linalg.norm(along))
            if length > 1e-6:
                pitch = np.arctan2(np.hypot(along[0], along[1]), along[2])
                turned = np.eye(4)
                turned[:3, :3] = rotation_rpy(
                    np.array([0.0, pitch, np.arctan2(along[1], along[0])])
                )
                turned[:3, 3] = start + along / 2
                yield k, Visual("", turned, CylinderShape(0.012 * size, length), grey)
