"""The controller contract: a callable (State, Reference) → Command, and the guard of its input."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import Enum
from threading import RLock
from typing import Any, Protocol

import numpy as np

from softdyn import ForceError, InputError, Reference, SetPoint, SoftModel, State
from softdyn.checks import array
from softdyn.compiled import COMPILES, compiled
from softdyn.controllers.channels import LogChannel, channels_of
from softdyn.controllers.failed_problem import FailedProblem
from softdyn.copies import KeepsMaking, Separate
from softdyn.description.robot import Robot
from softdyn.dynamics.model import check_model
from softdyn.tasks.task import Task

SILENT = np.errstate(all="ignore")  # a decorator: overflow gives no warning


class Status(Enum):
    """The origin of a command."""

    OK = "ok"
    NOT_SOLVED = "not solved"
    NON_FINITE = "non-finite"


OK = Status.OK


class TaskCondition(Enum):
    """How far a command meets a task; the rank rule and a residual decide."""

    MET = "met"
    TRADED = "traded"  # against tasks of its level, or against the regulariser of the last one
    REDUNDANT = "redundant"  # other tasks determine rows of it, and agree with it
    CONFLICTING = "conflicting"  # other tasks determine rows of it, and disagree
    UNREACHABLE = "unreachable"  # by inputs within their bounds


@dataclass(frozen=True, slots=True)
class TaskReport:
    """The effect of a command on one of several tasks.

    Attributes
    ----------
    name, level : str, int
        The task.
    condition : TaskCondition
        How far the command meets it.
    independent : int
        Number of its rows that neither higher levels nor earlier tasks of its own determine.
    shortfall : float
        ‖μ - μ_ref‖ of its rows (m/s² or rad/s²), in the accelerations that the controller assumes.
    """

    name: str
    level: int
    condition: TaskCondition
    independent: int
    shortfall: float


@dataclass(frozen=True, slots=True)
class Command:
    """The output of a controller.

    Attributes
    ----------
    u : ndarray, (nu,)
        The input, held until the next command.
    V : float
        Value of the Lyapunov function, if the controller has one.
    delta : float
        Slack δ of its decrease condition.
    status : Status
        If it is not `Status.OK`, `u` is a fallback.
    distance : float
        From the reference to the tip of the equilibrium that the controller goes to (m), if the
        controller has one. It is large for a set point out of reach.
    tasks : tuple of TaskReport
        For tasks in several levels, a report of each.
    values : mapping of str to float, array_like or str, or None
        Values of the channels that the controller declares (`Controller`), by their names.
    """

    u: np.ndarray
    V: float = float("nan")
    delta: float = float("nan")
    status: Status = Status.OK
    distance: float = float("nan")
    tasks: tuple[TaskReport, ...] = ()
    values: Mapping[str, Any] | None = None


@dataclass(frozen=True, eq=False)
class KnownRig:
    """The second argument of a controller's `reset`: the rig of the plant that it will drive.

    Attributes
    ----------
    lag : float
        Longest time constant (s) of the actuators.
    delay : float
        Time (s) from a state to the begin of the command that answers it: the actuators' longest
        delay, and the lateness of the states that the controller sees.
    friction : ndarray, (tendons,), optional
        Coefficients of the cables' friction; None where no cable rubs.
    """

    lag: float = 0.0
    delay: float = 0.0
    friction: np.ndarray | None = None


IDEAL = KnownRig()


class Controller(Protocol):
    """A controller; each run builds one instance.

    It may keep a warm start and counters, but never the robot's state. It may also have
    ``reset(period)``, which `validation.simulate` calls once before a run with the control period
    (s). It sets there everything that depends on the period or on an earlier run. A second
    parameter of `reset` with the name ``rig`` gets the rig of the plant, a
    `KnownRig`, or None where that is the file's. A `SafetyFilter`
    that changes its input calls its ``applied(u)``, if it has one, with the input that acts.

    It may declare ``channels``, a tuple of `LogChannel`, with quantities of its own. Its commands
    have their `values`, and the log, its files, its figures and its replay page show them.

    A call never waits for a search. A controller that searches for something has
    ``prepare(reference)``, which may wait, once, before a loop; and an attribute ``waits``, which
    `validation.simulate` sets to True for its calls, so that two runs are equal.
    """

    def __call__(self, state: State, reference: Reference | SetPoint) -> Command:
        """The input for this control period."""
        ...


class GuardedController(KeepsMaking, Separate, ABC):
    """A controller whose arguments and input are checked by its guard.

    The call refuses a State of another robot and anything but a Reference, because compiled kernels
    would read and write beyond their arrays. It runs without NumPy warnings, and a `LinAlgError`
    leads to the guard's fallback.

    Attributes
    ----------
    guard : InputGuard
        It knows the robot, counts, and makes the commands. Controllers that take turns may share
        it.
    tasks : tuple of softdyn.tasks.Task
        Its tasks; empty for the tip alone.
    """

    guard: InputGuard
    tasks: tuple[Task, ...] = ()

    def __call__(self, state: State, reference: Reference | SetPoint) -> Command:
        """The input at this state; see `Command`."""
        guard = self.guard
        if not (
            isinstance(state, State) and guard.knows(state) and isinstance(reference, Reference)
        ):
            raise no_arguments(state, reference, guard)
        with guard.lock:
            try:
                command = self._command(state, reference)
            except (np.linalg.LinAlgError, ForceError):  # a force of a user's own has failed
                command = guard.fall_back(Status.NON_FINITE, np.nan, np.nan)
            if command.status is not OK:
                guard.complete(state, reference)
            return command

    if not COMPILES:  # compiled kernels give no warnings
        __call__ = SILENT(__call__)

    @property
    def failed_problem(self) -> FailedProblem | None:
        """The QP of the last fallback with its state and reference; None since `reset` without."""
        return self.guard.failed

    def prepare(self, reference: Reference | Callable[[float], Reference]) -> None:
        """Do before a loop what may take long for a reference; most controllers have no such work.

        Parameters
        ----------
        reference : Reference or Callable[[float], Reference]
            The loop's reference, or its function of time (s).
        """
        first_of(reference)

    @abstractmethod
    def _command(self, state: State, reference: Reference | SetPoint) -> Command:
        """The controller's own computation; if it uses NumPy's arithmetic, decorate it `SILENT`."""


class WrappingController(GuardedController):
    """A controller that changes the input of another one, maybe a user's own.

    Parameters
    ----------
    controller : Callable[[State, Reference], Command]
        The other controller.
    model : SoftModel
        The robot.
    name : str
        The name; ``{}`` stands for the other one's.

    Attributes
    ----------
    inner : Callable[[State, Reference], Command]
        The other controller.

    Raises
    ------
    InputError
        A controller that cannot be called.
    """

    def __init__(self, controller: Callable[..., Any], model: SoftModel, name: str) -> None:
        if not callable(controller) or isinstance(controller, type):
            raise InputError("controller", "a callable (state, reference) -> command", controller)
        self.guard = InputGuard(check_model(model).u_min, model.u_max, model.robot)
        self.inner, self.tasks = controller, getattr(controller, "tasks", ())
        self.name = name.format(getattr(controller, "name", type(controller).__name__))
        self._admit = guard_of(controller, model).admit

    @property
    def failed_problem(self) -> FailedProblem | None:
        """The other controller's, if it keeps one, else its own."""
        return getattr(self.inner, "failed_problem", None) or self.guard.failed

    @property
    def gains(self) -> Any:
        """The other controller's gains or parameters."""
        return getattr(self.inner, "gains", getattr(self.inner, "parameters", None))

    @property
    def channels(self) -> tuple[LogChannel, ...]:
        """The other controller's channels."""
        return channels_of(self.inner)

    @property
    def waits(self) -> bool:
        """Whether the other one's calls may wait for its searches."""
        return bool(getattr(self.inner, "waits", False))

    @waits.setter
    def waits(self, value: bool) -> None:
        if hasattr(self.inner, "waits"):
            self.inner.waits = value

    def prepare(self, reference: Reference | Callable[[float], Reference]) -> None:
        """Let the other one prepare for a reference."""
        super().prepare(reference)
        if hasattr(self.inner, "prepare"):
            self.inner.prepare(reference)

    def reset(self, period: float, rig: KnownRig | None = None) -> None:
        """Begin a run with a control period (s), on a plant behind a rig; by default the file's."""
        self.guard.reset()
        reset_controller(self.inner, period, rig)


