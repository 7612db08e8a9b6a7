"""The true rate of V along a run, with the model's own acceleration, from the run's log.

A QP bounds V̇ with the accelerations of its own unknowns. In the hard ID-CLF-QP and in the CLF-QP
they are the model's, q̈ = M⁻¹(B u - h); in the Soft ID-CLF-QP they are not.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SetPoint, SoftModel, State
from softdyn.controllers.channels import LogChannel
from softdyn.controllers.controller import SILENT
from softdyn.controllers.gains import Gains
from softdyn.controllers.qps.clf import make_clf
from softdyn.controllers.qps.stacked_error import StackedError
from softdyn.validation.loop.log import Log


class TrueRate:
    """The true effect of a controller's inputs on its V.

    Parameters
    ----------
    controller : Any
        A controller with ε in its `gains`, or with `stages` that have. V is then that of the stage
        whose V the command has.

    Raises
    ------
    InputError
        For a controller without `Gains`.
    """

    def __init__(self, controller: Any) -> None:
        stages = getattr(controller, "stages", [controller])
        gains: list[Any] = [getattr(each, "gains", None) for each in stages]
        if not all(isinstance(each, Gains) for each in gains):
            expected = "one with softdyn.controllers.Gains, to certify it"
            raise InputError("controller", expected, type(controller).__name__)
        self._clfs = [make_clf(each.eps) for each in gains]
        error = getattr(controller, "error", None)
        self._error = error if isinstance(error, StackedError) else None

    @SILENT
    def __call__(
        self, state: State, reference: Reference | SetPoint, u: np.ndarray, V: float
    ) -> tuple[float, float]:
        """V̇ at the start of a hold of u (nu,), with q̈ = M⁻¹(B u - h), and its least relaxation.

        Parameters
        ----------
        state, reference, u, V
            The state that the controller saw, the reference, its input, and its V.

        Returns
        -------
        Vdot, delta_true : float
            V̇, and the least δ ≥ 0 with V̇ ≤ -V/ε + δ; NaN where M is singular.
        """
        try:
            qdd = np.linalg.solve(state.M, state.B @ u - state.h)
        except np.linalg.LinAlgError:
            qdd = np.full(len(state.v), np.nan)
        if self._error is not None:
            error, clf = self._error, self._clfs[0]
            error.update(state, reference)
            mu, found = error.J @ qdd - error.yddot, (error.V, error.row, float(error.bound.sum()))
        else:
            mu = state.J @ qdd + state.Jdot @ state.v - reference.yddot
            eta = np.concatenate((state.y - reference.y, state.ydot - reference.ydot))
            several = [(clf, clf.decrease(eta)) for clf in self._clfs]
            clf, found = min(several, key=lambda one: abs(one[1][0] - V))
        own, row, bound = found
        excess = float(row @ mu) - bound
        return excess - own / clf.eps, max(excess, 0.0)


def certify(
    log: Log,
    model: SoftModel,
    controller: Any,
    reference: Callable[[float], Reference | SetPoint],
) -> Log:
    """The log with `Vdot` and `delta_true`, see `TrueRate`.

    Each step costs one more State.

    Parameters
    ----------
    log : Log
        A run.
    model : SoftModel
        Its robot.
    controller : Any
        Its controller.
    reference : callable
        Time (s) → the reference of that run.

    Raises
    ------
    InputError
        For a controller without `Gains`.
    """
    rate = TrueRate(controller)
    seen = (log.q, log.v) if log.q_seen is None or log.v_seen is None else (log.q_seen, log.v_seen)
    found = np.full((2, log.steps), np.nan)
    for k in range(log.steps):
        state = model.state(seen[0][k], seen[1][k])
        found[:, k] = rate(state, reference(float(log.t[k])), log.u[k], float(log.V[k]))
    names = zip(("Vdot", "delta_true"), found, strict=True)
    return log.altered(*(LogChannel(n, held=True, values=x.copy()) for n, x in names))


def certified(*arguments: Any) -> Log:
    """The former name of `certify`, for one version."""
    warnings.warn("certified is now certify", DeprecationWarning, stacklevel=2)
    return certify(*arguments)
