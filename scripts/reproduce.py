#!/usr/bin/env python3
"""Why our table differs from the paper's: what its reference implementation does otherwise."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from softdyn.commands import cli

TITLES = (
    "Experiment", "Robot", "Controller",
    "SP (cm)", "SP, ours", "SP, paper", "TT (cm²)", "TT, ours", "TT, paper", "Failed runs",
)  # fmt: skip
EPILOG = """\
An EXPERIMENT switches one thing on (see --list) around the controller or in the plant; names joined
by + are switched on together, e.g. stale+plant-step. Without --robots and --controllers it runs on
the cells it is meant to explain. Beside it stand ours, from the grid of benchmark.py (what is
missing there is run), and the published value. A run that was interrupted goes on where it stopped.

scs and clf-objective need cvxpy and scs (pip install cvxpy scs), angular and exact quadprog, which
the test extra installs.

exit codes: 0 every case ran, failed loops included; 1 a process was killed; 2 bad input;
130 interrupted.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("experiments", nargs="*", metavar="EXPERIMENT", help="default: every one")
parser.add_argument("--list", action="store_true", help="say what there is and stop")
parser.add_argument("--robots", nargs="+", metavar="ROBOT")
parser.add_argument("--controllers", nargs="+", metavar="CONTROLLER")
parser.add_argument("--thetas", nargs="*", type=cli.finite, metavar="T", help="multiples of pi")
parser.add_argument("--omegas", nargs="*", type=cli.positive, metavar="W", help="as thetas")
parser.add_argument("--jobs", type=cli.count, metavar="N", help="processes (default: one per core)")
parser.add_argument("--out", default="results/reproduction", metavar="DIR")
parser.option("--grid", str, "DIR", "benchmark.py's folder", "results")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Run what is missing, then the table."""
    from tqdm import tqdm

    from softdyn import InputError
    from softdyn.controllers import CONTROLLERS
    from softdyn.validation.files import write_text
    from softdyn.validation.studies import benchmark, paper, reproduction

    if arguments.list:
        known = {name: change.what for name, change in reproduction.CHANGES.items()}
        known |= reproduction.ALIASES
        cli.write_report({"experiments": known}, arguments.json, listing(known))
        return cli.PASSED
    for name in arguments.controllers or ():
        if name not in CONTROLLERS:
            raise InputError("controller", f"one of {', '.join(CONTROLLERS)}", repr(name))
    names = arguments.experiments or [*reproduction.CHANGES, *reproduction.ALIASES]
    wanted = [
        (name, case)
        for name in dict.fromkeys(names)
        for case in reproduction.cases(
            name,
            arguments.robots,
            arguments.controllers,
            paper.THETAS if arguments.thetas is None else arguments.thetas,
            paper.OMEGAS if arguments.omegas is None else arguments.omegas,
        )
    ]
    out, grid, jobs = Path(arguments.out), Path(arguments.grid), arguments.jobs or -1
    for folder in (out, grid):
        cli.make_folder(folder)
    cli.check_outputs(arguments.json)
    ours = list(dict.fromkeys(case for _, case in wanted))
    with tqdm(total=len(ours) + len(wanted), disable=None, leave=False, unit="case") as bar:
        for _ in benchmark.run_grid(ours, grid, jobs):
            bar.update()
        for _ in reproduction.run_all(wanted, out, jobs):
            bar.update()
    rows = reproduction.rows(wanted, out, grid)
    write_text(out / "table.md", markdown(rows))
    cli.write_report({"rows": rows}, arguments.json, text(rows))
    return cli.PASSED


def listing(known: dict[str, Any]) -> str:
    """Names and what they mean, in columns."""
    from softdyn.validation.tables import columns

    return columns(list(known.items()))


def cells(row: dict[str, Any]) -> tuple[str, ...]:
    """One row of the table as text."""
    from softdyn.validation.report import tables

    robot, controller, sp, sp_paper, tt, tt_paper, failed = tables.cells(row)
    _, _, our_sp, _, our_tt, _, _ = tables.cells(row["ours"])
    shown = (sp, our_sp, sp_paper, tt, our_tt, tt_paper)
    # no run of a kind: nothing to show
    sp, our_sp, sp_paper = shown[:3] if row["set_points_cm"] else ("-",) * 3
    tt, our_tt, tt_paper = shown[3:] if row["trajectories_cm2"] else ("-",) * 3
    return (
        row["experiment"], robot, controller, sp, our_sp, sp_paper, tt, our_tt, tt_paper, failed
    )  # fmt: skip


def text(rows: list[dict[str, Any]]) -> str:
    """Aligned columns for a terminal."""
    from softdyn.validation.tables import columns

    return columns([TITLES, *(cells(row) for row in rows)])


def markdown(rows: list[dict[str, Any]]) -> str:
    """The table, then every run's figure and the reasons of the failed ones."""
    from softdyn.validation.tables import pipes

    parts = ["# Reproduction", "", *pipes([TITLES, *(cells(row) for row in rows)]), ""]
    for row in rows:
        runs = {f"θ = {k}π": v for k, v in row["set_points_cm"].items()}
        runs |= {f"ω = {k}π": v for k, v in row["trajectories_cm2"].items()}
        shown = ", ".join(f"{k}: {'-' if v is None else f'{v:.3g}'}" for k, v in runs.items())
        parts.append(f"- {row['experiment']}, {row['robot']}, {row['controller']}: {shown}")
        parts += [f"  - {f['value']:g}π: {f['reason']}" for f in row["failed"]]
    return "\n".join(parts) + "\n"


main = cli.program(parser, command, __name__)
