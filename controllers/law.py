"""The base of the paper's six controllers: gains, the tasks' error, the guard of the input."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar, Protocol

import numpy as np

from softdyn import Reference, SetPoint, SoftModel, State
from softdyn.controllers.controller import Command, GuardedController, InputGuard, warm_up
from softdyn.controllers.gains import Gains, resolve
from softdyn.controllers.qps.qp import DenseQp
from softdyn.controllers.qps.stacked_error import StackedError, TaskRows, task_error
from softdyn.tasks.task import Task


class InputRule(Protocol):
    """Computes a controller's input from its tasks' error: by a QP, or in closed form."""

    @property
    def solvers(self) -> tuple[DenseQp, ...]:
        """The QPs that it solves; none for a controller in closed form."""
        ...

    def command(self, state: State, tip: TaskRows, guard: InputGuard) -> Command:
        """The input at this state, as a command of `guard`."""
        ...

    def reset(self) -> None:
        """Delete the memory of earlier calls."""
        ...


class NamedLaw(GuardedController):
    """A controller of the package: with a line in `registry`, commands, tables and figures know it.

    Attributes
    ----------
    horizon : float
        The horizon (s) of its dynamics; 0 without one.
    name : str
        Its name on the command line and in logs.
    label : str
        Its name in tables and figures; empty where that is `name`.
    order : int or None
        Its place among the rows of the benchmark; None where `softdyn benchmark` leaves it out.
    options : tuple of str
        Names of further parameters of the class; a table of parameters may hold them too.
    parameter_class : type or None
        The class of its second argument, whose fields are the keys of a table of parameters.
    needs_gains : bool
        Whether a robot without published gains needs some from the user.
    takes_barriers : bool
        Whether the class has an argument `barriers`; any other gets a `SafetyFilter`.
    factory : callable or None
        Makes one from the class's arguments, where that is not the class.
    """

    horizon: float = 0.0
    name = ""
    label = ""
    order: int | None = None
    options: tuple[str, ...] = ()
    parameter_class: type | None = None
    needs_gains = False
    takes_barriers = False
    factory: ClassVar[Callable[..., Any] | None] = None


class TaskLaw(NamedLaw):
    """A controller of the paper: a rule for the input, behind a guard.

    A class of this kind has a `name`, and makes its rule in `_make_rule`. Its other
    attributes are those of `NamedLaw`.

    Parameters
    ----------
    model : SoftModel
        The robot.
    gains : Gains, optional
        By default the paper's, for a bundled robot; required for any other.
    tasks : sequence of softdyn.tasks.Task, optional
        What to control; by default the position of the tip.

    Attributes
    ----------
    published : mapping
        Its published gains, by the name of the bundled robot.
    gains : Gains
        The controller's parameters.
    error : TaskRows
        The tasks' error at the last call.
    solvers : tuple of DenseQp
        The solvers of the rule, so that a caller can time them.

    Raises
    ------
    InputError
        If there are no gains for this robot, or the robot has no inputs.
    """

    needs_gains = True
    parameter_class = Gains
    published: Mapping[str, Gains] = MappingProxyType({})

    def __init__(
        self,
        model: SoftModel,
        gains: Gains | None = None,
        *,
        tasks: Sequence[Task] | None = None,
    ) -> None:
        self.gains = resolve(model, self.published, gains)
        self.guard = InputGuard(model.u_min, model.u_max, model.robot)
        self.error = error = task_error(model, self.gains, tasks)
        self._rule = self._make_rule(model, self.gains, error)
        self.solvers = self._rule.solvers
        if isinstance(error, StackedError):
            self.tasks = error.tasks  # they have no targets yet
            self._rule.command(model.state(model.q0, np.zeros(model.nv)), error, self.guard)
            self.reset(0.0)
        else:
            warm_up(self, model)

    @abstractmethod
    def _make_rule(self, model: SoftModel, gains: Gains, error: TaskRows) -> InputRule:
        """The rule of this controller."""

    def reset(self, period: float) -> None:
        """Begin a run; these controllers do not use the control period (s)."""
        self.guard.reset()
        self._rule.reset()

    def _command(self, state: State, reference: Reference | SetPoint) -> Command:
        error = self.error
        error.update(state, reference)
        return self._rule.command(state, error, self.guard)
