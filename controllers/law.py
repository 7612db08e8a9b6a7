"""What is around each of the paper's six laws: gains, task error, the guard of its input."""

from __future__ import annotations

from typing import Protocol

from softdyn import Reference, SetPoint, SoftModel, State
from softdyn.controllers.controller import Command, GuardedController, InputGuard, warm_up
from softdyn.controllers.gains import Gains
from softdyn.controllers.qps.qp import DenseQp
from softdyn.controllers.qps.task import Task


class Programme(Protocol):
    """How a law finds its input, given the error of its task."""

    @property
    def solvers(self) -> tuple[DenseQp, ...]:
        """The QPs it solves; none for a law in closed form."""
        ...

    def command(self, state: State, task: Task, guard: InputGuard) -> Command:
        """What `guard` makes of the input at this state."""
        ...

    def reset(self) -> None:
        """Forget what earlier calls left."""
        ...


class TaskLaw(GuardedController):
    """A law of the paper: a programme on the task error, behind a guard.

    Parameters
    ----------
    model : SoftModel
        The robot.
    gains : Gains
        The law's parameters.
    programme : Programme
        Where the input comes from.

    Attributes
    ----------
    name : str
        On the command line and in tables.
    options : tuple of str
        What the class takes by name besides its gains, in a table of them as well.
    guard : InputGuard
        What was counted; laws that take turns may share one.
    solvers : tuple of DenseQp
        The QPs it solves, for their clocks.
    """

    name = ""
    options: tuple[str, ...] = ()

    def __init__(self, model: SoftModel, gains: Gains, programme: Programme) -> None:
        self.gains, self.guard = gains, InputGuard(model.u_min, model.u_max, model.robot)
        self.solvers = programme.solvers
        self._programme, self._task = programme, Task(gains)
        warm_up(self, model)

    def reset(self, period: float) -> None:
        """Begin a run; nothing of these laws depends on the control period (s)."""
        self.guard.reset()
        self._programme.reset()

    def _command(self, state: State, reference: Reference | SetPoint) -> Command:
        self._task.update(state, reference)
        return self._programme.command(state, self._task, self.guard)
