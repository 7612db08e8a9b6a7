"""Inputs that hold several tasks at once, such as a pose, or the equilibrium nearest to them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from softdyn.checks import instances, number, whole
from softdyn.dynamics.model import SoftModel, State, check_model
from softdyn.exceptions import InputError
from softdyn.references import Reference
from softdyn.statics.branch import REACHED, descend, input_scale
from softdyn.statics.equilibria import rest, settle
from softdyn.statics.equilibrium import Equilibrium, RankedEquilibria, StaticsError
from softdyn.statics.samples import sample_rests
from softdyn.tasks.task import Task

SECONDS = 60.0  # the usual limit of a search
SAME = 1e-3  # equilibria whose joints are this close count as one (rad, m)
TRIED = 10  # number of sampled equilibria from which a branch is followed
KICKS = 20  # and of equilibria beside the nearest ends, under other inputs
FREE = 2  # number of sampled equilibria from which a branch is followed beyond its stability
SIZES = (0.05, 0.15, 0.4)  # of an input's scale: standard deviations of these other inputs
BASES = 8  # number of ends beside which they are


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


def inputs_for_tasks(
    model: SoftModel,
    tasks: Sequence[Task],
    reference: Reference,
    starts: Iterable[Equilibrium] = (),
    *,
    rays: int = 32,
    seed: int = 0,
    seconds: float = SECONDS,
) -> TaskSearch:
    """Inputs within their bounds that hold all tasks, or come as near as was found.

    It follows branches of equilibria, from rest, from `starts` and from the best of sampled ones,
    which are kept for the model. Where none of them holds the targets, inputs of the nearest stable
    ends are changed at random (basin hopping, Wales and Doye 1997). It ends at the first stable
    equilibrium that holds them. Every equilibrium that it returns exists, but it may miss some.

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
    rays : int
        Number of random inputs for the samples, see `sample_rests`.
    seed : int
        Their seed.
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
    if check_model(model).nu == 0:
        raise InputError(str(model.robot.path), "a robot with an <actuator>", "one without inputs")
    search = TaskSearch(chosen, reference, ())
    known = [rest(model), *instances("starts", starts, Equilibrium, "an Equilibrium")]
    search.measure(known[0].state)  # a missing target is an error before the samples cost time
    samples = _samples(model, whole("rays", rays), whole("seed", seed), latest)
    sampled = sorted(samples, key=search.distance)
    ends = list[Equilibrium]()
    rng = np.random.default_rng(seed)
    timed_out = False
    for start, stay in _starts(known, sampled, ends, search, rng):
        timed_out = bool(ends) and perf_counter() > latest
        if timed_out:
            break
        ends.append(descend(start, search.measure, stay_stable=stay))
        if ends[-1].stable and search.distance(ends[-1]) <= REACHED:
            break
    found = list[Equilibrium]()
    for one in sorted(ends, key=lambda one: max(search.distance(one), REACHED)):
        if not any(_same(one, other) for other in found):
            found.append(one)
    return TaskSearch(chosen, reference, tuple(found), timed_out)


def _starts(
    known: Sequence[Equilibrium],
    sampled: Sequence[Equilibrium],
    ends: Sequence[Equilibrium],
    search: TaskSearch,
    rng: np.random.Generator,
) -> Iterator[tuple[Equilibrium, bool]]:
    """Starts, and whether their branches end before they lose stability; `ends` grows meanwhile."""
    given = (*known, *sampled[:TRIED])
    for one in given:
        yield one, one.stable
    for _ in range(KICKS):
        beside = _beside(ends, search, rng)
        if beside is not None:
            yield beside, True
    for one in given[: len(known) + FREE]:
        if one.stable:
            yield one, False


def _beside(
    ends: Sequence[Equilibrium], search: TaskSearch, rng: np.random.Generator
) -> Equilibrium | None:
    """A stable equilibrium under other inputs, beside one of the nearest stable ends.

    None if there is no such end, or no equilibrium under these inputs.
    """
    distinct = list[Equilibrium]()
    for one in sorted((one for one in ends if one.stable), key=search.distance):
        if len(distinct) < BASES and not any(_same(one, other) for other in distinct):
            distinct.append(one)
    if not distinct:
        return None
    base = distinct[min(int(rng.exponential()), len(distinct) - 1)]
    model = base.model
    change = rng.choice(SIZES) * input_scale(model, base) * rng.normal(size=model.nu)
    try:
        return settle(model, np.clip(base.u + change, model.u_min, model.u_max), base.q)
    except StaticsError:
        return None


def _same(one: Equilibrium, other: Equilibrium) -> bool:
    coordinates = one.model.coordinates
    return bool(np.abs(coordinates(one.q) - coordinates(other.q)).max() < SAME)


def _samples(model: SoftModel, rays: int, seed: int, latest: float) -> tuple[Equilibrium, ...]:
    """Sampled equilibria, which the model keeps, because all its searches begin there.

    If the time `latest` passes meanwhile, they are those up to then, and the model keeps none.
    """
    known: dict[tuple[int, int], tuple[Equilibrium, ...]]
    known = vars(model).setdefault("_sampled_rests", {})
    if (rays, seed) in known:
        return known[rays, seed]
    found = list[Equilibrium]()
    for one in sample_rests(model, rays, seed):
        found.append(one)
        if perf_counter() > latest:
            return tuple(found)
    known[rays, seed] = tuple(found)
    return known[rays, seed]
