"""Tuning of a schedule's gains by CMA-ES, on other set points and rates than the paper's.

Two searches: of the approach on the first second of runs, with the law of that stage alone, then of
the stay on whole runs that begin with the approach found. Runs near unstable shapes hang on
roundings, and a search finds the lucky: so its best few are run again on many more cases, and those
decide.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import softdyn
from softdyn import InputError
from softdyn.controllers import Schedule, SoftIdClfQp, Stage
from softdyn.controllers.qps.horizon import default_horizon
from softdyn.controllers.schedule import make_schedule, tuned
from softdyn.validation.files import read_json
from softdyn.validation.studies import experiments
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.executors import run_all

THETAS, OMEGAS = (0.25, 0.75, 1.25, 1.75), (0.12, 0.17, 0.25, 0.45)
# of the finals, at the published period and at 1 ms
MANY_THETAS = (0.04, 0.12, 0.27, 0.38, 0.62, 0.73, 0.88, 1.12, 1.27, 1.38, 1.62, 1.73, 1.88, 1.96)
MANY_OMEGAS = (0.08, 0.09, 0.11, 0.12, 0.14, 0.17, 0.25, 0.35, 0.45)
APPROACH = 1.0  # s
WORST = 10.0  # cost of a failed run; no run costs more
SETTLED, TRACKED = 0.01, 0.002  # what counts 1: final error / length, mean squared / length²
TUNED = ("Kp", "eps", "w2", "w3", "w4", "null_damping", "rho", "horizon", "u_ref")

Tables = Mapping[str, Any]
Cost = Callable[[Case, Mapping[str, Any]], float]
Candidate = Callable[[Mapping[str, float]], Tables]


def approach_cases(robot: str) -> list[Case]:
    """The first second of set points at the published period and 1 ms, and of trajectories."""
    return [
        Case(robot, "best", kind, value, period=period, duration=APPROACH)
        for kind, values, periods in (
            ("set_point", THETAS, (None, 0.001)),
            ("tracking", OMEGAS[2:], (None,)),
        )
        for value in values
        for period in periods
    ]


def stay_cases(robot: str) -> list[Case]:
    """Whole set points, two of them at 1 ms, and two cycles of each rate."""
    points = [
        Case(robot, "best", "set_point", theta, period=None if i < 2 else 0.001)
        for i, theta in enumerate(THETAS)
    ]
    return points + [Case(robot, "best", "tracking", omega) for omega in OMEGAS]


def final_cases(robot: str) -> list[Case]:
    """Whole set points at the published period and 1 ms, and two cycles of each rate."""
    points = [
        Case(robot, "best", "set_point", theta, period=period)
        for theta in MANY_THETAS
        for period in (None, 0.001)
    ]
    return points + [Case(robot, "best", "tracking", omega) for omega in MANY_OMEGAS]


def approach_cost(case: Case, result: Mapping[str, Any]) -> float:
    """Seconds in which the first error would cost what the run does, in tenths, and what is left.

    10 ∫ ‖e‖² dt / ‖e(0)‖² + ‖e(T)‖ / ‖e(0)‖, e against a moving target where it moves.
    """
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


# -- schedules as tables ---------------------------------------------------------------------------


def tables(schedule: Schedule) -> dict[str, Any]:
    """What `softdyn.controllers.schedule.make_schedule` reads."""
    found = asdict(schedule)
    for stage in ("approach", "stay"):
        found[stage] |= found[stage].pop("gains")
    return found


def first_schedule(robot: str, table: Tables | None = None) -> dict[str, Any]:
    """Where a search starts: `table`, the robot's tuned schedule, or its published gains twice."""
    model = softdyn.load(robot)
    length = experiments.setup_of(model).length
    schedule = make_schedule(table) if table else tuned(model)
    if schedule is None:
        gains = SoftIdClfQp(model).gains
        both = Stage(gains, default_horizon(gains))
        schedule = Schedule(both, both, arrive=0.02 * length, leave=0.2 * length, dwell=0.2)
    return tables(schedule)


def only(schedule: Tables, stage: str, values: Mapping[str, float]) -> dict[str, Any]:
    """A schedule whose both stages are one of `schedule`'s, with other values."""
    both = {**schedule[stage], **values}
    return {**schedule, "approach": both, "stay": both}


