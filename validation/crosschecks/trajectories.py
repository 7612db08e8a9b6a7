"""Trajectories of both engines: same scheme, same step, same inputs.

Rounding separates two exact copies of one system as fast as the system amplifies it. An undamped
chain of a dozen links is chaotic and forgets its initial state within seconds. So undamped robots
are followed for a quarter of a second. Every comparison ends when two runs of one engine that start
1e-8 apart have separated a thousandfold. The ladders of halved steps show that both engines
converge to the same motion, at the order of the scheme. Agreement at one step cannot show this.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from softdyn.dynamics.derivatives import total_damping
from softdyn.dynamics.integrators import step_implicit, step_rk4
from softdyn.dynamics.model import SoftModel
from softdyn.validation.crosschecks.mujoco_terms import MujocoTerms
from softdyn.validation.crosschecks.result import Rung, StepLadder, TrajectoryRun
from softdyn.validation.twin.free_base import step_free_implicit, step_free_rk4
from softdyn.validation.twin.twin import SimulationError

Start = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Scheme:
    """An integration scheme that both engines have.

    Attributes
    ----------
    name : str
        The name shown to a reader.
    step, free_step : callable
        Our step, and our step for a floating base.
    integrator : str
        The twin's name of the scheme.
    order : int
        Expected order of convergence.
    most_steps : int
        The largest number of steps of a comparison.
    """

    name: str
    step: Callable[..., Start]
    free_step: Callable[..., Start]
    integrator: str
    order: int
    most_steps: int


IMPLICIT = Scheme("implicit", step_implicit, step_free_implicit, "implicitfast", 1, 2000)
RK4 = Scheme("rk4", step_rk4, step_free_rk4, "rk4", 4, 400)
HORIZON = 1.0  # s, for a robot whose joints are all damped
HORIZON_UNDAMPED = 0.25
STEP = 5e-4  # s, at most
HOLD = 40  # steps for which an input is held
MOST_INPUT = 1e3
NUDGE = 1e-8
GROWTH = 1e3
RUNGS = 3
RUNG_STEPS = 48


@dataclass(frozen=True)
class Rates:
    """How fast a robot moves under its own forces.

    Attributes
    ----------
    damping : float
        λmax(M⁻¹D), 1/s.
    motion : float
        The fastest rate of springs, gravity and speed, 1/s.
    damped : bool
        Whether every joint is damped, so that rounding dies out.
    """

    damping: float
    motion: float
    damped: bool


def compare_trajectories(
    model: SoftModel, judge: MujocoTerms, rng: np.random.Generator, report: Callable[[str], None]
) -> tuple[tuple[TrajectoryRun, ...], tuple[StepLadder, ...]]:
    """Free and forced runs with every scheme the two engines share, and their ladders.

    A scheme under which MuJoCo cannot follow the robot has one run of no length that says why.

    Parameters
    ----------
    model : SoftModel
        The analytic model.
    judge : MujocoTerms
        The twin's terms.
    rng : Generator
        Draws the initial state and the inputs.
    report : callable
        Called with a short text about the current step.

    Raises
    ------
    SimulationError
        MuJoCo can follow the robot under no scheme.
    InputError, LinAlgError
        A trajectory is no longer finite.
    """
    start = random_start(model, rng)
    race = Race(model, judge, start, rates_of(model, *start), circles(model))
    # MuJoCo's implicit schemes drop damping between branches. For a free body that carries nothing
    # they treat the gyroscopic force implicitly. So both engines share no implicit scheme there.
    alone = model.robot.floating and not model.robot.moving_joints
    # Forces of one's own may damp a base, whose velocities have other axes in MuJoCo.
    dragged = model.robot.floating and model.forced
    # A judge that steps itself knows the slopes of linear dampers only.
    tied = judge.steps_itself and (bool(model.robot.fluid) or model.curved)
    none = alone or dragged or tied or damping_couples_branches(model, *start)
    share = share_of(model, *start)
    runs, ladders, refused = list[TrajectoryRun](), list[StepLadder](), list[SimulationError]()
    for scheme in (RK4,) if none else (IMPLICIT, RK4):
        try:
            for name, part in (("free", 0.0), ("forced", share)):
                if part or name == "free":
                    report(f"{name} trajectory, {scheme.name}")
                    runs.append(race.run(name, scheme, part, rng))
            report(f"step halving, {scheme.name}")
            ladders.append(race.ladder(scheme))
        except SimulationError as error:
            step, *_ = plan(scheme, race.rates)
            runs.append(TrajectoryRun("none", scheme.name, step, 0.0, math.nan, error.reason))
            refused.append(error)
    if not any(run.duration for run in runs):
        raise refused[0]
    return tuple(runs), tuple(ladders)


def damping_couples_branches(
    model: SoftModel, q: np.ndarray, v: np.ndarray, more: Mapping[str, float] | None = None
) -> bool:
    """Whether tendon damping couples two joints on different branches.

    MuJoCo's implicit schemes store M + h D in the sparsity of M and drop such terms. `more` is
    damping by tendon that acts beside the tendons' own.
    """
    if model.robot.followers:  # `MujocoTerms` integrates a robot with followers, and drops nothing
        return False
    parents = {joint.name: joint.parent for joint in model.robot.joints}
    free = model.nv - len(parents.keys() & set(model.joint_names))  # the floating base's own
    names = model.joint_names[free:]
    below = [{joint.name for joint in model.robot.chain(parents[name])} for name in names]
    state = model.state(q, v)
    damping = [t.damping + (more or {}).get(t.name, 0.0) for t in model.robot.tendons]
    arms = state.moment_arms.copy()
    for t, tendon in enumerate(model.robot.tendons):
        if tendon.wraps:  # which of its joints count changes where it touches its bodies
            links = [site.link for site in tendon.sites] + [wrap.link for wrap in tendon.wraps]
            chains = [{joint.name for joint in model.robot.chain(link)} for link in links]
            moving = set().union(*chains) - chains[0].intersection(*chains)
            arms[t, free:] = [name in moving for name in names]
    D = (arms.T * damping) @ arms
    D = D[free:, free:]
    return any(
        D[i, j] != 0.0 and names[i] not in below[j] and names[j] not in below[i]
        for i in range(len(names))
        for j in range(i)
    )


def distance(a: Start, b: Start, circular: np.ndarray) -> float:
    """The larger relative distance of positions and velocities; continuous joints count modulo 2π.

    Relative to the largest entry, 1 rad (m) and 1 rad/s (m/s).
    """
    turn = np.where(circular, 2 * np.pi, np.inf)
    gaps = a[0] - b[0]
    gaps = np.where(circular, np.remainder(gaps + np.pi, 2 * np.pi) - np.pi, gaps)
    sizes = np.minimum(np.abs(a[0]), turn).max(), np.minimum(np.abs(b[0]), turn).max()
    position = np.abs(gaps).max() / max(*sizes, 1.0)
    speed = max(np.abs(a[1]).max(), np.abs(b[1]).max(), 1.0)
    return float(np.maximum(position, np.abs(a[1] - b[1]).max() / speed))


def input_window(model: SoftModel) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bounds (nu,) of random inputs: the robot's own, at most ±1000."""
    lower, upper = np.clip([model.u_min, model.u_max], -MOST_INPUT, MOST_INPUT)
    return lower, upper


