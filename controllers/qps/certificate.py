"""The true rate of V under a controller, with the model's own acceleration.

A QP bounds V̇ with the accelerations of its own unknowns. In the hard ID-CLF-QP and in the CLF-QP
they are the model's, q̈ = M⁻¹(B u - h); in the Soft ID-CLF-QP they are not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SetPoint, State
from softdyn.controllers.controller import SILENT, Command
from softdyn.controllers.gains import Gains
from softdyn.controllers.qps.clf import make_clf
from softdyn.controllers.qps.stacked_error import StackedError
from softdyn.copies import Separate


@dataclass(frozen=True, slots=True)
class CertifiedCommand(Command):
    """A command with its true effect on V.

    Attributes
    ----------
    Vdot : float
        V̇ at the start of the hold, with q̈ = M⁻¹(B u - h).
    delta_true : float
        The least δ ≥ 0 with V̇ ≤ -V/ε + δ; `delta` is the controller's own value.
    """

    Vdot: float = float("nan")
    delta_true: float = float("nan")


class Certified(Separate):
    """Wraps a controller; its commands are `CertifiedCommand`, and a log has both numbers.

    Each step costs one more solve with M, in NumPy.

    Parameters
    ----------
    law : Any
        A controller with ε in its `gains`, or with `stages`; V is then that of the present `stage`.

    Raises
    ------
    InputError
        For a controller without `Gains`.
    """

    def __init__(self, law: Any) -> None:
        gains: list[Any] = [getattr(each, "gains", None) for each in getattr(law, "stages", [law])]
        if not all(isinstance(each, Gains) for each in gains):
            expected = "one with softdyn.controllers.Gains, to certify it"
            raise InputError("controller", expected, type(law).__name__)
        self.law, self.gains, self.guard, self.name = law, law.gains, law.guard, law.name
        self.tasks = getattr(law, "tasks", ())
        self._clf = {each.eps: make_clf(each.eps) for each in gains}

    def reset(self, period: float) -> None:
        """Begin a run of the controller with a control period (s)."""
        self.law.reset(period)

    @SILENT
    def __call__(self, state: State, reference: Reference | SetPoint) -> CertifiedCommand:
        """The controller's command, and its true effect on V."""
        command = self.law(state, reference)
        try:
            qdd = np.linalg.solve(state.M, state.B @ command.u - state.h)
        except np.linalg.LinAlgError:
            qdd = np.full(len(state.v), np.nan)
        clf = self._clf[getattr(self.law, "stage", self.law).gains.eps]
        error = getattr(self.law, "error", None)
        if isinstance(error, StackedError):
            mu, V = error.J @ qdd - error.yddot, error.V
            row, bound = error.row, float(error.bound.sum())
        else:
            mu = state.J @ qdd + state.Jdot @ state.v - reference.yddot
            eta = np.concatenate((state.y - reference.y, state.ydot - reference.ydot))
            V, row, bound = clf.decrease(eta)
        excess = float(row @ mu) - bound
        return CertifiedCommand(
            command.u, command.V, command.delta, command.status, command.distance, command.tasks,
            excess - V / clf.eps, max(excess, 0.0),
        )  # fmt: skip
