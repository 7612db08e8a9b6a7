"""Tuning of a schedule for a user's robot, on targets that its statics find.

`tuning_targets` divides the targets into three disjoint sets: for the search, the finals and a
test. The search draws gains at random over decades, in the robot's own scales, and continues by
CMA-ES from the best. The test compares the schedule with predictive control, which needs no gains.
So a schedule is only useful if it is better.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from os import cpu_count
from time import monotonic
from typing import Any

import numpy as np

from softdyn.validation.loop.metrics import mean_std
from softdyn.validation.studies import schedule_search
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.executors import run_all
from softdyn.validation.studies.schedule_search import STAGES, WORST, Entry, Tables
from softdyn.validation.studies.tuning_targets import TuningTargets
from softdyn.validation.tables import Table

RMS, FINAL = 0.1, 0.01  # of the length: the mean error and the final error that cost 1
DRAWN, BATCH = 24, 4  # candidates of the first search, and number that run at a time
ENDS = {"draw": 0.4, "approach": 0.7, "stay": 1.0}  # shares of the search's time
POPULATION, GENERATIONS, FINALISTS = 6, 100, 2
# shares of the time: predictive control on the test; finals and test at most
RIVAL, DECIDE = 0.25, 0.4
# ranges (decades) of random gains; w2 and w3 in the robot's own scales, the horizon in ε
RANGES = {
    "Kp": (20.0, 2000.0), "eps": (0.01, 0.2), "w2": (1e-2, 3.0), "w3": (1e-5, 10.0),
    "null_damping": (3.0, 100.0), "horizon": (0.5, 1.5),
}  # fmt: skip
COLUMNS = (
    ("", "name", ""), ("cost", "cost", ".3f"), ("final error (cm)", "final_cm", ".3f"),
    ("rms on paths (cm)", "rms_cm", ".3f"), ("failed", "failed", "d"),
    ("step (us)", "step_us", ".0f"),
)  # fmt: skip

Tell = Callable[[str, float], None]
"""(current step as text, share of the time that has passed) → None."""


def run_cost(length: float, case: Case, result: Mapping[str, Any]) -> float:
    """A run's rms error in tenths of the length; for a point plus its final error in hundredths."""
    if result["failed"] or result["mse_cm2"] is None:
        return WORST
    rms = math.sqrt(result["mse_cm2"]) / (100 * length * RMS)
    final = 0.0 if case.target else result["final_error_cm"] / (100 * length * FINAL)
    return min(WORST, rms + final)


def simulated_time(*cases: Case) -> float:
    """Total simulated time of the runs (s)."""
    return sum(case.duration or 0.0 for case in cases)


def random_schedule(targets: TuningTargets, rng: np.random.Generator) -> dict[str, Any]:
    """A schedule of random gains, equal in both stages.

    The random factors are the ratios of w2 ‖q̈‖² and w3 ‖u‖² to ‖μ‖², for a tip error of a tenth of
    the robot's length. There q̈ is the acceleration for this μ, and u the input at a typical
    equilibrium.
    """
    model, length = targets.model, targets.model.robot.length
    Kp, eps, w2, w3, null_damping, horizon = (
        float(10 ** rng.uniform(*np.log10(ends))) for ends in RANGES.values()
    )
    J = model.state(model.q0, np.zeros(model.nv)).J
    w2 *= (float(np.linalg.norm(J, 2)) or 1.0) ** 2
    w3 *= (Kp * length / 10 / targets.inputs) ** 2
    stage = {
        "Kp": Kp, "eps": eps, "w1": 1.0, "w2": w2, "w3": w3, "w4": w2 / 2, "rho": 1000.0,
        "null_damping": null_damping, "horizon": horizon * eps, "u_ref": 0.0,
    }  # fmt: skip
    stage = {name: float(f"{x:.4g}") for name, x in stage.items()}
    return {
        "arrive": 0.02 * length, "leave": 0.2 * length, "dwell": 0.2,
        "approach": stage, "stay": stage,
    }  # fmt: skip


