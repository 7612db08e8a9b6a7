#!/usr/bin/env python3
"""The slowest control step under hostile numbers: what a controller takes to fall back."""

from __future__ import annotations

import sys
from time import thread_time_ns
from typing import Any

from softdyn.commands import cli

EPILOG = """\
Every controller of every robot is called with states and references full of NaN, infinities, huge
and denormal numbers, singular Jacobians and input matrices (validation/timing/hostile.py). The time
is the processor's, not the clock's, and of the repetitions of a call the fastest counts, which
takes out what the machine was doing besides; of all calls the slowest is shown. An answer that is
not finite or not within bounds is a failure.

exit codes: 0 all answers finite, within bounds and within the limit; 1 not; 2 bad input.
"""
LIMIT_US = 5000.0


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--robots", nargs="+", metavar="ROBOT", help="(default: all bundled)")
parser.add_argument("--controllers", nargs="+", metavar="NAME", help="(default: all)")
parser.add_argument("--repeats", type=cli.count, default=5, metavar="N", help="(default: 5)")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Measure and report."""
    import softdyn
    from softdyn import bundled_names
    from softdyn.controllers import CONTROLLERS, find_controller

    rows: list[dict[str, Any]] = []
    for robot in arguments.robots or bundled_names():
        model = softdyn.load(robot)
        for name in arguments.controllers or CONTROLLERS:
            controller = find_controller(name)(model)
            if sys.stderr.isatty():
                print(f"\r\x1b[K{robot} {name}", end="", file=sys.stderr, flush=True)
            row = measure(model, controller, arguments)
            rows.append({"robot": robot, "controller": name, **row})
    if sys.stderr.isatty():
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)
    worst = max(row["worst_us"] for row in rows)
    wrong = sum(row["wrong"] for row in rows)
    report = {"rows": rows, "worst_us": worst, "limit_us": LIMIT_US, "wrong": wrong}
    cli.write_report(report, arguments.json, summary(report))
    return cli.PASSED if worst <= LIMIT_US and not wrong else cli.FAILED


def cases(model: Any) -> Any:
    """(name, state, reference) of every hostile call."""
    from softdyn import SetPoint
    from softdyn.validation.timing import hostile

    found = dict(hostile.states(model))
    good = found["inside, v ~ 1"]
    goal = SetPoint(good.y + 0.01)
    yield "ordinary", good, goal
    yield (
        "target at the tip, at rest",
        found["inside, at rest"],
        SetPoint(found["inside, at rest"].y),
    )
    for name, state in found.items():
        yield name, state, goal
    for name, state in (*hostile.forged(good), *hostile.degenerate(good)):
        yield name, state, goal
    for name, reference in hostile.references().items():
        yield name, good, reference


def measure(model: Any, controller: Any, arguments: cli.Arguments) -> dict[str, Any]:
    """Times of one controller over all cases (µs), its fallbacks, the case that took longest."""
    import numpy as np

    times, names, wrong = [], [], 0
    for name, state, reference in cases(model):
        best = np.inf
        for _ in range(arguments.repeats):
            began = thread_time_ns()
            u = controller(state, reference).u
            best = min(best, (thread_time_ns() - began) / 1e3)
        times.append(best)
        names.append(name)
        wrong += not ((model.u_min <= u) & (u <= model.u_max)).all()
    slowest = int(np.argmax(times))
    return {
        "calls": len(times),
        "fallbacks": controller.guard.fallbacks // arguments.repeats,
        "ordinary_us": times[0],
        "median_us": float(np.median(times)),
        "p99_us": float(np.percentile(times, 99)),
        "worst_us": times[slowest],
        "worst_case": names[slowest],
        "wrong": wrong,
    }


def summary(report: dict[str, Any]) -> str:
    """The table for people."""
    lines = [
        f"{'robot':<10}{'controller':<16}{'calls':>6}{'fell back':>10}{'ordinary':>10}"
        f"{'median':>8}{'p99':>8}{'worst us':>10}  worst case"
    ]
    for row in report["rows"]:
        lines.append(
            f"{row['robot']:<10}{row['controller']:<16}{row['calls']:>6}{row['fallbacks']:>10}"
            f"{row['ordinary_us']:>10.0f}{row['median_us']:>8.0f}{row['p99_us']:>8.0f}"
            f"{row['worst_us']:>10.0f}  {row['worst_case']}"
        )
    lines.append(
        f"slowest step {report['worst_us'] / 1e3:.2f} ms, limit {LIMIT_US / 1e3:g} ms; "
        f"{report['wrong']} answers not finite or out of bounds"
    )
    return "\n".join(lines)


main = cli.program(parser, command, __name__)
