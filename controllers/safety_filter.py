"""A safety filter: barriers for any controller."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SetPoint, SoftModel, State
from softdyn.checks import number
from softdyn.controllers.barriers import LOOKAHEAD, BarrierRows, ControlBarrier
from softdyn.controllers.channels import values_of
from softdyn.controllers.controller import Command, KnownRig, WrappingController
from softdyn.controllers.qps.qp import QpProblem, QpSolution
from softdyn.copies import keep_making, making_of
from softdyn.safety import Surroundings


class SafetyFilter(WrappingController):
    """A controller whose input is changed as little as the barriers require.

    It is the filter of Ames et al. 2017: min ‖(u - u_c) / range‖² over the rows of the barriers
    (`softdyn.controllers.barriers`) and the bounds, where u_c is the controller's input. An input
    that meets every row passes unchanged. If no admissible input meets them, the rows are relaxed.

    `SoftIdClfQp` has barriers of its own: it finds the best input among the safe ones, not the one
    nearest to an unsafe input.

    Parameters
    ----------
    controller : Callable[[State, Reference], Command]
        Any controller, also a user's own.
    model : SoftModel
        The robot.
    barriers : sequence of ControlBarrier
        Obstacles and limits, at least one.
    horizon : float
        The horizon τ of the rows (s).

    Attributes
    ----------
    barrier_rows : BarrierRows
        The rows, and the counts of states outside and of relaxed rows.
    changed : int
        Number of steps since `reset` at which the input was changed.

    Raises
    ------
    InputError
        A controller that cannot be called, no barrier, a horizon that is negative.
    """

    def __init__(
        self,
        controller: Callable[[State, Reference], Any],
        model: SoftModel,
        barriers: Sequence[ControlBarrier],
        *,
        horizon: float = LOOKAHEAD,
    ) -> None:
        super().__init__(controller, model, "{} among obstacles")
        if not barriers:
            raise InputError("barriers", "at least one", "none")
        horizon = number("horizon", horizon, lower=0.0)
        self.changed = 0
        self.barrier_rows = BarrierRows(model, barriers, horizon)
        span = model.u_max - model.u_min
        self._weight = 1 / np.where(span > 0, span, 1.0) ** 2
        self._H, self._A = np.diag(self._weight), np.eye(model.nu)

    def reset(self, period: float, rig: KnownRig | None = None) -> None:
        """Begin a run with a control period (s), on a plant behind a rig; by default the file's."""
        super().reset(period, rig)
        self.barrier_rows.reset(period)
        self.changed = 0

    def _command(self, state: State, reference: Reference | SetPoint) -> Command:
        answer = self.inner(state, reference)
        wanted, nu = self._admit(getattr(answer, "u", answer)), len(self._weight)
        nearest = QpProblem(
            self._H, -self._weight * wanted, self._A, self.guard.u_min, self.guard.u_max
        )  # fmt: skip
        given = QpSolution(wanted, np.zeros(nu), 0.0, 0.0, 0.0)
        found = self.barrier_rows.enforce(nearest, given, state)
        u = wanted if found is None else found.x[:nu]
        if not np.array_equal(u, wanted):
            self.changed += 1
            if hasattr(self.inner, "applied"):
                self.inner.applied(u)
        command = self.guard.accept(u, np.nan, np.nan, clamped=True)
        if isinstance(answer, Command):
            return replace(answer, u=command.u)
        return replace(command, values=values_of(self.channels, answer))


def with_barriers(make: Callable[..., Any], around: Surroundings | None) -> Callable[..., Any]:
    """`make`, a class or another callable, whose controllers keep clear of obstacles if any.

    A class that `takes_barriers` gets them, any other controller a filter. Neither changes the
    controller where no barrier acts; in particular no obstacle switches a horizon on.
    """
    if around is None:
        return make
    if getattr(make, "takes_barriers", False):
        return partial(make, barriers=around.barriers)
    return partial(_filtered, make, around.barriers)


def _filtered(
    make: Callable[..., Any],
    barriers: Sequence[ControlBarrier],
    model: SoftModel,
    *arguments: Any,
    **options: Any,
) -> SafetyFilter:
    inner = make(model, *arguments, **options)
    if making_of(inner) is None:
        keep_making(inner, make, (model, *arguments), options)
    return SafetyFilter(inner, model, barriers)
