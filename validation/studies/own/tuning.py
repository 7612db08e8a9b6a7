"""A schedule for anyone's robot: targets and paths from its statics, gains from a short search.

Nothing is asked of the user. `softdyn.statics` finds points and paths that the robot can rest at
and follow; they are dealt out to three sets: the search, the finals, and a test that neither saw.
The search draws gains at random over decades, in the robot's own scales, and goes on by CMA-ES from
the best. The test compares the schedule with predictive control, which needs no gains: a schedule
that is not better is not worth having.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from os import cpu_count
from time import monotonic
from typing import Any

import numpy as np

from softdyn.controllers.schedule import make_schedule
from softdyn.validation.studies import tuning
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.executors import run_all
from softdyn.validation.studies.own.budget import Budget, Generations, Tell, seconds
from softdyn.validation.studies.own.tasks import Tasks
from softdyn.validation.tables import Table

RMS, FINAL = 0.1, 0.01  # of the length: a mean and a final error that cost 1
DRAWN = 24  # candidates of the first search
ENDS = {"draw": 0.4, "approach": 0.7, "stay": 1.0}  # shares of the time
POPULATION, GENERATIONS, FINALISTS = 6, 100, 2
RIVAL, DECIDE = 0.25, 0.4  # of the time: predictive control on the test; finals and test at most
# decades that gains are drawn from; w2 and w3 in the robot's own scales, the horizon in ε
RANGES = {
    "Kp": (20.0, 2000.0), "eps": (0.01, 0.2), "w2": (1e-2, 3.0), "w3": (1e-5, 10.0),
    "null_damping": (3.0, 100.0), "horizon": (0.5, 1.5),
}  # fmt: skip
COLUMNS = (
    ("", "name", ""), ("cost", "cost", ".3f"), ("final error (cm)", "final_cm", ".3f"),
    ("rms on paths (cm)", "rms_cm", ".3f"), ("failed", "failed", "d"),
    ("step (us)", "step_us", ".0f"),
)  # fmt: skip


def cost(length: float, case: Case, result: Mapping[str, Any]) -> float:
    """A run's rms error in tenths of the length, and to a point its final one in hundredths."""
    if result["failed"] or result["mse_cm2"] is None:
        return tuning.WORST
    rms = math.sqrt(result["mse_cm2"]) / (100 * length * RMS)
    final = 0.0 if case.target else result["final_error_cm"] / (100 * length * FINAL)
    return min(tuning.WORST, rms + final)


def drawn(tasks: Tasks, rng: np.random.Generator) -> dict[str, Any]:
    """A schedule of random gains, both stages the same.

    w2 ‖q̈‖² and w3 ‖u‖² are so many times ‖μ‖² for a tip a tenth of the robot's length away, with q̈
    the acceleration that this asks for and u what holds the robot at a typical rest.
    """
    model = tasks.model
    value = {k: float(10 ** rng.uniform(*np.log10(ends))) for k, ends in RANGES.items()}
    J = model.state(model.q0, np.zeros(model.nv)).J
    reach = float(np.linalg.norm(J, 2)) or 1.0
    length = model.robot.length
    w2 = value["w2"] * reach**2
    w3 = value["w3"] * (value["Kp"] * length / 10 / tasks.inputs) ** 2
    stage = {
        "Kp": value["Kp"], "eps": value["eps"], "w1": 1.0, "w2": w2, "w3": w3, "w4": w2 / 2,
        "rho": 1000.0, "null_damping": value["null_damping"],
        "horizon": value["horizon"] * value["eps"], "u_ref": 0.0,
    }  # fmt: skip
    stage = {name: float(f"{x:.4g}") for name, x in stage.items()}
    return {
        "arrive": 0.02 * length, "leave": 0.2 * length, "dwell": 0.2,
        "approach": stage, "stay": stage,
    }  # fmt: skip


