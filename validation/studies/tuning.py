"""Tuning of a schedule's gains by CMA-ES, on cases that the paper does not have.

Two searches: of the approach on the first second of runs, with the law of that stage alone, then of
the stay on whole runs that begin with the approach found. Runs near unstable shapes hang on
roundings, and a search finds the lucky: so its best few are run again on many more cases, and those
decide.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from softdyn import InputError
from softdyn.controllers import Schedule
from softdyn.validation.studies import paper
from softdyn.validation.studies.trials import Trial, run_all

THETAS, OMEGAS = (0.25, 0.75, 1.25, 1.75), (0.12, 0.17, 0.25, 0.45)
# of the finals, at the published period and at 1 ms
MANY_THETAS = (0.04, 0.12, 0.27, 0.38, 0.62, 0.73, 0.88, 1.12, 1.27, 1.38, 1.62, 1.73, 1.88, 1.96)
MANY_OMEGAS = (0.08, 0.09, 0.11, 0.12, 0.14, 0.17, 0.25, 0.35, 0.45)
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


def final_cases(robot: str) -> list[Trial]:
    """Whole set points at the published period and 1 ms, and two cycles of each rate."""
    points = [
        Trial(robot, "best", "set_point", theta, period)
        for theta in MANY_THETAS
        for period in (None, 0.001)
    ]
    return points + [Trial(robot, "best", "tracking", omega) for omega in MANY_OMEGAS]


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
    """What `softdyn.controllers.schedule.make_schedule` reads."""
    found = asdict(schedule)
    for stage in ("approach", "stay"):
        found[stage] |= found[stage].pop("gains")
    return found


def only(schedule: Tables, stage: str, values: Mapping[str, float]) -> dict[str, Any]:
    """A schedule whose both stages are one of `schedule`'s, with other values."""
    both = {**schedule[stage], **values}
    return {**schedule, "approach": both, "stay": both}


def judge(
    trials: Sequence[Trial], cost: Cost, schedules: Sequence[Tables], jobs: int = -1
) -> list[dict[str, Any]]:
    """For each schedule the cost of every trial, and the mean for each kind of experiment, halved.

    Set points and trajectories weigh the same, however many there are of each.
    """
    runs = [replace(trial, gains=schedule) for schedule in schedules for trial in trials]
    results = run_all(runs, jobs)
    found = []
    for i in range(len(schedules)):
        part = results[i * len(trials) : (i + 1) * len(trials)]
        scores = [cost(trial, result) for trial, result in zip(trials, part, strict=True)]
        kinds: dict[str, list[float]] = {}
        for trial, score in zip(trials, scores, strict=True):
            kinds.setdefault(trial.kind, []).append(score)
        means = [sum(some) / len(some) for some in kinds.values()]
        found.append({"scores": scores, "cost": sum(means) / len(means)})
    return found


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
    """Minimise the cost over `trials`, see `judge`, in the logarithms of `start`'s values.

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
        The trace: parameters and what `judge` says, in order; the start is the first.

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

    def costs(points: Sequence[Sequence[float]], generation: int) -> list[float]:
        found = [{name: 10.0**x for name, x in zip(names, point, strict=True)} for point in points]
        judged = judge(trials, cost, [candidate(values) for values in found], jobs)
        for values, entry in zip(found, judged, strict=True):
            trace.append({"generation": generation, "values": values, **entry})
            if each is not None:
                each(trace[-1])
        return [entry["cost"] for entry in judged]

    costs([centre], 0)
    search = cma.CMAEvolutionStrategy(
        centre, spread, {"seed": seed, "popsize": population, "verbose": -9}
    )
    for generation in range(1, generations + 1):
        points = search.ask()
        search.tell(points, costs(points, generation))
    return trace
