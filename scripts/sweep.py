#!/usr/bin/env python3
"""Closed loops over a grid or random samples: gains, targets, robots, controllers, the plant."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from softdyn.commands import cli  # beside this script

if TYPE_CHECKING:
    from softdyn.validation.studies.sweep import Sweep
    from softdyn.validation.studies.sweep_run import Task

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
    from tqdm import tqdm

    from softdyn.validation.studies import sweep_report, sweep_run
    from softdyn.validation.studies.sweep_file import read

    began = perf_counter()
    sweep = read(arguments.file)
    out = Path(arguments.out or Path("results") / sweep.path.stem)
    tasks = sweep_run.tasks(sweep)
    missing = sweep_run.missing(tasks, out)
    if arguments.dry_run:
        return dry_run(sweep, tasks, missing, arguments.json)
    cli.make_folder(out)
    cli.check_outputs(arguments.json)
    if missing:
        if arguments.scheduler is None:
            executor = sweep_run.local(arguments.jobs or -1)
        else:
            executor = sweep_run.cluster(arguments.scheduler)
        troubled = 0
        with tqdm(total=len(tasks), initial=len(tasks) - len(missing), disable=None, leave=False,
                  unit="case") as bar:  # fmt: skip
            for answer in sweep_run.run(sweep, missing, out, executor):
                troubled += answer.result["outcome"] != "done"
                bar.set_postfix_str(f"{troubled} failed" if troubled else "", refresh=False)
                bar.update()
    rows = sweep_report.rows(tasks, out)
    written = write_reports(sweep, rows, out)
    ended = sweep_report.outcomes(rows)
    report: dict[str, Any] = {
        "sweep": str(sweep.path),
        "cases": len(tasks),
        "ran": len(missing),
        "kept": len(tasks) - len(missing),
        "outcomes": {name: ended.get(name, 0) for name in sweep_run.OUTCOMES},
        "figure": sweep.figure,
        "best": [best(row, sweep.figure) for row in sweep_report.ranked(rows, sweep.figure)],
        "files": [str(path) for path in written],
        "wall_s": perf_counter() - began,
    }
    cli.write_report(report, arguments.json, summary(report, out))
    return cli.FAILED if ended.get("not_run") else cli.PASSED


def write_reports(sweep: Sweep, rows: list[Any], out: Path) -> list[Path]:
    """The table as CSV, the best cases as Markdown; returns their files."""
    from softdyn.validation.files import write_text
    from softdyn.validation.studies import sweep_report

    write_text(out / "sweep.csv", sweep_report.to_csv(rows))
    write_text(out / "sweep.md", sweep_report.to_markdown(sweep, rows))
    return [out / "sweep.csv", out / "sweep.md"]


def best(row: Any, figure: str) -> dict[str, Any]:
    """One of the best cases for JSON."""
    case, result = row
    return {
        "file": f"cases/{case.name}.json",
        "outcome": result["outcome"],
        figure: result.get(figure),
        "inputs": result["inputs"],
    }


def dry_run(sweep: Sweep, tasks: list[Task], missing: list[Task], target: str | None) -> int:
    """Tell what there is to do; writes nothing but the JSON that was asked for."""
    simulated = sum(task.case.duration for task in missing)
    report = {
        "sweep": str(sweep.path),
        "cases": len(tasks),
        "missing": len(missing),
        "simulated_s": simulated,
        "names": [task.case.name for task in tasks],
    }
    text = (
        f"{len(tasks)} cases, {len(missing)} of them to be run: {simulated:g} s of simulated time"
    )
    cli.write_report(report, target, text)
    return cli.PASSED


def summary(report: dict[str, Any], out: Path) -> str:
    """The same for people."""
    ended = ", ".join(
        f"{n} {name.replace('_', ' ')}" for name, n in report["outcomes"].items() if n
    )
    lines = [
        f"{report['cases']} cases: {ended} ({report['ran']} run now, {report['wall_s']:.0f} s)",
        *(f"best   {row['file']}: {report['figure']} {row[report['figure']]:.4g}"
          for row in report["best"][:3] if row[report["figure"]] is not None),
        f"Tables and cases: {out}/",
    ]  # fmt: skip
    return "\n".join(lines)


main = cli.program(parser, command, __name__)
