"""What the QP controllers share: an objective in few unknowns, input bounds, the decrease row."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from controllers.clf import make_clf
from controllers.controller import Command, InputGuard, Status, rehearse
from controllers.gains import Gains
from controllers.qp import DenseQp, Problem
from controllers.task import Task, task_error
from softdyn import Reference, SetPoint, SoftModel, State
from softdyn.compiled import compiled

# The programme's bounds are drawn in by this share of their range, the solver's own accuracy, so
# that its answer lies inside the true ones without clipping.
BACKOFF = 1e-8


class Condensed(NamedTuple):
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
        self._qp = DenseQp(objective.size + decrease, model.nu + decrease)
        margin = BACKOFF * (model.u_max - model.u_min)
        self._u_min, self._u_max = model.u_min + margin, model.u_max - margin
        rehearse(self.command, model, self.guard)

    def command(self, state: State, reference: Reference | SetPoint) -> Command:
        """The bounded input, or the guard's fallback."""
        task = task_error(state, reference, self._gains)
        V, row, bound = self._clf.decrease(task.eta)
        p = self._objective.condense(state, task)
        if self._decrease:
            problem = Problem(
                *_bounded_decreasing(*p, self._u_min, self._u_max, row, bound, self._gains.rho)
            )
        else:
            problem = Problem(p.H, p.g, p.u_map, self._u_min - p.u_0, self._u_max - p.u_0)
        solution = self._qp.solve(problem)
        if solution is None:
            return self.guard.fall_back(Status.NON_FINITE, V, np.nan)
        k = self._objective.size
        delta = float(solution.x[k]) if self._decrease else np.nan
        if not solution.solved:
            return self.guard.fall_back(Status.NOT_SOLVED, V, delta)
        return self.guard.accept(p.u_0 + p.u_map @ solution.x[:k], V, delta)


@compiled
def _bounded_decreasing(H, g, mu_map, mu_0, u_map, u_0, u_min, u_max, row, bound, rho):
    """The programme in (x, δ) with bounds on u and the decrease row·μ - δ ≤ bound."""
    m, k = u_map.shape
    H2, g2 = np.zeros((k + 1, k + 1)), np.zeros(k + 1)
    H2[:k, :k], g2[:k] = H, g
    H2[k, k] = 2 * rho
    A, lower, upper = np.zeros((m + 1, k + 1)), np.empty(m + 1), np.empty(m + 1)
    A[:m, :k], lower[:m], upper[:m] = u_map, u_min - u_0, u_max - u_0
    A[m, :k], A[m, k] = row @ mu_map, -1.0
    lower[m], upper[m] = -np.inf, bound - np.dot(row, mu_0)
    return H2, g2, A, lower, upper
