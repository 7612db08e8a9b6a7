#!/usr/bin/env python3
"""The paper's whole table beside the published one: every robot, controller and experiment."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from softdyn.commands import cli

if TYPE_CHECKING:
    from softdyn.validation.studies.benchmark import Case

ROBOTS = ("finger", "helix", "spirob")
CONTROLLERS = ("clf-qp", "soft-id-clf-qp", "id-clf-qp", "ic", "uic", "ic-qp", "best")
EPILOG = """\
Robots and controllers as in run.py; a controller of your own is FILE.py:CLASS, a robot of your own
a URDF, and what has no published gains needs a controller that brings its own.

Each case leaves its files below --out. A run that was interrupted goes on where it stopped; a case
is done again when its robot, its controller, softdyn or an engine has changed. Below --out, for
the robots and controllers of the last call: index.html with replays/ and thumbnails/, table.md,
table.tex, results.json and figures/; of all calls: runs/ with the log and the
figures of every case, and times/.

exit codes: 0 every case ran, failed loops included; 1 a process was killed; 2 bad input;
130 interrupted.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--robots", nargs="+", default=ROBOTS, metavar="ROBOT")
parser.add_argument("--controllers", nargs="+", default=CONTROLLERS, metavar="CONTROLLER")
parser.add_argument(
    "--thetas", nargs="*", type=cli.finite, metavar="T", help="set points, multiples of pi"
)
parser.add_argument(
    "--omegas", nargs="*", type=cli.positive, metavar="W", help="rates, multiples of pi rad/s"
)
parser.add_argument("--jobs", type=cli.count, metavar="N", help="processes (default: one per core)")
parser.add_argument("--out", default="results", metavar="DIR", help="default: results")
figures = parser.add_mutually_exclusive_group()
figures.add_argument(
    "--plots",
    action="store_true",
    help="run nothing, make figures and index.html again from the logs",
)
figures.add_argument("--no-plots", action="store_true", help="leave figures and index.html out")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Run what is missing, then table and figures."""
    from softdyn import InputError
    from softdyn.validation.files import to_json, write_text
    from softdyn.validation.report import tables
    from softdyn.validation.studies import benchmark, paper

    began = perf_counter()
    out = Path(arguments.out)
    cli.check_outputs(arguments.json)
    cases = benchmark.grid(
        arguments.robots,
        arguments.controllers,
        paper.THETAS if arguments.thetas is None else arguments.thetas,
        paper.OMEGAS if arguments.omegas is None else arguments.omegas,
    )
    if not cases:
        raise InputError("--thetas, --omegas", "at least one of one of them", "none")
    if arguments.plots:
        return draw_again(cases, out, arguments.json, arguments.jobs or -1)
    cli.make_folder(out)
    run(cases, out, arguments.jobs or -1)
    rows = benchmark.rows(cases, out)
    write_text(out / "table.md", tables.markdown(rows))
    write_text(out / "table.tex", tables.latex(rows))
    write_text(out / "results.json", to_json({"rows": rows}) + "\n")
    if not arguments.no_plots:
        from softdyn.validation.report import index as page
        from softdyn.validation.report import plots

        plots.make_all(cases, out)
        index = page.make(cases, out, arguments.jobs or -1)
    report: dict[str, Any] = {
        "rows": rows,
        "wall_s": perf_counter() - began,
        "simulated_s": benchmark.simulated_seconds(cases, out),
        "step_us": benchmark.step_times(cases, out),
    }
    where = f"\n\nTable, figures and logs: {out}/\n{report['wall_s']:.0f} s"
    if not arguments.no_plots:
        where = f"\n\nThe whole result: {index}{where}"
    cli.write_report(report, arguments.json, tables.text(rows) + where)
    return cli.PASSED


def run(cases: list[Case], out: Path, jobs: int) -> None:
    """Run what is missing below `out`, with a bar that counts work, not cases."""
    from tqdm import tqdm

    from softdyn.validation.studies import benchmark

    def text() -> str:
        reused = f", {done - ran} of them before" if done > ran else ""
        return f"{done} of {len(cases)} runs{reused}"

    ran = done = 0
    costs = {case: benchmark.cost(case) for case in cases}
    layout = "{desc} |{bar}| {percentage:3.0f} % [{elapsed} < {remaining}]"
    with tqdm(
        total=sum(costs.values()),
        desc=text(),
        disable=None,  # silent where stderr is no terminal
        leave=False,
        smoothing=0,
        bar_format=layout,
    ) as bar:
        for case, was_run in benchmark.run_grid(cases, out, jobs):
            done, ran = done + 1, ran + was_run
            if not (was_run or bar.disable):
                bar.initial += costs[case]  # took no time: not a measure of the speed
            bar.set_description_str(text(), refresh=False)
            bar.update(costs[case])


def draw_again(cases: list[Case], out: Path, target: str | None, jobs: int) -> int:
    """Figures and page alone, from the files below `out`."""
    from softdyn import InputError
    from softdyn.validation.report import index as page
    from softdyn.validation.report import plots
    from softdyn.validation.studies import benchmark

    missing = [case.name for case in cases if not benchmark.log_path(out, case).is_file()]
    if missing:
        more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
        got = f"no log of {', '.join(missing[:3])}{more}"
        raise InputError(str(out), f"the logs of all {len(cases)} runs", got)
    files = [str(file) for file in plots.make_all(cases, out)]
    report: dict[str, Any] = {"figures": files}
    # the page shows the figures of merit too, which stand beside the logs
    if all(benchmark.load_result(case, out) is not None for case in cases):
        report["report"] = str(page.make(cases, out, jobs))
        files = [*files, report["report"]]
    cli.write_report(report, target, "\n".join(files))
    return cli.PASSED


main = cli.program(parser, command, __name__)
