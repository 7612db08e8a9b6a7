"""The time of one control step, (q, v) → u, its parts, the floor below it and the paper's stack.

`docs/real_time.md` says what is inside each figure. All figures of a robot come from the same
recorded states, in rounds that take every subject in turn, so that a drift of the machine meets
all of them alike; the garbage collector is off meanwhile, as it is between two of its runs.
"""

from __future__ import annotations

import gc
import os
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter_ns, process_time
from typing import Any, TypeVar

import numpy as np

from softdyn import Reference, SoftModel, State
from softdyn.compiled import COMPILES
from softdyn.dynamics import tree as engine
from softdyn.validation.oracles.programmes import PROGRAMMES, PrintedLaw
from softdyn.validation.oracles.solvers import Scs, Unsolved

SAMPLES = 10_000  # timed steps of a controller on a robot, for a 99.9th percentile of ten
STACK_STATES = 12
WARM_UP = 50  # steps before any is timed

Step = tuple[np.ndarray, np.ndarray, Reference]
Law = Callable[[Any, Any], Any]
Key = TypeVar("Key")


@dataclass(frozen=True)
class Times:
    """What was measured of one controller on one robot, in µs; arrays (rounds, states).

    Attributes
    ----------
    dynamics, law : `model.state`, and the controller on its answer; together the step.
    solve : inside ProxQP's ``update`` and ``solve``, calls from Python included.
    native : what ProxQP itself reports for both, `run_time`.
    engine : the step's Pinocchio calls alone.
    stack, stack_quadratic : (rounds,) a step in the paper's stack, as the reference implementation
        spells it and as a quadratic programme; one state a round.
    stack_difference : median over states of the largest difference of its input from ours, as a
        share of the largest input's range.
    """

    dynamics: np.ndarray
    law: np.ndarray
    solve: np.ndarray
    native: np.ndarray
    engine: np.ndarray
    stack: np.ndarray = field(default_factory=lambda: np.empty(0))
    stack_quadratic: np.ndarray = field(default_factory=lambda: np.empty(0))
    stack_difference: float | None = None

    @property
    def step(self) -> np.ndarray:
        """The whole step (rounds, states)."""
        return self.dynamics + self.law

    def row(self) -> dict[str, float | int | None]:
        """The figures: see `docs/real_time.md`."""
        step = self.step
        median, p99, p999 = (float(np.percentile(step, p)) for p in (50, 99, 99.9))
        dynamics, solve, native, calls = (
            float(np.median(x)) for x in (self.dynamics, self.solve, self.native, self.engine)
        )
        floor = float(np.median(self.engine + self.native))
        stack, quadratic = (
            float(np.median(x)) if x.size else None for x in (self.stack, self.stack_quadratic)
        )
        return {
            "median_us": median,
            "p99_us": p99,
            "p999_us": p999,
            "worst_state_us": float(np.median(step, axis=0).max()),
            "dynamics_us": dynamics,
            "assembly_us": float(np.median(self.law)) - solve,
            "solve_us": solve,
            "pinocchio_us": calls,
            "proxqp_us": native,
            "floor_us": floor,
            "floor_ratio": median / floor,
            "stack_us": stack,
            "ratio": None if stack is None else stack / median,
            "stack_quadratic_us": quadratic,
            "ratio_quadratic": None if quadratic is None else quadratic / median,
            "stack_difference": self.stack_difference,
            "states": step.shape[1],
            "samples": step.size,
            "stack_samples": int(self.stack.size),
        }


def paper_stack(controller: str) -> Callable[[Any, bool], Law] | None:
    """(controller, quadratic) → a step as the paper computes it: state → u, or NaN.

    The programme as printed, nothing condensed, scaled or kept: cvxpy builds it anew, SCS solves.
    None for laws that have no programme. Needs the extra ``bench``.
    """
    if controller not in PROGRAMMES:
        return None

    def make(ours: Any, quadratic: bool) -> Law:
        law = PrintedLaw(PROGRAMMES[controller], ours.gains, Scs(quadratic=quadratic))

        def step(state: State, reference: Reference) -> np.ndarray:
            try:
                return law(state, reference)["u"]
            except Unsolved:
                return np.full(state.model.nu, np.nan)

        return step

    return make


