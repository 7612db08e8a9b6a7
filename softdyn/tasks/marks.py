"""Targets of tasks as rows of numbers: what a log keeps, a page draws and a mouse drags."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from softdyn.checks import did_you_mean, unit
from softdyn.copies import keep_making
from softdyn.description.stated_task import TaskKind
from softdyn.description.task_mark import TaskMark
from softdyn.exceptions import InputError, errors_in
from softdyn.references import Reference, SetPoint
from softdyn.tasks.frames import FrameTask
from softdyn.tasks.rotations import log3
from softdyn.tasks.targets import References, StackedReference, Target, exp3, read_paths
from softdyn.tasks.task import Task


def marks_of(tasks: Sequence[Task]) -> tuple[TaskMark, ...]:
    """The marks of the tasks of links' frames; other tasks have none."""
    found = []
    for task, kind in _marked(tasks):
        x, y, z = getattr(task, "axis", task.point)
        found.append(TaskMark(task.name, task.link, kind, (float(x), float(y), float(z))))
    return tuple(found)


def _marked(tasks: Sequence[Task]) -> list[tuple[FrameTask, TaskKind]]:
    """The tasks that have marks, with their kinds."""
    framed = [task for task in tasks if isinstance(task, FrameTask)]
    return [(task, task.stated) for task in framed if task.stated is not None]


def target_row(tasks: Sequence[Task], reference: Any) -> np.ndarray:
    """The numbers of the targets of all tasks that have marks, one after the other.

    Raises
    ------
    InputError
        If a target is missing.
    """
    found = [numbers(task.target_in(reference).y) for task, _ in _marked(tasks)]
    return np.concatenate(found) if found else np.zeros(0)


def numbers(y: np.ndarray) -> np.ndarray:
    """A `Target`'s value as numbers: a rotation (3, 3) as a vector, a pose (4, 4) as six."""
    if y.shape == (3,):
        return y
    turn = log3(y[:3, :3])
    return turn if y.shape == (3, 3) else np.concatenate((y[:3, 3], turn))


def numbers_at(mark: TaskMark, pose: np.ndarray) -> np.ndarray:
    """The numbers of a target that the link's pose (4, 4) fulfils."""
    if mark.kind is TaskKind.AXIS:
        return unit("vector", pose[:3, :3] @ mark.vector)
    frame = pose.copy()
    frame[:3, 3] += pose[:3, :3] @ mark.vector
    if mark.kind is TaskKind.POSITION:
        return frame[:3, 3]
    return numbers(frame if mark.kind is TaskKind.POSE else frame[:3, :3])


def recorded_targets(path: str | Path, tasks: Sequence[Task]) -> References:
    """`read_paths` for given tasks: each path is of a task, and of its kind.

    Raises
    ------
    InputError
        It names the file, and the task. A task without a path must have an own target.
    """
    file, paths = str(path), read_paths(path)
    names = [task.name for task in tasks]
    for name in paths:
        if name not in names:
            expected = f"one of the tasks {', '.join(names)}"
            raise InputError(f"{file}: {name}", expected, did_you_mean(name, names))
    for mark in marks_of(tasks):
        if mark.name not in paths:
            continue
        kind = _kind_of(paths[mark.name](0.0))
        if kind is not mark.kind:
            raise InputError(
                f"{file}: {mark.name}", f"columns {', '.join(mark.columns)}", kind.value
            )
    for task in tasks:
        if task.name not in paths and task.target is None:
            expected = f"columns of task {task.name!r}"
            raise InputError(file, expected, f"those of {', '.join(paths)}")
    first = min(float(path.times[0]) for path in paths.values())
    if first < 0:
        raise InputError(f"{file}: t", "times from 0 on", f"{first:g} s")
    with errors_in(file):
        found = References(paths)
    keep_making(found, recorded_targets, (Path(path), tasks), {})
    return found


def _kind_of(target: Any) -> TaskKind:
    shapes = {(3, 3): TaskKind.ORIENTATION, (4, 4): TaskKind.POSE}
    plain = TaskKind.POSITION if isinstance(target, Reference) else TaskKind.AXIS
    return shapes.get(target.y.shape, plain)


def target_of(mark: TaskMark, values: np.ndarray) -> SetPoint | Target:
    """The target of a task from its numbers.

    Raises
    ------
    InputError
        For a direction that is zero.
    """
    if mark.kind is TaskKind.POSITION:
        return SetPoint(values)
    if mark.kind is TaskKind.AXIS:
        return Target(unit(f"target of {mark.name!r}", values))
    turn = exp3(values[-3:])
    if mark.kind is TaskKind.ORIENTATION:
        return Target(turn)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, values[:3]
    return Target(pose)


def stacked(marks: Sequence[TaskMark], row: np.ndarray) -> StackedReference:
    """The targets of all marks from one row of numbers, the inverse of `target_row`.

    Raises
    ------
    InputError
        If no target has a position, or a direction is zero.
    """
    found, at = {}, 0
    for mark in marks:
        end = at + len(mark.columns)
        found[mark.name], at = target_of(mark, row[at:end]), end
    return StackedReference(found)