def changed(schedule: Tables, stage: str, values: Mapping[str, float]) -> dict[str, Any]:
    """The schedule with other values in one stage, of four digits."""
    new = {name: float(f"{value:.4g}") for name, value in values.items()}
    return {**schedule, stage: {**schedule[stage], **new}}


def toml(schedule: Tables) -> str:
    """A schedule as text."""
    parts = {"": schedule} | {f"\n[{name}]\n": schedule[name] for name in STAGES}
    return "".join(
        head + "".join(f"{k} = {v:g}\n" for k, v in table.items() if not isinstance(v, Mapping))
        for head, table in parts.items()
    )


# -- searching -------------------------------------------------------------------------------------

# stage → what it is judged on, and what becomes of the schedule: the approach is tuned alone, for
# the stay is not yet
STAGES = {
    "approach": (approach_cases, approach_cost, only),
    "stay": (stay_cases, stay_cost, changed),
}


@dataclass(frozen=True)
class Search:
    """A tuning: with the same one the same candidates come again.

    Attributes
    ----------
    robot : str
        Its name.
    start : mapping
        The tables of the schedule that it starts from.
    generations : mapping
        Stage → how many of CMA-ES (Hansen, `cma`); 0 keeps the stage.
    population : int
        Candidates a generation.
    finalists : int
        How many meet at the end, the start included; 0 for no finals.
    seed : int
        Above 0.
    """

    robot: str
    start: Tables
    generations: Mapping[str, int]
    population: int
    finalists: int
    seed: int


def read(path: str | Path) -> Search:
    """The search that a summary, see `search`, is of.

    Raises
    ------
    InputError
        A file that cannot be read, or is no such summary.
    """
    expected = "a summary that tune.py wrote"
    settings = read_json(path, expected).get("settings")
    if not isinstance(settings, dict) or set(settings) != {f.name for f in fields(Search)}:
        raise InputError(str(path), expected, "other settings")
    wanted = Search(**settings)
    generations = wanted.generations
    counts = {"population": 1, "finalists": 0, "seed": 1}
    if not (
        isinstance(wanted.robot, str)
        and isinstance(generations, dict)
        and set(generations) == set(STAGES)
        and all(_is_count(number, 0) for number in generations.values())
        and all(_is_count(settings[name], least) for name, least in counts.items())
    ):
        raise InputError(str(path), expected, "settings of another kind")
    try:
        make_schedule(wanted.start)
    except (InputError, TypeError, AttributeError) as error:
        raise InputError(str(path), expected, error) from None
    return wanted


