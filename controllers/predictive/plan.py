"""Plans through a fold: bounded commands that move a robot from a state to an equilibrium (q*, u*).

A path obeys the analytic model in steps T of backward Euler,

    M (q̇⁺ - q̇) / T + h - B ā + stops = 0 at (q⁺, q̇⁺),   q⁺ = q ⊕ T q̇⁺,   a⁺ = E a + (1 - E) c,

where a joint beyond a limit meets a stiff spring (`SpringStops`). (With the stops of `Stops`,
`best` on SpiRob at θ = 0.25 with a lag of 10 ms ended at 7.38 cm instead of 0.29.) E = e^(-T/λ) is
the share of the acting input a that actuators of lag λ keep, and ā its mean over the step
(`softdyn.actuation.drives`). The commands c minimise

    Σ ‖y - y*‖² + speed² ‖q̇‖²_W + κ ‖a - u*‖²_diag(R) + σ ‖q - q*‖²_S / λ_S + rate ‖a⁺ - a‖²_R

in the metric of `Mpc`, where the last state counts `TAIL` times more. The first guess goes straight
to q*: simulated from the start alone, an arm that buckles loses the target's shape. `ilqr` has the
search.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from softdyn import SoftModel
from softdyn.controllers.predictive.ilqr import Path, PathProblem, search_path
from softdyn.controllers.predictive.objective import stiffness_at_rest
from softdyn.controllers.predictive.rest_target import RestTarget
from softdyn.controllers.predictive.stops import SpringStops
from softdyn.dynamics.balance import ForceBalance
from softdyn.dynamics.implicit_step import ImplicitStep
from softdyn.dynamics.motors import lag_shares
from softdyn.dynamics.stops import Stops

# Lines "x 0.1" and "x 10" as in `ilqr`, for the same two plans. Lines that begin with B are of two
# others, of SpiRob to 0.25π and 0.3π with a lag of 10 ms. As it is they end 3.2 and 1.4 cm away.
TRAVELS = (1.0, 0.6)  # s, durations of the first guess, tried one after the other
# B, x 0.1: 3.9 and 8.1 cm. x 10: 5.6 and 5.0 cm. The first alone: 11.8 and 3.2 cm.
NEAR = 0.05  # of the first ‖q - q*‖²_S: a path that ends nearer is taken
# B, x 0.1: all eight first guesses are tried, in place of eight and four. x 10: the first one is
# taken, 3.4 and 1.3 cm. A run at 0.25π loses its plans as before, and ends at 39 in place of 5 cm.
USEFUL = 0.25  # one that ends farther is no plan
# B, x 0.1: no plan to 0.25π. x 10: the same plans; it refuses those that fold nothing, such as the
# paths with 0.98 of it left that HORIZON, SPEED and TRAVELS x 10 give.
STEP = 0.01  # T (s)
# x 0.5: the steps are nearer to the motion of a fold. Two of five plans of SpiRob are lost when the
# same model follows them in steps of 5 ms or less. One that is planned in 5 ms holds.
# B, x 0.5: 1.5 cm, and from this first guess no plan, in twice the time.
STEPS = 150
# x 0.1: no plan.
FORM = 0.3  # σ
# x 0.1: 1.0 and 8.4 cm, in 6 and 7 s.
HORIZON, SPEED, RATE, HOLD = 0.3, 0.05, 1e-3, 1e-3  # s, s; the weights, as `Mpc` has them
# B, HORIZON x 0.1: 21 and 31 cm. x 10: 3.0 and 5.0 cm; the second shape is not reached.
# B, SPEED x 0.1: 11 and 0.3 cm, but the same model in steps of 2 ms is lost. x 10: 4.1 and 5.0 cm.
# HOLD x 0.1: gains two and five times as large, 0.6 and 3.3 cm. x 10: 1.9 and 10 cm.
# RATE x 0.1: 0.5 and 3.9 cm. x 10: 2.0 and 7.0 cm.
TAIL = 50.0
# x 0.1: 1.0 and 2.0 cm.
CLOSE = 1e-4  # rad, m: a step's error before Newton's last iteration, which leaves its square
# x 0.1: a third more time. x 10: 0.6 and 1.3 cm.


@dataclass(frozen=True, eq=False)
class Plan:
    """A path of commands and states through N steps, and the gains that keep a robot on it.

    Attributes
    ----------
    target : RestTarget
        The equilibrium it goes to.
    lag : float
        Time constant (s) of the actuators.
    q, v, acting : ndarray, (N + 1, nv), (N + 1, nv), (N + 1, nu)
        Joint coordinates, velocities and acting inputs.
    commands : ndarray, (N, nu)
        The command during each step, within the bounds.
    gains : ndarray, (N, nu, 2 nv + nu)
        Change of the command by the differences of (q, q̇, a); zero for a command at a bound.
    """

    target: RestTarget
    lag: float
    q: np.ndarray
    v: np.ndarray
    acting: np.ndarray
    commands: np.ndarray
    gains: np.ndarray

    @property
    def duration(self) -> float:
        """The time to its end (s)."""
        return STEP * len(self.commands)

    def command(self, t: float, q: np.ndarray, v: np.ndarray, acting: np.ndarray) -> np.ndarray:
        """The command (nu,), not yet bounded, at the time t in a state of the robot.

        Parameters
        ----------
        t : float
            Time since the plan's begin (s), before its end.
        q, v, acting : ndarray, (nv,), (nv,), (nu,)
            Joint coordinates, velocities, acting input.
        """
        k = min(int(t / STEP + 1e-9), len(self.commands) - 1)
        part = t / STEP - k
        planned = [(1 - part) * x[k] + part * x[k + 1] for x in (self.q, self.v, self.acting)]
        # an input that acts at once is no state between the plan's steps
        late = acting - planned[2] if self.lag > 0 else np.zeros_like(acting)
        away = np.concatenate((q - planned[0], v - planned[1], late))
        command: np.ndarray = self.commands[k] + self.gains[k] @ away
        return command


@np.errstate(all="ignore")  # paths that are no solution may overflow
def make_plan(
    model: SoftModel, q: np.ndarray, v: np.ndarray, acting: np.ndarray,
    targets: Sequence[RestTarget], goal: np.ndarray | None = None, lag: float = 0.0,
    wait: float = 0.0,
) -> Plan | None:  # fmt: skip
    """A plan from a state to one of some equilibria; None if no path comes near a target's shape.

    The targets are tried one after the other, until a path ends in the target's shape. If none
    does, the plan is the path that ends nearest. It depends on the arguments alone.

    Parameters
    ----------
    model : SoftModel
        The robot.
    q, v, acting : ndarray, (nq,), (nv,), (nu,)
        The state at its begin, and the input that acts then.
    targets : sequence of RestTarget
        The equilibria, the best first.
    goal : ndarray, (3,), optional
        The point (m) for the tip, by default the tip of the target.
    lag : float
        Time constant (s) of the actuators.
    wait : float
        Time (s) for which the acting input stays before the plan begins.
    """
    best: tuple[float, Plan] | None = None
    for target, travel in product(targets, TRAVELS):
        y = model.state(target.q, np.zeros(model.nv)).y if goal is None else goal
        try:
            problem = coast(pose(model, (q, v, acting), target, y, lag), wait)
            found = None if problem is None else search_path(problem, problem.straight(travel))
        except np.linalg.LinAlgError:
            continue
        if problem is None or found is None:
            continue
        left = problem.left(found[0])
        if left < (USEFUL if best is None else best[0]):
            best = left, problem.plan(lag, *found)
        if left < NEAR:
            break
    return None if best is None else best[1]


def pose(
    model: SoftModel, start: tuple[np.ndarray, np.ndarray, np.ndarray], target: RestTarget,
    goal: np.ndarray, lag: float,
) -> WayToRest:  # fmt: skip
    """The problem of a way from (q, q̇, a) to an equilibrium; the tip should be at goal (3,)."""
    n, m = model.nv, model.nu
    state, S, compliance = stiffness_at_rest(model, HORIZON)
    R = compliance * state.B.T @ np.linalg.solve(S, state.B)
    decay, mean = (float(share) for share in lag_shares(STEP, lag))
    weight = np.zeros((2 * n + m, 2 * n + m))
    weight[:n, :n] = FORM * compliance * S
    weight[n : 2 * n, n : 2 * n] = (SPEED * HORIZON) ** 2 * compliance * S
    weight[2 * n :, 2 * n :] = HOLD * np.diag(np.diag(R))
    change = (1 - decay) ** 2 * RATE * (R + 1e-8 * np.trace(R) * np.eye(m))
    return WayToRest(
        start=np.concatenate((model.coordinates(start[0]), *start[1:])),
        aim=np.concatenate((model.coordinates(target.q), np.zeros(n), target.u)),
        weight=weight, last=TAIL * weight, change=change, unit=np.diag(np.diag(R)),
        lower=model.u_min, upper=model.u_max, model=model, target=target, goal=goal,
        decay=decay, mean=mean,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class WayToRest(PathProblem):
    """A way to a target; its states are joint coordinates, velocities and acting inputs.

    Attributes
    ----------
    target : RestTarget
        The equilibrium.
    goal : ndarray, (3,)
        The point (m) for the tip.
    decay, mean : float
        Shares of the first input in the acting input after a step, and in its mean over it.
    """

    model: SoftModel
    target: RestTarget
    goal: np.ndarray
    decay: float
    mean: float

    @cached_property
    def _implicit(self) -> ImplicitStep:
        balance = SpringStops(self.model, ForceBalance(self.model, motors=()), STEP)
        return ImplicitStep(self.model, balance, Stops.none(self.model), CLOSE)

    def step(
        self, x: np.ndarray, c: np.ndarray, guess: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """The state after a step with springs for stops, and its derivatives.

        Newton's method begins at the velocity of `guess`; None if it does not converge.
        """
        model, n, m, E = self.model, self.model.nv, self.model.nu, self.decay
        q, v, a = model.configuration(x[:n]), x[n : 2 * n], x[2 * n :]
        input_ = self.mean * a + (1 - self.mean) * c
        found = self._implicit(q, v, input_, np.zeros(0), STEP, guess=guess[n : 2 * n])
        if found is None:
            return None
        A, B = np.zeros((2 * n + m, 2 * n + m)), np.zeros((2 * n + m, m))
        by_u = found.by_force @ model.state(found.q, found.v).B
        A[n : 2 * n] = np.hstack((found.by_state, self.mean * by_u))
        B[n : 2 * n] = (1 - self.mean) * by_u
        A[:n], B[:n] = STEP * A[n : 2 * n], STEP * B[n : 2 * n]
        A[:n, :n] += np.eye(n)
        A[2 * n :, 2 * n :], B[2 * n :] = E * np.eye(m), (1 - E) * np.eye(m)
        return np.concatenate((model.coordinates(found.q), found.v, E * a + (1 - E) * c)), A, B

    def output(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The tip's error (3,) and its Jacobian (3, nv)."""
        n = self.model.nv
        state = self.model.state(self.model.configuration(x[:n]), x[n : 2 * n])
        return state.y - self.goal, state.J

    def straight(self, travel: float) -> np.ndarray:
        """States (N, 2 nv + nu) on the straight line to the target, there after a time (s)."""
        n, way = self.model.nv, self.aim - self.start
        t = np.minimum(STEP * np.arange(1, STEPS + 1) / travel, 1.0)[:, None]
        states: np.ndarray = self.start + t * t * (3 - 2 * t) * way
        states[:, n : 2 * n] = 6 * t * (1 - t) / travel * way[:n]
        return states

    def left(self, path: Path) -> float:
        """Share of ‖q - q*‖²_S of the begin that is left at the end of a path."""
        n = self.model.nv
        first, last = (path.x[0] - self.aim)[:n], path.away[-1][:n]
        form = self.weight[:n, :n]
        return float(last @ form @ last) / max(float(first @ form @ first), 1e-300)

    def plan(self, lag: float, path: Path, gains: np.ndarray) -> Plan:
        """The plan of a path, for actuators of that lag (s)."""
        n = self.model.nv
        q, v, acting = path.x[:, :n], path.x[:, n : 2 * n], path.x[:, 2 * n :]
        return Plan(self.target, lag, q, v, acting, path.commands, gains)


def coast(problem: WayToRest, duration: float) -> WayToRest | None:
    """The problem some time (s) later, if the acting input stays; None if that has no solution."""
    x = problem.start
    c = x[2 * problem.model.nv :]
    for _ in range(round(duration / STEP)):
        solved = problem.step(x, c, x)
        if solved is None:
            return None
        x = solved[0]
        x[2 * problem.model.nv :] = c
    return replace(problem, start=x)
