#!/usr/bin/env python3
"""The paper's table beside the published one: every robot, controller and experiment."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter

from softdyn.commands import cli, study_options

ROBOTS = ("finger", "helix", "spirob")
EPILOG = """\
Robots and controllers are named as in run.py. A controller of your own is FILE.py:CLASS, a robot of
your own a URDF. A robot without published gains needs a controller that brings its own gains.

The files of each case go below --out. An interrupted run continues where it stopped. A case runs
again when its robot, its controller, softdyn or an engine has changed. Below --out, the robots and
controllers of the last call have index.html with replays/ and thumbnails/, table.md, table.tex,
results.json and figures/. All calls share runs/, with the log and the figures of every case, and
times/.

A chaotic loop has no unique figure. The table shows its median and range, marked ~, from the
committed ensembles (validation/studies/measured), or from those that --ensemble runs.

exit codes: 0 every case ran, failed loops included; 1 a process was killed; 2 bad input;
130 interrupted.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--robots", nargs="+", default=ROBOTS, metavar="ROBOT")
parser.add_argument("--controllers", nargs="+", metavar="CONTROLLER")
parser.add_argument(
    "--thetas", nargs="*", type=cli.finite, metavar="T", help="set points, multiples of pi"
)
parser.add_argument(
    "--omegas", nargs="*", type=cli.positive, metavar="W", help="rates, multiples of pi rad/s"
)
parser.add_argument("--jobs", type=cli.count, metavar="N", help="processes (default: one per core)")
parser.add_argument("--out", default="results", metavar="DIR", help="default: results")
study_options.add_ensemble_options(parser)
figures = parser.add_mutually_exclusive_group()
figures.add_argument(
    "--plots",
    action="store_true",
    help="only make figures and index.html again from the logs",
)
figures.add_argument("--no-plots", action="store_true", help="leave figures and index.html out")
cli.add_json(parser)
parser.unused("--seed --keep", lambda a: not a.ensemble, "only with --ensemble")
parser.unused("--ensemble", lambda a: a.plots, "--plots runs nothing")


def command(arguments: cli.Arguments) -> int:
    """Run the missing cases, then write table and figures."""
    from softdyn import InputError
    from softdyn.controllers.registry import in_table
    from softdyn.validation.studies import benchmark
    from softdyn.validation.studies.benchmark_table import (
        EMULATED,
        benchmark_table,
        write_benchmark,
    )
    from softdyn.validation.studies.engine import executors

    began = perf_counter()
    out, jobs = Path(arguments.out), arguments.jobs or -1
    controllers = in_table() if arguments.controllers is None else arguments.controllers
    cases = benchmark.grid(arguments.robots, controllers, arguments.thetas, arguments.omegas)
    if not cases:
        raise InputError("--thetas, --omegas", "at least one of one of them", "none")
    if arguments.plots:
        from softdyn.validation.report.index import draw_all

        drawn = draw_all(cases, out, jobs)
        files = [*drawn["figures"], *([drawn["report"]] if "report" in drawn else [])]
        cli.write_report(drawn, arguments.json, "\n".join(files))
        return cli.PASSED
    cli.make_folder(out)
    wanted = benchmark.sweep(cases).jobs()
    executors.follow(benchmark.store(out).run(wanted, executors.strict(jobs)), wanted)
    kept = benchmark.committed()
    if arguments.ensemble:
        kept = {**kept, **study_options.distributions(arguments, benchmark.labelled(cases))}
    report = benchmark.benchmark_report(cases, out, kept)
    write_benchmark(report["rows"], out)
    where = f"Table, figures and logs: {out}/"
    if not arguments.no_plots:
        from softdyn.validation.report.index import draw_all

        where = f"The whole result: {draw_all(cases, out, jobs)['report']}\n\n{where}"
    report["wall_s"] = perf_counter() - began
    text = benchmark_table(report["rows"]).text()
    if any(row["emulated"] for row in report["rows"]):
        text += f"\n\n{EMULATED}"
    cli.write_report(report, arguments.json, f"{text}\n\n{where}\n{report['wall_s']:.0f} s")
    return cli.PASSED


main = cli.program(parser, command, __name__)
