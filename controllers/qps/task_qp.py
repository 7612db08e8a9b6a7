"""The QP of several controllers: an objective in few unknowns, input bounds, the decrease row."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from softdyn import SoftModel, State
from softdyn.compiled import compiled
from softdyn.controllers.controller import Command, InputGuard, Status
from softdyn.controllers.gains import Gains
from softdyn.controllers.qps.horizon import Horizon
from softdyn.controllers.qps.qp import DenseQp, QpProblem, QpSolution
from softdyn.controllers.qps.stacked_error import TaskRows

# The QP's bounds are tightened by this share of their range, the solver's own accuracy, so that its
# answer lies inside the true bounds without clipping.
BACKOFF = 1e-8


class Condensed(NamedTuple):
    """An objective ½ xᵀHx + gᵀx; the first m unknowns x are u.

    Attributes
    ----------
    H : ndarray, (k, k)
        Quadratic part of the objective.
    g : ndarray, (k,)
        Linear part of the objective.
    mu_map : ndarray, (r, k)
        The map in μ = mu_0 + mu_map x; r is the number of rows of all tasks.
    mu_0 : ndarray, (r,)
        The constant in it (m/s²).
    """

    H: np.ndarray
    g: np.ndarray
    mu_map: np.ndarray
    mu_0: np.ndarray

    @classmethod
    def empty(cls, size: int, rows: int) -> Condensed:
        """An empty objective in `size` unknowns, for tasks of `rows` rows."""
        return cls(np.zeros((size, size)), np.zeros(size), np.zeros((rows, size)), np.zeros(rows))


class Objective(Protocol):
    """Turns a state into an objective, always with `size` unknowns."""

    size: int

    def condense(self, state: State, M: np.ndarray, h: np.ndarray, tip: TaskRows) -> Condensed:
        """The objective at this state with the dynamics M q̈ + h = B u.

        The next call may overwrite it.
        """
        ...


class Restriction(Protocol):
    """Further rows on u; see `barriers.BarrierRows`."""

    def enforce(
        self,
        problem: QpProblem,
        solution: QpSolution | None,
        state: State,
    ) -> QpSolution | None:
        """`solution` of `problem` if it meets the rows, else a solution with the rows."""
        ...


class TaskQp:
    """min objective (+ ρ δ²) subject to u_min ≤ u ≤ u_max (and the decrease row V̇ ≤ -V/ε + δ).

    δ ≥ 0 needs no row: a negative δ costs ρ δ² and only tightens the condition.

    Parameters
    ----------
    model : SoftModel
        The robot.
    gains : Gains
        The controller's gains; this class uses ρ only.
    objective : Objective
        The rest of the QP.
    decrease : bool
        Whether the decrease condition is a constraint; V is reported in both cases.
    horizon : Horizon, optional
        Its dynamics replace the state's own.
    barriers : Restriction, optional
        Further rows on u.
    """

    def __init__(
        self,
        model: SoftModel,
        gains: Gains,
        objective: Objective,
        *,
        decrease: bool,
        horizon: Horizon | None = None,
        barriers: Restriction | None = None,
    ) -> None:
        self._objective, self._horizon, self._barriers = objective, horizon, barriers
        self._rho, self._decrease = float(gains.rho), decrease
        size, m = objective.size, model.nu
        self._nu, self._size = m, size
        self._qp = DenseQp(size + decrease, m + decrease)
        self.solvers = (self._qp,)
        # x = (u, …, δ); constant entries are written once here
        self._problem = problem = QpProblem.empty(size + decrease, m + decrease)
        margin = BACKOFF * (model.u_max - model.u_min)
        problem.lower[:m], problem.upper[:m] = model.u_min + margin, model.u_max - margin
        problem.A[:m, :m] = np.eye(m)
        if decrease:
            problem.lower[m], problem.A[m, size] = -np.inf, -1.0

    def reset(self) -> None:
        """Do nothing; the QP has no memory."""

    def command(self, state: State, tip: TaskRows, guard: InputGuard) -> Command:
        """The bounded input, or the guard's fallback."""
        M, h = (state.M, state.h) if self._horizon is None else self._horizon(state)
        condensed, problem = self._objective.condense(state, M, h, tip), self._problem
        _write(
            *condensed,
            tip.row,
            tip.bound,
            self._rho,
            self._decrease,
            self._nu,
            *problem,
        )
        solution = self._qp.solve(problem)
        if self._barriers is not None:
            solution = self._barriers.enforce(problem, solution, state)
        if solution is None:
            return guard.fall_back(Status.NON_FINITE, tip.V, np.nan, problem)
        delta = float(solution.x[self._size]) if self._decrease else np.nan
        if not solution.solved:
            return guard.fall_back(Status.NOT_SOLVED, tip.V, delta, problem)
        return guard.accept(solution.x[: self._nu], tip.V, delta)


@compiled
def _write(H, g, mu_map, mu_0, row, bound, rho, decrease, m, H2, g2, A, lower, upper):
    """Write the objective and, below the bounds on u, the decrease condition row·μ - δ ≤ bound."""
    k = len(g)
    for i in range(k):
        g2[i] = g[i]
        for j in range(k):
            H2[i, j] = H[i, j]
    if decrease:
        H2[k, k] = 2 * rho
        upper[m] = bound[0]
        for x in range(len(row)):
            upper[m] -= row[x] * mu_0[x]
        for j in range(k):
            A[m, j] = 0.0
            for x in range(len(row)):
                A[m, j] += row[x] * mu_map[x, j]
