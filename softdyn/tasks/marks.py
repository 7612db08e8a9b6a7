"""Targets of tasks as rows of numbers: what a log keeps, a page draws and a mouse drags."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from softdyn.checks import array
from softdyn.description.stated_task import TaskKind
from softdyn.exceptions import InputError
from softdyn.references import SetPoint
from softdyn.tasks.frames import FrameTask
from softdyn.tasks.rotations import log3
from softdyn.tasks.targets import Target, exp3
from softdyn.tasks.task import Task, unit

PLACED = (TaskKind.POSITION, TaskKind.POSE)  # they begin with a point
TURNED = (TaskKind.ORIENTATION, TaskKind.POSE)  # they end with a rotation vector


@dataclass(frozen=True)
class TaskMark:
    """A task of a link's frame, as far as a picture of it and its target needs.

    Its target is a row of numbers: a point x y z (m), a rotation vector rx ry rz (rad), both, or a
    direction dx dy dz, all in the world.

    Attributes
    ----------
    name, link : str
        The task's name, and its link.
    kind : TaskKind
        The quantity.
    vector : tuple of float
        In the link's frame: the direction of an axis, else the origin of the frame (m).
    """

    name: str
    link: str
    kind: TaskKind
    vector: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @classmethod
    def of(cls, table: Any) -> TaskMark:
        """A mark from its `table`.

        Raises
        ------
        InputError
            For anything that is no such table.
        """
        kinds = [kind.value for kind in TaskKind]
        if not isinstance(table, Mapping) or set(table) != {"name", "link", "kind", "vector"}:
            raise InputError("mark", "name, link, kind and vector", repr(table))
        name, link, kind = (table[key] for key in ("name", "link", "kind"))
        if not (isinstance(name, str) and isinstance(link, str) and kind in kinds):
            raise InputError("mark", f"texts, and a kind of {', '.join(kinds)}", repr(table))
        x, y, z = array("mark: vector", table["vector"], (3,)).tolist()
        return cls(name, link, TaskKind(kind), (x, y, z))

    @property
    def table(self) -> dict[str, Any]:
        """The mark as plain data."""
        return vars(self) | {"kind": self.kind.value, "vector": list(self.vector)}

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of its target's numbers, as those of `recorded_paths`."""
        parts = ("dx", "dy", "dz") if self.kind is TaskKind.AXIS else self.kind.rows
        return tuple(f"{self.name}.{part}" for part in parts)

    def pose_numbers(self, pose: np.ndarray) -> np.ndarray:
        """The numbers of a target that the link's pose (4, 4) fulfils."""
        if self.kind is TaskKind.AXIS:
            return unit("vector", pose[:3, :3] @ self.vector)
        frame = pose.copy()
        frame[:3, 3] += pose[:3, :3] @ self.vector
        if self.kind is TaskKind.POSITION:
            return frame[:3, 3]
        return numbers(frame if self.kind is TaskKind.POSE else frame[:3, :3])

    def target(self, values: np.ndarray) -> SetPoint | Target:
        """The target from its numbers.

        Raises
        ------
        InputError
            For a direction that is zero.
        """
        if self.kind is TaskKind.POSITION:
            return SetPoint(values)
        if self.kind is TaskKind.AXIS:
            return Target(unit(f"target of {self.name!r}", values))
        turn = exp3(values[-3:])
        if self.kind is TaskKind.ORIENTATION:
            return Target(turn)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, values[:3]
        return Target(pose)

    def check(self, values: np.ndarray, reach: float) -> None:
        """Refuse numbers that no mouse drags to.

        Raises
        ------
        InputError
            For a coordinate beyond `reach` (m), a turn of more than π, or no unit vector.
        """
        at = f"target of {self.name!r}"
        if self.kind in PLACED and np.abs(values[:3]).max() > reach:
            raise InputError(at, f"a point within {reach:g} m", values[:3].tolist())
        size = math.hypot(*values[-3:].tolist())
        if self.kind in TURNED and size > math.pi + 1e-6:
            raise InputError(at, "a turn of at most pi", values[-3:].tolist())
        if self.kind is TaskKind.AXIS and not abs(size - 1) < 1e-6:
            raise InputError(at, "a unit vector", values.tolist())


def marks_of(tasks: Sequence[Task]) -> tuple[TaskMark, ...]:
    """The marks of the tasks of links' frames; other tasks have none."""
    found = []
    for task in tasks:
        if isinstance(task, FrameTask) and task.stated is not None:
            x, y, z = getattr(task, "axis", getattr(task, "point", (0.0, 0.0, 0.0)))
            found.append(
                TaskMark(task.name, task.link, task.stated, (float(x), float(y), float(z)))
            )
    return tuple(found)


def target_row(tasks: Sequence[Task], reference: Any) -> np.ndarray:
    """The numbers of the targets of all tasks that have marks, one after the other.

    Raises
    ------
    InputError
        If a target is missing.
    """
    marked = (task for task in tasks if isinstance(task, FrameTask) and task.stated is not None)
    found = [numbers(task.target_in(reference).y) for task in marked]
    return np.concatenate(found) if found else np.zeros(0)


def numbers(y: np.ndarray) -> np.ndarray:
    """A `Target`'s value as numbers: a rotation (3, 3) as a vector, a pose (4, 4) as six."""
    if y.shape == (3,):
        return y
    turn = np.empty(3)
    log3(np.ascontiguousarray(y[:3, :3]), turn)
    return turn if y.shape == (3, 3) else np.concatenate((y[:3, 3], turn))