@dataclass(eq=False)
class Tuning:
    """A running search: the time that has passed, and the best schedules so far.

    Attributes
    ----------
    targets, time, began, seed, jobs, tell
        As in `tune_schedule`.
    wall, simulated : float
        Wall-clock time of the runs of `best`, and their simulated time up to a failure (s).
    candidates : int
        Number of candidates that were judged.
    contenders : list of mapping
        Schedules, the best first.
    costs : dict[str, float]
        Part of the search → its least cost.
    """

    targets: TuningTargets
    time: float
    began: float
    seed: int
    jobs: int
    tell: Tell
    wall: float = 0.0
    simulated: float = 0.0
    candidates: int = 0
    contenders: list[Tables] = field(default_factory=list)
    costs: dict[str, float] = field(default_factory=dict)

    # -- the time ----------------------------------------------------------------------------------

    def spent(self) -> float:
        """The share of the time that has passed."""
        return (monotonic() - self.began) / self.time

    def share(self, simulated: float) -> float:
        """The share of the time that this much simulated time (s) takes; 0 while unknown."""
        return simulated * self.wall / self.simulated / self.time if self.simulated else 0.0

    def is_short(self, simulated: float, until: float) -> bool:
        """Whether this much simulated time (s) would end after this share of the time."""
        return self.spent() + self.share(simulated) > until

    def say(self, text: str) -> None:
        """Report the current step."""
        self.tell(text, self.spent())

    # -- what runs ---------------------------------------------------------------------------------

    def judge(self, cases: list[Case], schedules: Sequence[Tables]) -> list[Entry]:
        """Call `schedule_search.judge`, and record the time that it takes."""
        since, price = monotonic(), partial(run_cost, self.targets.model.robot.length)
        found = schedule_search.judge(cases, price, self.jobs, schedules)
        scores = [score for entry in found for score in entry["scores"]]
        runs = zip(cases * len(schedules), scores, strict=True)
        whole = simulated_time(*(case for case, score in runs if score < WORST))
        if whole > 0:
            self.wall += monotonic() - since
            self.simulated += whole
        self.candidates += len(schedules)
        return found

    def run_rival(self) -> list[dict[str, Any]]:
        """Run predictive control on the first runs of the test, as many as fit into its time.

        Each process does one at a time; there are at least two.
        """
        self.say("predictive control")
        cases, found = self.targets.cases("test", "mpc"), list[dict[str, Any]]()
        chunk = max(2, (cpu_count() or 1) if self.jobs < 0 else self.jobs)
        took = 0.0
        while len(found) < len(cases) and (not found or self.spent() + took < RIVAL):
            before = self.spent()
            found += run_all(cases[len(found) : len(found) + chunk], self.jobs)
            took = self.spent() - before
        return found

    def draw(self, start: Tables | None, end: Callable[[], float]) -> None:
        """Judge `start` and random gains until `end`, a share of the time; at least four."""
        rng, cases = np.random.default_rng(self.seed), self.targets.cases("search", window=True)
        found: list[tuple[float, Tables]] = []
        while len(found) < DRAWN and (not found or self.spent() < end()):
            some = [start] if start and not found else []
            some = some + [random_schedule(self.targets, rng) for _ in range(BATCH - len(some))]
            entries = self.judge(cases, some)
            found += [(entry["cost"], one) for entry, one in zip(entries, some, strict=True)]
            self.costs["draw"], best = min(found, key=lambda pair: pair[0])
            self.contenders = [best]
            self.say(f"{len(found)} random gains, best cost {self.costs['draw']:.3g}")

    def refine(self, stage: str, end: float) -> None:
        """Run CMA-ES on one stage until `end`, a share of the time; skipped if that is too soon."""
        cases = self.targets.cases("search", window=stage == "approach")
        if self.is_short((1 + POPULATION) * simulated_time(*cases), end):
            return
        schedule = self.contenders[0]
        trace = schedule_search.search_stage(
            schedule, stage, partial(self.judge, cases), generations=GENERATIONS,
            population=POPULATION, seed=self.seed,
            each=lambda entry: self.say(f"{stage}, cost {entry['cost']:.3g}"),
            enough=partial(self.is_short, POPULATION * simulated_time(*cases), end),
        )  # fmt: skip
        ranked = sorted(trace, key=lambda entry: entry["cost"])[:FINALISTS]
        self.costs[stage] = ranked[0]["cost"]
        best = [schedule_search.changed(schedule, stage, entry["values"]) for entry in ranked]
        if stage == "approach":  # the search of the stay begins with the approach's gains
            best = [{**best[0], "stay": best[0]["approach"]}]
        self.contenders = best + self.contenders

    def decide(self, count: int) -> Tables:
        """The best of `count` contenders on the targets of the finals."""
        contenders = self.contenders[: max(1, count)]
        if len(contenders) == 1:
            return contenders[0]
        self.say("finals")
        finals = [entry["cost"] for entry in self.judge(self.targets.cases("final"), contenders)]
        self.costs["final"], best = min(zip(finals, contenders, strict=True), key=lambda x: x[0])
        return best


