"""A schedule for anyone's robot: targets and paths from its statics, gains from a short search.

Nothing is asked of the user. `softdyn.statics` finds points and paths that the robot can rest at
and follow; they are dealt out to three sets: the search, the finals, and a test that neither saw.
The search draws gains at random over decades, in the robot's own scales, and goes on by CMA-ES from
the best. The test compares the schedule with predictive control, which needs no gains: a schedule
that is not better is not worth having.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from time import monotonic
from typing import Any

import numpy as np

from softdyn import InputError, Reference, SoftModel
from softdyn.controllers.schedule import make_schedule
from softdyn.statics import Equilibrium, Loop, loop_around, spread_rests
from softdyn.validation.loop.experiment import Experiment
from softdyn.validation.studies import tuning
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.executors import run_all
from softdyn.validation.tables import aligned

POINTS, PATHS = {"search": 3, "final": 3, "test": 6}, {"search": 1, "final": 1, "test": 1}
NEAREST = 0.05  # of the length: a target closer to the start is no task
POINT_TIME, WINDOW = 2.5, 1.0  # s of a run to a point, and of one that only tells the approach
RMS, FINAL = 0.1, 0.01  # of the length: a mean and a final error that cost 1
DRAWN = 24  # candidates of the first search
ENDS = {"draw": 0.4, "approach": 0.7, "stay": 1.0}  # shares of the time
POPULATION, GENERATIONS, FINALISTS = 6, 100, 2
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

Tell = Callable[[str, float], None]


@dataclass(frozen=True)
class Follow:
    """What a case on a path is given in place of its target."""

    loop: Loop

    def __call__(self, _robot: str, _experiment: Experiment) -> Callable[[float], Reference]:
        """The path itself."""
        return self.loop


@dataclass(frozen=True, eq=False)
class Tasks:
    """What a robot is tried on: points and paths for each of `POINTS`.

    Attributes
    ----------
    robot, annotations : str, str or None
        As on the command line.
    model : SoftModel
        The robot.
    points : dict[str, list of ndarray, (3,)]
        Tips of stable rests.
    loops : dict[str, list of Loop]
        Paths that stable rests follow.
    inputs : float
        A typical input at such rests, where it is not the least one.
    """

    robot: str
    annotations: str | None
    model: SoftModel
    points: dict[str, list[np.ndarray]]
    loops: dict[str, list[Loop]]
    inputs: float

    def cases(
        self, part: str, controller: str = "best", parameters: Any = None, window: bool = False
    ) -> list[Case]:
        """Runs to each point and along each path of one part, from q = 0."""
        make = partial(
            Case, self.robot, controller, "point", parameters=parameters,
            annotations=self.annotations,
        )  # fmt: skip
        points = [
            make(tuple(y.tolist()), duration=WINDOW if window else POINT_TIME)
            for y in self.points[part]
        ]
        paths = [
            make(tuple(loop(0.0).y.tolist()), duration=WINDOW if window else loop.period,
                 target=Follow(loop))
            for loop in self.loops[part]
        ]  # fmt: skip
        return points + paths


def find_tasks(robot: str, annotations: str | None, model: SoftModel, seed: int) -> Tasks:
    """Points and paths for a robot, spread over where its statics say that it can rest.

    Raises
    ------
    InputError
        A robot without inputs, without a length, or whose inputs move its tip nowhere far.
    """
    if model.nu == 0 or model.robot.length == 0:
        missing = "inputs" if model.nu == 0 else "a length from base to tip"
        raise InputError("robot", f"a robot with {missing}", str(model.robot.path))
    start = model.state(model.q0, np.zeros(model.nv)).y
    wanted = sum(POINTS.values())
    rests = [
        one
        for one in spread_rests(model, 2 * wanted, seed)
        if np.linalg.norm(one.y - start) > NEAREST * model.robot.length
    ]
    if len(rests) < len(POINTS):
        expected = f"at least {len(POINTS)} stable rests with the tip away from where it starts"
        raise InputError(str(model.robot.path), expected, len(rests))
    rests = rests[:wanted]
    # dealt out in turn, for the first ones are the outermost
    parts = [name for k in range(wanted) for name, n in POINTS.items() if k < n]
    dealt: dict[str, list[Equilibrium]] = {name: [] for name in POINTS}
    for name, one in zip(parts, rests, strict=False):
        dealt[name].append(one)
    loops = {
        name: list(_some(map(loop_around, reversed(some)), PATHS[name]))
        for name, some in dealt.items()
    }
    least = np.clip(np.zeros(model.nu), model.u_min, model.u_max)
    inputs = float(np.median([np.linalg.norm(one.u - least) for one in rests]))
    points = {name: [one.y for one in some] for name, some in dealt.items()}
    return Tasks(robot, annotations, model, points, loops, max(inputs, 1e-9))


def _some(found: Iterator[Loop | None], count: int) -> Iterator[Loop]:
    for loop in found:
        if count <= 0:
            return
        if loop is not None:
            count -= 1
            yield loop


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
    seconds: float,
    *,
    start: Mapping[str, Any] | None = None,
    seed: int = 1,
    jobs: int = -1,
    tell: Tell = lambda _text, _spent: None,
) -> dict[str, Any]:
    """Find a schedule within about so many seconds, and compare it with predictive control.

    Parameters
    ----------
    tasks : Tasks
        What the robot is tried on.
    seconds : float
        When the search ends, but for the generation under way. Finals and test come after it: a
        fixed number of runs, some two minutes of simulated time.
    start : mapping, optional
        Tables of a schedule that the search begins with, besides random ones.
    seed : int
        Above 0. With the same one the same candidates come again, as far as the time lasts.
    jobs : int
        Processes, -1 for one per core.
    tell : Callable[[str, float], None]
        Told what is being done, and the share of `seconds` that has passed.

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
    began, tried = monotonic(), 0
    price = partial(cost, tasks.model.robot.length)

    def spent() -> float:
        return (monotonic() - began) / seconds

    def judged(part: str, schedules: Sequence[Mapping[str, Any]], window: bool) -> list[float]:
        nonlocal tried
        tried += len(schedules)
        cases = tasks.cases(part, window=window)
        return [entry["cost"] for entry in tuning.judge(cases, price, schedules, jobs)]

    def count(text: str, entry: Mapping[str, Any]) -> None:
        nonlocal tried
        tried += 1
        tell(f"{text}, cost {entry['cost']:.3g}", spent())

    # -- random gains
    rng = np.random.default_rng(seed)
    firsts = [] if start is None else [tuning.tables(make_schedule(start))]
    candidates: list[tuple[float, dict[str, Any]]] = []
    while len(candidates) < DRAWN and (not candidates or spent() < ENDS["draw"]):
        some = firsts + [drawn(tasks, rng) for _ in range(4 - len(firsts))]
        firsts = []
        found = judged("search", some, window=True)
        candidates += zip(found, some, strict=True)
        best = min(c for c, _ in candidates)
        tell(f"{len(candidates)} random gains, best cost {best:.3g}", spent())
    schedule = min(candidates, key=lambda pair: pair[0])[1]
    costs = {"draw": min(c for c, _ in candidates)}
    contenders = [schedule]

    # -- CMA-ES: the approach alone, then the stay behind it
    for stage, candidate in (("approach", tuning.only), ("stay", tuning.changed)):
        trace = tuning.tune(
            tasks.cases("search", window=stage == "approach"),
            price,
            partial(candidate, schedule, stage),
            {name: schedule[stage][name] for name in tuning.TUNED if schedule[stage][name] > 0},
            generations=GENERATIONS, population=POPULATION, seed=seed, jobs=jobs,
            each=partial(count, stage),
            enough=lambda stage=stage: spent() > ENDS[stage],  # type: ignore[misc]
        )  # fmt: skip
        best_few = 1 if stage == "approach" else FINALISTS
        ranked = sorted(trace, key=lambda entry: entry["cost"])[:best_few]
        costs[stage] = ranked[0]["cost"]
        contenders += [replaced(schedule, stage, entry["values"]) for entry in ranked]
        schedule = contenders[-len(ranked)]

    # -- finals, and the test
    tell("finals", spent())
    finals = judged("final", contenders, window=False)
    schedule = contenders[int(np.argmin(finals))]
    costs["final"] = min(finals)
    tell("test against mpc", spent())
    rows = compared(tasks, schedule, jobs)
    return {
        "schedule": schedule, "better": rows[0]["cost"] < rows[1]["cost"], "rows": rows,
        "costs": costs, "candidates": tried, "seconds": monotonic() - began,
    }  # fmt: skip


