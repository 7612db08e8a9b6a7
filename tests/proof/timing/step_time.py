"""The time of one control step, (q, v) → u, its parts, the floor below it and the paper's stack.

`docs/real_time.md` defines each figure. All figures of a robot come from the same recorded states,
in rounds that take every subject in turn, so that a drift of the machine affects all of them alike.
The garbage collector is off during a round.
"""

from __future__ import annotations

import gc
import os
import random
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from time import perf_counter_ns, process_time
from typing import Any, NamedTuple, TypeVar

import numpy as np

from softdyn import InputError, Reference, SoftModel, State
from softdyn.compiled import COMPILES
from softdyn.dynamics import tree as engine
from softdyn.dynamics.projection import Projection, underlying_tree
from softdyn.tasks import PointTask
from tests.proof.timing.recording import RecordedStates
from tests.support.paper_qps import PAPER_QPS, PrintedLaw
from tests.support.qp_solvers import Scs, Unsolved

SAMPLES = 10_000  # timed steps of a controller on a robot, for a 99.9th percentile of ten
STACK_STATES = 12
WARM_UP = 50  # steps before any is timed

Step = tuple[np.ndarray, np.ndarray, Reference]
Key = TypeVar("Key", bound=Hashable)


class Round(NamedTuple):
    """Times of one pass over all states (ns): one per state, and one per variant of the stack."""

    dynamics: list[float]
    law: list[float]
    engine: list[float]
    solve: list[float]
    native: list[float]
    stacks: list[float]


@dataclass(frozen=True)
class Times:
    """Measured times of one controller on one robot.

    Attributes
    ----------
    dynamics, law : array, (rounds, states)
        `model.state`, and the controller on that state (µs); together they are the step.
    engine : array, (rounds, states)
        Only the Pinocchio calls of the step.
    solve : array, (rounds, states)
        Time in the solvers of QPs (DAQP, rarely ProxQP), including their calls from Python.
    native : array, (rounds, states)
        The same by the solvers' own clocks.
    stacks : array, (rounds, 2) or (rounds, 0)
        A step of the paper's stack, once with the QP as the reference implementation writes it and
        once with a quadratic objective. One state per round.
    stack_difference : float or None
        Median over states of the largest difference between its input and ours, relative to the
        largest range of an input.
    """

    dynamics: np.ndarray
    law: np.ndarray
    engine: np.ndarray
    solve: np.ndarray
    native: np.ndarray
    stacks: np.ndarray
    stack_difference: float | None

    @property
    def step(self) -> np.ndarray:
        """The whole step (rounds, states)."""
        return self.dynamics + self.law

    def row(self) -> dict[str, float | int | None]:
        """The figures that `docs/real_time.md` defines."""
        step, floor = self.step, float(np.median(self.engine + self.native))
        median, p99, p999 = (float(np.percentile(step, p)) for p in (50, 99, 99.9))
        solve = float(np.median(self.solve))
        stack, quadratic = np.median(self.stacks, axis=0).tolist() or (None, None)
        return {
            "median_us": median,
            "p99_us": p99,
            "p999_us": p999,
            "worst_state_us": float(np.median(step, axis=0).max()),
            "dynamics_us": float(np.median(self.dynamics)),
            "assembly_us": float(np.median(self.law)) - solve,
            "solve_us": solve,
            "pinocchio_us": float(np.median(self.engine)),
            "solver_us": float(np.median(self.native)),
            "floor_us": floor,
            "floor_ratio": median / floor,
            "stack_us": stack,
            "ratio": None if stack is None else stack / median,
            "stack_quadratic_us": quadratic,
            "ratio_quadratic": None if quadratic is None else quadratic / median,
            "stack_difference": self.stack_difference,
            "states": step.shape[1],
            "samples": step.size,
            "stack_samples": len(self.stacks) if stack else 0,
        }


Law = Callable[[State, Reference], Any]


