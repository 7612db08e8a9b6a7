"""One search for equilibria that hold a target: of the tip, or of several tasks.

The unknowns are q and u: r(q, u) = 0 between the joint limits, u within its bounds, and an error
e(q) = 0. From a given equilibrium `descend` follows the branch of exact equilibria, with
∂y/∂u = J (∂r/∂q)⁻¹ B, until e is as small as the bounds allow. From other shapes `explore` solves
for q and u together. Both start at many places: at rest, at given and sampled equilibria, beside
the nearest ends under other inputs (basin hopping, Wales and Doye 1997), at random shapes, and
downhill from saddles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import chain
from time import perf_counter
from typing import Any

import numpy as np

from softdyn.checks import array, instance, instances, length, number, whole
from softdyn.dynamics.model import SoftModel, State, check_model
from softdyn.exceptions import InputError
from softdyn.references import Reference
from softdyn.statics.branch import REACHED, descend, input_scale
from softdyn.statics.equilibria import balance, move, rest, settle
from softdyn.statics.equilibrium import Equilibrium, RankedEquilibria, StaticsError
from softdyn.statics.samples import random_shapes, sample_rests
from softdyn.statics.unknown_inputs import TargetProblem, balance_at, explore_from
from softdyn.tasks.task import Task

SECONDS = 60.0  # the usual limit of a search
SAME = 1e-3  # equilibria whose joints are this close count as one (rad, m)
EXPLORED = 4  # number of given starts from which `explore` starts too
SADDLES = 4  # unstable equilibria, the closest, from which stable ones are sought downhill
ASIDE = 0.1  # of a joint, out of an unstable equilibrium (rad, m)
TRIED = 10  # number of sampled equilibria from which a branch is followed
FREE = 2  # and from which it is followed beyond its stability
KICKS = 20  # number of equilibria beside the nearest ends, under other inputs
SIZES = (0.05, 0.15, 0.4)  # of an input's scale: standard deviations of these other inputs
BASES = 8  # number of ends beside which they are

Guess = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class TipSearch(RankedEquilibria):
    """Equilibria that hold the tip at or near a target, the closest first.

    Equilibria within `REACHED` of the target count as equally close; of these the one with the
    least input ‖u‖ comes first.

    Attributes
    ----------
    target : ndarray, (3,)
        The target in the world (m).
    found : tuple of Equilibrium
        Distinct equilibria, stable or not; at least one.
    timed_out : bool
        Whether the limit of time ended the search before all starts were tried.
    """

    target: np.ndarray
    found: tuple[Equilibrium, ...]
    timed_out: bool = False

    @property
    def most_stable(self) -> Equilibrium | None:
        """The stable equilibrium whose smallest eigenvalue is largest; None if none was found.

        Only those as close to the target as the closest stable one are compared.
        """
        nearest = self.nearest_stable
        if nearest is None:
            return None
        within = max(self.distance(nearest), REACHED)
        close = [one for one in self.found if one.stable and self.distance(one) <= within]
        return max(close, key=lambda one: one.eigenvalues[0] if one.eigenvalues.size else np.inf)

    def distance(self, equilibrium: Equilibrium) -> float:
        """Distance of an equilibrium's tip from the target (m)."""
        one = instance("equilibrium", equilibrium, Equilibrium, "an Equilibrium")
        return float(np.linalg.norm(one.y - self.target))


