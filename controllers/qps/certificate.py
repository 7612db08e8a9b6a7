"""The true rate of V under a controller, with the model's own acceleration.

A QP bounds V̇ by the accelerations that are its own unknowns. Those of the hard ID-CLF-QP and
of the CLF-QP are the model's, q̈ = M⁻¹(B u - h); those of the Soft ID-CLF-QP are not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SetPoint, State
from softdyn.controllers.controller import SILENT, Command
from softdyn.controllers.gains import Gains
from softdyn.controllers.qps.clf import make_clf


@dataclass(frozen=True, slots=True)
class CertifiedCommand(Command):
    """A command that knows what it does to V.

    Attributes
    ----------
    Vdot : float
        V̇ at the start of the hold, with q̈ = M⁻¹(B u - h).
    delta_true : float
        The least δ ≥ 0 with V̇ ≤ -V/ε + δ; the law's own claim is `delta`.
    """

    Vdot: float = float("nan")
    delta_true: float = float("nan")


class Certified:
    """A law whose commands are `CertifiedCommand`; a log has both numbers as columns then.

    A solve with M more a step (in NumPy); the law itself, left alone, pays nothing.

    Parameters
    ----------
    law : Any
        A law with ε in its `gains`, or one of `stages`: V is then that of the present `stage`.

    Raises
    ------
    InputError
        A law without `Gains`.
    """

    def __init__(self, law: Any) -> None:
        gains: list[Any] = [getattr(each, "gains", None) for each in getattr(law, "stages", [law])]
        if not all(isinstance(each, Gains) for each in gains):
            raise InputError("law", "one with softdyn.controllers.Gains", repr(law))
        self.law, self.gains, self.guard, self.name = law, law.gains, law.guard, law.name
        self._clf = {each.eps: make_clf(each.eps) for each in gains}

    def reset(self, period: float) -> None:
        """Begin a run of the law with a control period (s)."""
        self.law.reset(period)

    @SILENT
    def __call__(self, state: State, reference: Reference | SetPoint) -> CertifiedCommand:
        """The law's command, and what it does to V."""
        command = self.law(state, reference)
        try:
            qdd = np.linalg.solve(state.M, state.B @ command.u - state.h)
        except np.linalg.LinAlgError:
            qdd = np.full(len(state.v), np.nan)
        mu = state.J @ qdd + state.Jdot @ state.v - reference.yddot
        eta = np.concatenate((state.y - reference.y, state.ydot - reference.ydot))
        clf = self._clf[getattr(self.law, "stage", self.law).gains.eps]
        V, row, bound = clf.decrease(eta)
        excess = float(row @ mu) - bound
        return CertifiedCommand(
            command.u, command.V, command.delta, command.status,
            excess - V / clf.eps, max(excess, 0.0),
        )  # fmt: skip
