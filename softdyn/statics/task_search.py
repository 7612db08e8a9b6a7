"""Inputs that hold several tasks at once, such as a pose, or the equilibrium nearest to them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from softdyn.checks import instances, number, whole
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.exceptions import InputError
from softdyn.references import Reference
from softdyn.statics.branch import REACHED, descend
from softdyn.statics.equilibria import rest
from softdyn.statics.equilibrium import Equilibrium, RankedEquilibria
from softdyn.statics.samples import sample_rests
from softdyn.tasks.task import Task

SAME = 1e-3  # equilibria whose joints are this close count as one (rad, m)
TRIED = 10  # number of sampled equilibria from which a branch is followed


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
    """

    tasks: tuple[Task, ...]
    reference: Reference
    found: tuple[Equilibrium, ...]

    def errors(self, equilibrium: Equilibrium) -> dict[str, float]:
        """The residual ‖e‖ of each task at an equilibrium (m, rad; unweighted), by name."""
        return {
            task.name: float(np.linalg.norm(task(equilibrium.state, self.reference).error))
            for task in self.tasks
        }

    def measure(self, equilibrium: Equilibrium) -> tuple[np.ndarray, np.ndarray]:
        """The weighted errors (r,) of all tasks, and their Jacobian (r, nv)."""
        parts = []
        for task in self.tasks:
            error, _, jacobian, _ = task(equilibrium.state, self.reference)
            root = np.sqrt(np.broadcast_to(task.weight, error.shape))
            parts.append((root * error, root[:, None] * jacobian))
        errors, jacobians = zip(*parts, strict=True)
        return np.concatenate(errors), np.concatenate(jacobians)

    def distance(self, equilibrium: Equilibrium) -> float:
        """The weighted error (Σ w ‖e‖²)^½ of an equilibrium."""
        return float(np.linalg.norm(self.measure(equilibrium)[0]))


def inputs_for_tasks(
    model: SoftModel,
    tasks: Sequence[Task],
    reference: Reference,
    starts: Iterable[Equilibrium] = (),
    *,
    rays: int = 8,
    seed: int = 0,
    seconds: float = math.inf,
) -> TaskSearch:
    """Inputs within their bounds that hold all tasks, or come as near as was found.

    It follows branches of equilibria, from rest, from `starts` and from the best of sampled ones.
    Every equilibrium that it returns exists, but it may miss some.

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
        Time after which no further start is tried.

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
    search.measure(known[0])  # a missing target is an error before the samples cost time
    sampled = sorted(sample_rests(model, whole("rays", rays), whole("seed", seed)),
                     key=search.distance)  # fmt: skip
    ends = list[Equilibrium]()
    for one in (*known, *sampled[:TRIED]):
        if ends and perf_counter() > latest:
            break
        ends.append(descend(one, search.measure, stay_stable=one.stable))
        if one.stable and search.distance(ends[-1]) > REACHED:
            ends.append(descend(one, search.measure))
        elif ends[-1].stable:
            break
    found = list[Equilibrium]()
    for one in sorted(ends, key=lambda one: max(search.distance(one), REACHED)):
        q = model.coordinates(one.q)
        if all(np.abs(q - model.coordinates(other.q)).max() >= SAME for other in found):
            found.append(one)
    return TaskSearch(chosen, reference, tuple(found))
