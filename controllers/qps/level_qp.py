"""Tasks in strict levels of priority: one QP for each level, under the same bounds.

Level k minimises its own w1 ‖μ_k - μ_k,ref‖² + ρ δ_k² over the inputs that keep the optima of all
higher levels (Escande, Mansard and Wieber 2014). The regulariser, all other terms of the
controller's cost, stands in the last level only. A projection into the null space of the higher
tasks would be wrong where bounds are active: it ignores what the bounds leave free.

All optima of a level have the same μ. The next level therefore has fewer unknowns, x = x_0 + Z w,
where Z spans the null space of μ's map. It needs no row for a saturated input: a bound with a
multiplier is active at every optimum, so no w within the bounds leaves it. The one rank rule
decides how many rows of a level, or of a task, are independent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from softdyn import InputError, SoftModel, State
from softdyn.controllers.controller import (
    SILENT,
    Command,
    InputGuard,
    Status,
    TaskCondition,
    TaskReport,
)
from softdyn.controllers.gains import Gains
from softdyn.controllers.qps.horizon import Horizon
from softdyn.controllers.qps.linear_algebra import RANK_TOLERANCE, row_space
from softdyn.controllers.qps.qp import DenseQp, QpProblem
from softdyn.controllers.qps.stacked_error import StackedError, TaskRows, several_levels
from softdyn.controllers.qps.task_qp import BACKOFF, Objective, Restriction, TaskQp

RIDGE = 1e-9  # of the solver's start, as a share of the level's largest row squared
ROUNDING = 1e-12  # a multiplier below this share of its cancelling terms counts as zero
SAME = 1e-6  # a task counts as met at this share of its μ_ref, an input as at its bound
EXACT = 1e-9  # largest violation of a scaled row that counts as rounding


class LevelProblem(NamedTuple):
    """min ½ xᵀHx + gᵀx + ‖F x - f‖² + ρ δ² s.t. lower ≤ G x ≤ upper, along·F x - δ ≤ bound."""

    H: np.ndarray  # (k, k)
    g: np.ndarray  # (k,)
    F: np.ndarray  # (r, k)
    f: np.ndarray  # (r,)
    G: np.ndarray  # (p, k)
    lower: np.ndarray  # (p,)
    upper: np.ndarray  # (p,)
    along: np.ndarray  # (r,)
    bound: float
    rho: float  # 0: no decrease condition

    @property
    def row(self) -> np.ndarray:
        """The row (k,) of the decrease condition."""
        return self.along @ self.F


class LevelQp:
    """The input of a controller whose tasks have several levels.

    Parameters
    ----------
    model : SoftModel
        The robot.
    gains : Gains
        The controller's gains; this class uses w1 and ρ.
    objective : Objective
        The regulariser, with a w1 of zero.
    decrease : bool
        Whether each level has a Lyapunov function whose decrease it demands.
    horizon : Horizon, optional
        Its dynamics replace the state's own.
    apart : bool
        Whether the regulariser is a level of its own, below the last one.

    Attributes
    ----------
    solvers : tuple of DenseQp
        Empty: their number and sizes depend on the state.

    Raises
    ------
    InputError
        For a w1 of zero.
    """

    solvers: tuple[DenseQp, ...] = ()

    def __init__(
        self,
        model: SoftModel,
        gains: Gains,
        objective: Objective,
        *,
        decrease: bool,
        horizon: Horizon | None = None,
        apart: bool = False,
    ) -> None:
        if gains.w1 == 0:
            raise InputError("gains.w1", "a positive number, for tasks of several levels", 0)
        self._objective, self._horizon, self._apart = objective, horizon, apart
        self._root, self._rho = np.sqrt(gains.w1), float(gains.rho) if decrease else 0.0
        margin = BACKOFF * (model.u_max - model.u_min)
        self._lower, self._upper = model.u_min + margin, model.u_max - margin
        self._nu, self._qps = model.nu, dict[tuple[int, int], DenseQp]()

    def reset(self) -> None:
        """Do nothing; the QPs have no memory."""

    @SILENT
    def command(self, state: State, tip: TaskRows, guard: InputGuard) -> Command:
        """The bounded input, or the guard's fallback."""
        assert isinstance(tip, StackedError)  # `make_qp` gives no other
        M, h = (state.M, state.h) if self._horizon is None else self._horizon(state)
        H, g, mu_map, mu_0 = self._objective.condense(state, M, h, tip)
        if not np.isfinite([H.sum(), g.sum(), mu_map.sum(), mu_0.sum(), tip.V]).all():
            return guard.fall_back(Status.NON_FINITE, tip.V, np.nan)
        # unknowns with a unit regulariser: x = scale · x'
        size, m = len(g), self._nu
        scale = 1 / np.sqrt(np.where(np.diag(H) > 0, np.diag(H), 1.0))
        H, g, mu_map = H * np.outer(scale, scale), g * scale, mu_map * scale
        G, x, Z = np.diag(scale)[:m], np.zeros(size), np.eye(size)
        x[:m] = np.clip(0.0, self._lower, self._upper) / scale[:m]
        reports: list[TaskReport] = []
        none, delta = np.zeros((0, size)), 0.0
        for k, rows in enumerate(tip.levels):
            bound = float(tip.bound[k] - tip.row[rows] @ mu_0[rows])
            F, f = self._root * mu_map[rows], self._root * (tip.mu_ref[rows] - mu_0[rows])
            last = k == len(tip.levels) - 1 and not self._apart
            level = LevelProblem(
                H * last, g * last, F, f, G, self._lower, self._upper,
                tip.row[rows] / self._root, bound, self._rho,
            )  # fmt: skip
            found = self._solve(level, x, Z, unique=last)
            if found is None:
                return guard.fall_back(Status.NOT_SOLVED, tip.V, np.nan)
            x = found
            delta = max(delta, float(level.row @ x - level.bound)) if self._rho else np.nan
            room = np.minimum(G @ x - self._lower, self._upper - G @ x)
            saturated = bool((room <= SAME * (self._upper - self._lower)).any())
            reports += _reports(tip, rows, mu_map, mu_0, x, Z, saturated=saturated)
            Z = Z @ _null(F @ Z, float(np.linalg.norm(F, axis=1).max()))
        if self._apart and Z.shape[1]:
            level = LevelProblem(
                H, g, none, none[:, 0], G, self._lower, self._upper, none[:, 0], 0.0, 0.0
            )
            found = self._solve(level, x, Z, unique=True)
            if found is None:
                return guard.fall_back(Status.NOT_SOLVED, tip.V, np.nan)
            x = found
        return replace(guard.accept(scale[:m] * x[:m], tip.V, delta), tasks=tuple(reports))

    def _solve(
        self, level: LevelProblem, x: np.ndarray, Z: np.ndarray, *, unique: bool
    ) -> np.ndarray | None:
        """An optimum of a level in x + Z w; None without one.

        The solver's answer with a small ridge is only the start of an exact active set method.
        """
        if Z.shape[1] == 0:
            return x
        inner = _within(level, x, Z, EXACT if unique else RANK_TOLERANCE)
        F, f, tolerance = inner.F, inner.f, RANK_TOLERANCE
        largest = float(np.linalg.norm(level.F, axis=1).max(initial=0.0))
        if unique:
            values, vectors = np.linalg.eigh(inner.H / 2)
            half = np.sqrt(np.maximum(values, 0.0)) * vectors
            F, f = np.vstack((F, half.T)), np.append(f, np.linalg.lstsq(half, -inner.g / 2)[0])
            largest, tolerance = float(np.linalg.norm(F, axis=1).max()), 1e-14
        w, side, late = self._start(inner, RIDGE * largest**2)
        for _ in range(2):
            rows, goal = F, f
            if late:
                root = np.sqrt(inner.rho)
                rows, goal = np.vstack((F, root * inner.row)), np.append(f, root * inner.bound)
            found = _least_squares(rows, goal, inner, w, side, tolerance * largest)
            if found is None:
                return None
            w, side = found
            if not inner.rho or (inner.row @ w > inner.bound) == late:
                break
            late = not late
        result: np.ndarray = x + Z @ w
        return result

    def _start(self, level: LevelProblem, ridge: float) -> tuple[np.ndarray, np.ndarray, bool]:
        """The solver's answer, the side (p,) of each row's active bound, and whether δ > 0.

        If the solver has no answer, the start is w = 0.
        """
        k, kept = len(level.g), _moving(level.G)
        p, late = int(kept.sum()), level.rho > 0 and bool(np.abs(level.row).max() > 0)
        H, g = np.zeros((k + late, k + late)), np.zeros(k + late)
        H[:k, :k] = level.H + 2 * level.F.T @ level.F + ridge * np.eye(k)
        g[:k] = level.g - 2 * level.F.T @ level.f
        A = np.zeros((p + late, k + late))
        A[:p, :k] = level.G[kept]
        lower, upper = level.lower[kept], level.upper[kept]
        if late:
            H[k, k], A[p, :k], A[p, k] = 2 * level.rho, level.row, -1.0
            lower, upper = np.append(lower, -np.inf), np.append(upper, level.bound)
        key = len(g), len(lower)
        if key not in self._qps:
            self._qps[key] = DenseQp(*key)
        found = self._qps[key].solve(QpProblem(H, g, A, lower, upper))
        side = np.zeros(len(level.G))
        if found is None or not found.solved:
            return np.zeros(k), side, False
        w = found.x[:k]
        side[kept] = np.sign(found.multipliers[:p])
        at = level.G @ w
        if (np.maximum(level.lower - at, at - level.upper) > EXACT).any():
            return np.zeros(k), 0 * side, False
        return w, side, bool(late and found.x[k] > 0)


