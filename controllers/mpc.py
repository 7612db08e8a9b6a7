"""Model predictive control on the analytic linearisation at the present state.

Each call predicts the state at which its command will begin to act, and the tip over a short
horizon from there (`predictive.prediction`). A bounded QP chooses the inputs at a few knots. The
command moves the input along the first ramp. `docs/beyond.md` derives the objective and reports
the results. No number in it belongs to a robot: lengths, masses and stiffnesses enter through the
model, by the rules below.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from softdyn import Reference, SetPoint, SoftModel, State
from softdyn.checks import number, vector
from softdyn.controllers.channels import PHASE
from softdyn.controllers.controller import (
    SILENT,
    Command,
    InputGuard,
    KnownRig,
    Status,
    first_of,
    warm_up,
)
from softdyn.controllers.gains import check_fields, no_actuator
from softdyn.controllers.law import NamedLaw
from softdyn.controllers.predictive.actuation import Actuation
from softdyn.controllers.predictive.aim import Aim, TipAim, aim_of
from softdyn.controllers.predictive.buckling import buckling_input
from softdyn.controllers.predictive.objective import HorizonWeights, horizon_weights
from softdyn.controllers.predictive.prediction import RIDGE, Present, ahead, condensed_qp
from softdyn.controllers.predictive.pulls import FrictionPulls
from softdyn.controllers.predictive.rest_target import RestTargets
from softdyn.controllers.predictive.state_filter import StateFilter
from softdyn.controllers.predictive.stops import held_joints, stop_stiffness
from softdyn.controllers.predictive.supervisor import (
    Followed,
    Supervisor,
    moves,
    numbers,
)
from softdyn.controllers.qps.qp import DenseQp, QpProblem
from softdyn.dynamics.balance import ForceBalance
from softdyn.dynamics.model import check_model
from softdyn.tasks.task import Task
from softdyn.toml_table import TomlTable

KNOTS = (1, 3, 6, 12, 30)  # unknown inputs at the ends of these steps; the last is the horizon
DEFAULT_PERIOD = 0.002  # s
MOVES = 1e-3  # of the tip's most mobile direction: what moves less has no speed of its own
PATH = 0.1  # s, the horizon on a path that a buckled arm follows, and
LAGS = 4.0  # of the actuators' lag more
NO_DISTURBANCE = np.zeros(0)
LINK = ("lag", "delay", "friction")  # of the actuators (s), and of the cables
SHORTER = 5  # halvings of the horizon where the arm is unstable


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
    speed: float = 0.1
    rate: float = 1e-4
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
    return TomlTable({} if given is None else given, "parameters").make(MpcParameters)


class Mpc(NamedLaw):
    """min Σ ‖e_k‖² + speed² ‖q̇_k - v_k‖²_W + rate Σ ‖Δu‖²_R / steps  subject to u_min ≤ c ≤ u_max.

    W and R are one metric, the robot's dynamic stiffness over the horizon H at rest,
    S = M/H² + D/H + diag(k), in units of what it costs to move the tip: W = H² S / λ and
    R = Bᵀ S⁻¹ B / λ with 1/λ = ‖J S⁻¹ Jᵀ‖, so that both compare with m² of the tip's error.

    v_k are the joint speeds of least ‖·‖_W that move the tip like the reference.

    The inputs are those that act. The command c leads them by the actuators' lag, and is bounded
    at every knot. A joint at its limit is held by a stiff spring in the prediction; what else the
    model does not explain is estimated as a constant joint force d from the last period's
    prediction error, so that the tip settles without offset.

    An unstable state, such as that of a joint between two stops which its cables pull to either,
    grows by e^(H/τ) over the horizon H. Where τ is a few milliseconds, the growth leaves no digits
    of the QP's matrix for anything else: the ridge of `predictive.prediction` exceeds the inputs'
    own weights. There the horizon is halved until it does not.

    With tasks, e are their errors, scaled by the roots of their weights, and J their rows.

    Parameters
    ----------
    model : SoftModel
        The robot.
    parameters : MpcParameters or mapping, optional
        Or a mapping of its fields.
    period : float
        Control period T (s); `reset` sets another.
    lag, delay : float, optional
        Time constant (s) with which the inputs follow the commands, and time (s) from a state to
        the begin of the command that answers it; by default those of the plant that `reset` names,
        else the longest of the robot's file.
    friction : float or array_like, (tendons,), optional
        Coefficients of the cables' friction that the pulls make up for (`predictive.pulls`); by
        default as for lag and delay. What they leave is part of d.
    targets : RestTargets, optional
        Finds an equilibrium (q*, u*) for a set point at which the tip does not arrive: after 1 s
        farther than 5 mm away it is searched for, and 0.5 s later, or any second after, it acts if
        its tip is nearer by that. A plan leads to its shape. `softdyn.controllers.predictive` has
        the rules in its `supervisor`. A process of its own searches, for up to a minute,
        and the target acts later if that takes longer; see `waits` and `prepare`.
        The objective then has κ ‖u - u*‖²_diag(R), and σ ‖q - q*‖²_S if it is unstable. The
        `distance` of a command is that of its tip.
        With targets, a robot that its cables can buckle is pulled on paths.
    tasks : sequence of softdyn.tasks.Task, optional
        Tasks of one level; by default the position of the tip. An own K_p has no effect.

    Attributes
    ----------
    supervisor : Supervisor
        It decides what is followed; its phase is in each command's `values`.
    waits : bool
        Whether a call may wait for a search, so that equal runs have equal commands; False by
        default. `softdyn.validation.simulate` sets it for its calls.

    Raises
    ------
    InputError
        A robot without actuators, parameters of another kind, a negative lag or delay, tasks of
        several levels.
    """

    name = "mpc"
    options = LINK
    parameter_class = MpcParameters
    waits = False
    channels = (PHASE,)

    def __init__(
        self,
        model: SoftModel,
        parameters: Any = None,
        period: float = DEFAULT_PERIOD,
        *,
        lag: float | None = None,
        delay: float | None = None,
        friction: np.ndarray | float | None = None,
        targets: RestTargets | None = None,
        tasks: Sequence[Task] | None = None,
    ) -> None:
        if check_model(model).nu == 0:
            raise no_actuator(model)
        aim = aim_of(model, tasks)
        self.parameters = resolve_parameters(parameters)
        self.guard = InputGuard(model.u_min, model.u_max, model.robot)
        self.actuation = Actuation.of(model, delay, lag)
        self._pulls = FrictionPulls(model, friction)
        self._given = delay, lag, friction
        self._filter = StateFilter(model, self.parameters.memory)
        self._model, self._balance = model, ForceBalance(model, motors=())
        self._still = np.zeros((KNOTS[-1], model.nv))
        size = len(KNOTS) * model.nu
        self._qp = DenseQp(size, size)
        self.solvers = (self._qp,)
        given = self.parameters
        self._weigh = partial(horizon_weights, model, KNOTS, speed=given.speed, rate=given.rate)
        with np.errstate(all="ignore"):
            least = None if targets is None else buckling_input(model)
            self.targets, self.supervisor = targets, Supervisor(model, targets, least)
            self._weigh_rows(None)
        self._aim: Aim = TipAim()
        self.reset(period)
        warm_up(self, model, period)  # with the tip, because tasks have no targets yet
        self._aim, self.tasks = aim, aim.tasks
        self.reset(period)

    def _weigh_rows(self, rows: np.ndarray | None) -> None:
        """The weights at set points and on paths, for the errors' rows (r, n) at rest."""
        given, lag = self.parameters, self.actuation.lag
        self._usual = self._on_path = self._weigh(given.horizon, lag=lag, rows=rows)
        if self.supervisor.pulls:
            horizon = min(given.horizon, PATH + LAGS * lag)
            self._on_path = self._weigh(horizon, lag=lag, blind=True, rows=rows)
        self._shorter = [
            self._weigh(given.horizon / 2**k, lag=lag, rows=rows) for k in range(1, SHORTER + 1)
        ]

    def reset(self, period: float, rig: KnownRig | None = None) -> None:
        """Begin a run with a control period (s): forget the input applied, the estimated forces.

        Parameters
        ----------
        period : float
            Control period (s).
        rig : KnownRig, optional
            The rig of the plant, for what was not given; by default the file's.
        """
        self.period = number("period", period, above=0.0)
        self.guard.reset()
        self._drive(rig)
        self.actuation.reset(self.period, self.guard.held)
        self._filter.reset(self.period)
        self.supervisor.reset(self.period, self.actuation.lag)
        self._present: Present | None = None
        self._weighed = not self._aim.tasks

    def _drive(self, rig: KnownRig | None) -> None:
        """Take lag, delay and friction of a rig where they are not given."""
        delay, lag, friction = self._given
        before, self.actuation = self.actuation, Actuation.of(self._model, delay, lag, rig)
        self._pulls = FrictionPulls(self._model, friction, rig)
        if self.actuation.lag != before.lag:
            with np.errstate(all="ignore"):
                self._weigh_rows(None)

    @property
    def buckles(self) -> bool:
        """Whether it pulls the robot into buckled shapes on paths: with targets alone."""
        return self.supervisor.pulls

    @property
    def planning(self) -> bool:
        """Whether targets or a plan are searched in the background."""
        return self.supervisor.planning

    def prepare(self, reference: Reference | Callable[[float], Reference]) -> None:
        """Search for the targets of a set point now, for all runs of the robot's controllers.

        Parameters
        ----------
        reference : Reference or Callable[[float], Reference]
            A set point. A reference that moves has no targets.
        """
        now = first_of(reference)
        goals = self._aim.targets(now)
        if self.targets is not None and not any(map(moves, goals)):
            self.targets.find(numbers(goals), self._aim.tasks, now, waits=True)

    @SILENT
    def _command(self, state: State, reference: Reference | SetPoint) -> Command:
        """One step towards the target that the supervisor follows now."""
        moving = any(map(moves, self._aim.targets(reference)))
        small = math.isfinite(
            state.q @ state.q + state.v @ state.v
        )  # as all but hostile numbers are
        if not (small or (np.isfinite(state.q).all() and np.isfinite(state.v).all())):
            return self._fall_back(Status.NON_FINITE)
        if not self._weighed:
            rest = self._model.state(self._model.q0, np.zeros(self._model.nv))
            self._weigh_rows(self._aim(rest, reference, moving).rows)
            self._weighed = True
        now = self._observe(state, (self._on_path if moving else self._usual).step)
        error = self._aim(now.state, reference, moving)
        aim = self._aim
        target = self.supervisor(reference, aim, moving, error, now, waits=self.waits)
        self.guard.values = target.phase.channel
        return self._step(now, target)

    def _observe(self, state: State, step: float) -> Present:
        """The filtered state, its linear model, and what the actuation makes of it over the delay.

        `step` (s) is that of the prediction.
        """
        model, link = self._model, self.actuation
        acting, held = link.acting, held_joints(state)
        p, speed, unmodelled = self._filter(state, held)
        if self._filter.noisy:  # noise would enter the matrices, too
            state = model.state(model.integrate(state.q, p), speed)
            p = np.zeros(model.nv)
        v = state.v
        # the terms of `tangent_dynamics`
        terms = self._balance.trusted(state.q, v, np.zeros(model.nv), acting, NO_DISTURBANCE)
        K, D = terms.by_q, terms.by_v
        linear = state.M, K + np.diag(stop_stiffness(state, held, step)), D, state.B
        force = state.B @ acting - state.h + unmodelled + D @ v
        first, u = (p, speed), acting
        if link.delay > 0:
            means, u = link.over_delay(step)
            p, speed, _ = ahead(linear, force, first, means - acting, link.delay / len(means))
        return Present(state, linear, force, first, acting, p, speed, u)

    def _step(self, now: Present, target: Followed) -> Command:
        """The input for a target; V of the command is the cost that the horizon predicts.

        It has no memory but the filter's and the actuation's, which learn what is sent.

        Parameters
        ----------
        now : Present
            The present state.
        target : Followed
            What to follow, see `softdyn.controllers.predictive.supervisor`.
        """
        if target.command is not None:
            return self._send(target.command, np.nan, now, target)
        model, u = self._model, now.acting
        for weights in (self._on_path if target.moving else self._usual, *self._shorter):
            H, g, c = self._condensed(weights, now, target)
            if RIDGE * np.trace(H) <= np.trace(weights.inputs):
                break
        knots = len(KNOTS)
        lower, upper = np.tile(model.u_min - u, knots), np.tile(model.u_max - u, knots)
        problem = QpProblem(H, g, weights.rows, lower, upper)
        solution = self._qp.solve(problem)
        if solution is None or not solution.solved:
            status = Status.NON_FINITE if solution is None else Status.NOT_SOLVED
            return self._fall_back(status, problem)
        x = solution.x
        V = max(0.0, float(x @ (0.5 * (H @ x) + g)) + c)
        share = min(1.0, self.period / (KNOTS[0] * weights.step))
        asked = self.actuation.command_for(u + share * x[: model.nu], u)
        return self._send(asked, V, now, target)

    def _condensed(
        self, by: HorizonWeights, now: Present, target: Followed
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """The objective over one horizon."""
        u, aim, rest = now.acting, target.aim, target.rest
        t = by.ahead + self.actuation.delay
        error = aim.now - (aim.y + t * aim.ydot + 0.5 * t * t * aim.yddot)
        rows, inputs, offset = aim.rows, by.inputs, by.offset @ u
        if rest is not None:
            inputs, offset = inputs + by.hold, offset + by.hold_offset @ (u - rest.u)
            if not rest.stable:
                rows, model = np.vstack((rows, by.form)), self._model
                bent = by.form @ (model.coordinates(now.state.q) - model.coordinates(rest.q))
                error = np.hstack((error, np.tile(bent, (len(error), 1))))
        pace = self._pace(by.lookahead.metric, aim.rows, aim.ydot + t * aim.yddot)
        force = now.force
        if self.actuation.delay > 0:
            force = force + now.state.B @ (u - now.input)
        return condensed_qp(
            now.linear, force, (now.p, now.v), rows, error, pace, by.lookahead, inputs, offset
        )

    def _send(self, asked: np.ndarray, V: float, now: Present, target: Followed) -> Command:
        """The command that is sent, within its bounds; it also predicts the next state.

        A command of a plan has no bounds of its own, as a QP's answer has.
        """
        clamped = target.command is not None
        command, self._present = self.guard.accept(asked, V, np.nan, clamped), None
        if command.status is Status.OK:
            self._present = now
        self._expect(self.actuation.send(command.u))
        if self._pulls.rubs and command.status is Status.OK:
            command = replace(command, u=self._pulls(command.u, now.state, self._filter.force))
        if target.rest is not None:
            command = replace(command, distance=target.rest.distance)
        return command

    @SILENT
    def applied(self, u: np.ndarray) -> None:
        """The input u (nu,) was sent instead of the last command's.

        Raises
        ------
        InputError
            For a wrong shape or a number that is not finite.
        """
        sent = vector("u", u, self._model.nu)
        self._expect(self.actuation.send_instead(self._pulls.inputs(sent)))

    def _expect(self, mean: np.ndarray) -> None:
        """Predict the next state from the mean input (nu,) of this period."""
        now = self._present
        if now is not None:
            change = (mean - now.input)[None]
            p, speed, matrix = ahead(now.linear, now.force, now.first, change, self.period)
            self._filter.expect(self._model.integrate(now.state.q, p), speed, matrix)

    def _pace(self, metric: np.ndarray, J: np.ndarray, ydot: np.ndarray) -> np.ndarray:
        """Metric times the joint speeds (N, nv) of least metric that move the tip at ẏ (N, r).

        With the rows G = J (metric)⁻¹ these are G⁺ ẏ; directions that hardly move the tip are left
        out.
        """
        if not ydot.any():
            return self._still
        G = np.linalg.solve(metric.T, J.T).T
        left, values, right = np.linalg.svd(G, full_matrices=False)
        inverse = np.where(values > MOVES * values[0], 1.0 / np.maximum(values, 1e-300), 0.0)
        pace: np.ndarray = ((ydot @ left) * inverse) @ right
        return pace

    def _fall_back(self, status: Status, problem: QpProblem | None = None) -> Command:
        self._present = None
        self._filter.forget()
        if not np.isfinite(self._filter.force).all():
            self._filter.reset(self.period)
        command = self.guard.fall_back(status, np.nan, np.nan, problem)
        self.actuation.send(command.u)
        return command