def engine_calls(model: SoftModel, *, gravity: bool, coriolis: bool) -> Callable[..., None]:
    """The calls of Pinocchio that a step makes, (q, v) → nothing, with nothing around them.

    `gravity` and `coriolis` for laws that ask for `State.g` and `State.C`.
    """
    pin, model_ = engine.pin, engine.tree_of(model).pin_model
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
    """A controller on a robot and the steps to time it on.

    Parameters
    ----------
    make : builds the controller; twice, since one copy's QP solvers (its `solvers`) are clocked.
    steps : (q, v, reference) of every step.
    stack : (controller, quadratic) → the paper's stack for it, if it is to be timed too.
    """

    def __init__(
        self,
        model: SoftModel,
        make: Callable[[SoftModel], Any],
        steps: Sequence[Step],
        stack: Callable[[Any, bool], Law] | None = None,
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
        lazy = vars(state).keys() - given  # what the law made the State compute
        self._engine = engine_calls(model, gravity="g" in lazy, coriolis="C" in lazy)
        self._stacks: dict[bool, Law] = {}
        self._difference: float | None = None
        if stack is not None:
            self._add_stack(stack)

    def _add_stack(self, make: Callable[[Any, bool], Law]) -> None:
        """The paper's stack in both spellings, on a few states spread over all; warms it up."""
        self._stacks = {quadratic: make(self._law, quadratic) for quadratic in (False, True)}
        chosen = np.linspace(0, len(self._steps) - 1, min(STACK_STATES, len(self._steps)))
        self._stack_steps = [self._steps[i] for i in chosen.astype(int)]
        differences = []
        for q, v, reference in self._stack_steps:
            state = self._model.state(q, v)
            ours = self._law(state, reference).u
            theirs = [stack(state, reference) for stack in self._stacks.values()]
            differences.append(max(float(np.abs(ours - u).max()) for u in theirs))
        span = float((self._model.u_max - self._model.u_min).max())
        self._difference = float(np.nanmedian(differences)) / span

    def begin(self, rounds: int) -> None:
        """Make room for what is measured."""
        shape = (rounds, len(self._steps))
        self._ns = {name: np.zeros(shape) for name in ("dynamics", "law", "solve", "engine")}
        self._native = np.zeros(shape)
        self._stack_ns: dict[bool, list[int]] = {False: [], True: []}

    def run(self, k: int) -> None:
        """One round."""
        ns, now = self._ns, perf_counter_ns
        dynamics, law = ns["dynamics"][k], ns["law"][k]
        state_of, controller = self._model.state, self._law
        for i, (q, v, reference) in enumerate(self._steps):
            began = now()
            state = state_of(q, v)
            halfway = now()
            controller(state, reference)
            ended = now()
            dynamics[i], law[i] = halfway - began, ended - halfway
        pinocchio, calls = self._engine, ns["engine"][k]
        for i, (q, v, _) in enumerate(self._steps):
            began = now()
            pinocchio(q, v)
            calls[i] = now() - began
        if self._clocks:
            self._look(ns["solve"][k], self._native[k])
        for quadratic, stack in self._stacks.items():
            # one state a round: its step takes as long as two hundred of ours
            q, v, reference = self._stack_steps[k % len(self._stack_steps)]
            began = now()
            stack(state_of(q, v), reference)
            self._stack_ns[quadratic].append(now() - began)

    def _look(self, solve: np.ndarray, native: np.ndarray) -> None:
        for i, (q, v, reference) in enumerate(self._steps):
            state = self._model.state(q, v)
            for clock in self._clocks:
                clock.reset()
            self._looked_into(state, reference)
            solve[i] = sum(clock.outside for clock in self._clocks)
            native[i] = sum(clock.inside for clock in self._clocks)

    def times(self) -> Times:
        """All rounds, in µs."""
        stacks = {k: np.array(rows, float) / 1e3 for k, rows in self._stack_ns.items()}
        return Times(
            **{name: values / 1e3 for name, values in self._ns.items()},
            native=self._native,
            stack=stacks[False],
            stack_quadratic=stacks[True],
            stack_difference=self._difference,
        )


def measure(
    subjects: Mapping[Key, Subject], rounds: int, tick: Callable[[], Any] = lambda: None
) -> dict[Key, Times]:
    """Time all subjects in turn, `rounds` times over; `tick` is called after every round."""
    order = list(subjects.values())
    shuffle = random.Random(0).shuffle
    for subject in order:
        subject.begin(rounds)
    with quiet():
        for k in range(rounds):
            shuffle(order)
            for subject in order:
                subject.run(k)
            tick()
    return {key: subject.times() for key, subject in subjects.items()}


@contextmanager
def quiet() -> Iterator[None]:
    """No garbage collection inside."""
    enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


class MachineLoad:
    """How busy the machine was while something was measured, and with what else."""

    def __init__(self) -> None:
        self._before = os.getloadavg()[0]
        self._wall, self._own = perf_counter_ns(), process_time()

    def report(self) -> dict[str, float | int | None]:
        """Cores, load averages (1 min) before and after, and our share of the wall clock.

        A `cpu_share` below 1 says that this process was kept waiting by others; at 1 others may
        still have shared its caches, its memory and its core's clock.
        """
        wall = (perf_counter_ns() - self._wall) / 1e9
        return {
            "cores": os.cpu_count(),
            "load_before": self._before,
            "load_after": os.getloadavg()[0],
            "cpu_share": (process_time() - self._own) / wall,
        }
