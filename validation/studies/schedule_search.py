"""CMA-ES on the gains of a schedule, one stage at a time; both tunings use it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from softdyn import InputError
from softdyn.controllers import Schedule
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.executors import run_all

STAGES = ("approach", "stay")
TUNED = ("Kp", "eps", "w2", "w3", "w4", "null_damping", "rho", "horizon", "u_ref")
WORST = 10.0  # cost of a failed run; no run costs more
SPREAD = 0.15  # first standard deviation of CMA-ES, in decades

Tables = Mapping[str, Any]
"""A schedule as the tables of its TOML file."""
Cost = Callable[[Case, Mapping[str, Any]], float]
"""(case, figures of its run) → cost."""
Entry = dict[str, Any]
"""A candidate with the ``scores`` of its cases and its ``cost``."""


def schedule_tables(schedule: Schedule) -> dict[str, Any]:
    """The tables that `softdyn.controllers.schedule.make_schedule` reads."""
    found = asdict(schedule)
    for stage in STAGES:
        found[stage] |= found[stage].pop("gains")
    return found


def schedule_toml(schedule: Tables) -> str:
    """A schedule as text."""
    parts = {"": schedule} | {f"\n[{name}]\n": schedule[name] for name in STAGES}
    return "".join(
        head + "".join(f"{k} = {v:g}\n" for k, v in table.items() if not isinstance(v, Mapping))
        for head, table in parts.items()
    )


def changed(schedule: Tables, stage: str, values: Mapping[str, float]) -> dict[str, Any]:
    """The schedule with other values in one stage, rounded to four digits."""
    new = {name: float(f"{value:.4g}") for name, value in values.items()}
    return {**schedule, stage: {**schedule[stage], **new}}


def judge(cases: Sequence[Case], cost: Cost, jobs: int, schedules: Sequence[Tables]) -> list[Entry]:
    """The ``scores`` of all cases and their ``cost``, for each schedule.

    The cost is the mean over the kinds of experiment of a kind's mean score. So set points and
    trajectories have equal weight, whatever their numbers.
    """
    runs = [replace(case, parameters=schedule) for schedule in schedules for case in cases]
    results = run_all(runs, jobs)
    found = []
    for start in range(0, len(runs), len(cases)):
        part = results[start : start + len(cases)]
        scores = [cost(case, result) for case, result in zip(cases, part, strict=True)]
        kinds: dict[str, list[float]] = {}
        for case, score in zip(cases, scores, strict=True):
            kinds.setdefault(case.kind, []).append(score)
        means = [sum(some) / len(some) for some in kinds.values()]
        found.append({"scores": scores, "cost": sum(means) / len(means)})
    return found


def need_cma() -> Any:
    """The package `cma` (Hansen), or an InputError that says how to install it."""
    try:
        import cma
    except ImportError:
        raise InputError("cma", "softdyn[tune]: pip install cma", "no such package") from None
    return cma


def search_stage(
    schedule: Tables,
    stage: str,
    judge: Callable[[Sequence[Tables]], list[Entry]],
    *,
    generations: int,
    population: int,
    seed: int,
    each: Callable[[Entry], None] = lambda _: None,
    enough: Callable[[], bool] = lambda: False,
) -> list[Entry]:
    """Minimise the cost of a schedule in the logarithms of one stage's positive gains.

    Candidates for the approach have its gains in both stages, because the stay is not tuned yet.

    Parameters
    ----------
    schedule : mapping
        The tables of the initial schedule.
    stage : str
        One of `STAGES`.
    judge : Callable[[sequence of mapping], list of dict]
        Schedules → the ``scores`` and the ``cost`` of each.
    generations, population : int
        Settings of CMA-ES.
    seed : int
        Above 0. The same seed gives the same candidates again.
    each : Callable[[dict], None]
        Called with every entry of the trace.
    enough : Callable[[], bool]
        Called before every generation; True ends the search.

    Returns
    -------
    list of dict
        The trace, the start first: ``generation``, ``values``, ``scores``, ``cost``.

    Raises
    ------
    InputError
        Without the package `cma` (the extra softdyn[tune]).
    """
    cma = need_cma()
    names = [name for name in TUNED if schedule[stage].get(name, 0) > 0]
    centre = [math.log10(schedule[stage][name]) for name in names]
    trace: list[Entry] = []

    def candidate(values: Mapping[str, float]) -> Tables:
        if stage == "stay":
            return changed(schedule, stage, values)
        return {**schedule, **{key: {**schedule[stage], **values} for key in STAGES}}

    def costs(points: Sequence[Sequence[float]], generation: int) -> list[float]:
        found = [{name: 10.0**x for name, x in zip(names, point, strict=True)} for point in points]
        judged = judge([candidate(values) for values in found])
        for values, entry in zip(found, judged, strict=True):
            trace.append({"generation": generation, "values": values, **entry})
            each(trace[-1])
        return [entry["cost"] for entry in judged]

    costs([centre], 0)
    options = {"seed": seed, "popsize": population, "verbose": -9}
    evolution = cma.CMAEvolutionStrategy(centre, SPREAD, options)
    for generation in range(1, generations + 1):
        if enough():
            break
        points = evolution.ask()
        evolution.tell(points, costs(points, generation))
    return trace