@dataclass(frozen=True, eq=False)
class TaskSearch(RankedEquilibria):
    """Equilibria at or near the targets of several tasks, the best first.

    Attributes
    ----------
    tasks : tuple of Task
        The tasks; their weights count, their levels do not.
    reference : Reference
        Their targets.
    found : tuple of Equilibrium
        Distinct equilibria, stable or not; at least one.
    timed_out : bool
        Whether the limit of time ended the search before all starts were tried.
    """

    tasks: tuple[Task, ...]
    reference: Reference
    found: tuple[Equilibrium, ...]
    timed_out: bool = False

    def errors(self, equilibrium: Equilibrium) -> dict[str, float]:
        """The residual ‖e‖ of each task at an equilibrium (m, rad; unweighted), by name."""
        return {
            task.name: float(np.linalg.norm(task(equilibrium.state, self.reference).error))
            for task in self.tasks
        }

    def measure(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """The weighted errors (r,) of all tasks in a state, and their Jacobian (r, nv)."""
        parts = []
        for task in self.tasks:
            error, _, jacobian, _ = task(state, self.reference)
            root = np.sqrt(np.broadcast_to(task.weight, error.shape))
            parts.append((root * error, root[:, None] * jacobian))
        errors, jacobians = zip(*parts, strict=True)
        return np.concatenate(errors), np.concatenate(jacobians)

    def distance(self, equilibrium: Equilibrium) -> float:
        """The weighted error (Σ w ‖e‖²)^½ of an equilibrium."""
        return float(np.linalg.norm(self.measure(equilibrium.state)[0]))


def inputs_for_tip(
    model: SoftModel,
    target: np.ndarray,
    starts: Iterable[Equilibrium] = (),
    *,
    guesses: Iterable[Guess] = (),
    shapes: int = 16,
    rays: int = 32,
    seed: int = 0,
    seconds: float = SECONDS,
) -> TipSearch:
    """Inputs within their bounds that hold the tip at `target`, or as near as was found.

    It is a local search from many starts. Every equilibrium that it returns exists, but it may miss
    some.

    Parameters
    ----------
    target : ndarray, (3,)
        The target in the world (m).
    starts : iterable of Equilibrium
        Equilibria to start from besides `rest`, for example from `sample_rests`, the nearest first.
        Branches start from each of them, `explore` from the first few.
    guesses : iterable of (ndarray, ndarray)
        Further starts (q, u), (nq,) and (nu,), which need not be equilibria.
    shapes : int
        Number of random shapes to start from.
    rays : int
        Number of random inputs for sampled equilibria, see `sample_rests`. They are starts
        until one of them leads to a stable equilibrium at the target.
    seed : int
        Seed of the shapes and inputs.
    seconds : float
        Time (s) after which no further start is tried; `timed_out` says whether that happened. With
        ``math.inf`` the result depends on the arguments alone.

    Raises
    ------
    StaticsError
        If the robot has no equilibrium under the least input.
    InputError
        For a target of the wrong shape or not finite, and for a robot without inputs.
    """
    latest = perf_counter() + number("seconds", seconds, lower=0.0, finite=False)
    target = array("target", target, (3,))
    numbers = whole("shapes", shapes), whole("rays", rays), whole("seed", seed)
    _check_driven(model)
    given = instances("starts", starts, Equilibrium, "an Equilibrium")
    pairs: tuple[Any, ...] = instances("guesses", guesses, object, "a pair (q, u)")
    for pair in pairs:
        if length("guesses", pair) != 2:
            raise InputError("guesses", "pairs (q, u)", repr(pair))
    start = rest(model)
    problem = TargetProblem.for_tip(model, target)
    search = _Search(problem, (start, *given), *numbers, latest, pairs)
    search.run(chain(
        search.branches(), search.free_branches(), search.explored(), search.beside_saddles(),
        *((search.sampled_branches_too(), search.unless_held(search.kicks)) if rays else ()),
    ))  # fmt: skip
    return TipSearch(target, distinct(sorted(search.ends, key=search.order)), search.timed_out)


def inputs_for_tips(
    model: SoftModel, targets: np.ndarray, starts: Iterable[Equilibrium] = (), **settings: Any
) -> tuple[TipSearch, ...]:
    """`inputs_for_tip` for many targets, one after the other, with the results of single calls.

    All searches share the sampled equilibria. Threads do not shorten it: a search is Python. In
    processes, ``joblib.delayed(statics.inputs_for_tip)(model, target)`` is a call for each target.

    Parameters
    ----------
    targets : array_like, (k, 3)
        Targets in the world (m).
    starts : iterable of Equilibrium
        As for `inputs_for_tip`.
    **settings : Any
        Its other arguments. `seconds` is the time for each target.

    Raises
    ------
    StaticsError
        If the robot has no equilibrium under the least input.
    InputError
        As `inputs_for_tip`.
    """
    targets = array("targets", targets, (length("targets", targets), 3))
    given = instances("starts", starts, Equilibrium, "an Equilibrium")
    return tuple(inputs_for_tip(model, target, given, **settings) for target in targets)


def inputs_for_tasks(
    model: SoftModel,
    tasks: Sequence[Task],
    reference: Reference,
    starts: Iterable[Equilibrium] = (),
    *,
    shapes: int = 4,
    rays: int = 32,
    seed: int = 0,
    seconds: float = SECONDS,
) -> TaskSearch:
    """Inputs within their bounds that hold all tasks, or come as near as was found.

    It follows branches of equilibria, from rest, from `starts` and from the best of sampled ones,
    which are kept for the model. Where none of them holds the targets, inputs of the nearest stable
    ends are changed at random, and random shapes are tried. It ends at the first stable equilibrium
    that holds all targets.

    Parameters
    ----------
    model : SoftModel
        The robot.
    tasks : sequence of Task
        The tasks.
    reference : Reference
        Their targets, stacked by name; a plain one is that of a point.
    starts : iterable of Equilibrium
        Further equilibria to start from.
    shapes : int
        Number of random shapes to start from; 0 for branches of equilibria alone.
    rays : int
        Number of random inputs for the samples, see `sample_rests`.
    seed : int
        Seed of the shapes and inputs.
    seconds : float
        Time (s) after which no further sample is taken and no further start is tried; `timed_out`
        says whether that happened. With ``math.inf`` the result depends on the robot, the targets
        and the seed alone.

    Raises
    ------
    StaticsError
        If the robot has no equilibrium under the least input.
    InputError
        For an empty list of tasks, a missing target, or a robot without inputs.
    """
    latest = perf_counter() + number("seconds", seconds, lower=0.0, finite=False)
    kind: Any = Task  # mypy wants a concrete class
    chosen: tuple[Task, ...] = instances("tasks", tasks, kind, "a softdyn.tasks.Task")
    if not chosen:
        raise InputError("tasks", "a task or more", "none")
    if not isinstance(reference, Reference):
        raise InputError("reference", "a Reference", repr(reference))
    numbers = whole("shapes", shapes), whole("rays", rays), whole("seed", seed)
    _check_driven(model)
    given = instances("starts", starts, Equilibrium, "an Equilibrium")
    measure, start = TaskSearch(chosen, reference, ()).measure, rest(model)
    problem = TargetProblem.build(start, measure)  # a missing target is an error here
    search = _Search(problem, (start, *given), *numbers, latest)
    search.run(search.unless_held(
        search.branches, search.sampled_branches, search.kicks,
        partial(search.free_branches, FREE),
        *((search.explored, search.beside_saddles) if shapes else ()),
    ))  # fmt: skip
    found = sorted(search.ends, key=lambda one: max(search.distance(one), REACHED))
    return TaskSearch(chosen, reference, distinct(found), search.timed_out)


def all_at(problem: TargetProblem, guesses: Iterable[Guess]) -> tuple[Equilibrium, ...]:
    """Distinct equilibria without an error, that `balance_at` finds from (q, u), as found."""
    ends = list[Equilibrium]()
    for q, u in guesses:
        with suppress(StaticsError, np.linalg.LinAlgError):
            ends.append(balance_at(problem, q, u))
    return distinct(ends)


def distinct(ends: Iterable[Equilibrium]) -> tuple[Equilibrium, ...]:
    """Each equilibrium once, as first found."""
    found = list[Equilibrium]()
    for one in ends:
        if not any(_same(one, other) for other in found):
            found.append(one)
    return tuple(found)


def _same(one: Equilibrium, other: Equilibrium) -> bool:
    coordinates = one.model.coordinates
    return bool(np.abs(coordinates(one.q) - coordinates(other.q)).max() < SAME)


def _check_driven(model: SoftModel) -> None:
    if check_model(model).nu == 0:
        raise InputError(str(model.robot.path), "a robot with an <actuator>", "one without inputs")


Attempt = Callable[[], Equilibrium]


@dataclass(eq=False)
class _Search:
    """A search's starts, and the ends that it has found.

    The methods yield attempts: functions that give an end, or raise a StaticsError.
    """

    problem: TargetProblem
    known: tuple[Equilibrium, ...]  # rest, and given ones
    shapes: int
    rays: int
    seed: int
    latest: float  # s, when the search ends
    guesses: tuple[Guess, ...] = ()
    ends: list[Equilibrium] = field(default_factory=list)
    held: bool = False  # whether a stable end is at the target
    timed_out: bool = False

    def run(self, attempts: Iterable[Attempt]) -> None:
        """Make attempts until the time is over; the first is always made."""
        for attempt in attempts:
            self.timed_out = self.timed_out or (bool(self.ends) and perf_counter() > self.latest)
            if self.timed_out:
                break
            with suppress(StaticsError):
                end = attempt()
                self.ends.append(end)
                self.held = self.held or (end.stable and self.distance(end) <= REACHED)

    def distance(self, one: Equilibrium) -> float:
        """The error's norm."""
        return float(np.linalg.norm(self.problem.measure(one.state)[0]))

    def order(self, one: Equilibrium) -> tuple[float, float]:
        """A key: the nearest first; of those at the target, the one with the least input."""
        return max(self.distance(one), REACHED), float(np.linalg.norm(one.u))

    def unless_held(self, *kinds: Callable[[], Iterator[Attempt]]) -> Iterator[Attempt]:
        """Attempts of several kinds, until a stable end is at the target."""
        for kind in kinds:
            for attempt in kind() if not self.held else ():
                yield attempt
                if self.held:
                    return

    def branches(self) -> Iterator[Attempt]:
        """Branches of the known equilibria; those of stable ones end with their stability."""
        return (self._branch(one, one.stable) for one in self.known)

    def free_branches(self, sampled: int = 0) -> Iterator[Attempt]:
        """Branches of known equilibria, and of some samples, beyond their stability."""
        starts = (*self.known, *(self.samples[:sampled] if sampled else ()))
        return (self._branch(one, False) for one in starts if one.stable)

    def sampled_branches(self) -> Iterator[Attempt]:
        """Branches of the nearest sampled equilibria."""
        return (self._branch(one, one.stable) for one in self.samples[:TRIED])

    def sampled_branches_too(self) -> Iterator[Attempt]:
        """The same until one of these ends holds the target, whether another does or not.

        Inputs that rise slowly lead to a sample, so the robot gets to such an end by itself.
        """
        before, self.held = self.held, False
        yield from self.unless_held(self.sampled_branches)
        self.held = self.held or before

    def kicks(self) -> Iterator[Attempt]:
        """Branches of stable equilibria under other inputs, beside the nearest stable ends."""
        rng = np.random.default_rng(self.seed)
        for _ in range(KICKS):
            stable = sorted((one for one in self.ends if one.stable), key=self.distance)
            bases = distinct(stable)[:BASES]
            if not bases:
                continue
            base = bases[min(int(rng.exponential()), len(bases) - 1)]
            model = base.model
            change = rng.choice(SIZES) * input_scale(model, base) * rng.normal(size=model.nu)
            with suppress(StaticsError):
                u = np.clip(base.u + change, model.u_min, model.u_max)
                yield self._branch(settle(model, u, base.q), True)

    def explored(self) -> Iterator[Attempt]:
        """Given guesses, and shapes near which there may be no equilibrium."""
        model, measure = self.problem.model, self.problem.measure
        for q, u in self.guesses:
            yield lambda q=q, u=u: descend(balance(model, u, q), measure)  # type: ignore[misc]
            yield partial(explore_from, self.problem, q, u)
        near = [(one.q, one.u) for one in self.known[: 1 + EXPLORED]]
        for q, u in (*near, *random_shapes(model, self.shapes, self.seed)):
            yield partial(explore_from, self.problem, q, u)

    def beside_saddles(self) -> Iterator[Attempt]:
        """Branches of the stable equilibria on both sides of the nearest unstable ends."""
        sides = list[Equilibrium]()
        unstable = [one for one in distinct(sorted(self.ends, key=self.order)) if not one.stable]
        for side in chain.from_iterable(map(_downhill, unstable[:SADDLES])):
            if not any(_same(side, other) for other in sides):
                sides.append(side)
                yield self._branch(side, True)

    def _branch(self, start: Equilibrium, stay_stable: bool) -> Attempt:
        return partial(descend, start, self.problem.measure, stay_stable=stay_stable)

    @cached_property
    def samples(self) -> list[Equilibrium]:
        """Sampled equilibria, the nearest first.

        The model keeps them, because all its searches begin there. If the time is over meanwhile,
        they are those up to then, and the model keeps none.
        """
        kept: dict[tuple[int, int], list[Equilibrium]]
        kept = vars(self.problem.model).setdefault("_sampled_rests", {})
        found = kept.get((self.rays, self.seed))
        if found is None:
            found, over = [], False
            for one in sample_rests(self.problem.model, self.rays, self.seed):
                found.append(one)
                over = perf_counter() > self.latest
                if over:
                    break
            if not over:
                kept[self.rays, self.seed] = found
        return sorted(found, key=self.distance)


def _downhill(saddle: Equilibrium) -> Iterator[Equilibrium]:
    """Stable equilibria under the same input, on both sides of each unstable direction."""
    model, free = saddle.model, ~saddle.held
    values, vectors = np.linalg.eigh(saddle.stiffness[np.ix_(free, free)])
    for direction in vectors.T[values < 0]:
        step = np.zeros(model.nv)
        step[free] = ASIDE * direction / np.abs(direction).max()
        for aside in (step, -step):
            with suppress(StaticsError):
                yield settle(model, saddle.u, move(model, saddle.q, aside))