def paper_stack(controller: Any) -> list[Law]:
    """A controller's step as the paper computes it: functions (state, reference) → u (m,), or NaN.

    cvxpy builds the QP as printed anew at every step, without condensing or scaling, and SCS solves
    it. The first function writes it as the reference implementation does, the second as a quadratic
    program. A controller without QP has none. Needs the extra ``bench``.
    """

    def law(quadratic: bool) -> Law:
        printed = PrintedLaw(PAPER_QPS[controller.name], controller.gains, Scs(quadratic=quadratic))

        def u(state: State, reference: Reference) -> np.ndarray:
            try:
                return printed(state, reference)["u"]
            except Unsolved:
                return np.full(state.model.nu, np.nan)

        return u

    return [law(False), law(True)] if getattr(controller, "name", "") in PAPER_QPS else []


def engine_calls(model: SoftModel, *, gravity: bool, coriolis: bool) -> Callable[..., None]:
    """A function of (q, v) that makes only the Pinocchio calls of a step.

    `gravity` and `coriolis` are for controllers that read `State.g` and `State.C`. (q, v) are those
    of the model's underlying tree, see `Subject`.
    """
    pin, model_ = engine.pin, underlying_tree(model)[0].pin_model
    data = model_.createData()

    def calls(q: np.ndarray, v: np.ndarray) -> None:
        pin.nonLinearEffects(model_, data, q, v)
        if COMPILES:
            pin.computeCentroidalMap(model_, data, q)
        else:
            pin.crba(model_, data, q, pin.Convention.WORLD)
            pin.computeJointJacobiansTimeVariation(model_, data, q, v)
        if gravity:
            pin.computeCentroidalMap(model_, data, q)
        if coriolis:
            pin.computeCoriolisMatrix(model_, data, q, v)

    return calls


class Subject:
    """A controller on a robot, and the steps on which it is timed.

    Parameters
    ----------
    model : SoftModel
    make : callable
        Builds the controller. It is called twice, because the QP solvers of one copy (its
        `solvers`) are timed.
    steps : sequence
        (q, v, reference) of every step.
    stack : callable, optional
        Controller → the paper's stack for it, to be timed too; see `paper_stack`.
    """

    def __init__(
        self,
        model: SoftModel,
        make: Callable[[SoftModel], Any],
        steps: Sequence[Step],
        stack: Callable[[Any], list[Law]] | None = None,
    ) -> None:
        self._model, self._steps = model, list(steps)
        self._law, self._looked_into = make(model), make(model)
        self._clocks = [solver.clocked() for solver in getattr(self._looked_into, "solvers", ())]
        for i in range(WARM_UP):
            q, v, reference = self._steps[i % len(self._steps)]
            state = model.state(q, v)
            given = set(vars(state))
            for law in (self._law, self._looked_into):
                law(state, reference)
        lazy = vars(state).keys() - given  # the terms that the controller made the State compute
        self._engine = engine_calls(model, gravity="g" in lazy, coriolis="C" in lazy)
        # a projected model makes the engine calls of its tree
        self._engine_steps = [
            (model.expand(q), model.S @ v) if isinstance(model, Projection) else (q, v)
            for q, v, _ in self._steps
        ]
        self._stacks = stack(self._law) if stack else []
        chosen = np.linspace(0, len(self._steps) - 1, min(STACK_STATES, len(self._steps)))
        self._stack_steps = [self._steps[i] for i in chosen.astype(int)]
        self.stack_difference = self._difference() if self._stacks else None

    def _difference(self) -> float:
        """`Times.stack_difference`; this also warms the stack up."""
        differences = []
        for q, v, reference in self._stack_steps:
            state = self._model.state(q, v)
            ours = self._law(state, reference).u
            theirs = [stack(state, reference) for stack in self._stacks]
            differences.append(np.abs(np.subtract(theirs, ours)).max())
        span = float((self._model.u_max - self._model.u_min).max())
        return float(np.nanmedian(differences)) / span

    def round(self, k: int) -> Round:
        """Time everything once on every state, and the stack on state `k` of its few."""
        found, now = Round([], [], [], [], [], []), perf_counter_ns
        dynamics, law, engine, solve, native, stacks = found
        state_of, controller, pinocchio = self._model.state, self._law, self._engine
        for q, v, reference in self._steps:
            began = now()
            state = state_of(q, v)
            halfway = now()
            controller(state, reference)
            ended = now()
            dynamics.append(halfway - began)
            law.append(ended - halfway)
        for q, v in self._engine_steps:
            began = now()
            pinocchio(q, v)
            engine.append(now() - began)
        for q, v, reference in self._steps:
            if self._clocks:
                state = state_of(q, v)
                for clock in self._clocks:
                    clock.reset()
                self._looked_into(state, reference)
            solve.append(sum(clock.outside for clock in self._clocks))
            native.append(sum(clock.inside * 1e3 for clock in self._clocks))
        # one state per round: its step takes as long as two hundred of ours
        q, v, reference = self._stack_steps[k % len(self._stack_steps)]
        for stack in self._stacks:
            began = now()
            stack(state_of(q, v), reference)
            stacks.append(now() - began)
        return found


