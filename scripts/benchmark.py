#!/usr/bin/env python3
"""The paper's whole table beside the published one: every robot, controller and experiment."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from time import perf_counter
from typing import Any

import cli

ROBOTS = ("finger", "helix", "spirob")
CONTROLLERS = ("clf-qp", "soft-id-clf-qp", "id-clf-qp", "ic", "uic", "ic-qp")
EPILOG = """\
Robots and controllers as in run.py; a controller of your own is FILE.py:CLASS, a robot of your own
a URDF, and what has no published gains needs a controller that brings its own.

Each case leaves its files below --out. A run that was interrupted goes on where it stopped; a case
is done again when its robot, its controller, softdyn or an engine has changed. Below --out:
table.md, table.tex and results.json, figures/, runs/ with the log of every case, times/.

exit codes: 0 every case ran, failed loops included; 2 bad input; 130 interrupted.
"""


def parser() -> cli.Parser:
    """The command line."""
    found = cli.Parser(description=__doc__, epilog=EPILOG)
    found.add_argument("--robots", nargs="+", default=ROBOTS, metavar="ROBOT")
    found.add_argument("--controllers", nargs="+", default=CONTROLLERS, metavar="CONTROLLER")
    found.add_argument("--thetas", nargs="*", type=cli.finite, metavar="T", help="multiples of pi")
    found.add_argument("--omegas", nargs="*", type=cli.positive, metavar="W", help="as thetas")
    found.add_argument(
        "--jobs", type=cli.count, metavar="N", help="processes (default: one per core)"
    )
    found.add_argument("--out", default="results", metavar="DIR", help="default: results")
    found.add_argument(
        "--plots", action="store_true", help="only make the figures again, from the logs"
    )
    found.add_argument("--no-plots", action="store_true", help="leave the figures out")
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
    """Run what is missing, then table and figures."""
    from tqdm import tqdm

    from validation import benchmark, paper, tables
    from validation.files import check_writable, to_json, write_text

    began = perf_counter()
    out = Path(arguments.out)
    cli.make_folder(out)
    if arguments.json not in (None, "-"):
        check_writable(arguments.json)
    cases = benchmark.grid(
        arguments.robots,
        arguments.controllers,
        paper.THETAS if arguments.thetas is None else arguments.thetas,
        paper.OMEGAS if arguments.omegas is None else arguments.omegas,
    )
    if not arguments.plots:
        jobs = arguments.jobs or -1
        with tqdm(total=len(cases), disable=None, leave=False, unit="case") as bar:
            for case, _ in benchmark.run_grid(cases, out, jobs):
                bar.set_postfix_str(f"{case.robot} {case.controller}", refresh=False)
                bar.update()
    rows = benchmark.rows(cases, out)
    write_text(out / "table.md", tables.markdown(rows))
    write_text(out / "table.tex", tables.latex(rows))
    write_text(out / "results.json", to_json({"rows": rows}) + "\n")
    if not arguments.no_plots:
        from validation import plots

        plots.make_all(cases, out)
    report: dict[str, Any] = {
        "rows": rows,
        "wall_s": perf_counter() - began,
        "simulated_s": benchmark.simulated_seconds(cases, out),
        "step_us": benchmark.step_times(cases, out),
    }
    where = f"\n\nTable, figures and logs: {out}/\n{report['wall_s']:.0f} s"
    cli.write_report(report, arguments.json, tables.text(rows) + where)
    return cli.PASSED


if __name__ == "__main__":
    sys.exit(main())
