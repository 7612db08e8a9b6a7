"""Soft ID-CLF-QP, by default exactly as published, and its hard ancestor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softdyn import Reference, SetPoint, SoftModel, State
from softdyn.checks import array, number
from softdyn.compiled import compiled
from softdyn.controllers.barriers import BarrierRows, ControlBarrier
from softdyn.controllers.controller import Command, InputGuard, guarded
from softdyn.controllers.gains import Gains, resolve
from softdyn.controllers.programmes.horizon import over_hold
from softdyn.controllers.programmes.linear_algebra import (
    cholesky,
    dot,
    inner,
    row_space,
    substitute_back,
)
from softdyn.controllers.programmes.soft_inverse_dynamics import SoftInverseDynamics
from softdyn.controllers.programmes.task import Task
from softdyn.controllers.programmes.task_qp import Condensed, TaskQp


class SoftIdClfQp:
    """Paper, "Soft ID-CLF-QP": hard on the actuated dynamics, soft on the unactuated ones.

    Parameters
    ----------
    model : the robot.
    gains : the paper's for a bundled robot by default; required for any other.
    horizon : τ (s) of the dynamics, `programmes.horizon`; 0 is the published law.
    u_ref : the input (nu,), or one for all, that costs nothing: w3 ‖u - u_ref‖². Tension in all
        cables keeps co-contracted shapes from relaxing, `docs/beyond.md`; 0 in the paper.
    barriers : what not to run into, `barriers`; `barrier_rows` says what came of it.
        They want a horizon: the accelerations of damped joints at the start of a hold mislead.

    Raises
    ------
    InputError
        No gains for this robot, a robot without inputs, a negative horizon, or an u_ref of
        another shape.
    """

    name = "soft-id-clf-qp"

    def __init__(
        self,
        model: SoftModel,
        gains: Gains | None = None,
        *,
        horizon: float = 0.0,
        u_ref: np.ndarray | float = 0.0,
        barriers: Sequence[ControlBarrier] = (),
    ) -> None:
        self.gains = resolve(model, self.name, gains)
        self.horizon = number("horizon", horizon, lower=0.0)
        self.u_ref = array(
            "u_ref", [u_ref] * model.nu if np.ndim(u_ref) == 0 else u_ref, (model.nu,)
        )
        self.barrier_rows = BarrierRows(model, barriers, self.horizon) if barriers else None
        self._qp = TaskQp(
            model,
            self.gains,
            SoftInverseDynamics(self.gains, model.nu, self.u_ref),
            decrease=True,
            barriers=self.barrier_rows,
        )
        if self.barrier_rows is not None:
            self.barrier_rows.reset()  # of warming up
        self.guard, self.solvers = self._qp.guard, (self._qp.solver,)

    def share(self, guard: InputGuard) -> None:
        """Count and hold inputs in another law's guard: of one that takes turns with this one."""
        self.guard = self._qp.guard = guard

    def reset(self, period: float) -> None:
        """Begin a run; no law of its own depends on the control period (s)."""
        self.guard.reset()
        if self.barrier_rows is not None:
            self.barrier_rows.reset()

    @guarded
    def __call__(self, state: State, reference: Reference | SetPoint) -> Command:
        """The input at this state; see `Command`."""
        return self._qp.command(over_hold(state, self.horizon), reference)


class IdClfQp:
    """ID-CLF-QP after Reher et al. 2019: the whole dynamics M q̈ + h = B u as the constraint.

    The paper's Discussion reports that it does not converge on highly underactuated robots.
    Parameters and errors as for `SoftIdClfQp`.
    """

    name = "id-clf-qp"

    def __init__(self, model: SoftModel, gains: Gains | None = None) -> None:
        self.gains = resolve(model, self.name, gains)
        self._qp = TaskQp(
            model, self.gains, HardInverseDynamics(self.gains, model.nu), decrease=True
        )
        self.guard, self.solvers = self._qp.guard, (self._qp.solver,)

    def reset(self, period: float) -> None:
        """Begin a run; no law of its own depends on the control period (s)."""
        self.guard.reset()

    @guarded
    def __call__(self, state: State, reference: Reference | SetPoint) -> Command:
        """The input at this state; see `Command`."""
        return self._qp.command(state, reference)


class HardInverseDynamics:
    """The published objective with q̈ = M⁻¹(B u - h) substituted: the unknowns are u.

    w1 ‖μ - μ_ref‖² + w2 ‖q̈‖² + w3 ‖u‖² + w4 ‖N (q̈ + D q̇)‖².
    """

    def __init__(self, gains: Gains, nu: int) -> None:
        self.size = nu
        self._weights = np.array(
            [gains.w1, gains.w2, gains.w3, gains.w4, gains.null_damping], float
        )
        self._condensed = Condensed.empty(nu)

    def condense(self, state: State, task: Task) -> Condensed:
        """The programme at this state."""
        _hard(
            state.M, state.h, state.v, state.B.T, state.J, state.Jdot, task.mu_ref, task.yddot,
            self._weights, *self._condensed,
        )  # fmt: skip
        return self._condensed


@compiled
def _hard(
    M, h, v, Bt, J, Jdot, mu_ref, yddot, weights, H, g, mu_map, mu_0
):  # fmt: skip
    w1, w2, w3, w4, damping = weights[0], weights[1], weights[2], weights[3], weights[4]
    m, n = Bt.shape
    # q̈ = M⁻¹B u + drift; the rows of X are the columns of M⁻¹B, and drift
    right = np.empty((m + 1, n))
    right[:m], right[m] = Bt, -h
    R, X = cholesky(M, right)
    substitute_back(R, X)
    drift, damped = X[m], np.empty(n)
    for i in range(n):
        damped[i] = drift[i] + damping * v[i]
    reach = row_space(J)
    r = len(reach)
    RX, Rd = inner(reach, X[:m]), np.empty(r)
    for x in range(r):
        Rd[x] = dot(reach[x], damped)
    short = np.empty(3)
    for x in range(3):
        for j in range(m):
            mu_map[x, j] = dot(J[x], X[j])
        mu_0[x] = dot(J[x], drift) + dot(Jdot[x], v) - yddot[x]
        short[x] = mu_0[x] - mu_ref[x]
    # N is a projector: (N X)ᵀ N X = XᵀX - (R X)ᵀ R X
    for i in range(m):
        slope = w2 * dot(X[i], drift) + w4 * dot(X[i], damped)
        for x in range(3):
            slope += w1 * mu_map[x, i] * short[x]
        for x in range(r):
            slope -= w4 * RX[x, i] * Rd[x]
        g[i] = 2 * slope
        for j in range(i + 1):
            value = (w2 + w4) * dot(X[i], X[j])
            for x in range(3):
                value += w1 * mu_map[x, i] * mu_map[x, j]
            for x in range(r):
                value -= w4 * RX[x, i] * RX[x, j]
            H[i, j] = H[j, i] = 2 * value
        H[i, i] += 2 * w3