def reset_controller(controller: Any, period: float, rig: KnownRig | None = None) -> None:
    """Let a controller, maybe a user's own, begin a run, if it has a method `reset`.

    Parameters
    ----------
    controller : Any
        The controller.
    period : float
        The control period (s).
    rig : KnownRig, optional
        The rig of the plant, for a `reset` with a parameter of this name; None is the file's.
    """
    reset = getattr(controller, "reset", None)
    if reset is None:
        return
    try:
        knows = "rig" in inspect.signature(reset).parameters
    except (TypeError, ValueError):  # of a compiled function
        knows = False
    if knows:
        reset(period, rig=rig)
    else:
        reset(period)


@contextmanager
def waiting(controller: Any) -> Iterator[None]:
    """Let calls of a controller, maybe a user's own, wait for its searches inside the block."""
    before = getattr(controller, "waits", None)
    if before is None:
        yield
        return
    controller.waits = True
    try:
        yield
    finally:
        controller.waits = before


def first_of(reference: Reference | Callable[[float], Reference]) -> Reference:
    """A reference, or what a function of time gives for 0.

    Raises
    ------
    InputError
        For anything else.
    """
    if callable(reference) and not isinstance(reference, Reference):
        reference = reference(0.0)
    if not isinstance(reference, Reference):
        raise InputError("reference", "a Reference, e.g. SetPoint(y)", repr(reference))
    return reference


