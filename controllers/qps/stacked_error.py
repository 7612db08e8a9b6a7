"""The errors of several tasks as one, for controllers that are written for the tip's.

The rows of task i are scaled by the root of its weight, so that one Lyapunov function
V = Σ w_i η_iᵀ P_ε η_i and one cost Σ w_i ‖μ_i - μ_i,ref‖² stand over all of them; see
`docs/derivations.md`, section 11. Rows of one level follow each other, higher priorities first.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from softdyn import InputError, Reference, SetPoint, SoftModel, State
from softdyn.checks import instances
from softdyn.controllers.controller import SILENT
from softdyn.controllers.gains import Gains
from softdyn.controllers.qps.clf import make_clf
from softdyn.controllers.qps.tip_error import TipError
from softdyn.tasks.frames import FrameStack, PointTask, frame_error
from softdyn.tasks.task import Task, TaskError


class TaskRows(Protocol):
    """The error that a controller regulates: `TipError`, or `StackedError` of several tasks.

    Attributes
    ----------
    rows : int
        Their number r.
    mu_ref, yddot, row : ndarray, (r,)
        μ_ref, ÿ_ref and the row of the decrease condition.
    bound : ndarray, (levels,)
        The bound of this condition, for each level of priority.
    V : float
        Value of the Lyapunov function.
    J, Jdot, ydot : ndarray, (r, n), (r, n), (r,)
        Those in μ = J q̈ + J̇ q̇ - ÿ_ref, and J q̇.
    """

    rows: int
    mu_ref: np.ndarray
    yddot: np.ndarray
    row: np.ndarray
    bound: np.ndarray
    V: float
    J: np.ndarray
    Jdot: np.ndarray
    ydot: np.ndarray

    def update(self, state: State, reference: Reference | SetPoint) -> None:
        """The error of `state` against `reference`."""
        ...


class StackedError:
    """Errors of several tasks, scaled and stacked; updated at every step.

    `Jdot` is zero, and `yddot` is -(J̇ q̇ - ÿ_ref), because a task knows only the sum.

    Parameters
    ----------
    model : SoftModel
        The robot.
    gains : Gains
        Their K_p is that of tasks without an own one; ε is common to all.
    tasks : sequence of Task
        The tasks.

    Attributes
    ----------
    tasks : tuple of Task
        The tasks, higher priorities first.
    parts : tuple of slice
        The rows of each task.
    levels : tuple of slice
        The rows of each level.
    roots : ndarray, (r,)
        Roots of the weights.

    Raises
    ------
    InputError
        For an empty list, anything but tasks, or two tasks of one name.
    """

    def __init__(self, model: SoftModel, gains: Gains, tasks: Sequence[Task]) -> None:
        self.tasks = tuple(sorted(tasks, key=lambda task: task.level))  # stable
        sizes = [rows_of(task, model) for task in self.tasks]
        ends = np.cumsum([0, *sizes])
        self.parts = tuple(slice(a, b) for a, b in pairwise(ends))
        r, n = int(ends[-1]), model.nv
        order = sorted({task.level for task in self.tasks})
        levels = np.repeat([order.index(task.level) for task in self.tasks], sizes)
        starts = np.searchsorted(levels, np.arange(len(order) + 1))
        self.levels = tuple(slice(a, b) for a, b in pairwise(starts))
        self.rows = r
        self._levels = levels
        both = list(zip(self.tasks, self.parts, strict=True))
        framed: list[Any] = [each for each in both if type(each[0]).evaluate is frame_error]
        rows = [
            (k, row, part.start + i)
            for k, (task, part) in enumerate(framed)
            for i, row in enumerate(task.axes or range(part.stop - part.start))
        ]
        self._framed = FrameStack([task for task, _ in framed], rows) if framed else None
        self._others = [each for each in both if each not in framed]
        weights = [
            np.broadcast_to(task.weight, size) for task, size in zip(self.tasks, sizes, strict=True)
        ]
        self.roots = np.sqrt(np.concatenate(weights))
        Kp = [gains.Kp if task.Kp is None else task.Kp for task in self.tasks]
        self._Kp = np.repeat(np.array(Kp, float), sizes)
        clf = make_clf(gains.eps)
        P = clf.P_eps[::3, ::3]
        self._numbers = float(clf.eps), float(P[0, 0]), float(P[0, 1]), float(P[1, 1])
        self._found = np.zeros((3, r)), np.zeros((r, n))
        self._filled = np.zeros((4, r)), np.zeros((r, n)), np.zeros(len(order))
        self.V = 0.0
        self._expose()

    def _expose(self) -> None:
        vectors, J, self.bound = self._filled
        # kernels are compiled for read-only matrices, like a State's
        self.J, self.Jdot = J.view(), np.zeros_like(J)
        self.J.flags.writeable = self.Jdot.flags.writeable = False
        self.mu_ref, self.yddot, self.row, self.ydot = vectors

    def __getstate__(self) -> dict[str, Any]:
        views = ("J", "Jdot", "mu_ref", "yddot", "row", "ydot", "bound")
        return {name: value for name, value in vars(self).items() if name not in views}

    def __setstate__(self, values: dict[str, Any]) -> None:
        vars(self).update(values)
        self._expose()

    def update(self, state: State, reference: Reference | SetPoint) -> None:
        """The tasks' errors at `state`, against their parts of `reference`.

        Raises
        ------
        InputError
            Whatever a task raises, or for a task's result of another shape.
        """
        values, jacobian = self._found
        if self._framed is not None:
            self._framed.take_from(reference)
            self._framed.fill(state, values, jacobian)
        for task, part in self._others:
            found = evaluated(task, part.stop - part.start, state, reference)
            values[0, part], values[1, part], jacobian[part], values[2, part] = found
        self._scale(state.v)

    @SILENT
    def _scale(self, v: np.ndarray) -> None:
        """Scale the rows; fill (μ_ref, ÿ_ref, row, J q̇), J, the levels' bounds and V."""
        (found, jacobian), (vectors, J, bounds) = self._found, self._filled
        eps, P, Q, R = self._numbers
        e, edot, drift = self.roots * found
        np.multiply(self.roots[:, None], jacobian, out=J)
        vectors[0] = -2 * np.sqrt(self._Kp) * edot - self._Kp * e
        vectors[1] = -drift
        half = Q * e + R * edot
        vectors[2] = 2 * half
        vectors[3] = J @ v
        pull = P * e + Q * edot
        V = e * pull + edot * half
        bounds[:] = -np.bincount(self._levels, V / eps + 2 * pull * edot, len(bounds))
        self.V = float(V.sum())


