#!/usr/bin/env python3
"""Regulate finger, helix and spirob to the paper's four set points with Soft ID-CLF-QP."""

from __future__ import annotations

import argparse
import sys
from typing import Any

import cli  # type: ignore[import-not-found]  # beside this script

ROBOTS = ("finger", "helix", "spirob")
CONTROLLER = "soft-id-clf-qp"
EPILOG = """\
The table shows the final error of every set point in cm and their mean and standard deviation,
beside the paper's. A failed run is marked * and explained below it; it stays in the mean.

exit codes: 0 every case ran, failed loops included; 2 bad input.
"""


def parser() -> cli.Parser:
    """The command line."""
    found = cli.Parser(description=__doc__, epilog=EPILOG)
    found.add_argument(
        "--jobs", type=cli.count, metavar="N", help="processes (default: one per core)"
    )
    found.add_argument("--duration", type=cli.positive, metavar="S", help="instead of 10 s")
    found.add_argument(
        "--json", metavar="FILE", help="write the figures as JSON; - prints them and nothing else"
    )
    return found


def main(argv: list[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    arguments = parser().parse_args(argv)
    cli.one_thread()
    return cli.run(command, arguments)


def command(arguments: argparse.Namespace) -> int:
    """Run every case, report."""
    from joblib import Parallel, delayed, parallel_config
    from tqdm import tqdm

    from validation import paper
    from validation.files import check_writable

    if arguments.json not in (None, "-"):
        check_writable(arguments.json)
    # The costliest cases first, so that no core idles at the end.
    cases = [(robot, theta) for robot in reversed(ROBOTS) for theta in paper.THETAS]
    results = {}
    jobs = min(arguments.jobs or -1, len(cases))
    with (
        parallel_config("loky", n_jobs=jobs, inner_max_num_threads=1),
        tqdm(total=len(cases), disable=None, leave=False, unit="run") as bar,
    ):
        runs = Parallel(return_as="generator_unordered")(
            delayed(regulate)(robot, theta, arguments.duration) for robot, theta in cases
        )
        for result in runs:
            results[result["robot"], result["theta"]] = result
            bar.update()
    rows = [row(robot, [results[robot, theta] for theta in paper.THETAS]) for robot in ROBOTS]
    cli.write_report({"controller": CONTROLLER, "rows": rows}, arguments.json, table(rows))
    return cli.PASSED


def regulate(robot: str, theta: float, duration: float | None) -> dict[str, Any]:
    """One case, engines built where it runs."""
    import softdyn
    from controllers import CONTROLLERS
    from validation import metrics, paper, simulate

    model = softdyn.load(robot)
    controller = CONTROLLERS[CONTROLLER](model)
    log = simulate(model, controller, paper.set_point(robot, theta), duration=duration)
    return {
        "robot": robot,
        "theta": theta,
        "final_error_cm": metrics.final_error_cm(log),
        "failed": log.failed,
        "reason": log.reason,
        "not_solved": log.not_solved,
        "median_us": metrics.step_times_us(log)["median"],
    }


def row(robot: str, runs: list[dict[str, Any]]) -> dict[str, Any]:
    """A robot's cases, their mean and the paper's."""
    from dataclasses import asdict

    from validation import metrics, paper

    mean, std = metrics.mean_std(run["final_error_cm"] for run in runs)
    published = paper.published(robot, CONTROLLER)
    return {
        "robot": robot,
        "runs": [{key: value for key, value in run.items() if key != "robot"} for run in runs],
        "sp_mean_cm": mean,
        "sp_std_cm": std,
        "failed": sum(run["failed"] for run in runs),
        "paper": None if published is None else asdict(published),
    }


def table(rows: list[dict[str, Any]]) -> str:
    """The rows for people."""
    thetas = [run["theta"] for run in rows[0]["runs"]]
    titles = ["robot", *(f"{theta:g} pi" for theta in thetas), "mean ± std", "paper", "step"]
    lines = [titles]
    notes = []
    for entry in rows:
        cells = [entry["robot"]]
        for run in entry["runs"]:
            cells.append(f"{run['final_error_cm']:.3f}{'*' if run['failed'] else ' '}")
            if run["failed"]:
                notes.append(f"* {entry['robot']} at {run['theta']:g} pi: {run['reason']}")
        median = sum(run["median_us"] for run in entry["runs"]) / len(entry["runs"])
        paper = entry["paper"]
        cells.append(spread(entry["sp_mean_cm"], entry["sp_std_cm"]))
        cells.append(spread(paper["sp_mean_cm"], paper["sp_std_cm"]))
        cells.append(f"{median:.0f} us")
        lines.append(cells)
    widths = [max(len(line[i]) for line in lines) for i in range(len(titles))]
    text = ["  ".join(c.rjust(w) for c, w in zip(line, widths, strict=True)) for line in lines]
    title = f"Final error in cm after regulation with {CONTROLLER}"
    return "\n".join([title, "", *text, *([""] if notes else []), *notes])


def spread(mean: float | None, std: float | None) -> str:
    """Mean ± standard deviation, or that there is none."""
    return "none" if mean is None or std is None else f"{mean:.2f} ± {std:.2f}"


if __name__ == "__main__":
    sys.exit(main())
