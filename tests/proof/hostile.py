"""The slowest control step under hostile inputs, fallbacks included."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from time import thread_time_ns
from typing import Any

import numpy as np

import softdyn
from softdyn import Reference, SetPoint, SoftModel, State
from softdyn.commands import cli
from softdyn.controllers import CONTROLLERS, find_controller
from softdyn.validation.tables import Table
from tests.proof.timing.recording import ROBOTS
from tests.support import hostile_states

EPILOG = """\
Every controller gets states and references full of NaN, infinities, huge and denormal numbers,
singular Jacobians and input matrices (tests/support/hostile_states.py), --rounds times each. The
figure is the processor time of the fastest repetition. A step over 5 ms fails, and so does an
answer that is not finite or not within bounds.

exit codes: 0 done; 1 a step failed; 2 bad input; 130 interrupted.
"""
LIMIT_US = 5000.0
COLUMNS = (
    ("robot", "robot", ""),
    ("controller", "controller", ""),
    ("calls", "calls", "d"),
    ("fell back", "fallbacks", "d"),
    ("ordinary", "ordinary_us", ".0f"),
    ("median", "median_us", ".0f"),
    ("p99", "p99_us", ".0f"),
    ("worst µs", "worst_us", ".0f"),
    ("worst case", "worst_case", ""),
)


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--robots", nargs="+", default=ROBOTS, metavar="ROBOT")
parser.add_argument("--controllers", nargs="+", default=(*CONTROLLERS,), metavar="CONTROLLER")
parser.option("--rounds", cli.count, "N", "calls of each case", 5)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Time the slowest step of each controller and print the table."""
    from tqdm import tqdm

    makes = {name: find_controller(name) for name in arguments.controllers}
    models = {name: softdyn.load(name) for name in dict.fromkeys(arguments.robots)}
    with tqdm(total=len(models) * len(makes), disable=None, leave=False) as bar:
        report = survey(models, makes, arguments.rounds, bar.update)
    cli.write_report(report, arguments.json, worst_step_text(report))
    return cli.PASSED if report["passed"] else cli.FAILED


def cases(model: SoftModel) -> Iterator[tuple[str, State, Reference]]:
    """(name, state, reference) of an ordinary call, then of every hostile one."""
    found = dict(hostile_states.states(model))
    good, rest = found["inside, v ~ 1"], found["inside, at rest"]
    goal = SetPoint(good.y + 0.01)
    yield "ordinary", good, goal
    yield "target at the tip, at rest", rest, SetPoint(rest.y)
    for name, state in (
        *found.items(),
        *hostile_states.forged(good),
        *hostile_states.degenerate(good),
    ):
        yield name, state, goal
    for name, reference in hostile_states.references().items():
        yield name, good, reference


def measure(model: SoftModel, controller: Any, repeats: int) -> dict[str, Any]:
    """Times of one controller over all cases (µs), its fallbacks and its slowest case.

    A time is the processor's time of the fastest of `repeats` calls, so that other load of the
    machine does not count.
    """
    timed: list[tuple[float, str]] = []
    wrong = 0
    for name, state, reference in cases(model):
        each = []
        for _ in range(repeats):
            began = thread_time_ns()
            u = controller(state, reference).u
            each.append((thread_time_ns() - began) / 1e3)
        timed.append((min(each), name))
        wrong += not ((model.u_min <= u) & (u <= model.u_max)).all()
    times = [time for time, _ in timed]
    worst, case = max(timed)
    return {
        "calls": len(times),
        "fallbacks": controller.guard.fallbacks // repeats,
        "ordinary_us": times[0],
        "median_us": float(np.median(times)),
        "p99_us": float(np.percentile(times, 99)),
        "worst_us": worst,
        "worst_case": case,
        "wrong": wrong,
    }


def survey(
    models: Mapping[str, SoftModel],
    makes: Mapping[str, Callable[[SoftModel], Any]],
    repeats: int,
    tick: Callable[[], Any] = lambda: None,
) -> dict[str, Any]:
    """A row for every robot and controller, and whether all were fast enough and within bounds."""
    rows = []
    for robot, model in models.items():
        for name, make in makes.items():
            row = measure(model, make(model), repeats)
            rows.append({"robot": robot, "controller": name, **row})
            tick()
    worst, wrong = max(row["worst_us"] for row in rows), sum(row["wrong"] for row in rows)
    passed = worst <= LIMIT_US and not wrong
    return {
        "rows": rows, "worst_us": worst, "limit_us": LIMIT_US, "wrong": wrong, "passed": passed
    }  # fmt: skip


def worst_step_text(report: Mapping[str, Any]) -> str:
    """The report for a terminal."""
    return (
        f"{Table.of(COLUMNS, report['rows']).text()}\n"
        f"slowest step {report['worst_us'] / 1e3:.2f} ms, limit {LIMIT_US / 1e3:g} ms; "
        f"{report['wrong']} answers not finite or out of bounds"
    )


main = cli.program(parser, command, __name__)
