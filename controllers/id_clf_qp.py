"""Soft ID-CLF-QP: the paper's controller, exactly as published, in condensed form."""

from __future__ import annotations

import numpy as np

from controllers.clf import make_clf
from controllers.controller import Command, InputGuard, Status
from controllers.gains import Gains, resolve
from controllers.qp import DenseQp, Problem
from controllers.soft_inverse_dynamics import SoftInverseDynamics
from softdyn import Reference, SetPoint, SoftModel, State

# The programme's bounds are drawn in by this share of their range, the solver's own accuracy, so
# that its answer lies inside the true ones without clipping.
BACKOFF = 1e-8


class SoftIdClfQp:
    """Paper, "Soft ID-CLF-QP": hard on the actuated dynamics, soft on the unactuated ones.

    Parameters
    ----------
    model : the robot.
    gains : the paper's for a bundled robot by default; required for any other.

    Raises
    ------
    InputError
        No gains for this robot, or a robot without inputs.
    """

    name = "soft-id-clf-qp"

    def __init__(self, model: SoftModel, gains: Gains | None = None) -> None:
        self.gains = resolve(model, self.name, gains)
        self.guard = InputGuard(model.u_min, model.u_max)
        self._clf = make_clf(self.gains.eps)
        self._dynamics = SoftInverseDynamics(self.gains, model.nu)
        size = self._dynamics.size
        self._qp = DenseQp(size + 1, model.nu + 1)
        margin = BACKOFF * (model.u_max - model.u_min)
        self._lower = np.concatenate((model.u_min + margin, [-np.inf]))
        self._upper = np.concatenate((model.u_max - margin, [np.inf]))
        self._H = np.zeros((size + 1, size + 1))
        self._H[size, size] = 2 * self.gains.rho
        self._A = np.zeros((model.nu + 1, size + 1))
        self._A[-1, -1] = -1.0

    def __call__(self, state: State, reference: Reference | SetPoint) -> Command:
        """The input at this state; see `Command`."""
        e, edot = state.y - reference.y, state.ydot - reference.ydot
        V, row, bound = self._clf.decrease(np.concatenate((e, edot)))
        mu_ref = -self.gains.Kd * edot - self.gains.Kp * e
        p = self._dynamics.condense(state, mu_ref, reference.yddot)
        k = len(p.g)
        self._H[:k, :k] = p.H
        self._A[:-1, :k] = p.u_map
        self._A[-1, :k] = row @ p.mu_map
        lower, upper = self._lower.copy(), self._upper.copy()
        lower[:-1] -= p.u_0
        upper[:-1] -= p.u_0
        upper[-1] = bound - row @ p.mu_0
        solution = self._qp.solve(Problem(self._H, np.append(p.g, 0.0), self._A, lower, upper))
        if solution is None:
            return self.guard.fall_back(Status.NON_FINITE, V, np.nan)
        delta = float(solution.x[k])
        if not solution.solved:
            return self.guard.fall_back(Status.NOT_SOLVED, V, delta)
        return self.guard.accept(p.u_0 + p.u_map @ solution.x[:k], V, delta)