def _least_squares(
    F: np.ndarray,
    f: np.ndarray,
    bounds: LevelProblem,
    w: np.ndarray,
    side: np.ndarray,
    smallest: float,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Minimise ‖F w - f‖² within the bounds from an admissible w.

    It is a primal active set method; `side` (p,) is -1 or 1 for a row at its lower or upper bound.
    Returns w and the sides; None if it does not end. Singular values of F below `smallest` count as
    zero. Each step is the least that reaches the optimum on the active rows.
    """
    G, lower, upper, side = bounds.G, bounds.lower, bounds.upper, side.copy()
    sizes = np.linalg.norm(G, axis=1)
    fixed = ~_moving(G)
    scale = float(np.linalg.norm(F, axis=1).max(initial=0.0) * (np.linalg.norm(f) + 1e-300))
    dropped = -1
    for _ in range(10 * len(G) + 10):
        active = side != 0
        N = _null(G[active], 0.0)
        U, values, Vt = np.linalg.svd(F @ N, full_matrices=False)
        counted = values > max(smallest, 1e-300)
        right = U[:, counted].T @ (f - F @ w)
        step = N @ (Vt[counted].T @ (right / values[counted]))
        along, at = G @ step, G @ w
        along[active | fixed] = 0.0
        room = np.full(len(G), np.inf)
        up, down = along > 0, along < 0
        room[up] = np.maximum(upper - at, 0.0)[up] / along[up]
        room[down] = np.minimum(lower - at, 0.0)[down] / along[down]
        k = int(room.argmin()) if len(room) else -1
        if k >= 0 and room[k] < 1.0:
            w = w + room[k] * step
            if k == dropped and room[k] == 0.0:
                return w, side  # its multiplier was only rounding
            side[k] = np.sign(along[k])
            continue
        w = w + step
        weight = np.zeros(len(G))
        weight[active] = np.linalg.lstsq(G[active].T, F.T @ (f - F @ w), rcond=1e-10)[0]
        weight *= sizes / max(scale, 1e-300)
        wrong = -weight * side
        dropped = int(wrong.argmax()) if len(wrong) else -1
        if dropped < 0 or wrong[dropped] <= ROUNDING:
            return w, side
        side[dropped] = 0.0
    return None


def _moving(G: np.ndarray) -> np.ndarray:
    """Which rows of G, in units of the free directions, are not fixed by the levels above."""
    sizes = np.linalg.norm(G, axis=1)
    return sizes > EXACT * sizes.max(initial=0.0)


def _within(level: LevelProblem, x: np.ndarray, Z: np.ndarray, tolerance: float) -> LevelProblem:
    """The level in w of x + Z w; w = 0 meets every row, whatever rounding says.

    Singular values of F Z below `tolerance` times the largest row of F are zero but for rounding.
    """
    at = level.G @ x
    U, values, Vt = np.linalg.svd(level.F @ Z, full_matrices=False)
    values[values <= tolerance * np.linalg.norm(level.F, axis=1).max(initial=0.0)] = 0.0
    F = (U * values) @ Vt
    return LevelProblem(
        Z.T @ level.H @ Z, Z.T @ (level.g + level.H @ x),
        F, level.f - level.F @ x,
        level.G @ Z, np.minimum(level.lower - at, 0.0), np.maximum(level.upper - at, 0.0),
        level.along, level.bound - float(level.row @ x), level.rho,
    )  # fmt: skip


def _null(rows: np.ndarray, largest: float) -> np.ndarray:
    """Orthonormal columns (k, free) on which `rows` vanish.

    A row counts by the one rank rule, as a share of `largest` or of the largest row.
    """
    k = rows.shape[1]
    most = float(np.linalg.norm(rows, axis=1).max(initial=0.0))
    if most <= RANK_TOLERANCE * max(largest, most * RANK_TOLERANCE) or most <= 1e-12:
        return np.eye(k)
    own = row_space(np.ascontiguousarray(rows), RANK_TOLERANCE * max(largest, most) / most)
    return np.linalg.svd(own, full_matrices=True)[2][len(own) :].T


def _reports(
    tip: StackedError,
    level: slice,
    mu_map: np.ndarray,
    mu_0: np.ndarray,
    x: np.ndarray,
    Z: np.ndarray,
    *,
    saturated: bool,
) -> list[TaskReport]:
    """A report of each task of a level whose free directions were Z."""
    found, free = [], Z
    for task, part in zip(tip.tasks, tip.parts, strict=True):
        if not level.start <= part.start < level.stop:
            continue
        A, short = mu_map[part], mu_map[part] @ x + mu_0[part] - tip.mu_ref[part]
        largest = float(np.linalg.norm(A, axis=1).max())
        own = A.shape[1] - _null(A, largest).shape[1]
        after = free @ _null(A @ free, largest)
        independent = free.shape[1] - after.shape[1]
        free = after
        shortfall = float(np.linalg.norm(short / tip.roots[part]))
        close = np.abs(short).max() <= SAME * max(1.0, float(np.abs(tip.mu_ref[part]).max()))
        if independent < own:
            condition = TaskCondition.REDUNDANT if close else TaskCondition.CONFLICTING
        elif close:
            condition = TaskCondition.MET
        elif saturated or own < min(A.shape):
            condition = TaskCondition.UNREACHABLE
        else:
            condition = TaskCondition.TRADED
        found.append(TaskReport(task.name, task.level, condition, independent, shortfall))
    return found


def make_qp(
    model: SoftModel,
    gains: Gains,
    objective: Callable[[Gains], Objective],
    error: TaskRows,
    *,
    decrease: bool,
    horizon: Horizon | None = None,
    barriers: Restriction | None = None,
) -> TaskQp | LevelQp:
    """The QP of a controller: one for tasks of one level, else one for each level.

    Parameters
    ----------
    model, gains, decrease, horizon, barriers
        As in `TaskQp`.
    objective : Callable
        Makes the objective from gains.
    error : TaskRows
        The tasks' error.

    Raises
    ------
    InputError
        For several levels with barriers, or with a w1 of zero.
    """
    if not several_levels(error):
        return TaskQp(
            model, gains, objective(gains), decrease=decrease, horizon=horizon, barriers=barriers,
            guess=isinstance(error, StackedError),
        )  # fmt: skip
    if barriers is not None:
        raise InputError("tasks", "one level, beside barriers", "several")
    rest = objective(replace(gains, w1=0.0))
    return LevelQp(model, gains, rest, decrease=decrease, horizon=horizon)
