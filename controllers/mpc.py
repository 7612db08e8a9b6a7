"""Model predictive control on the analytic linearisation at the present state.

Each call predicts the tip over a short horizon with `qps.prediction`, chooses the inputs
at a few knots by a bounded QP, and moves the input along the first ramp. `docs/beyond.md` derives
the objective and reports what it reaches. No number in it belongs to a robot: lengths, masses and
stiffnesses enter through the model, by the rules below.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SetPoint, SoftModel, State
from softdyn.checks import number
from softdyn.controllers.controller import (
    SILENT,
    Command,
    GuardedController,
    InputGuard,
    Status,
    warm_up,
)
from softdyn.controllers.gains import check_fields, no_actuator
from softdyn.controllers.qps.prediction import condensed_qp, one_period, ramps
from softdyn.controllers.qps.qp import DenseQp, QpProblem
from softdyn.dynamics.derivatives import tangent_dynamics
from softdyn.dynamics.model import check_model

KNOTS = (1, 3, 6, 12, 30)  # unknown inputs at the ends of these steps; the last is the horizon
DEFAULT_PERIOD = 0.002  # s
SIZE = 1e-8  # weight of ‖u‖² beside that of its rate: it only picks among equal answers
NEAR_STOP = 2e-3  # of a joint's range: so near to its limit it is held by the stop
STOP = 1e4  # stiffness of a stop, in M_jj / Δt²


@dataclass(frozen=True)
class MpcParameters:
    """Parameters of `Mpc`; the same defaults for every robot.

    Attributes
    ----------
    horizon : float
        How far ahead it looks (s).
    speed : float
        Time (s) that makes joint speeds comparable with the tip's error.
    rate : float
        Weight of the inputs' changes beside the tip's error.
    memory : float
        Time constant (s) of the estimate of unmodelled joint forces.
    """

    horizon: float = 0.3
    speed: float = 0.05
    rate: float = 1e-3
    memory: float = 0.1

    def __post_init__(self) -> None:
        check_fields(self, "parameters", positive=vars(self))


def resolve_parameters(given: MpcParameters | Mapping[str, Any] | None) -> MpcParameters:
    """The parameters meant by a constructor's argument.

    Raises
    ------
    InputError
        For anything but an `MpcParameters`, a mapping of its fields, or None.
    """
    if isinstance(given, MpcParameters):
        return given
    table = {} if given is None else given
    names = [field.name for field in fields(MpcParameters)]
    if isinstance(table, Mapping) and set(table) <= set(names):
        return MpcParameters(**table)
    raise InputError(
        "parameters", f"softdyn.controllers.MpcParameters ({', '.join(names)})", repr(given)
    )


class Mpc(GuardedController):
    """min Σ ‖e_k‖² + speed² ‖q̇_k‖²_W + rate Σ ‖Δu‖²_R / steps  subject to u_min ≤ u ≤ u_max.

    W and R are one metric, the robot's dynamic stiffness over the horizon H at rest,
    S = M/H² + D/H + diag(k), in units of what it costs to move the tip: W = H² S / λ and
    R = Bᵀ S⁻¹ B / λ with 1/λ = ‖J S⁻¹ Jᵀ‖, so that both compare with m² of the tip's error.

    A joint at its limit is held by a stiff spring in the prediction; what else the model does not
    explain is estimated as a constant joint force d from the last period's prediction error, so
    that the tip settles without offset.

    Parameters
    ----------
    model : SoftModel
        The robot.
    parameters : MpcParameters or mapping, optional
        Or a mapping of its fields.
    period : float
        Control period T (s); `reset` sets another.

    Raises
    ------
    InputError
        A robot without actuators, or parameters of another kind.
    """

    name = "mpc"

    def __init__(
        self, model: SoftModel, parameters: Any = None, period: float = DEFAULT_PERIOD
    ) -> None:
        if check_model(model).nu == 0:
            raise no_actuator(model)
        self.parameters = resolve_parameters(parameters)
        self.guard = InputGuard(model.u_min, model.u_max, model.robot)
        self._model = model
        self._step = self.parameters.horizon / KNOTS[-1]
        self._ahead = self._step * np.arange(1.0, KNOTS[-1] + 1)[:, None]
        self._shape = ramps(KNOTS)
        size = len(KNOTS) * model.nu
        self._qp, self._identity = DenseQp(size, size), np.eye(size)
        self.solvers = (self._qp,)
        with np.errstate(all="ignore"):
            self._weigh(model)
        span = model.upper - model.lower
        self._margin = np.where(np.isfinite(span), NEAR_STOP * span, 0.0)
        self.reset(period)
        warm_up(self, model, period)

    def reset(self, period: float) -> None:
        """Begin a run with a control period (s): forget the input applied, the estimated forces."""
        model = self._model
        self.period = number("period", period, above=0.0)
        self.guard.reset()
        self._u = self.guard.held
        self._unmodelled = np.zeros(model.nv)
        self._expected: tuple[np.ndarray, np.ndarray] | None = None
        self._held = np.zeros(model.nv, bool)

    @SILENT
    def _command(self, state: State, reference: Reference | SetPoint) -> Command:
        """V of the command is the cost that the horizon predicts."""
        model, u, v = self._model, self._u, state.v
        small = math.isfinite(state.q @ state.q + v @ v)  # as all but hostile numbers are
        if not (small or (np.isfinite(state.q).all() and np.isfinite(v).all())):
            self._expected = None
            return self.guard.fall_back(Status.NON_FINITE, np.nan, np.nan)
        K, D = tangent_dynamics(model, state.q, v, u)
        held = self._at_stops(state)
        unmodelled = self._estimate(v, held)
        force = state.B @ u - state.h + unmodelled
        stopped = K + np.diag(np.where(held, STOP / self._step**2 * np.diag(state.M), 0.0))
        t = self._ahead
        goal = reference.y + t * reference.ydot + 0.5 * t * t * reference.yddot
        H, g, c = condensed_qp(
            state.M, stopped, D, state.B, state.J, force, v, state.y - goal, self._shape,
            self._step, self._metric, self._inputs, self._offset @ u,
        )  # fmt: skip
        knots = len(KNOTS)
        lower, upper = np.tile(model.u_min - u, knots), np.tile(model.u_max - u, knots)
        solution = self._qp.solve(QpProblem(H, g, self._identity, lower, upper))
        if solution is None or not solution.solved:
            self._expected = None
            status = Status.NON_FINITE if solution is None else Status.NOT_SOLVED
            return self.guard.fall_back(status, np.nan, np.nan)
        x = solution.x
        V = max(0.0, float(x @ (0.5 * (H @ x) + g)) + c)
        share = min(1.0, self.period / (KNOTS[0] * self._step))
        command = self.guard.accept(u + share * x[: model.nu], V, np.nan)
        if command.status is Status.OK:
            push = force + state.B @ (command.u - u)
            self._expected = one_period(state.M, stopped, D, push, v, self.period)
            self._unmodelled, self._held, self._u = unmodelled, held, command.u
        return command

    def _weigh(self, model: SoftModel) -> None:
        """The metric of joint speeds and inputs, at rest."""
        state, H = model.state(model.q0, np.zeros(model.nv)), self.parameters.horizon
        S = state.M / H**2 + state.D / H + np.diag(model.stiffness)
        factor = np.linalg.cholesky(S)
        compliance = np.linalg.norm(state.J @ np.linalg.solve(S, state.J.T), 2)
        self._metric = self.parameters.speed * H * math.sqrt(compliance) * factor.T.copy()
        R = self.parameters.rate * compliance * state.B.T @ np.linalg.solve(S, state.B)
        lengths = np.diff((0, *KNOTS)).astype(float)
        differences = np.eye(len(KNOTS)) - np.eye(len(KNOTS), k=-1)
        rates = differences.T @ np.diag(1 / lengths) @ differences
        self._inputs = np.kron(rates, R) + np.kron(np.diag(lengths), SIZE * R)
        self._offset = np.kron(lengths[:, None], SIZE * R)

    def _at_stops(self, state: State) -> np.ndarray:
        """Whether each joint (nv,) is held by a stop."""
        q, model = self._model.coordinates(state.q), self._model
        held: np.ndarray = (q >= model.upper - self._margin) | (q <= model.lower + self._margin)
        return held

    def _estimate(self, v: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Unmodelled joint forces (nv,), from what the last period did not do as predicted."""
        estimate = self._unmodelled
        if self._expected is not None:
            expected, matrix = self._expected
            residual = matrix @ (v - expected) / self.period
            share = min(1.0, self.period / self.parameters.memory)
            estimate = estimate + share * np.where(held | self._held, 0.0, residual)
        return np.where(held, 0.0, estimate)
