"""A drawing for the viewer of a robot in the neutral form, from a URDF or an MJCF."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from softdyn.description.inertia import rotation_rpy
from softdyn.description.robot import Robot, moving_link_of, poses
from softdyn.description.visuals import CylinderShape, Rgba, SphereShape, Visual, visuals
from softdyn.exceptions import UrdfError
from softdyn.validation.mjcf.comparison.neutral import FREEDOMS, WORLD, Neutral
from softdyn.validation.mjcf.comparison.side import Side
from softdyn.validation.mjcf.scenery import geom_visuals
from softdyn.view.scene import FigureData, columns, shape_data

AXES = np.eye(3)


@dataclass(frozen=True, eq=False)
class RobotDrawing:
    """A robot with its shapes, each on a part or on the root, in the root's axes at zero.

    `rest` are the coordinates of free bodies in the file. If the robot is drawn as sticks,
    `problem` says why.
    """

    name: str
    robot: Neutral
    shapes: tuple[tuple[int, Visual], ...]
    rest: Mapping[str, list[float]]
    problem: str = ""

    @classmethod
    def of(cls, side: Side) -> RobotDrawing:
        """The drawing of a robot with its file's shapes, or with sticks if they cannot be read."""
        robot = side.neutral
        found: tuple[tuple[int, Visual], ...] = ()
        problem, rest = "", {}
        try:
            if side.is_mjcf:
                found, rest = tuple(_of_mjcf(robot, side.scene)), _rest(robot, side.scene)
            else:
                found = tuple(_of_urdf(robot, side.robot))
        except UrdfError as error:
            problem = str(error)
        return cls(robot.path.stem, robot, found or tuple(_sticks(robot)), rest, problem)

    def painted(self, colours: Mapping[int, Rgba], other: Rgba) -> RobotDrawing:
        """The drawing with the given colours of its parts."""
        shapes = tuple(
            (part, replace(shape, rgba=colours.get(part, other))) for part, shape in self.shapes
        )
        return replace(self, shapes=shapes)

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
        for part in self.robot.parts:
            value = np.zeros(FREEDOMS[part.kind]) + q.get(part.name, self.rest.get(part.name, 0.0))
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
        cables = [
            {
                "name": cable.name, "weights": [], "limit": 0, "side": 0,
                "sites": [
                    [link[p.part], *(p.xyz - origins[p.part]).tolist()] for p in cable.path
                ],
            }
            for cable in self.robot.cables
            if len(cable.path) > 1
        ]  # fmt: skip
        return {
            "name": self.name, "size": self.size, "links": len(joints) + 1, "tip": 0,
            "dof": len(joints), "floating": False, "root": 0, "joints": joints, "inputs": [],
            **shape_data(placed, {str(k): number for k, number in link.items()}),
            "cables": cables, "marks": [], "numbers": 0, "coordinates": [], "skins": [],
        }  # fmt: skip


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


def _of_urdf(robot: Neutral, parsed: Robot) -> Iterator[tuple[int, Visual]]:
    carrier = moving_link_of(parsed)
    index = {part.link: k for k, part in enumerate(robot.parts)}
    for shape in visuals(parsed)[0]:
        rotation, translation = poses(parsed)[shape.link]
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, translation
        yield index.get(carrier[shape.link], WORLD), replace(shape, pose=pose @ shape.pose)


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