def random_start(model: SoftModel, rng: np.random.Generator) -> Start:
    """A random state in the middle half of the limits, within ±π/4, with small velocities."""
    lower, upper = np.maximum(model.lower, -np.pi / 4), np.minimum(model.upper, np.pi / 4)
    lower, upper = np.minimum(lower, upper), np.maximum(lower, upper)
    middle, half = (lower + upper) / 2, (upper - lower) / 4
    reach = np.clip(upper - lower, 0.1, 1.0) / 2
    q = model.configuration(middle + half * rng.uniform(-1, 1, model.nv))
    return q, reach * rng.uniform(-1, 1, model.nv)


def rates_of(
    model: SoftModel, q: np.ndarray, v: np.ndarray, winches: np.ndarray | float = 0.0
) -> Rates:
    """The rates of damping, and of springs, `winches` (nv, nv), gravity and speed at one state."""
    state = model.state(q, v)
    D = total_damping(state)
    damping = np.abs(np.linalg.eigvals(np.linalg.solve(state.M, D))).max()
    stiffness = model.tangent_stiffness(q) + winches
    springs = np.abs(np.linalg.eigvals(np.linalg.solve(state.M, stiffness))).max()
    pull = np.abs(np.linalg.solve(state.M, state.bias + state.K)).max()
    motion = max(np.sqrt(springs), np.sqrt(pull), np.abs(v).max(), 1.0)
    return Rates(float(damping), float(motion), bool((np.diag(D) > 0).all()))


