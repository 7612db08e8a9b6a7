"""Explain differences from the paper's table by changes of its reference implementation."""

from __future__ import annotations

from pathlib import Path

from softdyn.commands import cli, study_options

EPILOG = """\
An EXPERIMENT applies one change (see --list) to the controller or the plant. Names joined by +
apply together, e.g. stale+plant-step. By default an experiment runs on the cells that it is meant
to explain; --robots and --controllers choose others. The table also shows our result from the grid
of benchmark.py (missing cases run first), and the published value. An interrupted run continues
where it stopped.

hulls needs --files, a checkout of the reference implementation. --records takes a folder of its
runs, recorded at every step (ROBOT_CONTROLLER_thetaT.npz with q, v, ctrl, target). Then there is no
simulation over time: at each recorded state, the emulated controller's input and the emulated
plant's next state are compared with the recorded ones. By default the experiment consists of all
changes in the recorded commit, with hulls if --files is given.

With --ensemble or --keep only the experiments run, as distributions, without the grid.

scs and clf-objective need cvxpy and scs (pip install cvxpy scs). angular and exact need quadprog,
which the test extra installs.

exit codes: 0 every case ran, failed loops included; 1 a process was killed; 2 bad input;
130 interrupted.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("experiments", nargs="*", metavar="EXPERIMENT", help="default: every one")
parser.add_argument("--list", action="store_true", help="list the experiments and stop")
parser.add_argument("--robots", nargs="+", metavar="ROBOT")
parser.add_argument("--controllers", nargs="+", metavar="CONTROLLER")
parser.add_argument("--thetas", nargs="*", type=cli.finite, metavar="T", help="multiples of pi")
parser.add_argument("--omegas", nargs="*", type=cli.positive, metavar="W", help="as thetas")
parser.add_argument("--jobs", type=cli.count, metavar="N", help="processes (default: one per core)")
parser.add_argument("--out", default="results/reproduction", metavar="DIR")
parser.option("--grid", str, "DIR", "benchmark.py's folder", "results")
parser.add_argument("--records", metavar="DIR", help="one-step table of the runs recorded in DIR")
parser.add_argument(
    "--files", metavar="DIR", help="folder of the reference implementation, for hulls"
)
study_options.add_ensemble_options(parser)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Run the missing cases, then write the table."""
    from softdyn.controllers import find_controller
    from softdyn.validation.files import write_text
    from softdyn.validation.studies import benchmark
    from softdyn.validation.studies.engine import executors, worker
    from softdyn.validation.tables import Table
    from tests.proof.paper import reproduction

    if arguments.list:
        known = {name: change.what for name, change in reproduction.CHANGES.items()}
        known |= reproduction.ALIASES
        listed = Table((), list(known.items())).text()
        cli.write_report({"experiments": known}, arguments.json, listed)
        return cli.PASSED
    if arguments.records is not None:
        return one_step_table(arguments)
    for name in arguments.controllers or ():
        find_controller(name)
    names = arguments.experiments or [*reproduction.CHANGES, *reproduction.ALIASES]
    wanted = [
        (name, case)
        for name in dict.fromkeys(names)
        for case in reproduction.cases(
            name, arguments.robots, arguments.controllers, arguments.thetas, arguments.omegas
        )
    ]
    if arguments.keep or arguments.ensemble:
        from softdyn.validation.studies.engine.distribution import pivot

        cli.make_folder(Path(arguments.out))
        found = study_options.distributions(
            arguments, reproduction.labelled(wanted, files(arguments))
        )
        table = pivot(found, ["experiment", "robot", "controller"])
        cli.write_report(study_options.summaries(found), arguments.json, table)
        return cli.PASSED
    out, grid, jobs = Path(arguments.out), Path(arguments.grid), arguments.jobs or -1
    for folder in (out, grid):
        cli.make_folder(folder)
    reproduction.run_experiments(wanted, out, jobs, files(arguments))
    ours = worker.jobs_of([*{case.name: case for _, case in wanted}.values()], log=True)
    executors.follow(benchmark.store(grid).run(ours, executors.strict(jobs)), ours)
    rows = reproduction.reproduction_rows(wanted, out, grid)
    write_text(out / "table.md", reproduction.reproduction_document(rows))
    cli.write_report({"rows": rows}, arguments.json, reproduction.reproduction_table(rows).text())
    return cli.PASSED


def files(arguments: cli.Arguments) -> Path | None:
    """The reference's folder, if one is given."""
    return Path(arguments.files).resolve() if arguments.files is not None else None


def one_step_table(arguments: cli.Arguments) -> int:
    """Evaluate each record under each experiment; each row is printed when it is done."""
    from tqdm import tqdm

    from softdyn import InputError
    from softdyn.validation.files import write_text
    from softdyn.validation.tables import Table
    from tests.proof.paper import one_step

    asked = [
        (record, name)
        for record in one_step.records(Path(arguments.records))
        if arguments.robots is None or {record.robot, record.case.robot} & {*arguments.robots}
        if arguments.controllers is None or record.case.controller in arguments.controllers
        for name in arguments.experiments
        or [record.experiment + ("+hulls" if arguments.files is not None else "")]
    ]
    if not asked:
        raise InputError(arguments.records, "a record of these robots and controllers", "none")
    out = Path(arguments.out)
    cli.make_folder(out)
    rows = [
        one_step.row(record, name, files(arguments))
        for record, name in tqdm(asked, disable=None, leave=False, unit="run")
    ]
    table = Table.of(one_step.COLUMNS, rows)
    write_text(out / "one_step.md", table.markdown() + "\n")
    cli.write_report({"rows": rows}, arguments.json, table.text())
    return cli.PASSED


main = cli.program(parser, command, __name__)