def measure(
    subjects: Mapping[Key, Subject], rounds: int, tick: Callable[[], Any] = lambda: None
) -> dict[Key, Times]:
    """Time all subjects in turn, `rounds` times; `tick` is called after every round."""
    found: dict[Key, list[Round]] = {key: [] for key in subjects}
    order, shuffle = list(subjects), random.Random(0).shuffle
    with quiet():
        for k in range(rounds):
            shuffle(order)
            for key in order:
                found[key].append(subjects[key].round(k))
            tick()
    times = {}
    for key, passes in found.items():
        columns = zip(Round._fields, zip(*passes, strict=True), strict=True)
        arrays: dict[str, Any] = {name: np.array(column) / 1e3 for name, column in columns}
        times[key] = Times(**arrays, stack_difference=subjects[key].stack_difference)
    return times


def rows_of(
    robot: str,
    model: SoftModel,
    makes: Mapping[str, Callable[..., Any]],
    states: RecordedStates,
    rounds: int,
    stack: Callable[[Any], list[Law]] | None = None,
    tick: Callable[[], Any] = lambda: None,
    rows: Sequence[int] = (),
) -> list[dict[str, Any]]:
    """The table of one robot: a row for each controller of `makes`, by name.

    For each number in `rows` the controller has a further row, with that many rows of tasks; see
    `spread_points`. Other parameters are those of `Subject` and `measure`.

    Raises
    ------
    InputError
        For a number of rows that is no multiple of 3, or more points than the robot has links.
    """
    subjects = {
        (law, 3): Subject(model, make, states.steps(), stack) for law, make in makes.items()
    }
    for count in rows:
        tasks = spread_points(model, count)
        steps = states.task_steps(model, tasks)
        for law, make in makes.items():
            subjects[law, count] = Subject(model, partial(make, tasks=tasks), steps)
    size, found = {"n": model.nv, "m": model.nu}, []
    for (law, count), times in (all_times := measure(subjects, rounds, tick)).items():
        row = {"robot": robot, "controller": law, "task_rows": count, **size, **times.row()}
        if rows:
            row["tip_ratio"] = float(np.median(times.step) / np.median(all_times[law, 3].step))
        found.append(row)
    return found


def spread_points(model: SoftModel, rows: int) -> list[PointTask]:
    """The positions of `rows` / 3 links, evenly from the tip to the base; the tip comes first.

    Raises
    ------
    InputError
        For a number of rows that is no multiple of 3, or more points than the robot has links.
    """
    tip = model.robot.task
    links, (count, rest) = [joint.child for joint in model.robot.chain(tip)], divmod(rows, 3)
    if rest or not 0 < count <= len(links):
        expected = f"a multiple of 3, at most {3 * len(links)} on {model.name!r}"
        raise InputError("rows", expected, rows)
    return [PointTask(links[-1 - len(links) * k // count]) for k in range(count)]


@contextmanager
def quiet() -> Iterator[None]:
    """Switch garbage collection off inside the context."""
    enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


class MachineLoad:
    """The load of the machine during a measurement."""

    def __init__(self) -> None:
        self._before = os.getloadavg()[0]
        self._wall, self._own = perf_counter_ns(), process_time()

    def report(self) -> dict[str, float | int | None]:
        """Cores, load averages (1 min) before and after, and our share of the wall clock.

        A `cpu_share` below 1 means that other processes made this one wait. Even at 1, others may
        have shared its caches, its memory and its core's clock.
        """
        wall = (perf_counter_ns() - self._wall) / 1e9
        return {
            "cores": os.cpu_count(),
            "load_before": self._before,
            "load_after": os.getloadavg()[0],
            "cpu_share": (process_time() - self._own) / wall,
        }
