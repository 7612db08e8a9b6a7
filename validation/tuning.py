"""Tuning of a schedule's gains by CMA-ES, on cases that the paper does not have.

Two searches: of the approach on the first second of runs, with the law of that stage alone, then of
the stay on whole runs that begin with the approach found.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from controllers import Schedule
from softdyn import InputError
from validation import paper
from validation.trials import Trial, run_all

THETAS, OMEGAS = (0.25, 0.75, 1.25, 1.75), (0.12, 0.17, 0.25, 0.45)
APPROACH = 1.0  # s
WORST = 10.0  # cost of a failed run; no run costs more
SETTLED, TRACKED = 0.01, 0.002  # what counts 1: final error / length, mean squared / length²

Tables = Mapping[str, Any]
Cost = Callable[[Trial, Mapping[str, Any]], float]
Candidate = Callable[[Mapping[str, float]], Tables]


def approach_cases(robot: str) -> list[Trial]:
    """The first second of set points at the published period and 1 ms, and of trajectories."""
    return [
        Trial(robot, "best", kind, value, period, duration=APPROACH)
        for kind, values, periods in (
            ("set_point", THETAS, (None, 0.001)),
            ("tracking", OMEGAS[2:], (None,)),
        )
        for value in values
        for period in periods
    ]


def stay_cases(robot: str) -> list[Trial]:
    """Whole set points, two of them at 1 ms, and two cycles of each rate."""
    points = [
        Trial(robot, "best", "set_point", theta, None if i < 2 else 0.001)
        for i, theta in enumerate(THETAS)
    ]
    return points + [Trial(robot, "best", "tracking", omega) for omega in OMEGAS]


def approach_cost(trial: Trial, result: Mapping[str, Any]) -> float:
    """Seconds in which the first error would cost what the run does, in tenths, and what is left.

    10 ∫ ‖e‖² dt / ‖e(0)‖² + ‖e(T)‖ / ‖e(0)‖, e against a moving target where it moves.
    """
    if result["failed"]:
        return WORST
    first = result["first_error_cm"]
    lost = 10 * APPROACH * result["mse_cm2"] / first**2
    return float(min(WORST, lost + result["final_error_cm"] / first))


def stay_cost(trial: Trial, result: Mapping[str, Any]) -> float:
    """The paper's figure of the run, in `SETTLED` lengths or `TRACKED` lengths squared."""
    if result["failed"]:
        return WORST
    length = 100 * paper.setup(trial.robot).length
    if trial.kind == "set_point":
        return float(min(WORST, result["final_error_cm"] / length / SETTLED))
    return float(min(WORST, result["mse_cm2"] / length**2 / TRACKED))


def tables(schedule: Schedule) -> dict[str, Any]:
    """What `controllers.schedule.make_schedule` reads."""
    found = asdict(schedule)
    for stage in ("approach", "stay"):
        found[stage] |= found[stage].pop("gains")
    return found


def only(schedule: Tables, stage: str, **values: float) -> dict[str, Any]:
    """A schedule whose both stages are one of `schedule`'s, with other values."""
    both = {**schedule[stage], **values}
    return {**schedule, "approach": both, "stay": both}


def tune(
    trials: Sequence[Trial],
    cost: Cost,
    candidate: Candidate,
    start: Mapping[str, float],
    *,
    generations: int,
    population: int,
    seed: int,
    spread: float = 0.15,
    jobs: int = -1,
    each: Callable[[dict[str, Any]], None] | None = None,
) -> list[dict[str, Any]]:
    """Minimise the mean cost over `trials` in the logarithms of `start`'s values.

    Parameters
    ----------
    candidate : parameters → what the controller is built with.
    start : parameter → value > 0; what the first candidate is.
    generations, population : of CMA-ES (Hansen, `cma`).
    seed : > 0; with the same one the same candidates come again.
    spread : first standard deviation, in decades.
    each : told every entry of the trace as it comes.

    Returns
    -------
    list of dict
        The trace: parameters, costs of the trials and their mean, in order; the start is the first.

    Raises
    ------
    InputError
        Without the package `cma` (pip install 'softdyn[tune]').
    """
    try:
        import cma
    except ImportError:
        raise InputError("cma", "pip install 'softdyn[tune]'", "no such package") from None
    names = list(start)
    centre = [math.log10(start[name]) for name in names]
    trace: list[dict[str, Any]] = []

    def judge(points: Sequence[Sequence[float]], generation: int) -> list[float]:
        found = [{name: 10.0**x for name, x in zip(names, point, strict=True)} for point in points]
        runs = [replace(trial, gains=candidate(values)) for values in found for trial in trials]
        results = run_all(runs, jobs)
        costs = []
        for i, values in enumerate(found):
            part = results[i * len(trials) : (i + 1) * len(trials)]
            scores = [cost(trial, result) for trial, result in zip(trials, part, strict=True)]
            costs.append(sum(scores) / len(scores))
            entry = {"generation": generation, "values": values, "scores": scores}
            trace.append({**entry, "cost": costs[-1]})
            if each is not None:
                each(trace[-1])
        return costs

    judge([centre], 0)
    search = cma.CMAEvolutionStrategy(
        centre, spread, {"seed": seed, "popsize": population, "verbose": -9}
    )
    for generation in range(1, generations + 1):
        points = search.ask()
        search.tell(points, judge(points, generation))
    return trace
