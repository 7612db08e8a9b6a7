"""The contract of a task: a quantity of the robot, its error against a target and two rates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from softdyn.checks import array, number, whole
from softdyn.copies import Frozen, KeepsMaking
from softdyn.dynamics.model import SoftModel, State
from softdyn.exceptions import InputError
from softdyn.references import Reference
from softdyn.tasks.targets import StackedReference, Target

PARTS = {"m": "position", "rad": "angle"}  # names of the parts of an error with two units


class TaskError(NamedTuple):
    """Error of a task at a State; ë = jacobian q̈ + drift.

    Attributes
    ----------
    error : ndarray, (r,)
        e; zero where the task is fulfilled (m, rad).
    rate : ndarray, (r,)
        ė, the target's motion included (per second).
    jacobian : ndarray, (r, n)
        ∂ė/∂q̇.
    drift : ndarray, (r,)
        J̇ q̇ and the target's accelerations.
    """

    error: np.ndarray
    rate: np.ndarray
    jacobian: np.ndarray
    drift: np.ndarray


@dataclass(frozen=True, eq=False)
class Task(KeepsMaking, Frozen, ABC):
    """A quantity to be controlled: a subclass has one method, `evaluate`, and a `size`.

    Attributes
    ----------
    size : int or None
        Number of rows that `evaluate` returns; None for as many as the robot has joints.
    name : str
        Name of its target in a `StackedReference`; each kind has a default.
    weight : float or array_like, (r,)
        Weight of the squared error, of each row or of all.
    Kp : float, optional
        Own stiffness (1/s²), by default that of the controller's gains; K_d = 2 √K_p.
    level : int
        0 is the highest priority: a level is never sacrificed for those below it.
    axes : sequence of int, optional
        The rows of the error that count, by default all.
    target : Target or Reference, optional
        The target if the controller's reference has none for this task.

    Raises
    ------
    InputError
        For a negative weight, a K_p that is not positive, or a level or axis that is no whole
        number.
    """

    _: KW_ONLY
    name: str = ""
    weight: Any = 1.0
    Kp: float | None = None
    level: int = 0
    axes: Any = None
    target: Any = None

    kind = "task"  # the name of one without
    size: ClassVar[int | None] = None
    units: ClassVar[tuple[str, ...]] = ("",)  # of the rows; the last is that of all others

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise InputError("task", "a name", repr(self.name))
        if not self.name:
            object.__setattr__(self, "name", self.kind)
        whole(f"{self.name}: level", self.level)
        if self.Kp is not None:
            number(f"{self.name}: Kp", self.Kp, above=0.0)
        if np.ndim(self.weight) == 0:
            number(f"{self.name}: weight", self.weight, above=0.0)
        else:
            weight = array(f"{self.name}: weight", self.weight, np.shape(self.weight))
            if weight.ndim != 1 or not (weight > 0).all():
                raise InputError(f"{self.name}: weight", "positive numbers", repr(self.weight))
            object.__setattr__(self, "weight", weight)
        if self.axes is not None:
            try:
                axes = tuple(whole(f"{self.name}: axes", axis) for axis in self.axes)
            except TypeError:
                raise InputError(f"{self.name}: axes", "rows such as (0, 2)", self.axes) from None
            if not axes or len(set(axes)) < len(axes):
                raise InputError(f"{self.name}: axes", "rows, each once", repr(self.axes))
            if self.size is not None and max(axes) >= self.size:
                raise InputError(f"{self.name}: axes", f"below {self.size}", max(axes))
            object.__setattr__(self, "axes", axes)
        if not (self.target is None or isinstance(self.target, Target | Reference)):
            raise InputError(f"{self.name}: target", "a Target", repr(self.target))

    @abstractmethod
    def evaluate(self, state: State, target: Any) -> TaskError:
        """The error at `state` against `target`, all rows of it.

        Raises
        ------
        InputError
            For a target of another kind, or a link or joint that the robot does not have.
        """

    def __call__(self, state: State, reference: Any) -> TaskError:
        """The selected rows of the error against this task's part of a reference."""
        found = self.evaluate(state, self.target_in(reference))
        if self.axes is None:
            return found
        rows = list(self.axes)
        if max(rows) >= len(found.error):
            raise InputError(f"{self.name}: axes", f"below {len(found.error)}", max(rows))
        return TaskError(*(np.ascontiguousarray(part[rows]) for part in found))

    def target_in(self, reference: Any) -> Any:
        """The part of a reference that has this task's name; a plain one is a point's target.

        Raises
        ------
        InputError
            If there is none, and the task has no own one.
        """
        found = None
        if isinstance(reference, StackedReference):
            found = reference.targets.get(self.name)
        elif self.takes_plain:
            found = reference
        found = self.target if found is None else found
        if found is None:
            given = list(reference.targets) if isinstance(reference, StackedReference) else []
            got = f"those of {', '.join(given)}" if given else "a plain reference"
            raise InputError("reference", f"a target of task {self.name!r}", got)
        return found

    def columns(self, rows: int) -> dict[str, tuple[str, np.ndarray]]:
        """The parts of its error of `rows` rows with units of their own: name → unit, rows."""
        axes = range(rows) if self.axes is None else self.axes
        units = np.array([self.units[min(axis, len(self.units) - 1)] for axis in axes])
        found = {unit: np.flatnonzero(units == unit) for unit in dict.fromkeys(units.tolist())}
        if len(found) == 1:
            return {self.name: next(iter(found.items()))}
        return {f"{self.name}.{PARTS[unit]}": (unit, part) for unit, part in found.items()}

    @property
    def takes_plain(self) -> bool:
        """Whether a plain `Reference` is its target: only for a point."""
        return False


def compute_errors(
    model: SoftModel, tasks: Sequence[Task], log: Any, reference: Callable[[float], Any]
) -> dict[str, np.ndarray]:
    """The error ‖e‖ (N,) of each task at every sample of a run (m, rad; unweighted), by name.

    A pose has two, NAME.position and NAME.angle.

    Parameters
    ----------
    model : SoftModel
        The robot.
    tasks : sequence of Task
        The tasks.
    log : Log, or anything with t (N,), q (N, nq) and v (N, nv)
        The run.
    reference : Callable
        Time → targets, the reference of the run.

    Raises
    ------
    InputError
        Whatever a task raises.
    """
    found: dict[str, list[float]] = {}
    for t, q, v in zip(log.t, log.q, log.v, strict=True):
        state, goal = model.state(q, v), reference(float(t))
        for task in tasks:
            error = task(state, goal).error
            for name, (_, rows) in task.columns(len(error)).items():
                found.setdefault(name, []).append(float(np.linalg.norm(error[rows])))
    return {name: np.array(values) for name, values in found.items()}


def check_target(task: Task, target: Any, what: str, shape: tuple[int, ...]) -> None:
    """Refuse a target of another kind or shape.

    Raises
    ------
    InputError
        It names the task, and says what its target must be.
    """
    y = getattr(target, "y", None)
    if not isinstance(y, np.ndarray) or y.shape != shape:
        got = repr(target) if y is None else f"shape {np.shape(y)}"
        raise InputError(f"target of {task.name!r}", f"{what}, shape {shape}", got)
