"""A log's arrays during the run, the counts of the controller, and package versions."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np

import softdyn
from softdyn import InputError, SoftModel, State
from softdyn.checks import number
from softdyn.controllers.controller import Command, InputGuard
from softdyn.controllers.qps.stacked_error import rows_of
from softdyn.tasks.marks import marks_of, target_row
from softdyn.tasks.task import Task, errors_along
from softdyn.validation.loop.log_checks import EXTRA, GOING, SHAPES

LONGEST = 200  # characters of a status
LARGEST = 2**53  # of a count: a float represents all integers up to it


class ControllerOutput(Protocol):
    """A controller's answer to a state; V, delta and status are optional."""

    @property
    def u(self) -> Any:
        """(nu,) the input."""
        ...


@dataclass(frozen=True)
class ControlStep:
    """A control step, at the beginning of a control period.

    Attributes
    ----------
    t : float
        Time (s).
    state : State
        The state that the controller saw.
    output : ControllerOutput
        The controller's answer to it.
    u : ndarray, (nu,)
        The controller's answer, clipped to the robot's bounds. It acts at once without a rig.
    plant : State
        The plant's state, which is `state` without a rig.
    acting : ndarray, (nu,)
        The inputs that act at t, which are `u` without a rig.
    """

    t: float
    state: State
    output: ControllerOutput
    u: np.ndarray
    plant: State
    acting: np.ndarray


class Recorder:
    """Fills a log's arrays, allocated once for the planned run.

    Parameters
    ----------
    model : SoftModel
        The robot.
    t : np.ndarray, (N + 1,)
        The sampling times of N control steps (s).
    guard : InputGuard
        Checks and clips the inputs; the controller's own guard has already done so.

    Attributes
    ----------
    t, q, v, y, y_ref, error, u, V, delta, step_us, u_min, u_max : np.ndarray
        As in `Log`; NaN where no sample was recorded.
    samples : int
        The number of samples recorded.
    """

    def __init__(self, model: SoftModel, t: np.ndarray, guard: InputGuard) -> None:
        size = {"samples": len(t), "steps": len(t) - 1, "space": 3}
        size |= {"nq": model.nq, "nv": model.nv, "nu": model.nu}
        made = {
            name: np.full([size[axis] for axis in axes], np.nan) for name, axes in SHAPES.items()
        }
        self.t, self.u_min, self.u_max = t, model.u_min, model.u_max
        self.q, self.v, self.u = made["q"], made["v"], made["u"]
        self.y, self.y_ref, self.error = made["y"], made["y_ref"], made["error"]
        self.V, self.delta, self.step_us = made["V"], made["delta"], made["step_us"]
        self._guard, self._model = guard, model
        self.samples = 0
        self._statuses: list[str] = []
        self._extra: dict[str, np.ndarray] = {}  # only if the answer has it

    def sample(self, k: int, y: np.ndarray, y_ref: np.ndarray) -> float:
        """Record the tip (3,) and its reference (3,) at sample `k`; returns ‖e‖ (m)."""
        error = np.subtract(y, y_ref, out=self.error[k])
        self.y[k], self.y_ref[k] = y, y_ref
        self.samples = k + 1
        return math.hypot(*error.tolist())  # no overflow

    def output(self, k: int, answer: ControllerOutput, nanoseconds: int) -> str | None:
        """Record an answer with clipped input; return why it cannot be used, or None."""
        try:
            u = getattr(answer, "u", answer)  # the answer may be a plain array
            if isinstance(u, np.ma.MaskedArray):
                return "its u is a masked array"
            self.u[k] = self._guard.admit(u)
        except InputError as error:
            return str(error)
        self.V[k] = _scalar(getattr(answer, "V", None))
        self.delta[k] = _scalar(getattr(answer, "delta", None))
        if isinstance(answer, Command) and math.isfinite(answer.distance):
            if "distance" not in self._extra:
                self.extra(GOING)
            self.put(k, distance=np.array(answer.distance))
        status = getattr(answer, "status", "")
        self._statuses.append(str(status.value if isinstance(status, Enum) else status)[:LONGEST])
        self.step_us[k] = nanoseconds / 1e3
        return None

    def extra(self, names: Iterable[str], **sizes: int) -> None:
        """Prepare arrays of `EXTRA`; `sizes` are the lengths of their axes of their own."""
        sizes |= {"samples": len(self.t), "steps": len(self.t) - 1}
        sizes |= {"nq": self.q.shape[1], "nv": self.v.shape[1], "nu": self.u.shape[1]}
        self._extra |= {
            name: np.full([sizes[axis] for axis in EXTRA[name]], np.nan) for name in names
        }

    def put(self, k: int, **values: np.ndarray) -> None:
        """Record values at sample or step `k`, by the names of `EXTRA`."""
        for name, value in values.items():
            self._extra[name][k] = value

    def task_errors(self, steps: int, controller: object, reference: Any) -> dict[str, Any]:
        """Errors of a controller's `tasks` at the finite samples, and the targets of the tasks."""
        tasks = tasks_in(controller)
        if not tasks:
            return {}
        t, q, v = (values[: steps + 1] for values in (self.t, self.q, self.v))
        known = np.isfinite(np.hstack((q, v))).all(axis=1)
        run = SimpleNamespace(t=t[known], q=q[known], v=v[known])
        found = errors_along(self._model, tasks, run, reference)
        parts = [task.columns(rows_of(task, self._model)) for task in tasks]
        units = {name: unit for part in parts for name, (unit, _) in part.items()}
        errors = np.full((len(t), len(units)), np.nan)
        errors[known] = np.column_stack([found[name] for name in units])
        made = {"tasks": errors, "task_names": (*units,), "task_units": (*units.values(),)}
        marks = marks_of(tasks)
        if not marks:
            return made
        rows = [target_row(tasks, reference(float(time))) for time in t]
        return {**made, "targets": np.array(rows), "marks": marks}

    def arrays(self, steps: int) -> dict[str, np.ndarray]:
        """The arrays of a log of a run that did `steps` control steps."""
        ends = {"samples": steps + 1, "steps": steps}
        extra = {
            name: values[: ends[EXTRA[name][0]]].copy() for name, values in self._extra.items()
        }
        return extra | {
            name: np.array(self._statuses[:steps], str)
            if name == "status"
            else getattr(self, name)[: ends.get(axes[0])].copy()
            for name, axes in SHAPES.items()
        }