def search(
    tasks: Tasks,
    time: float,
    *,
    began: float | None = None,
    start: Mapping[str, Any] | None = None,
    seed: int = 1,
    jobs: int = -1,
    tell: Tell = lambda _text, _spent: None,
) -> dict[str, Any]:
    """Find a schedule and compare it with predictive control, in about so many seconds.

    Predictive control runs first, on as many targets of the test as fit: no target is chosen by
    what comes of it. The search ends when finals and test, priced by the runs before them, need
    what is left. What has begun is finished: of a slow robot two runs of predictive control, four
    candidates and the test are made however long they take.

    Parameters
    ----------
    tasks : Tasks
        What the robot is tried on.
    time : float
        How long all of it may take (s).
    began : float, optional
        When that time began, as `time.monotonic` says; now by default.
    start : mapping, optional
        Tables of a schedule that the search begins with, besides random ones.
    seed : int
        Above 0. With the same one the same candidates come again, as far as the time lasts.
    jobs : int
        Processes, -1 for one per core.
    tell : Callable[[str, float], None]
        Told what is being done, and the share of the time that has passed.

    Returns
    -------
    dict
        ``schedule``; ``better``, whether it beats predictive control on the test; ``rows`` of that
        test; ``costs`` of the search by part; ``candidates``, how many were tried; ``seconds``.

    Raises
    ------
    InputError
        Without the package `cma`; a `start` that is no schedule.
    """
    firsts = [] if start is None else [tuning.tables(make_schedule(start))]
    tuning.need_cma()
    budget, tried = Budget(time, monotonic() if began is None else began), 0
    price = partial(cost, tasks.model.robot.length)

    def judged(part: str, schedules: Sequence[Mapping[str, Any]], window: bool) -> list[float]:
        nonlocal tried
        tried += len(schedules)
        cases, since = tasks.cases(part, window=window), monotonic()
        entries = tuning.judge(cases, price, schedules, jobs)
        scores = [score for entry in entries for score in entry["scores"]]
        budget.note(since, cases * len(schedules), scores)
        return [entry["cost"] for entry in entries]

    tell("predictive control", budget.spent())
    rival = run_rival(tasks, budget, jobs)
    test = seconds(*tasks.cases("test")[: len(rival)])
    final = seconds(*tasks.cases("final"))

    def end() -> float:
        """The share of the time at which finals and test must begin."""
        wanted = budget.share(test + (2 + FINALISTS) * final)
        return 1.0 - max(budget.share(test), min(DECIDE, wanted))

    # -- random gains
    rng, first = np.random.default_rng(seed), budget.spent()
    candidates: list[tuple[float, dict[str, Any]]] = []
    while len(candidates) < DRAWN and (
        not candidates or budget.spent() < first + ENDS["draw"] * (end() - first)
    ):
        some = firsts + [drawn(tasks, rng) for _ in range(4 - len(firsts))]
        firsts = []
        found = judged("search", some, window=True)
        candidates += zip(found, some, strict=True)
        best = min(c for c, _ in candidates)
        tell(f"{len(candidates)} random gains, best cost {best:.3g}", budget.spent())
    schedule = min(candidates, key=lambda pair: pair[0])[1]
    costs = {"draw": min(c for c, _ in candidates)}
    contenders = [schedule]

    # -- CMA-ES: the approach alone, then the stay behind it
    for stage, candidate in (("approach", tuning.only), ("stay", tuning.changed)):
        cases = tasks.cases("search", window=stage == "approach")
        until = first + ENDS[stage] * (end() - first)
        if budget.spent() + budget.share((1 + POPULATION) * seconds(*cases)) > until:
            continue
        clock = Generations(budget, cases, POPULATION, until, tell, stage)
        trace = tuning.tune(
            cases,
            price,
            partial(candidate, schedule, stage),
            {name: schedule[stage][name] for name in tuning.TUNED if schedule[stage][name] > 0},
            generations=GENERATIONS, population=POPULATION, seed=seed, jobs=jobs,
            each=clock.each, enough=clock.enough,
        )  # fmt: skip
        tried += len(trace)
        best_few = 1 if stage == "approach" else FINALISTS
        ranked = sorted(trace, key=lambda entry: entry["cost"])[:best_few]
        costs[stage] = ranked[0]["cost"]
        found_here = [replaced(schedule, stage, entry["values"]) for entry in ranked]
        schedule = found_here[0]
        contenders = found_here + contenders

    # -- finals between as many as there is time for, and the test
    left = 1.0 - budget.spent() - budget.share(test)
    affordable = int(left / max(budget.share(final), 1e-9))
    contenders = contenders[: max(1, affordable)]
    if len(contenders) > 1:
        tell("finals", budget.spent())
        finals = judged("final", contenders, window=False)
        schedule = contenders[int(np.argmin(finals))]
        costs["final"] = min(finals)
    tell("test against mpc", budget.spent())
    rows = compared(tasks, schedule, rival, jobs)
    return {
        "schedule": schedule, "better": rows[0]["cost"] < rows[1]["cost"], "rows": rows,
        "costs": costs, "candidates": tried, "seconds": monotonic() - budget.began,
    }  # fmt: skip