def tune_schedule(
    targets: TuningTargets,
    time: float,
    *,
    began: float | None = None,
    start: Tables | None = None,
    seed: int = 1,
    jobs: int = -1,
    tell: Tell = lambda _text, _spent: None,
) -> dict[str, Any]:
    """Find a schedule within about `time` seconds and compare it with predictive control.

    Predictive control runs first, on as many targets of the test as fit, so that no target is
    chosen by its result. The search ends when finals and test need the rest of the time; their time
    is estimated from earlier runs. Started work is finished. Even for a slow robot there are two
    runs of predictive control, four candidates and the test.

    Parameters
    ----------
    targets : TuningTargets
        The targets of the robot.
    time : float
        Limit of the total time (s).
    began : float, optional
        Start of that time, as a `time.monotonic` value; now by default.
    start : mapping, optional
        Tables of a schedule with which the search begins, besides random ones.
    seed : int
        Above 0. The same seed gives the same candidates, as many as fit into the time.
    jobs : int
        Processes, -1 for one per core.
    tell : Callable[[str, float], None]
        Called with the current step as text, and the share of the time that has passed.

    Returns
    -------
    dict
        ``schedule``; ``better``, whether it beats predictive control on the test; ``rows`` of that
        test; ``costs`` of the search by part; ``candidates``, their number; ``seconds``.

    Raises
    ------
    InputError
        Without the package `cma`.
    """
    schedule_search.need_cma()
    run = Tuning(targets, time, monotonic() if began is None else began, seed, jobs, tell)
    rival = run.run_rival()
    first = run.spent()
    test = simulated_time(*targets.cases("test")[: len(rival)])
    final = simulated_time(*targets.cases("final"))

    def end(part: str) -> float:
        """The share of the time at which a part of the search ends, so that finals and test fit."""
        wanted = run.share(test + (2 + FINALISTS) * final)
        last = 1.0 - max(run.share(test), min(DECIDE, wanted))
        return first + ENDS[part] * (last - first)

    run.draw(start, partial(end, "draw"))
    for stage in STAGES:
        run.refine(stage, end(stage))
    left = 1.0 - run.spent() - run.share(test)
    schedule = run.decide(int(left / max(run.share(final), 1e-9)))
    run.say("test against mpc")
    cases = targets.cases("test", "best", schedule)[: len(rival)]
    pairs = (("best", run_all(cases, jobs)), ("mpc", rival))
    rows = [figures_on_test(name, targets, cases, results) for name, results in pairs]
    return {
        "schedule": schedule, "better": rows[0]["cost"] < rows[1]["cost"], "rows": rows,
        "costs": run.costs, "candidates": run.candidates, "seconds": monotonic() - run.began,
    }  # fmt: skip


def figures_on_test(
    name: str, targets: TuningTargets, cases: Sequence[Case], results: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """The figures of one controller on the runs of the test."""
    runs = list(zip(cases, results, strict=True))
    prices = [run_cost(targets.model.robot.length, case, result) for case, result in runs]
    finals = [result["final_error_cm"] for case, result in runs if not case.target]
    squares = [result["mse_cm2"] for case, result in runs if case.target]
    square = mean_std(squares)[0]
    return {
        "name": name, "cost": float(np.mean(prices)), "costs": prices,
        "final_cm": mean_std(finals)[0],
        "rms_cm": None if square is None else math.sqrt(square),
        "failed": sum(bool(result["failed"]) for result in results),
        "step_us": float(np.median([r["step_us"]["median"] or math.nan for r in results])),
        "targets": len(finals), "paths": len(squares),
    }  # fmt: skip


def tuning_text(targets: TuningTargets, found: Mapping[str, Any]) -> str:
    """The result of `tune_schedule` as text."""
    points, paths = (sum(map(len, some.values())) for some in (targets.points, targets.loops))
    costs = ", ".join(f"{name} {value:.3g}" for name, value in found["costs"].items())
    first, whole = found["rows"][0], len(targets.cases("test"))
    tested = f"{first['targets']} targets and {first['paths']} paths"
    if first["targets"] + first["paths"] < whole:
        tested += f" of {whole} (more with more --seconds)"
    verdict = (
        "the schedule beats predictive control"
        if found["better"]
        else "predictive control is better, so no schedule is needed"
    )
    return "\n".join((
        f"{targets.model.name}: {points} targets and {paths} paths, found by its statics",
        f"{found['candidates']} candidates in {found['seconds']:.0f} s; least costs: {costs}",
        f"on {tested} that the search has not used:",
        Table.of(COLUMNS, found["rows"]).text(),
        verdict,
    ))  # fmt: skip


def robot_schedule_toml(targets: TuningTargets, schedule: Tables, text: str) -> str:
    """A schedule as the text of a file for one robot, with a comment about its origin."""
    about = "".join(f"# {line}".rstrip() + "\n" for line in text.splitlines())
    return (
        about
        + f'robot = "{targets.model.robot.digest}"\n'
        + schedule_search.schedule_toml(schedule)
    )