def _is_count(value: Any, least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and least <= value < 2**32


def search(
    wanted: Search, jobs: int = -1, each: Callable[[dict[str, Any]], None] | None = None
) -> dict[str, Any]:
    """Tune one stage after the other, then let the finals decide.

    Parameters
    ----------
    wanted : Search
        What to search, and from where.
    jobs : int
        Processes, -1 for one per core.
    each : Callable[[dict], None], optional
        Told every candidate with its stage and its scores as it comes.

    Returns
    -------
    dict
        ``settings``; ``winners`` of the searches, by stage; ``finals``, the start first, with the
        scores of the best; ``schedule``, the tables of what was found.
    """

    def tell(stage: str, entry: dict[str, Any]) -> None:
        if each is not None:
            each({"stage": stage, **entry})

    schedule: Tables = wanted.start
    contenders = [schedule]
    winners = {}
    for stage, (cases, cost, candidate) in STAGES.items():
        if wanted.generations[stage] == 0:
            continue
        trace = tune(
            cases(wanted.robot),
            cost,
            partial(candidate, schedule, stage),
            {name: schedule[stage][name] for name in TUNED if schedule[stage][name] > 0},
            generations=wanted.generations[stage],
            population=wanted.population,
            seed=wanted.seed,
            jobs=jobs,
            each=partial(tell, stage),
        )
        ranked = sorted(trace, key=lambda entry: entry["cost"])
        keys = ("generation", "values", "cost")
        winners[stage] = {"start_cost": trace[0]["cost"]} | {key: ranked[0][key] for key in keys}
        found = [changed(schedule, stage, entry["values"]) for entry in ranked]
        schedule, contenders = found[0], [wanted.start, *found]
    finals: list[dict[str, Any]] = []
    if wanted.finalists:
        contenders = contenders[: wanted.finalists]
        judged = judge(final_cases(wanted.robot), stay_cost, contenders, jobs)
        finals = [{"schedule": c} | j for c, j in zip(contenders, judged, strict=True)]
        for final in finals:
            tell("final", final)
        best = min(finals, key=lambda final: final["cost"])
        schedule = best["schedule"]
        finals = [final if final is best else without_scores(final) for final in finals]
    return {
        "settings": vars(wanted), "winners": winners, "finals": finals, "schedule": schedule
    }  # fmt: skip


def without_scores(entry: dict[str, Any]) -> dict[str, Any]:
    """An entry of a trace without what each of its cases cost."""
    return {key: value for key, value in entry.items() if key != "scores"}


def text(found: Mapping[str, Any]) -> str:
    """What `search` found, for people."""
    lines = [
        f"{stage}: cost {winner['start_cost']:.4g} at the start, {winner['cost']:.4g} now"
        for stage, winner in found["winners"].items()
    ]
    if found["finals"]:
        costs = ", ".join(f"{final['cost']:.4g}" for final in found["finals"])
        lines.append(f"final: cost {costs} (start first)")
    return "\n".join(lines)


def judge(
    cases: Sequence[Case], cost: Cost, schedules: Sequence[Tables], jobs: int = -1
) -> list[dict[str, Any]]:
    """For each schedule the cost of every case, and the mean for each kind of experiment, halved.

    Set points and trajectories weigh the same, however many there are of each.
    """
    runs = [replace(case, parameters=schedule) for schedule in schedules for case in cases]
    results = run_all(runs, jobs)
    found = []
    for i in range(len(schedules)):
        part = results[i * len(cases) : (i + 1) * len(cases)]
        scores = [cost(case, result) for case, result in zip(cases, part, strict=True)]
        kinds: dict[str, list[float]] = {}
        for case, score in zip(cases, scores, strict=True):
            kinds.setdefault(case.kind, []).append(score)
        means = [sum(some) / len(some) for some in kinds.values()]
        found.append({"scores": scores, "cost": sum(means) / len(means)})
    return found


def need_cma() -> Any:
    """The package `cma`, or an InputError that says how to install it."""
    try:
        import cma
    except ImportError:
        raise InputError("cma", "pip install 'softdyn[tune]'", "no such package") from None
    return cma


def tune(
    cases: Sequence[Case],
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
    enough: Callable[[], bool] = lambda: False,
) -> list[dict[str, Any]]:
    """Minimise the cost over `cases`, see `judge`, in the logarithms of `start`'s values.

    Parameters
    ----------
    cases : sequence of Case
        What a candidate is judged on.
    cost : Callable[[Case, mapping], float]
        What a case with its figures costs.
    candidate : Callable[[mapping], mapping]
        Parameters → what the controller is built with.
    start : mapping
        Parameter → value > 0; what the first candidate is.
    generations, population : int
        Of CMA-ES (Hansen, `cma`).
    seed : int
        Above 0; with the same one the same candidates come again.
    spread : float
        First standard deviation, in decades.
    jobs : int
        Processes, -1 for one per core.
    each : Callable[[dict], None], optional
        Told every entry of the trace as it comes.
    enough : Callable[[], bool]
        Asked before every generation whether to end.

    Returns
    -------
    list of dict
        The trace: parameters and what `judge` says, in order; the start is the first.

    Raises
    ------
    InputError
        Without the package `cma` (pip install 'softdyn[tune]').
    """
    cma = need_cma()
    names = list(start)
    centre = [math.log10(start[name]) for name in names]
    trace: list[dict[str, Any]] = []

    def costs(points: Sequence[Sequence[float]], generation: int) -> list[float]:
        found = [{name: 10.0**x for name, x in zip(names, point, strict=True)} for point in points]
        judged = judge(cases, cost, [candidate(values) for values in found], jobs)
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
        if enough():
            break
        points = search.ask()
        search.tell(points, costs(points, generation))
    return trace
