"""The base of the paper's six controllers: gains, the tasks' error, the guard of the input."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from softdyn import Reference, SetPoint, SoftModel, State
from softdyn.controllers.controller import Command, GuardedController, InputGuard, warm_up
from softdyn.controllers.gains import Gains
from softdyn.controllers.qps.qp import DenseQp
from softdyn.controllers.qps.stacked_error import StackedError, TaskRows


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

    Parameters
    ----------
    model : SoftModel
        The robot.
    gains : Gains
        The controller's parameters.
    rule : InputRule
        Computes the input.
    error : TaskRows
        The error that it regulates.

    Attributes
    ----------
    name : str
        Its name on the command line and in tables.
    options : tuple of str
        Names of further parameters of the class; a table of gains may hold them too.
    error : TaskRows
        The tasks' error at the last call.
    solvers : tuple of DenseQp
        The solvers of the rule, so that a caller can time them.
    """

    name = ""
    options: tuple[str, ...] = ()

    def __init__(self, model: SoftModel, gains: Gains, rule: InputRule, error: TaskRows) -> None:
        self.gains, self.guard = gains, InputGuard(model.u_min, model.u_max, model.robot)
        self.solvers = rule.solvers
        self._rule, self.error = rule, error
        if isinstance(error, StackedError):
            self.tasks = error.tasks  # they have no targets yet
            rule.command(model.state(model.q0, np.zeros(model.nv)), error, self.guard)
            self.reset(0.0)
        else:
            warm_up(self, model)

    def reset(self, period: float) -> None:
        """Begin a run; these controllers do not use the control period (s)."""
        self.guard.reset()
        self._rule.reset()

    def _command(self, state: State, reference: Reference | SetPoint) -> Command:
        error = self.error
        error.update(state, reference)
        return self._rule.command(state, error, self.guard)
