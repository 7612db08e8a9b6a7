"""Tuning of a controller's few parameters by CMA-ES, on cases that the paper does not have."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from softdyn import InputError
from validation import paper
from validation.trials import Trial, run_all

THETAS, OMEGAS = (0.25, 0.75, 1.25, 1.75), (0.15, 0.35)
WORST = 4.0  # cost of a failed run, log10 of what an error of two lengths costs and more
FLOOR = 1e-3  # an error of a thousandth of the robot's length is as good as none


def cases(robots: Sequence[str], controller: str, duration: float) -> list[Trial]:
    """The training set: set points and trajectories between the paper's, all `duration` s long."""
    return [
        Trial(robot, controller, kind, value, duration=duration)
        for robot in robots
        for kind, values in (("set_point", THETAS), ("tracking", OMEGAS))
        for value in values
    ]


def cost(trial: Trial, result: Mapping[str, Any]) -> float:
    """log10 of the run's root-mean-square and final error over the length, half each."""
    if result["failed"]:
        return WORST
    length = 100 * paper.setup(trial.robot).length
    rms, final = math.sqrt(result["mse_cm2"]) / length, result["final_error_cm"] / length
    return 0.5 * (math.log10(rms + FLOOR) + math.log10(final + FLOOR))


def tune(
    trials: Sequence[Trial],
    start: Mapping[str, float],
    *,
    generations: int,
    population: int,
    seed: int,
    spread: float = 0.3,
    jobs: int = -1,
    each: Callable[[dict[str, Any]], None] | None = None,
) -> list[dict[str, Any]]:
    """Minimise the mean cost over `trials` in the logarithms of `start`'s values.

    Parameters
    ----------
    start : parameter → value > 0; what the first candidate is.
    generations, population : of CMA-ES (Hansen, `cma`).
    seed : > 0; with the same one the same candidates come again.
    spread : first standard deviation, in decades.
    each : told every entry of the trace as it comes.

    Returns
    -------
    list of dict
        The trace: parameters and cost of every candidate, in order; the start is the first.

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
        candidates = [
            {name: 10.0**x for name, x in zip(names, point, strict=True)} for point in points
        ]
        jobs_of = [replace(trial, gains=gains) for gains in candidates for trial in trials]
        results = run_all(jobs_of, jobs)
        costs = []
        for i, gains in enumerate(candidates):
            part = results[i * len(trials) : (i + 1) * len(trials)]
            scores = [cost(trial, result) for trial, result in zip(trials, part, strict=True)]
            costs.append(sum(scores) / len(scores))
            failed = sum(result["failed"] for result in part)
            entry = {"generation": generation, **gains, "cost": costs[-1], "failed": failed}
            trace.append(entry)
            if each is not None:
                each(entry)
        return costs

    judge([centre], 0)
    search = cma.CMAEvolutionStrategy(
        centre, spread, {"seed": seed, "popsize": population, "verbose": -9}
    )
    for generation in range(1, generations + 1):
        points = search.ask()
        search.tell(points, judge(points, generation))
    return trace