def run_rival(tasks: Tasks, budget: Budget, jobs: int) -> list[dict[str, Any]]:
    """Predictive control on the first runs of the test, as many as fit into its share of the time.

    One for each process at a time, and never less than two.
    """
    cases, found = tasks.cases("test", "mpc"), list[dict[str, Any]]()
    chunk = max(2, (cpu_count() or 1) if jobs < 0 else jobs)
    took = 0.0
    while len(found) < len(cases) and (not found or budget.spent() + took < RIVAL):
        before = budget.spent()
        found += run_all(cases[len(found) : len(found) + chunk], jobs)
        took = budget.spent() - before
    return found


def replaced(
    schedule: Mapping[str, Any], stage: str, values: Mapping[str, float]
) -> dict[str, Any]:
    """The schedule with what one search found: the approach's gains are the stay's first ones."""
    new = tuning.changed(schedule, stage, values)
    return {**new, "stay": new["approach"]} if stage == "approach" else new


def compared(
    tasks: Tasks, schedule: Mapping[str, Any], rival: Sequence[Mapping[str, Any]], jobs: int
) -> list[dict[str, Any]]:
    """A row each for the schedule and for predictive control, on the runs that `rival` has."""
    price = partial(cost, tasks.model.robot.length)
    cases = tasks.cases("test", "best", schedule)[: len(rival)]
    rows = []
    for name, results in (("best", run_all(cases, jobs)), ("mpc", rival)):
        found = list(zip(cases, results, strict=True))
        prices = [price(case, result) for case, result in found]
        finals = [r["final_error_cm"] for c, r in found if not c.target]
        squares = [r["mse_cm2"] for c, r in found if c.target]
        whole = squares and all(x is not None and math.isfinite(x) for x in squares)
        rows.append({
            "name": name, "cost": float(np.mean(prices)), "costs": prices,
            "final_cm": _mean(finals),
            "rms_cm": float(np.sqrt(np.mean(squares))) if whole else None,
            "failed": sum(bool(result["failed"]) for _, result in found),
            "step_us": float(np.median([r["step_us"]["median"] or np.nan for _, r in found])),
            "targets": len(finals), "paths": len(squares),
        })  # fmt: skip
    return rows


def _mean(values: Sequence[float | None]) -> float | None:
    numbers = [x for x in values if x is not None and math.isfinite(x)]
    return float(np.mean(numbers)) if numbers and len(numbers) == len(values) else None


def text(tasks: Tasks, found: Mapping[str, Any]) -> str:
    """What `search` found, for people."""
    points, paths = (sum(map(len, some.values())) for some in (tasks.points, tasks.loops))
    costs = ", ".join(f"{name} {value:.3g}" for name, value in found["costs"].items())
    first = found["rows"][0]
    tested = f"{first['targets']} targets and {first['paths']} paths"
    if first["targets"] + first["paths"] < len(tasks.cases("test")):
        tested += f" of {len(tasks.cases('test'))} (more with more --seconds)"
    verdict = (
        "the schedule beats predictive control"
        if found["better"]
        else "predictive control is better: no schedule is worth having here"
    )
    return "\n".join((
        f"{tasks.model.name}: {points} targets and {paths} paths, found by its statics",
        f"{found['candidates']} candidates in {found['seconds']:.0f} s; least costs: {costs}",
        f"on {tested} that no step of the search saw:",
        Table.of(COLUMNS, found["rows"]).text(),
        verdict,
    ))  # fmt: skip


def for_robot(tasks: Tasks, schedule: Mapping[str, Any], text: str) -> str:
    """A schedule as the text of a file for one robot, with what it is as a comment."""
    about = "".join(f"# {line}".rstrip() + "\n" for line in text.splitlines())
    mark = f'robot = "{tasks.model.robot.digest}"\n'
    return about + mark + tuning.toml(schedule)
