"""Tuning of the bundled robots' schedules, on other set points and rates than the paper's.

The first search tunes the approach, on the first second of runs with the controller of that stage
alone. The second tunes the stay, on complete runs that begin with the tuned approach. Runs near
unstable shapes depend on rounding errors, and a search prefers lucky ones. So the best few
candidates run again on many more cases, and these decide.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import softdyn
from softdyn import InputError
from softdyn.controllers import Schedule, SoftIdClfQp, Stage
from softdyn.controllers.qps.horizon import default_horizon
from softdyn.controllers.schedule import make_schedule, tuned
from softdyn.validation.files import read_json
from softdyn.validation.studies import experiments, schedule_search
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.schedule_search import STAGES, WORST, Tables

THETAS, OMEGAS = (0.25, 0.75, 1.25, 1.75), (0.12, 0.17, 0.25, 0.45)
MANY_THETAS = (0.04, 0.12, 0.27, 0.38, 0.62, 0.73, 0.88, 1.12, 1.27, 1.38, 1.62, 1.73, 1.88, 1.96)
MANY_OMEGAS = (0.08, 0.09, 0.11, 0.12, 0.14, 0.17, 0.25, 0.35, 0.45)
PERIODS = (None, 0.001)  # s; the published period, and 1 ms
APPROACH = 1.0  # s
# part → set points and their periods, rates, duration (s; None: 10 s, and two cycles)
PARTS: dict[str, tuple[Any, Any, float | None]] = {
    "approach": ([(x, p) for x in THETAS for p in PERIODS], OMEGAS[2:], APPROACH),
    "stay": ([*zip(THETAS, (None, None, 0.001, 0.001), strict=True)], OMEGAS, None),
    "final": ([(x, p) for x in MANY_THETAS for p in PERIODS], MANY_OMEGAS, None),
}
# values that cost 1: final error / length, mean squared error / length²
SETTLED, TRACKED = 0.01, 0.002


def search_cases(robot: str, part: str) -> list[Case]:
    """The runs that judge a stage or the finals."""
    points, rates, duration = PARTS[part]
    make = partial(Case, robot, "best", duration=duration)
    return [make("set_point", theta, period=period) for theta, period in points] + [
        make("tracking", omega) for omega in rates
    ]


def approach_cost(case: Case, result: Mapping[str, Any]) -> float:
    """10 ∫ ‖e‖² dt / ‖e(0)‖² + ‖e(T)‖ / ‖e(0)‖, with e the error of the tip."""
    if result["failed"]:
        return WORST
    first = result["first_error_cm"]
    lost = 10 * APPROACH * result["mse_cm2"] / first**2
    return float(min(WORST, lost + result["final_error_cm"] / first))


def stay_cost(case: Case, result: Mapping[str, Any]) -> float:
    """The paper's figure of the run, in `SETTLED` lengths or `TRACKED` lengths squared."""
    if result["failed"]:
        return WORST
    length = 100 * experiments.setup(case.robot).length
    if case.kind == "set_point":
        return float(min(WORST, result["final_error_cm"] / length / SETTLED))
    return float(min(WORST, result["mse_cm2"] / length**2 / TRACKED))


def first_schedule(robot: str) -> dict[str, Any]:
    """The start of a search: the robot's tuned schedule, or its published gains in both stages."""
    model = softdyn.load(robot)
    schedule = tuned(model)
    if schedule is None:
        gains, length = SoftIdClfQp(model).gains, experiments.setup_of(model).length
        both = Stage(gains, default_horizon(gains))
        schedule = Schedule(both, both, arrive=0.02 * length, leave=0.2 * length, dwell=0.2)
    return schedule_search.schedule_tables(schedule)


@dataclass(frozen=True)
class Search:
    """The settings of a tuning. The same settings give the same candidates again.

    Attributes
    ----------
    robot : str
        Its name.
    start : mapping
        The tables of the schedule from which it starts.
    generations : mapping
        Stage → generations of CMA-ES; 0 keeps the stage.
    population : int
        Candidates a generation.
    finalists : int
        Number of candidates in the finals, the start included; 0 for no finals.
    seed : int
        Above 0.
    """

    robot: str
    start: Tables
    generations: Mapping[str, int]
    population: int
    finalists: int
    seed: int