def replaced(
    schedule: Mapping[str, Any], stage: str, values: Mapping[str, float]
) -> dict[str, Any]:
    """The schedule with what one search found: the approach's gains are the stay's first ones."""
    new = tuning.changed(schedule, stage, values)
    return {**new, "stay": new["approach"]} if stage == "approach" else new


def compared(tasks: Tasks, schedule: Mapping[str, Any], jobs: int) -> list[dict[str, Any]]:
    """A row each for the schedule and for predictive control, on the test's points and paths."""
    price = partial(cost, tasks.model.robot.length)
    runs = {
        "best": tasks.cases("test", "best", schedule),
        "mpc": tasks.cases("test", "mpc"),
    }
    results = iter(run_all([case for cases in runs.values() for case in cases], jobs))
    rows = []
    for name, cases in runs.items():
        found = [(case, next(results)) for case in cases]
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
        })  # fmt: skip
    return rows


def _mean(values: Sequence[float | None]) -> float | None:
    numbers = [x for x in values if x is not None and math.isfinite(x)]
    return float(np.mean(numbers)) if numbers and len(numbers) == len(values) else None


def text(tasks: Tasks, found: Mapping[str, Any]) -> str:
    """What `search` found, for people."""
    points, paths = (sum(map(len, some.values())) for some in (tasks.points, tasks.loops))
    costs = ", ".join(f"{name} {value:.3g}" for name, value in found["costs"].items())
    tested = f"{len(tasks.points['test'])} targets and {len(tasks.loops['test'])} paths"
    verdict = (
        "the schedule beats predictive control"
        if found["better"]
        else "predictive control is better: no schedule is worth having here"
    )
    return "\n".join((
        f"{tasks.model.name}: {points} targets and {paths} paths, found by its statics",
        f"{found['candidates']} candidates in {found['seconds']:.0f} s; least costs: {costs}",
        f"on {tested} that no step of the search saw:",
        aligned(COLUMNS, found["rows"]),
        verdict,
    ))  # fmt: skip


def for_robot(tasks: Tasks, schedule: Mapping[str, Any], text: str) -> str:
    """A schedule as the text of a file for one robot, with what it is as a comment."""
    about = "".join(f"# {line}".rstrip() + "\n" for line in text.splitlines())
    mark = f'robot = "{tasks.model.robot.digest}"\n'
    return about + mark + tuning.toml(schedule)
