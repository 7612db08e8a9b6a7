"""The error that the predictive controller weighs along its horizon: of the tip, or of tasks."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from softdyn import InputError, Reference, SoftModel, State
from softdyn.controllers.qps.stacked_error import checked_tasks, evaluated, rows_of
from softdyn.tasks.targets import StackedReference
from softdyn.tasks.task import Task


class ErrorAhead(NamedTuple):
    """Errors y_now - (y + t ẏ + ½ t² ÿ) at a configuration; they change with p by `rows`.

    Attributes
    ----------
    rows : ndarray, (r, n)
        Their Jacobian.
    now, y, ydot, yddot : ndarray, (r,)
        The outputs, and the motion wanted of them.
    scale : ndarray, (r,), or float
        Roots of the weights, by which all the others are multiplied.
    """

    rows: np.ndarray
    now: np.ndarray
    y: np.ndarray
    ydot: np.ndarray
    yddot: np.ndarray
    scale: np.ndarray | float = 1.0

    @property
    def far(self) -> float:
        """‖error‖ at t = 0, unweighted (m, rad)."""
        return float(np.linalg.norm((self.now - self.y) / self.scale))


class TipAim:
    """The position of the tip; in a stacked reference its target has the given name."""

    tasks: tuple[Task, ...] = ()

    def __init__(self, name: str = "") -> None:
        self._name = name

    def targets(self, reference: Reference) -> tuple[Any, ...]:
        """The only target."""
        if self._name and isinstance(reference, StackedReference):
            return (reference.targets.get(self._name, reference),)
        return (reference,)

    def __call__(self, state: State, reference: Reference, moving: bool) -> ErrorAhead:
        """The tip's error at `state`."""
        (goal,) = self.targets(reference)
        return ErrorAhead(state.J, state.y, goal.y, goal.ydot, goal.yddot)


class TasksAim:
    """Errors of several tasks, their rows scaled by the roots of the weights.

    The errors are second-order polynomials in time at a fixed configuration. A task at rest gives
    them: its rate and drift are then its target's motion alone.
    """

    def __init__(self, model: SoftModel, tasks: tuple[Task, ...]) -> None:
        self.tasks, self._sizes = tasks, [rows_of(task, model) for task in tasks]
        weights = [np.broadcast_to(t.weight, s) for t, s in zip(tasks, self._sizes, strict=True)]
        self._roots = np.sqrt(np.concatenate(weights))

    def targets(self, reference: Reference) -> tuple[Any, ...]:
        """The target of each task."""
        return tuple(task.target_in(reference) for task in self.tasks)

    def __call__(self, state: State, reference: Reference, moving: bool) -> ErrorAhead:
        """The stacked errors; targets that are not `moving` have no rates."""
        if moving:
            state = state.model.state(state.q, np.zeros_like(state.v))
        parts = [
            evaluated(task, size, state, reference)
            for task, size in zip(self.tasks, self._sizes, strict=True)
        ]
        error, rate, jacobian, drift = (np.concatenate(part) for part in zip(*parts, strict=True))
        root, none = self._roots, np.zeros_like(error)
        ydot, yddot = (-root * rate, -root * drift) if moving else (none, none)
        return ErrorAhead(root[:, None] * jacobian, root * error, none, ydot, yddot, root)


Aim = TipAim | TasksAim


def aim_of(model: SoftModel, tasks: Any) -> Aim:
    """The aim of some tasks of one level; that of the tip for None, or its position alone.

    Raises
    ------
    InputError
        As `checked_tasks`, and for several levels.
    """
    found, tip = checked_tasks(model, tasks)
    levels = sorted({task.level for task in found})
    if len(levels) > 1:
        expected = "weighted tasks of one level; the paper's QPs keep several"
        raise InputError("tasks", expected, f"levels {', '.join(map(str, levels))}")
    return TipAim(found[0].name if found else "") if tip else TasksAim(model, found)