def read_search(path: str | Path) -> Search:
    """Read the search from a summary of `search_schedule`.

    Raises
    ------
    InputError
        The file cannot be read, or is no such summary.
    """
    expected = "a summary that tune.py wrote"
    settings = read_json(path, expected).get("settings")
    if not isinstance(settings, dict) or set(settings) != {f.name for f in fields(Search)}:
        raise InputError(str(path), expected, "other settings")
    wanted = Search(**settings)
    stages, counts = wanted.generations, [(wanted.population, 1), (wanted.finalists, 0)]
    if not (
        isinstance(wanted.robot, str)
        and isinstance(stages, dict)
        and set(stages) == set(STAGES)
        and all(
            type(number) is int and least <= number < 2**32
            for number, least in (*counts, (wanted.seed, 1), *((n, 0) for n in stages.values()))
        )
    ):
        raise InputError(str(path), expected, "settings of another kind")
    try:
        make_schedule(wanted.start)
    except (InputError, TypeError, AttributeError) as error:
        raise InputError(str(path), expected, error) from None
    return wanted


def search_schedule(
    wanted: Search, jobs: int = -1, each: Callable[[dict[str, Any]], None] = lambda _: None
) -> dict[str, Any]:
    """Tune one stage after the other, then let the finals decide.

    Parameters
    ----------
    wanted : Search
        The search's settings and start.
    jobs : int
        Processes, -1 for one per core.
    each : Callable[[dict], None]
        Called with every candidate, its stage and its scores.

    Returns
    -------
    dict
        ``settings``; ``winners`` of the searches, by stage; ``finals``, the start first, with the
        scores of the best; ``schedule``, the tables of the best schedule.
    """

    def tell(stage: str, entry: dict[str, Any]) -> None:
        each({"stage": stage, **entry})

    schedule: Tables = wanted.start
    contenders = [schedule]
    winners = {}
    for stage, cost in (("approach", approach_cost), ("stay", stay_cost)):
        if wanted.generations[stage] == 0:
            continue
        trace = schedule_search.search_stage(
            schedule, stage,
            partial(schedule_search.judge, search_cases(wanted.robot, stage), cost, jobs),
            generations=wanted.generations[stage], population=wanted.population, seed=wanted.seed,
            each=partial(tell, stage),
        )  # fmt: skip
        ranked = sorted(trace, key=lambda entry: entry["cost"])
        keys = ("generation", "values", "cost")
        winners[stage] = {"start_cost": trace[0]["cost"]} | {key: ranked[0][key] for key in keys}
        found = [schedule_search.changed(schedule, stage, entry["values"]) for entry in ranked]
        schedule, contenders = found[0], [wanted.start, *found]
    finals: list[dict[str, Any]] = []
    if wanted.finalists:
        contenders = contenders[: wanted.finalists]
        judged = schedule_search.judge(
            search_cases(wanted.robot, "final"), stay_cost, jobs, contenders
        )
        finals = [{"schedule": c} | j for c, j in zip(contenders, judged, strict=True)]
        for final in finals:
            tell("final", final)
        best = min(finals, key=lambda final: final["cost"])
        schedule = best["schedule"]
        for final in finals:
            if final is not best:
                del final["scores"]
    return {
        "settings": vars(wanted), "winners": winners, "finals": finals, "schedule": schedule
    }  # fmt: skip


def search_text(found: Mapping[str, Any]) -> str:
    """The result of `search_schedule` as text."""
    lines = [
        f"{stage}: cost {winner['start_cost']:.4g} at the start, {winner['cost']:.4g} now"
        for stage, winner in found["winners"].items()
    ]
    if found["finals"]:
        costs = ", ".join(f"{final['cost']:.4g}" for final in found["finals"])
        lines.append(f"final: cost {costs} (start first)")
    return "\n".join(lines)