def several_levels(error: TaskRows) -> bool:
    """Whether the tasks have more than one level."""
    return isinstance(error, StackedError) and len(error.levels) > 1


def evaluated(task: Task, size: int, state: State, reference: Reference | SetPoint) -> TaskError:
    """The error of a task, which must have `size` rows.

    Raises
    ------
    InputError
        Whatever the task raises, or for a result of another shape.
    """
    found = task(state, reference)
    # np.shape costs half a microsecond, and almost all are arrays
    shapes = [getattr(each, "shape", None) or np.shape(each) for each in found]
    if shapes != [(size,), (size,), (size, len(state.v)), (size,)]:
        expected = f"an error of {size} rows, its rate, Jacobian and drift"
        raise InputError(f"task {task.name!r}", expected, shapes)
    return found


def rows_of(task: Task, model: SoftModel) -> int:
    """The number of rows of a task's error."""
    size = model.nv if task.size is None else task.size
    return size if task.axes is None else len(task.axes)


def task_error(
    model: SoftModel, gains: Gains, tasks: Sequence[Task] | None
) -> TipError | StackedError:
    """The error of the tasks; that of the tip for None, or for its position as the only task.

    Raises
    ------
    InputError
        For an empty list, anything but tasks, or two tasks of one name.
    """
    found, tip = checked_tasks(model, tasks)
    if not tip:
        return StackedError(model, gains, found)
    return TipError(gains, found[0].name if found else "")


def checked_tasks(model: SoftModel, tasks: Sequence[Task] | None) -> tuple[tuple[Task, ...], bool]:
    """The tasks, none for None, and whether they are no more than the position of the tip.

    Raises
    ------
    InputError
        For an empty list, anything but tasks, or two tasks of one name.
    """
    if tasks is None:
        return (), True
    kind: Any = Task  # mypy wants a concrete class
    found: tuple[Task, ...] = instances("tasks", tasks, kind, "a softdyn.tasks.Task")
    names = [task.name for task in found]
    repeated = [name for name in names if names.count(name) > 1]
    if not found or repeated:
        got = f"{repeated[0]!r} twice" if repeated else "none"
        raise InputError("tasks", "a task or more, each with its own name", got)
    only = found[0]
    plain = isinstance(only, PointTask) and only.plain and only.link == model.robot.task
    return found, plain and len(found) == 1
