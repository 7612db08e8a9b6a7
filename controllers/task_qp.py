"""What the QP controllers share: an objective in few unknowns, input bounds, the decrease row."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from controllers.clf import make_clf
from controllers.controller import Command, InputGuard, Status
from controllers.gains import Gains
from controllers.qp import DenseQp, Problem
from controllers.task import Task, task_error
from softdyn import Reference, SetPoint, SoftModel, State

# The programme's bounds are drawn in by this share of their range, the solver's own accuracy, so
# that its answer lies inside the true ones without clipping.
BACKOFF = 1e-8


@dataclass(frozen=True, slots=True)
class Condensed:
    """An objective ½ xᵀHx + gᵀx over unknowns x, and what x means.

    Attributes
    ----------
    H, g : (k, k), (k,) the objective.
    mu_map, mu_0 : (3, k), (3,) so that μ = mu_0 + mu_map x.
    u_map, u_0 : (m, k), (m,) so that u = u_0 + u_map x.
    """

    H: np.ndarray
    g: np.ndarray
    mu_map: np.ndarray
    mu_0: np.ndarray
    u_map: np.ndarray
    u_0: np.ndarray


class Objective(Protocol):
    """Turns a state into an objective; `size` unknowns, always."""

    size: int

    def condense(self, state: State, task: Task) -> Condensed:
        """The objective at this state."""
        ...


class TaskQp:
    """min objective (+ ρ δ²) subject to u_min ≤ u ≤ u_max (and the decrease row V̇ ≤ -V/ε + δ).

    δ ≥ 0 needs no row: a negative δ costs ρ δ² and only tightens the condition.

    Parameters
    ----------
    decrease : whether the decrease condition is a constraint; V is reported either way.
    """

    def __init__(
        self, model: SoftModel, gains: Gains, objective: Objective, *, decrease: bool
    ) -> None:
        self.guard = InputGuard(model.u_min, model.u_max)
        self._gains, self._objective = gains, objective
        self._clf = make_clf(gains.eps)
        self._decrease = decrease
        unknowns, rows = objective.size + decrease, model.nu + decrease
        self._qp = DenseQp(unknowns, rows)
        self._H, self._g = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
        self._A = np.zeros((rows, unknowns))
        self._lower, self._upper = np.full(rows, -np.inf), np.full(rows, np.inf)
        margin = BACKOFF * (model.u_max - model.u_min)
        self._u_min, self._u_max = model.u_min + margin, model.u_max - margin
        if decrease:
            self._H[-1, -1] = 2 * gains.rho
            self._A[-1, -1] = -1.0

    def command(self, state: State, reference: Reference | SetPoint) -> Command:
        """The bounded input, or the guard's fallback."""
        task = task_error(state, reference, self._gains)
        V, row, bound = self._clf.decrease(task.eta)
        p = self._objective.condense(state, task)
        k, m = self._objective.size, len(self._u_min)
        self._H[:k, :k], self._g[:k] = p.H, p.g
        self._A[:m, :k] = p.u_map
        self._lower[:m], self._upper[:m] = self._u_min - p.u_0, self._u_max - p.u_0
        if self._decrease:
            self._A[m, :k], self._upper[m] = row @ p.mu_map, bound - row @ p.mu_0
        solution = self._qp.solve(Problem(self._H, self._g, self._A, self._lower, self._upper))
        if solution is None:
            return self.guard.fall_back(Status.NON_FINITE, V, np.nan)
        delta = float(solution.x[k]) if self._decrease else np.nan
        if not solution.solved:
            return self.guard.fall_back(Status.NOT_SOLVED, V, delta)
        return self.guard.accept(p.u_0 + p.u_map @ solution.x[:k], V, delta)
