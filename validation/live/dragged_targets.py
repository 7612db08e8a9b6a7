"""The target of the tip, or the targets of tasks, that a page drags."""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatchmethod
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SetPoint, SoftModel, State
from softdyn.tasks.marks import marks_of, numbers_at, stacked
from softdyn.tasks.task import Task
from softdyn.view.live.messages import SetTarget, SetTargets


class DraggedTargets:
    """The reference of a session, changed by messages.

    Parameters
    ----------
    model : SoftModel
        The robot.
    tasks : sequence of Task
        Tasks of links' frames; none for the position of the tip.

    Attributes
    ----------
    marks : tuple of TaskMark
        The tasks.
    row : ndarray, (numbers,)
        The numbers of their targets.
    reference : Reference
        The target of the tip, or those of all tasks.

    Raises
    ------
    InputError
        A task is of something else than a link's frame.
    """

    reference: Reference

    def __init__(self, model: SoftModel, tasks: Sequence[Task]) -> None:
        self._model, self.marks = model, marks_of(tasks)
        if len(self.marks) < len(tasks):
            raise InputError("tasks", "tasks of links' frames", repr(tasks))
        # arguments of the controllers
        self.arguments: dict[str, Any] = {"tasks": list(tasks)} if tasks else {}
        self.row = np.zeros(sum(len(mark.columns) for mark in self.marks))

    def begin(self, state: State, target: Any) -> None:
        """Targets where the robot is in a state, the first point at `target` if there is one.

        Raises
        ------
        InputError
            No task has a position.
        """
        if not self.marks:
            self.reference = SetPoint(state.y if target is None else target)
            return
        poses, rows = self._model.link_poses(state.q), []
        for mark in self.marks:
            rows.append(numbers_at(mark, poses[mark.link]).copy())
            if target is not None and mark.placed:
                rows[-1][:3], target = SetPoint(target).y, None
        self.row = np.concatenate(rows)
        self.reference = stacked(self.marks, self.row)

    @singledispatchmethod
    def move(self, message: Any) -> None:
        """Carry out a message.

        Raises
        ------
        InputError
            A message for tasks to a robot that has none, or for the tip to one that has some.
        """
        raise NotImplementedError

    @move.register
    def _(self, message: SetTarget) -> None:
        if self.marks:
            raise InputError("do", "targets, because the robot has tasks", "target")
        self.reference = SetPoint(message.y)

    @move.register
    def _(self, message: SetTargets) -> None:
        if not self.marks:
            raise InputError("do", "target, because the robot has no tasks", "targets")
        self.reference = stacked(self.marks, message.values)
        self.row = message.values
