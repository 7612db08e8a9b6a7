#!/usr/bin/env python3
"""Closed loops over a grid, random samples or one change at a time: gains, targets, the plant."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from softdyn.commands import cli, study_options

if TYPE_CHECKING:
    from softdyn.validation.studies.engine.worker import CaseJob, CaseResult

EPILOG = """\
FILE is TOML, described in docs/sweeps_reference.md; for example

    robots = ["finger"]
    controllers = ["soft-id-clf-qp", "ic-qp"]
    [targets]
    theta = [0, 0.5, 1]                     # multiples of pi
    [gains]
    Kp = [100, 500, 2000]
    eps = { from = 0.01, to = 0.1, count = 5, spacing = "log" }

or the name of a shipped sweep, if no such file exists: robustness (other targets, plants, delays,
noise: one change at a time), horizon (of the soft controller's dynamics), periods (the paper's
experiments at several control periods), set_points (14 others on the ellipse, with the nearest
stable equilibria of those missed).

Below --out: cases/ with one file per case, sweep.csv with all of them, sweep.pdf and sweep.png with
a panel per parameter, and sweep.md with the best ones, or with a table of all if the file asks for
it. If it asks for several figures a cell, table.tex, .csv, .pdf and .png are for a paper. An
interrupted sweep continues where it stopped. A case runs again when it, its robot, its controller,
softdyn or an engine has changed.

exit codes: 0 every case has a result, failed loops included; 1 a case could not run, your own code
raised an error, whose traceback is printed, the scheduler was lost, or a case failed that must not
fail (for robustness: masses, springs and damping within 10 %); 2 bad input; 130 interrupted.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("file", metavar="FILE", nargs="?", help="a TOML file, or a sweep's name")
parser.add_argument("--list", action="store_true", help="list the shipped sweeps")
instead = "instead of the file's"
parser.add_argument("--robots", nargs="+", metavar="ROBOT", help=instead)
parser.add_argument("--controllers", nargs="+", metavar="CONTROLLER", help=instead)
parser.add_argument("--period", type=cli.positive, metavar="S", help=f"control period, {instead}")
study_options.add_own_options(parser)
cli.add_force_options(parser)
where = parser.add_mutually_exclusive_group()
where.add_argument("--jobs", type=cli.count, metavar="N", help="processes (default: one per core)")
where.add_argument(
    "--scheduler", metavar="tcp://HOST:PORT", help="scheduler of a dask cluster: softdyn[cluster]"
)
parser.add_argument("--out", metavar="DIR", help="default: results/ and FILE's name")
parser.add_argument("--dry-run", action="store_true", help="only list the cases that would run")
study_options.add_ensemble_options(parser)
cli.add_json(parser)
parser.unused("--seed", lambda a: not a.ensemble and not a.list, "only with --ensemble")
parser.unused(
    "--jobs --scheduler --ensemble --seed --keep", lambda a: a.dry_run, "--dry-run runs nothing"
)
parser.unused(
    "--robots --controllers --period --annotations --gains --force --force-set --jobs --scheduler "
    "--out --dry-run --ensemble --seed --keep --json",
    lambda a: a.list, "--list only lists the shipped sweeps",
)  # fmt: skip


def command(arguments: cli.Arguments) -> int:
    """Run the missing cases, then write the tables."""
    from softdyn import InputError
    from softdyn.validation.studies import sweep, sweep_report
    from softdyn.validation.studies.engine import cluster, executors
    from softdyn.validation.studies.sweep_file import read_sweep, shipped

    began = perf_counter()
    if arguments.list:
        cli.say("\n".join(f"{name:12}{path}" for name, path in shipped().items()))
        return cli.PASSED
    if arguments.file is None:
        parser.error(f"FILE: expected a TOML file, or one of {', '.join(shipped())}, got none")
    said = {key: getattr(arguments, key) for key in ("robots", "controllers", "period")}
    said |= {"annotations": arguments.annotations, "forces": arguments.force or None}
    said |= {"force": cli.force_numbers(arguments) or None}
    said |= {"gains": cli.read_toml(arguments.gains) if arguments.gains else None}
    wanted = read_sweep(arguments.file, said)
    if not wanted.rows and (arguments.ensemble or arguments.keep):
        raise InputError("--ensemble, --keep", f"rows in {wanted.path}", "none")
    if wanted.figures and (arguments.ensemble or arguments.keep):
        raise InputError("--ensemble, --keep", f"{wanted.path} without figures", "some")
    out = Path(arguments.out or Path("results") / wanted.path.stem)
    jobs, store = wanted.jobs(), sweep.store(out, timed="step_us" in wanted.figures)
    if arguments.dry_run:
        plan = sweep_report.plan(wanted, jobs, store.missing(jobs))
        cli.write_report(plan, arguments.json, sweep_report.plan_text(plan))
        return cli.PASSED
    cli.make_folder(out)

    traces: list[str] = []

    def execute(order: list[CaseJob]) -> Iterator[tuple[int, CaseResult]]:
        if arguments.scheduler is None:
            executor = executors.patient(arguments.jobs or -1)
        else:
            executor = cluster.cluster(arguments.scheduler)
        with closing(executor(order)) as results:  # type: ignore[type-var]
            for index, result in results:
                traces.extend(filter(None, [result.trace]))
                yield index, result

    from softdyn.validation.report import sweep_figure
    from softdyn.validation.studies.paper_table import PaperTable

    ran = executors.follow(store.run(jobs, execute), jobs)
    rows, table = sweep_report.sweep_rows(jobs, store), ""
    report = sweep_report.report(wanted, rows, ran)
    more, paper = dict[str, str](), PaperTable.of(wanted, rows) if wanted.figures else None
    if paper is not None:
        table = paper.markdown()
        more = {"table.tex": paper.latex(), "table.csv": paper.csv()}
    elif wanted.rows:
        cells = study_options.distributions(
            arguments, wanted.cells, store, execute, wanted.folder, wanted.depends,
            lambda ran: sweep_report.missed(wanted, ran),
        )  # fmt: skip
        table = sweep_report.cell_tables(wanted, cells)
        report |= study_options.summaries(cells)
    drawn = sweep_figure.draw(wanted, rows, out / "sweep")
    drawn += [] if paper is None else sweep_figure.draw_table(paper, out / "table")
    picture = next((path.name for path in drawn if path.suffix == ".png"), "")
    report["files"] = sweep_report.write_sweep(wanted, rows, out, table, picture, more)
    report["files"] += map(str, drawn)
    report["wall_s"] = perf_counter() - began
    text = f"{table}\n" if table else sweep_report.summary(report)
    cli.write_report(report, arguments.json, f"{text}\nTables and cases: {out}/")
    failed = {case.name for case, result in rows if result.get("failed", True)}
    for trace in traces[:1]:  # the others are usually the same
        print(trace, end="", file=sys.stderr)
    ended = report["outcomes"]
    bad = ended["not_run"] or ended["raised"] or wanted.failures(failed)
    return cli.FAILED if bad else cli.PASSED


main = cli.program(parser, command, __name__)
