"""The base of the paper's six controllers: gains, the tasks' error, the guard of the input."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Protocol

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


class TaskLaw(GuardedController):
    """A controller of the paper: a rule for the input, behind a guard.

    A class of this kind has a `name`, and makes its rule in `_make_rule`.

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
    name : str
        Its name on the command line and in tables.
    options : tuple of str
        Names of further parameters of the class; a table of gains may hold them too.
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

    name = ""
    options: tuple[str, ...] = ()

    def __init__(
        self,
        model: SoftModel,
        gains: Gains | None = None,
        *,
        tasks: Sequence[Task] | None = None,
    ) -> None:
        self.gains = resolve(model, self.name, gains)
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