def share_of(model: SoftModel, q: np.ndarray, v: np.ndarray) -> float:
    """Share of the input range (at most 1) that about doubles the acting forces."""
    if not model.nu:
        return 0.0
    state = model.state(q, v)
    most = np.abs(state.B) @ np.abs(input_window(model)).max(axis=0)
    pull = np.abs(state.bias + state.K).max()
    return float(min(1.0, max(pull, 1e-3) / max(most.max(), 1e-300)))


def plan(scheme: Scheme, rates: Rates) -> tuple[float, list[int], int]:
    """Step (s), steps of every hold, and the number of steps of the whole horizon."""
    fastest = rates.motion if scheme is IMPLICIT else max(rates.damping, rates.motion)
    step = min(STEP, 0.5 / fastest)
    wanted = math.ceil((HORIZON if rates.damped else HORIZON_UNDAMPED) / step)
    total = min(wanted, scheme.most_steps)
    return step, [min(HOLD, total - done) for done in range(0, total, HOLD)], wanted


@dataclass(frozen=True, eq=False)
class Race:
    """One robot in both engines, from one state (q, v)."""

    model: SoftModel
    judge: MujocoTerms
    start: Start
    rates: Rates
    circular: np.ndarray

    def run(
        self, name: str, scheme: Scheme, share: float, rng: np.random.Generator
    ) -> TrajectoryRun:
        """Follow one trajectory in both engines, input by input."""
        step, holds, wanted = plan(scheme, self.rates)
        lower, upper = input_window(self.model)
        inputs = [share * rng.uniform(lower, upper) for _ in holds]
        return self.compare(name, scheme, step, holds, inputs, wanted)

    def compare(
        self,
        name: str,
        scheme: Scheme,
        step: float,
        holds: list[int],
        inputs: list[np.ndarray],
        wanted: int,
    ) -> TrajectoryRun:
        """Follow one trajectory under given inputs; `wanted` steps are the whole horizon."""
        model, start = self.model, self.start
        nudged = model.integrate(start[0], np.full(model.nv, NUDGE)), start[1] + NUDGE
        marks = _until_failure(self._theirs(scheme, step, inputs, holds, start))
        shadow = _until_failure(self._theirs(scheme, step, inputs, holds, nudged))
        reach = 0
        for mark, other in zip(marks, shadow, strict=False):
            if reach and not distance(mark, other, self.circular) < GROWTH * NUDGE:
                break
            reach += 1
        if not reach:
            why = (
                f"within {holds[0]} steps of {step:.2g} s the motion, at {self.rates.motion:.2g} "
                f"rad/s, amplifies rounding more than {GROWTH:g} times"
            )
            raise SimulationError(holds[0] * step, why)

        error = 0.0
        ours = self._ours(scheme, step, inputs[:reach], holds)
        for here, mark in zip(ours, marks, strict=False):
            error = float(np.maximum(error, distance(here, mark, self.circular)))
        if reach < len(holds):
            why = f"beyond it the motion amplifies rounding more than {GROWTH:g} times"
        else:
            why = "whole horizon" if sum(holds) == wanted else "as many steps as the time allows"
        return TrajectoryRun(name, scheme.name, step, sum(holds[:reach]) * step, error, why)

    def ladder(self, scheme: Scheme) -> StepLadder:
        """Halve the step; the limit is MuJoCo's Runge–Kutta at an eighth of the finest step.

        Springs that stiffen on the way may need a shorter step than the rates at the start say.
        """
        coarse = min(4e-3, 0.3 / max(self.rates.damping, self.rates.motion))
        while self.model.curved and self._diverges(scheme, coarse):
            coarse /= 2
        rest, finest = [np.zeros(self.model.nu)], 2 ** (RUNGS - 1)
        steps = [RUNG_STEPS * 8 * finest]
        limit = next(self._theirs(RK4, coarse / (8 * finest), rest, steps))
        rungs: list[Rung] = []
        for k in range(RUNGS):
            step, count = coarse / 2**k, [RUNG_STEPS * 2**k]
            ours = next(self._ours(scheme, step, rest, count))
            theirs = next(self._theirs(scheme, step, rest, count))
            apart, off = (distance(ours, other, self.circular) for other in (theirs, limit))
            rungs.append(Rung(step, apart, off, None))
        return StepLadder(scheme.name, scheme.order, RUNG_STEPS * coarse, _with_orders(rungs))

    def _diverges(self, scheme: Scheme, step: float) -> bool:
        """Whether MuJoCo's free motion over the first rung is not finite at this step."""
        try:
            next(self._theirs(scheme, step, [np.zeros(self.model.nu)], [RUNG_STEPS]))
        except SimulationError:
            return True
        return False

    def _ours(
        self, scheme: Scheme, step: float, inputs: Sequence[np.ndarray], holds: Sequence[int]
    ) -> Iterator[Start]:
        """Coordinates and velocities after each held input, by our model."""
        q, v = self.start
        advance = scheme.free_step if self.model.robot.floating else scheme.step
        for u, steps in zip(inputs, holds, strict=False):
            for _ in range(steps):
                q, v = advance(self.model, q, v, u, step)
            yield self.model.coordinates(q), v

    def _theirs(
        self,
        scheme: Scheme,
        step: float,
        inputs: Sequence[np.ndarray],
        holds: Sequence[int],
        start: Start | None = None,
    ) -> Iterator[Start]:
        """Coordinates and velocities after each held input, by MuJoCo."""
        self.judge.start(*(start or self.start), scheme.integrator, step)
        return self.judge.follow(inputs, holds)


def _until_failure(marks: Iterator[Start]) -> list[Start]:
    """All states before the simulation fails.

    Raises
    ------
    SimulationError
        It fails before the first one.
    """
    reached = list[Start]()
    try:
        for mark in marks:
            reached.append(mark)
    except SimulationError:
        if not reached:
            raise
    return reached


def circles(model: SoftModel) -> np.ndarray:
    """(nv,) bool, true for continuous joints."""
    kinds = {joint.name: joint.kind for joint in model.robot.joints}
    return np.array([kinds.get(name) == "continuous" for name in model.joint_names])


def _with_orders(rungs: list[Rung]) -> tuple[Rung, ...]:
    """The rungs with observed orders: log2 of each error over the next, None near rounding."""
    done = rungs[:1]
    for before, rung in pairwise(rungs):
        measurable = min(before.truncation_error, rung.truncation_error) > 1e-12
        order = math.log2(before.truncation_error / rung.truncation_error) if measurable else None
        done.append(Rung(rung.step, rung.engine_error, rung.truncation_error, order))
    return tuple(done)
