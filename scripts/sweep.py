#!/usr/bin/env python3
"""Closed loops over a grid, random samples or one change at a time: gains, targets, the plant."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from time import perf_counter
from typing import Any

from softdyn.commands import cli

EPILOG = """\
FILE is TOML, described in docs/sweeps.md; for example

    robots = ["finger"]
    controllers = ["soft-id-clf-qp", "ic-qp"]
    [targets]
    theta = [0, 0.5, 1]                     # multiples of pi
    [gains]
    Kp = [100, 500, 2000]
    eps = { from = 0.01, to = 0.1, count = 5, spacing = "log" }

or the name of a sweep that comes with softdyn, where there is no such file:

    horizon       the soft controller with different horizons of its dynamics
    periods       the paper's set points at several control periods, and its trajectories
    robustness    other targets, plants, delays, noise: one change at a time

These print a table of all cases, as any file with rows or changes does. --robots, --controllers,
--annotations, --gains and --period stand in the place of what a file says, also for a robot of
your own: it goes to points that it can rest at.

By default cases run on the cores of this machine. --scheduler sends them to the workers of a
dask.distributed cluster (pip install 'softdyn[cluster]'); results come back to this process, which
writes them, so that no folder needs to be shared.

Below --out: cases/ with one file a case, sweep.csv with all of them, sweep.md with the table or the
best. A sweep that was interrupted goes on where it stopped; a case is done again when it, its
robot, its controller, softdyn or an engine has changed.

exit codes: 0 every case has a result, failed loops included; 1 some could not be run, the scheduler
went away, or a run from rest failed that must not (must_not_fail in the file: of robustness masses,
springs and damping within 10 %); 2 bad input; 130 interrupted.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument(
    "file", metavar="FILE", nargs="?", help="the sweep, a TOML file or horizon, periods, robustness"
)
parser.add_argument("--list", action="store_true", help="list the sweeps that come with softdyn")
parser.add_argument("--robots", nargs="+", metavar="ROBOT", help="instead of the file's")
parser.add_argument("--controllers", nargs="+", metavar="CONTROLLER", help="instead of the file's")
parser.add_argument("--period", type=cli.positive, metavar="S", help="control period")
cli.add_own_options(parser)
where = parser.add_mutually_exclusive_group()
where.add_argument("--jobs", type=cli.count, metavar="N", help="processes (default: one per core)")
where.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="of a dask cluster")
parser.add_argument("--out", metavar="DIR", help="default: results/ and FILE's name")
parser.add_argument("--dry-run", action="store_true", help="only tell what there is to do")
cli.add_ensemble_options(parser)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Run what is missing, then the tables."""
    from softdyn.validation.studies import sweep, sweep_cells, sweep_report
    from softdyn.validation.studies.engine import cluster, executors
    from softdyn.validation.studies.sweep_file import Instead, read

    if arguments.list:
        return list_shipped(arguments)
    if arguments.file is None:
        parser.error("FILE: expected a sweep, got none; --list names those that are there")
    began = perf_counter()
    wanted = read(arguments.file, Instead(
        arguments.robots, arguments.controllers, arguments.annotations,
        cli.read_toml(arguments.gains) if arguments.gains else None, arguments.period,
    ))  # fmt: skip
    out = Path(arguments.out or Path("results") / wanted.path.stem)
    tabulated = wanted.tabulated or arguments.ensemble or arguments.keep
    cells = sweep_cells.cells(wanted) if tabulated else {}
    jobs, store = wanted.jobs(), sweep.store(out)
    if arguments.dry_run:
        plan = sweep_report.plan(wanted, jobs, store.missing(jobs))
        cli.write_report(plan, arguments.json, sweep_report.plan_text(plan))
        return cli.PASSED
    cli.make_folder(out)

    def execute(order: list[Any]) -> Iterator[Any]:
        if arguments.scheduler is None:
            return executors.patient(arguments.jobs or -1)(order)
        return cluster.cluster(arguments.scheduler)(order)

    ran = executors.follow(store.run(jobs, execute), jobs)
    rows = sweep_report.rows(jobs, store)
    report = sweep_report.report(wanted, rows, ran)
    table, failed = None, 0
    if tabulated:
        found = cli.distributions(arguments, cells, store, execute, wanted.folder)
        table, failed = sweep_cells.markdown(wanted, found), sweep_cells.failures(wanted, found)
        report |= cli.summaries(found)
    report["files"] = sweep_report.write(wanted, rows, out, table, cells)
    report["wall_s"] = perf_counter() - began
    text = sweep_report.summary(report) if table is None else f"{table}\n"
    cli.write_report(report, arguments.json, f"{text}\nTables and cases: {out}/")
    return cli.FAILED if report["outcomes"]["not_run"] or failed else cli.PASSED


def list_shipped(arguments: cli.Arguments) -> int:
    """Say which sweeps come with softdyn, and where their files lie."""
    from softdyn.validation.studies.sweep_file import shipped

    found = [
        {"name": name, "about": path.read_text("utf-8").splitlines()[0].lstrip("# "),
         "file": str(path)}
        for name, path in shipped().items()
    ]  # fmt: skip
    text = "\n".join(f"{one['name']:12}{one['about']}\n{'':12}{one['file']}" for one in found)
    cli.write_report({"sweeps": found}, arguments.json, text)
    return cli.PASSED


main = cli.program(parser, command, __name__)
