"""Tasks in strict levels of priority: one QP for each level, under the same bounds.

Level k minimises its own w1 ‖μ_k - μ_k,ref‖² + ρ δ_k² over the inputs that keep the optima of all
higher levels (Escande, Mansard and Wieber 2014). The regulariser, all other terms of the
controller's cost, stands in the last level only. A projection into the null space of the higher
tasks would be wrong where bounds are active: it ignores what the bounds leave free.

All optima of a level have the same μ. The next level therefore has fewer unknowns, x = x_0 + Z w,
where Z spans the null space of μ's map. It needs no row for a saturated input: a bound with a
multiplier is active at every optimum, so no w within the bounds leaves it. The one rank rule
decides how many rows of a level, or of a task, are independent.

`DenseQp` solves every level, in unknowns whose Hessian is the identity: those of the singular value
decomposition of the level's rows. So small singular values cost no accuracy.
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
from softdyn.controllers.qps.linear_algebra import RANK_TOLERANCE
from softdyn.controllers.qps.qp import DenseQp, QpProblem
from softdyn.controllers.qps.stacked_error import StackedError, TaskRows, several_levels
from softdyn.controllers.qps.task_qp import BACKOFF, Objective, Restriction, TaskQp

RIDGE = 1e-6  # weight of directions without any, beside the smallest weight of the others
REPEATS = 20  # steps of the proximal point method
SAME = 1e-6  # a task counts as met at this share of its μ_ref, an input as at its bound
EXACT = 1e-9  # share of the largest row below which a row or singular value is rounding


class Level(NamedTuple):
    """min ‖F x - f‖² + ρ δ² s.t. along·F x - δ ≤ bound, δ ≥ 0, and the bounds on u."""

    F: np.ndarray  # (r, k)
    f: np.ndarray  # (r,)
    along: np.ndarray  # (r,)
    bound: float
    rho: float  # 0: no decrease condition

    def beyond(self, x: np.ndarray) -> float:
        """The δ that x needs; negative if the decrease condition holds without."""
        return float(self.along @ (self.F @ x) - self.bound)

    @property
    def largest(self) -> float:
        """The norm of the largest row of F."""
        return float(np.linalg.norm(self.F, axis=1).max(initial=0.0))


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
        self._failed: QpProblem | None = None

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
        square, zero = _root(H * np.outer(scale, scale), g * scale)
        mu_map = mu_map * scale
        x, Z = np.zeros(size), np.eye(size)
        x[:m] = np.clip(0.0, self._lower, self._upper) / scale[:m]
        levels = [
            Level(
                self._root * mu_map[rows], self._root * (tip.mu_ref[rows] - mu_0[rows]),
                tip.row[rows] / self._root, float(bound - tip.row[rows] @ mu_0[rows]), self._rho,
            )
            for rows, bound in zip(tip.levels, tip.bound, strict=True)
        ]  # fmt: skip
        if self._apart:
            levels.append(Level(mu_map[:0], mu_0[:0], mu_0[:0], 0.0, 0.0))
        reports: list[TaskReport] = []
        delta = 0.0
        for k, level in enumerate(levels):
            last, free = level is levels[-1], Z
            found = self._solve(level, scale, x, Z, (square, zero) if last else None)
            if found is None:
                return guard.fall_back(Status.NOT_SOLVED, tip.V, np.nan, self._failed)
            x, Z = found
            if k == len(tip.levels):
                break
            delta = max(delta, level.beyond(x)) if self._rho else np.nan
            u = scale[:m] * x[:m]
            room = np.minimum(u - self._lower, self._upper - u)
            saturated = bool((room <= SAME * (self._upper - self._lower)).any())
            reports += _reports(tip, tip.levels[k], mu_map, mu_0, x, free, saturated=saturated)
        return replace(guard.accept(scale[:m] * x[:m], tip.V, delta), tasks=tuple(reports))

    def _solve(
        self,
        level: Level,
        scale: np.ndarray,
        x: np.ndarray,
        Z: np.ndarray,
        regulariser: tuple[np.ndarray, np.ndarray] | None,
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """An optimum x + Z w of a level, and the directions that it leaves free; None without one.

        Singular values of F Z that are too small are zero but for rounding. A regulariser, of the
        last level, is ‖square x - zero‖².
        """
        if Z.shape[1] == 0:
            return x, Z
        m, smallest = self._nu, RANK_TOLERANCE * level.largest
        rows, goal, beyond = level.F @ Z, level.f - level.F @ x, level.beyond(x)
        within = Z @ _null(rows, level.largest)
        slope = level.along @ rows
        if regulariser is not None:
            square, zero = regulariser
            U, values, Vt = np.linalg.svd(rows, full_matrices=False)
            rows = (U * np.where(values > EXACT * level.largest, values, 0.0)) @ Vt
            rows, goal = np.vstack((rows, square @ Z)), np.append(goal, zero - square @ x)
            smallest = 1e-14 * float(np.linalg.norm(rows, axis=1).max())
        G, at = scale[:m, None] * Z[:m], scale[:m] * x[:m]
        lower, upper = np.minimum(self._lower - at, 0.0), np.maximum(self._upper - at, 0.0)
        # With δ = max(0, …) the objective is one of two quadratics, with δ or without it. The right
        # one has a minimiser with the sign of δ that it assumes.
        late = level.rho > 0 and level.along @ level.f > level.bound
        for _ in range(2):
            both = rows, goal
            if late:
                root = np.sqrt(level.rho)
                both = np.vstack((rows, root * slope)), np.append(goal, -root * beyond)
            w = self._closest(*both, smallest, G, lower, upper)
            if w is None:
                return None
            if not level.rho or (slope @ w + beyond > 0) == late:
                break
            late = not late
        return x + Z @ w, within

    def _closest(
        self,
        rows: np.ndarray,
        goal: np.ndarray,
        smallest: float,
        G: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
    ) -> np.ndarray | None:
        """The w (k,) of least ‖rows w - goal‖² with lower ≤ G w ≤ upper; None without one.

        Singular values below `smallest` count as zero.
        """
        k = rows.shape[1]
        # k rows of zeros, so that there are k singular values
        U, values, Vt = np.linalg.svd(np.vstack((rows, np.zeros((k, k)))), full_matrices=False)
        counted = values > max(smallest, 1e-300)
        # unknowns y with w = T y: the objective is ‖y - aim‖², for those that count
        T = Vt.T / np.where(counted, values, values[counted].min() if counted.any() else 1.0)
        aim, weights = np.where(counted, goal @ U[: len(goal)], 0.0), np.where(counted, 1.0, RIDGE)
        sizes = np.linalg.norm(G, axis=1)
        moving = sizes > EXACT * sizes.max()  # the other inputs are fixed by the levels above
        key = k, int(moving.sum())
        if key not in self._qps:
            self._qps[key] = DenseQp(*key)
        H, A, y = np.diag(2 * weights), G[moving] @ T, np.zeros(k)
        # Directions that do not count have a small weight. The proximal point method removes its
        # effect: their aim is their last value.
        for _ in range(REPEATS):
            problem = QpProblem(H, -2 * weights * aim, A, lower[moving], upper[moving])
            found = self._qps[key].solve(problem)
            if found is None or not found.solved:
                self._failed = problem
                return None
            y, before = found.x, y
            if not np.abs((y - before)[~counted]).max(initial=0.0) > EXACT * np.abs(y).max():
                break
            aim = np.where(counted, aim, y)
        w: np.ndarray = T @ y
        return w


def _root(H: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(square, zero) with ‖square x - zero‖² = ½ xᵀH x + gᵀx but for a constant."""
    values, vectors = np.linalg.eigh(H / 2)
    root = np.sqrt(np.maximum(values, 0.0)) * vectors
    return root.T, np.linalg.lstsq(root, -g / 2)[0]


def _null(rows: np.ndarray, largest: float) -> np.ndarray:
    """Orthonormal columns (k, free) on which `rows` vanish, but for a share of `largest`."""
    if not rows.shape[1]:
        return np.zeros((0, 0))
    _, values, Vt = np.linalg.svd(rows)
    return Vt[np.count_nonzero(values > max(RANK_TOLERANCE * largest, 1e-300)) :].T


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
            model,
            gains,
            objective(gains),
            decrease=decrease,
            horizon=horizon,
            barriers=barriers,
        )
    if barriers is not None:
        raise InputError("tasks", "one level, beside barriers", "several")
    rest = objective(replace(gains, w1=0.0))
    return LevelQp(model, gains, rest, decrease=decrease, horizon=horizon)