def no_arguments(state: Any, reference: Any, guard: InputGuard) -> InputError:
    """The error to raise about arguments that this guard's controller refuses."""
    if not isinstance(state, State):
        return InputError("state", "a State, from model.state(q, v)", repr(state))
    if not guard.knows(state):
        own = f"a State of the controller's own robot, with {guard.nu} inputs"
        robot = state.model.robot
        got = f"one of {robot.name!r} with {state.model.nu} inputs"
        return InputError("state", own, f"{got}, of {robot.path}")
    return InputError("reference", "a Reference, e.g. SetPoint(y)", repr(reference))


class InputGuard(Separate):
    """Checks and clips inputs: its commands are always finite and within the bounds.

    `robot` is the controller's own; States of another one are refused. The fallback holds the last
    good input or, before there is one, the input nearest to 0.

    Attributes
    ----------
    not_solved : int
        Number of answers whose recomputed residual was too large.
    fallbacks : int
        Number of commands that held the last good input instead.
    max_bound_violation : float
        Largest violation of the bounds by an accepted answer, before clipping.
    held : ndarray, (nu,)
        The last good input, read-only.
    values : mapping of str to Any, or None
        Values of the controller's channels in the commands that it makes.
    failed : FailedProblem or None
        What the last fallback could not solve; None since `reset` without one.
    lock : RLock
        A call of the controller holds it, and `softdyn.validation.simulate` holds it for a whole
        run, so that threads that share a controller take turns.
    """

    def __init__(self, u_min: np.ndarray, u_max: np.ndarray, robot: Robot | None = None) -> None:
        self.u_min, self.u_max, self.nu = u_min, u_max, len(u_min)
        self._robot, self.lock = robot, RLock()
        self.reset()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "lock"}

    def __setstate__(self, values: dict[str, Any]) -> None:
        vars(self).update(values, lock=RLock())
        for values_ in (self.u_min, self.u_max, self.held):  # unpickled arrays are writable
            values_.flags.writeable = False

    def knows(self, state: State) -> bool:
        """Whether a State belongs to this robot, or to an equal copy of its description."""
        robot = state.model.robot
        if robot is self._robot:
            return True
        if self._robot is not None and robot.digest != self._robot.digest:
            return False
        return state.model.nu == self.nu

    def reset(self) -> None:
        """Reset all counts, and the last good input."""
        self.not_solved = 0
        self.fallbacks = 0
        self.max_bound_violation = 0.0
        self.failed: FailedProblem | None = None
        self.values: Mapping[str, Any] | None = None
        self.held = np.clip(np.zeros_like(self.u_min), self.u_min, self.u_max)
        self.held.flags.writeable = False

    def accept(self, u: np.ndarray, V: float, delta: float, clamped: bool = False) -> Command:
        """A command from the computed input `u` (nu,).

        A `clamped` controller saturates by design, so its violation of the bounds is not counted.
        """
        inside, violation = _clip(u, self.u_min, self.u_max)
        if not violation < np.inf:  # NaN is not
            if np.shape(u) != self.u_min.shape:
                raise InputError("u", f"shape {self.u_min.shape}", np.shape(u))
            return self.fall_back(Status.NON_FINITE, V, delta)
        if not clamped and violation > self.max_bound_violation:
            self.max_bound_violation = violation
        inside.flags.writeable = False
        self.held = inside
        return Command(inside, V, delta, OK, values=self.values)

    def admit(self, u: Any) -> np.ndarray:
        """The input (nu,) that acts if a controller, maybe a user's own, returns `u`.

        The last input of this guard passes unchanged. Any other input is checked and clipped, and
        its violation of the bounds is counted.

        Raises
        ------
        InputError
            For anything but finite numbers of shape (nu,).
        """
        if u is self.held:
            return self.held
        u = array("u", u, self.u_min.shape).copy()  # the kernel is compiled for writable arrays
        inside, violation = _clip(u, self.u_min, self.u_max)
        self.max_bound_violation = max(self.max_bound_violation, violation)
        return inside

    def fall_back(
        self,
        status: Status,
        V: float,
        delta: float,
        problem: tuple[np.ndarray, ...] | None = None,
    ) -> Command:
        """A command with the last good input; it counts as a fallback.

        `problem` is the QP (H, g, A, lower, upper) that gave none, see `FailedProblem`; it is
        copied.
        """
        self.failed = FailedProblem.of(status.value, problem)
        self.fallbacks += 1
        self.not_solved += status is Status.NOT_SOLVED
        return Command(self.held, V, delta, status, values=self.values)

    def complete(self, state: State, reference: Reference) -> None:
        """Add to the problem of the last fallback what it was made from."""
        if self.failed is not None and self.failed.state is None:
            self.failed = replace(self.failed, state=state, reference=reference)


