"""Errors of several tasks of links' frames in one kernel.

One call costs about as much as the evaluation of a single task, because at these sizes Python and
the calls of kernels cost more than the arithmetic.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from softdyn.compiled import compiled
from softdyn.dynamics.model import State
from softdyn.exceptions import InputError
from softdyn.tasks.frames import AxisTask, FrameTask, OrientationTask, PointTask, PoseTask
from softdyn.tasks.link_motion import LinkKinematics, body_rates, frame_motion
from softdyn.tasks.rotations import SERIES, axis_terms, orientation_terms, pose_terms
from softdyn.tasks.targets import StackedReference

POINT, ORIENTATION, POSE, AXIS = range(4)  # kinds of tasks, for the kernel
KINDS: dict[type, int] = {
    PointTask: POINT, OrientationTask: ORIENTATION, PoseTask: POSE, AxisTask: AXIS,
}  # fmt: skip


class FrameStack:
    """Fills the rows of frame tasks, those of their own `evaluate` but for rounding.

    Parameters
    ----------
    tasks : sequence of FrameTask
        Tasks of the classes in `KINDS`, none of a user's own.
    parts : sequence of slice
        The rows of each task in the arrays to be filled.

    Raises
    ------
    InputError
        For an axis that a task does not have.
    """

    def __init__(self, tasks: Sequence[FrameTask], parts: Sequence[slice]) -> None:
        count = len(tasks)
        self._tasks, self._parts = tuple(tasks), tuple(parts)
        rows: list[tuple[int, int, int]] = []
        for k, (task, part) in enumerate(zip(tasks, parts, strict=True)):
            own = task.axes or range(part.stop - part.start)
            if max(own) >= (size := type(task).size or 0):
                raise InputError(f"{task.name}: axes", f"below {size}", max(own))
            rows += [(k, row, part.start + i) for i, row in enumerate(own)]
        self._rows = np.array(rows)
        # the targets: poses and rotations, and before their rates points and directions
        self._poses, self._motions = np.zeros((count, 4, 4)), np.zeros((count, 3, 6))
        self._goals = self._poses.view(), self._motions.view()
        for goal in self._goals:  # kernels are compiled for read-only arrays, like a target's
            goal.flags.writeable = False
        self._held: list[tuple[str, Any]] = [(task.name, self) for task in self._tasks]
        self._kinematics: LinkKinematics | None = None
        self._places: Any = ()

    def __reduce__(self) -> tuple[Any, ...]:
        return FrameStack, (self._tasks, self._parts)

    def fill(self, state: State, reference: Any, values: np.ndarray, jacobian: np.ndarray) -> None:
        """Write error, rate and drift of all tasks into `values` (3, r), and J (r, n).

        Raises
        ------
        InputError
            Whatever a task raises.
        """
        kinematics = LinkKinematics.of(state.model)
        if kinematics is not self._kinematics:
            self._find(kinematics)
        targets = reference.targets if isinstance(reference, StackedReference) else {}
        for name, held in self._held:
            if targets.get(name) is not held:
                self._take(targets, reference)
                break
        S = kinematics.S
        into = jacobian if S is None else np.empty((len(jacobian), len(S)))
        arguments: Any = (
            *kinematics.engine(state), *self._places, *self._goals, kinematics.base(state), SERIES,
            values, into,
        )  # fmt: skip
        _fill(*arguments)
        if S is not None:
            rows = self._rows[:, 2]
            jacobian[rows] = into[rows] @ S

    def _find(self, kinematics: LinkKinematics) -> None:
        """Collect the places of the frames in a model's bodies."""
        found = [kinematics.place(task.link, task.point) for task in self._tasks]
        own = np.zeros((len(found), 5, 3))
        for k, (task, place) in enumerate(zip(self._tasks, found, strict=True)):
            own[k, :3], own[k, 3] = place.rotation, place.offset
            own[k, 4] = task.axis if isinstance(task, AxisTask) else 0.0
        kinds = [KINDS[type(task)] for task in self._tasks]
        self._places = (
            kinematics.columns, *np.zeros((2, kinematics.count, 6)), self._rows,
            np.column_stack((kinds, [place.body for place in found])),
            np.array([place.moves for place in found]), own,
        )  # fmt: skip
        self._kinematics = kinematics

    def _take(self, targets: Mapping[str, Any], reference: Any) -> None:
        """Check and copy the targets."""
        held = []
        for k, task in enumerate(self._tasks):
            target = task.target_in(reference)
            task.check(target)
            goal, y = self._motions[k], target.y
            if y.ndim == 1:
                goal[0, :3] = y
            else:
                self._poses[k, : len(y), : len(y)] = y
            goal[1, : len(target.ydot)], goal[2, : len(target.yddot)] = target.ydot, target.yddot
            held.append((task.name, targets.get(task.name, self if task.takes_plain else None)))
        self._held = held


@compiled
def _fill(
    S, rotations, translations, v, tree, twists, accelerations, rows, codes, moves, own,
    poses, motions, base, series, values, jacobian,
):  # fmt: skip
    n = len(S)
    rotation, position, six = np.empty((3, 3)), np.empty(3), np.empty((6, n))
    rates, found, own_rows = np.empty((2, 6)), np.empty((3, 6)), np.empty((6, n))
    a, x = np.empty(3), 0
    body_rates(S, tree, v, twists, accelerations)
    for k in range(len(codes)):
        kind = codes[k, 0]
        frame_motion(
            S, rotations, translations, twists, accelerations, codes[k, 1], moves[k],
            own[k, :3], own[k, 3], rotation, position, six, rates,
        )  # fmt: skip
        goal = motions[k]
        if kind == POINT:
            for i in range(3):
                position[i] += base[i]
                found[0, i] = position[i] - goal[0, i]
                found[1, i] = rates[0, i] - goal[1, i]
                found[2, i] = rates[1, i] - goal[2, i]
        elif kind == ORIENTATION:
            orientation_terms(
                rotation, six[3:], rates[0, 3:], rates[1, 3:], poses[k, :3, :3], goal[1, :3],
                goal[2, :3], series, found[0, :3], found[1, :3], own_rows[:3], found[2, :3],
            )  # fmt: skip
        elif kind == POSE:
            for i in range(3):
                position[i] += base[i]
            pose_terms(
                rotation, position, six, rates[0], rates[1], poses[k], goal[1], goal[2], series,
                found[0], found[1], own_rows, found[2],
            )  # fmt: skip
        else:
            for i in range(3):
                a[i] = 0.0
                for j in range(3):
                    a[i] += rotation[i, j] * own[k, 4, j]
            axis_terms(
                a, six[3:], rates[0, 3:], rates[1, 3:], goal[0, :3], goal[1, :3], goal[2, :3],
                found[0, :3], found[1, :3], own_rows[:3], found[2, :3],
            )  # fmt: skip
        source = six if kind == POINT else own_rows
        while x < len(rows) and rows[x, 0] == k:
            i, j = rows[x, 1], rows[x, 2]
            for part in range(3):
                values[part, j] = found[part, i]
            for column in range(n):
                jacobian[j, column] = source[i, column]
            x += 1
