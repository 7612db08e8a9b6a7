"""The time of a control step beside its floor and the paper's stack."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from softdyn.commands import cli
from tests.proof.timing.recording import DRIVER, ROBOTS

CONTROLLERS = ("soft-id-clf-qp", "id-clf-qp", "clf-qp", "ic-qp", "ic", "uic")
EPILOG = """\
Robots and controllers are named as in benchmark.py. Every figure comes from the same recorded
closed-loop states, states/ROBOT.npz below --out. Missing ones are recorded first, in loops driven
by Soft ID-CLF-QP at the paper's set points, or for another robot by `mpc` at equilibria that its
statics find. docs/real_time.md defines the figures, the floor and the paper's stack. The stack
needs the extra bench (cvxpy, SCS) and is left out without it.

--rows 6 12 times each controller also with the positions of 2 and 4 links, evenly from the tip to
the base. The tip has the recorded reference, each other link its place at the end of its loop.

Times are meaningful only on an idle machine; the report states its load.

exit codes: 0 done; 2 bad input; 130 interrupted.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--robots", nargs="+", default=ROBOTS, metavar="ROBOT")
parser.add_argument(
    "--controllers", nargs="+", default=CONTROLLERS, metavar="CONTROLLER",
    help="default: the paper's and id-clf-qp",
)  # fmt: skip
parser.option("--states", cli.count, "N", "a robot", 400)
parser.add_argument(
    "--rounds", type=cli.count, metavar="N", help="over all states (default: 10000 samples)"
)
parser.add_argument("--no-stack", action="store_true", help="leave the paper's stack out")
parser.add_argument(
    "--rows", nargs="+", type=cli.count, default=(), metavar="R",
    help="also with R rows of tasks: the positions of R/3 links",
)  # fmt: skip
parser.add_argument(
    "--out", default="results/step_time", metavar="DIR", help="default: results/step_time"
)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Time the steps, then write tables and figures."""
    from tqdm import tqdm

    import softdyn
    from softdyn.controllers import find_controller
    from softdyn.validation.files import to_json, write_text
    from tests.proof.timing import step_figures, step_report
    from tests.proof.timing.recording import recorded
    from tests.proof.timing.step_time import SAMPLES, MachineLoad, paper_stack, rows_of

    makes = {name: find_controller(name) for name in arguments.controllers}
    models = {name: softdyn.load(name) for name in dict.fromkeys(arguments.robots)}
    out = Path(arguments.out)
    cli.make_folder(out / "states")
    stack = paper_stack if not arguments.no_stack and has_stack() else None
    rounds = arguments.rounds or -(-SAMPLES // arguments.states)

    load, report = MachineLoad(), dict[str, Any](rows=[])
    total = rounds * len(models)
    with tqdm(total=total, unit="round", disable=None, leave=False) as bar:
        for name, model in models.items():
            bar.set_description(name)
            drive = find_controller(DRIVER if model.bundled else "mpc")
            states = recorded(model, drive, arguments.states, out / "states", name)
            report["rows"] += rows_of(
                name, model, makes, states, rounds, stack, bar.update, arguments.rows
            )
    report["machine"] = step_report.machine() | load.report()

    step_figures.bars(report["rows"], out / "step_time")
    write_text(out / "step_time.md", step_report.step_document(report))
    write_text(out / "step_time.json", to_json(report) + "\n")
    where = f"\nTables, figures, states: {out}/"
    cli.write_report(report, arguments.json, step_report.step_text(report) + where)
    return cli.PASSED


def has_stack() -> bool:
    """Whether the extra ``bench`` is installed; a note on stderr says if it is not."""
    found = find_spec("cvxpy") is not None
    if not found:
        hint = "pip install cvxpy scs"
        print(f"note: no cvxpy, so the paper's stack is left out: {hint}", file=sys.stderr)
    return found


main = cli.program(parser, command, __name__)
