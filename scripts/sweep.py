#!/usr/bin/env python3
"""Closed loops over a grid or random samples: gains, targets, robots, controllers, the plant."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter

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

By default cases run on the cores of this machine. --scheduler sends them to the workers of a
dask.distributed cluster (pip install 'softdyn[cluster]'); results come back to this process, which
writes them, so that no folder needs to be shared.

Below --out: cases/ with one file a case, sweep.csv with all of them, sweep.md with the best. A
sweep that was interrupted goes on where it stopped; a case is done again when it, its robot, its
controller, softdyn or an engine has changed.

exit codes: 0 every case has a result, failed loops included; 1 some could not be run, or the
scheduler went away; 2 bad input; 130 interrupted.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("file", metavar="FILE", help="the sweep, a TOML file")
where = parser.add_mutually_exclusive_group()
where.add_argument("--jobs", type=cli.count, metavar="N", help="processes (default: one per core)")
where.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="of a dask cluster")
parser.add_argument("--out", metavar="DIR", help="default: results/ and FILE's name")
parser.add_argument("--dry-run", action="store_true", help="only tell what there is to do")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Run what is missing, then the tables."""
    from softdyn.validation.studies import sweep, sweep_report
    from softdyn.validation.studies.engine import cluster, executors
    from softdyn.validation.studies.sweep_file import read

    began = perf_counter()
    wanted = read(arguments.file)
    out = Path(arguments.out or Path("results") / wanted.path.stem)
    jobs, store = wanted.jobs(), sweep.store(out)
    if arguments.dry_run:
        plan = sweep_report.plan(wanted, jobs, store.missing(jobs))
        cli.write_report(plan, arguments.json, sweep_report.plan_text(plan))
        return cli.PASSED
    cli.make_folder(out)
    cli.check_outputs(arguments.json)
    executor = executors.patient(arguments.jobs or -1)
    if arguments.scheduler is not None and store.missing(jobs):
        executor = cluster.cluster(arguments.scheduler)
    ran = executors.follow(store.run(jobs, executor), jobs)
    rows = sweep_report.rows(jobs, store)
    report = sweep_report.report(wanted, rows, ran)
    report["files"] = sweep_report.write(wanted, rows, out)
    report["wall_s"] = perf_counter() - began
    text = f"{sweep_report.summary(report)}\nTables and cases: {out}/"
    cli.write_report(report, arguments.json, text)
    return cli.FAILED if report["outcomes"]["not_run"] else cli.PASSED


main = cli.program(parser, command, __name__)