class Counts:
    """Increases of the counts of a controller or its `guard` since this object was made.

    Raises
    ------
    InputError
        A count is not a number, at the beginning or when it is read.
    """

    def __init__(self, controller: object) -> None:
        has_own = hasattr(controller, "not_solved") or hasattr(controller, "fallbacks")
        self._source = controller if has_own else getattr(controller, "guard", controller)
        self._before = {name: self._count(name) for name in ("not_solved", "fallbacks")}

    def _count(self, name: str) -> int:
        value = number(f"the controller's {name}", getattr(self._source, name, 0))
        if not value.is_integer() or abs(value) > LARGEST:
            raise InputError(f"the controller's {name}", "a whole number", repr(value))
        return int(value)

    def told(self) -> tuple[tuple[int, int, float], str | None]:
        """Both increases and the violation; or zeros, and the name of the one that is no number."""
        try:
            counts = self.since("not_solved"), self.since("fallbacks"), self.violation()
        except InputError as error:
            return (0, 0, 0.0), str(error)
        return counts, None

    def since(self, name: str) -> int:
        """Increase of ``not_solved`` or ``fallbacks``."""
        return self._count(name) - self._before[name]

    def violation(self) -> float:
        """Largest violation of the bounds that the controller itself clipped."""
        name = "max_bound_violation"
        return number(f"the controller's {name}", getattr(self._source, name, 0.0), lower=0.0)


def tasks_in(controller: object) -> tuple[Task, ...]:
    """The `tasks` of a controller; none if it has something else of that name."""
    tasks = getattr(controller, "tasks", ())
    own = isinstance(tasks, tuple) and all(isinstance(one, Task) for one in tasks)
    return tasks if own else ()


def _scalar(value: Any) -> float:
    """A diagnostic as a float; NaN when it is missing or not a number."""
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


@cache
def package_versions() -> tuple[tuple[str, str], ...]:
    """Versions of the packages that influence a run's numbers."""
    found = [("softdyn", softdyn.__version__)]
    for package in ("pin", "mujoco", "proxsuite", "numpy"):
        try:
            found.append((package, version(package)))
        except PackageNotFoundError:
            continue
    return tuple(found)
