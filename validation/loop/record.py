"""A log's arrays during the run, and the counts of the controller."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np

from softdyn import InputError, SoftModel, State
from softdyn.checks import number
from softdyn.controllers.channels import LogChannel, values_of
from softdyn.controllers.controller import Command
from softdyn.controllers.qps.stacked_error import rows_of
from softdyn.description.task_mark import TaskMark
from softdyn.tasks.marks import marks_of, target_row
from softdyn.tasks.task import Task, compute_errors
from softdyn.validation.channels import every_run, goals
from softdyn.validation.loop.log import check_channel_name
from softdyn.validation.loop.log_files import SETTINGS

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
    """Fills the channels of a run, allocated once for all its periods.

    Parameters
    ----------
    model : SoftModel
        The robot.
    t : np.ndarray, (N + 1,)
        The sampling times of N control steps (s).
    more : iterable of LogChannel
        The channels besides those of every run.

    Attributes
    ----------
    t : np.ndarray, (N + 1,)
        The sampling times.
    channels : dict of str to LogChannel
        The channels by name.
    samples : int
        The number of samples recorded.
    """

    def __init__(self, model: SoftModel, t: np.ndarray, more: Iterable[LogChannel] = ()) -> None:
        self.t, self.samples, self._model = t, 0, model
        self.channels: dict[str, LogChannel] = {}
        self._arrays: dict[str, np.ndarray] = {}
        self._own: tuple[LogChannel, ...] = ()
        for channel in (*every_run(model), *more):
            self.add(channel)
        self._arrays["t"] = t

    def add(self, channel: LogChannel) -> None:
        """Record one channel more.

        Raises
        ------
        InputError
            Its name or the name of one of its columns is taken.
        """
        check_channel_name(channel.name)
        taken = {SETTINGS, *(name for one in self.channels.values() for name in one.names)}
        if both := [channel.name] * (channel.name in self.channels) + sorted(
            {*channel.names} & taken
        ):
            raise InputError(
                "channels", "channels and columns of different names", f"{both[0]} twice"
            )
        self.channels[channel.name] = channel
        self._arrays[channel.name] = channel.empty(len(self.t))

    def declare(self, channels: Iterable[LogChannel]) -> None:
        """Record a controller's own channels, whose values are in its answers.

        Raises
        ------
        InputError
            As `add` does, and for the name of a channel that logs of other controllers have.
        """
        self._own = tuple(channels)
        for channel in self._own:
            check_channel_name(channel.name, own=True)
            self.add(channel)

    def put(self, k: int, **values: Any) -> None:
        """Record values at sample or step `k`, by the channels' names.

        Raises
        ------
        InputError
            A value of no channel of the run, or of another shape, such as one of a user's plant.
        """
        for name, value in values.items():
            try:
                self._arrays[name][k] = value
            except KeyError:
                known = ", ".join(self.channels)
                raise InputError(
                    "values of a run", f"names of its channels, {known}", name
                ) from None
            except (TypeError, ValueError):
                shape = self._arrays[name].shape[1:]
                got = f"shape {np.shape(value)}" if np.shape(value) != shape else repr(value)
                raise InputError(
                    f"values of a run: {name}", f"numbers of shape {shape}", got
                ) from None

    def sample(self, k: int, y: np.ndarray, y_ref: np.ndarray) -> float:
        """Record the tip (3,) and its reference (3,) at sample `k`; returns ‖e‖ (m)."""
        error = np.subtract(y, y_ref, out=self._arrays["error"][k])
        self.put(k, y=y, y_ref=y_ref)
        self.samples = k + 1
        return math.hypot(*error.tolist())  # no overflow

    def output(self, k: int, answer: ControllerOutput, u: np.ndarray, nanoseconds: int) -> None:
        """Record an answer, its input within the bounds, and the time that it took.

        Raises
        ------
        InputError
            Values of a channel that the controller does not declare, or of another shape.
        """
        status = getattr(answer, "status", "")
        self.put(
            k, u=u, V=_scalar(getattr(answer, "V", None)),
            delta=_scalar(getattr(answer, "delta", None)), step_us=nanoseconds / 1e3,
            status=str(status.value if isinstance(status, Enum) else status)[:LONGEST],
        )  # fmt: skip
        if self._own or isinstance(answer, Command):  # `values` of others may mean anything
            for name, value in values_of(self._own, answer).items():
                self._arrays[name][k] = value[:LONGEST] if isinstance(value, str) else value
        if isinstance(answer, Command) and math.isfinite(answer.distance):
            if "distance" not in self.channels:
                self.add(LogChannel("distance", units=("m",), held=True))
            self.put(k, distance=answer.distance)

    def repeat(self, k: int, y_ref: np.ndarray) -> None:
        """Record at sample `k` what sample k - 1 has, without a step time."""
        for name, array in self._arrays.items():
            if name != "t":
                array[k] = array[k - 1]
        self.put(k, step_us=np.nan, status="left out")
        self.sample(k, self._arrays["y"][k].copy(), y_ref)

    def share(self, shared: Callable[[np.ndarray], np.ndarray]) -> None:
        """Keep all numbers in the arrays that a function returns for the present ones."""
        for name, array in self._arrays.items():
            if array.dtype != object:
                self._arrays[name] = shared(array)
        self.t = self._arrays["t"]

    def error_at(self, k: int) -> np.ndarray:
        """The error (3,) (m) of sample `k`."""
        return self._arrays["error"][k]

    def of_tasks(
        self, steps: int, controller: object, reference: Any
    ) -> tuple[list[LogChannel], tuple[TaskMark, ...]]:
        """Errors of a controller's `tasks` at the finite samples, and their targets and marks."""
        tasks = tasks_in(controller)
        if not tasks:
            return [], ()
        t, q, v = (self._arrays[name][: steps + 1] for name in ("t", "q", "v"))
        known = np.isfinite(np.hstack((q, v))).all(axis=1)
        run = SimpleNamespace(t=t[known], q=q[known], v=v[known])
        found = compute_errors(self._model, tasks, run, reference)
        parts = [task.columns(rows_of(task, self._model)) for task in tasks]
        units = {name: unit for part in parts for name, (unit, _) in part.items()}
        channel = LogChannel.of("tasks", units.items(), "task")
        errors = channel.empty(len(t))
        errors[known] = np.column_stack([found[name] for name in units])
        made, marks = [channel.filled(errors)], marks_of(tasks)
        if marks:
            rows = np.array([target_row(tasks, reference(float(time))) for time in t])
            made.append(LogChannel.of("targets", goals(marks), "goal").filled(rows))
        return made, marks

    def filled(self, steps: int) -> list[LogChannel]:
        """The channels of a run that did `steps` control steps."""
        found = []
        for name, channel in self.channels.items():
            values = self._arrays[name][: steps + (not channel.held)]
            found.append(channel.filled(values.astype(str) if channel.text else values.copy()))
        return found


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

    def totals(self) -> tuple[tuple[int, int, float], str | None]:
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