def guard_of(controller: object, model: SoftModel) -> InputGuard:
    """The controller's own guard if it has this robot's bounds, else a new one."""
    own, bounds = getattr(controller, "guard", None), (model.u_min, model.u_max)
    if isinstance(own, InputGuard) and np.array_equal((own.u_min, own.u_max), bounds):
        return own
    return InputGuard(*bounds, model.robot)


def warm_up(law: Any, model: SoftModel, period: float = 0.0) -> None:
    """Call a controller, so that its kernels are compiled, and reset it.

    The second call has a present state besides the one that a predictive controller expected.
    """
    y = model.state(model.q0, np.zeros(model.nv)).y
    with np.errstate(all="ignore"):  # extreme gains may overflow
        for speed in (0.0, 1e-3):
            law(model.state(model.q0, np.full(model.nv, speed)), Reference(y))
    law.reset(period)


@compiled
def _clip(u, u_min, u_max):
    """Clip `u` to its bounds; return also how far it was outside.

    The distance is infinite if u is not finite or has another length than the bounds.
    """
    inside, violation = np.empty(len(u)), 0.0
    if len(u) != len(u_min):
        return inside, np.inf
    for i in range(len(u)):
        inside[i] = u_min[i] if u[i] < u_min[i] else u_max[i] if u[i] > u_max[i] else u[i]
        outside = abs(u[i] - inside[i])
        if not outside <= violation:
            violation = outside if outside == outside else np.inf
    return inside, violation
