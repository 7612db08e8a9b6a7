#!/usr/bin/env python3
"""The time of a control step beside its floor and the paper's stack, or of an observer's step."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from softdyn.commands import cli, study_options

if TYPE_CHECKING:
    from softdyn import SoftModel

ROBOTS = ("finger", "helix", "spirob", "spirob48")
CONTROLLERS = ("soft-id-clf-qp", "id-clf-qp", "clf-qp", "ic-qp", "ic", "uic")
HOSTILE_ROUNDS = 5
DRIVER = "soft-id-clf-qp"  # drives the loops from which states are recorded
EPILOG = """\
Robots and controllers are named as in benchmark.py. Every figure comes from the same recorded
closed-loop states, states/ROBOT.npz below --out. Missing ones are recorded first, in loops driven
by the first controller: at the paper's set points, or for a user's robot at equilibria that its
statics find. docs/real_time.md defines the figures, the floor and the paper's stack. The stack
needs the extra bench (cvxpy, SCS) and is left out without it.

--rows 6 12 times each controller also with the positions of 2 and 4 links, evenly from the tip to
the base. The tip has the recorded reference, each other link its place at the end of its loop.

--hostile times the slowest step instead. Every controller gets states and references full of NaN,
infinities, huge and denormal numbers, singular Jacobians and input matrices
(validation/timing/hostile.py), --rounds times each (5 by default). The figure is the processor time
of the fastest repetition. A step over 5 ms fails, and so does an answer that is not finite or not
within bounds.

--observer times an observer's step instead, with all measurements of a control period: softdyn's
filter with the disturbances that are named, or a class of your own as FILE.py:CLASS. Its readings
are those of a loop behind a rig with these sensors, "file" or a list as in softdyn observe. Steps
in which a reading with a latency arrives have their own columns.

Times are meaningful only on an idle machine; the report states its load.

exit codes: 0 done; 1 with --hostile, a step failed; 2 bad input; 130 interrupted.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--robots", nargs="+", default=ROBOTS, metavar="ROBOT")
parser.add_argument(
    "--controllers", nargs="+", metavar="CONTROLLER",
    help="default: the paper's and id-clf-qp; with --hostile, all",
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
parser.add_argument("--hostile", action="store_true", help="the slowest step under hostile numbers")
parser.add_argument("--throughput", action="store_true", help="also whole closed loops")
parser.add_argument(
    "--out", default="results/step_time", metavar="DIR", help="default: results/step_time"
)
parser.add_argument(
    "--observer",
    nargs="?",
    const="",
    metavar="WHICH",
    help="an observer's step: names, FILE.py:CLASS",
)
parser.option(
    "--sensors",
    str,
    "WHICH",
    "of --observer: file, or a list",
    "lengths=0.0005@1000,tip=0.001@60+0.03",
)
study_options.add_own_options(parser)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Measure the requested figures."""
    from functools import partial

    import softdyn
    from softdyn.controllers import CONTROLLERS as EVERY
    from softdyn.controllers import find_controller
    from softdyn.controllers.registry import make_controller

    names = arguments.controllers or (EVERY if arguments.hostile else CONTROLLERS)
    table = study_options.own_gains(arguments)
    makes: dict[str, Any] = {
        name: partial(make_controller, name, parameters=table, cls=find_controller(name))
        for name in names
    }
    models = {
        name: softdyn.load(name, annotations=arguments.annotations)
        for name in dict.fromkeys(arguments.robots)
    }
    if arguments.observer is not None:
        if arguments.hostile or arguments.throughput:
            parser.error("argument --observer: not with --hostile or --throughput")
        return observer_steps(arguments, models, makes)
    return (hostile_steps if arguments.hostile else step_times)(arguments, models, makes)


def driver(model: SoftModel, makes: dict[str, Any]) -> Any:
    """Name and factory of the controller of a loop: for a user's robot, the first one given."""
    from softdyn.controllers import find_controller

    return (DRIVER, find_controller(DRIVER)) if model.bundled else next(iter(makes.items()))


def observer_steps(arguments: cli.Arguments, models: dict[str, Any], makes: dict[str, Any]) -> int:
    """Time an observer's steps and print the table."""
    from tqdm import tqdm

    from softdyn.commands.observe import sensors_of
    from softdyn.validation import Rig
    from softdyn.validation.loop.observation import make_observer
    from softdyn.validation.timing import step_report
    from softdyn.validation.timing.observer_time import observed_loop, observer_row, observer_text
    from softdyn.validation.timing.step_time import SAMPLES, MachineLoad

    load, rows = MachineLoad(), []
    with tqdm(unit="round", disable=None, leave=False) as bar:
        for name, model in models.items():
            rig = Rig(sensors=sensors_of(model, arguments.sensors), seed=0)
            make_observer(model, rig, arguments.observer)  # it may refuse its words
            loop = observed_loop(model, driver(model, makes)[1], rig)
            rounds = arguments.rounds or -(-SAMPLES // len(loop.steps))
            observers = [make_observer(model, rig, arguments.observer) for _ in range(rounds)]
            rows.append(observer_row(name, model, observers, loop, bar.update))
    report = {"rows": rows, "machine": step_report.machine() | load.report()}
    cli.write_report(report, arguments.json, observer_text(report))
    return cli.PASSED


def hostile_steps(arguments: cli.Arguments, models: dict[str, Any], makes: dict[str, Any]) -> int:
    """Time the slowest step of each controller and print the table."""
    from tqdm import tqdm

    from softdyn.validation.timing.worst_step import survey, worst_step_text

    with tqdm(total=len(models) * len(makes), disable=None, leave=False) as bar:
        report = survey(models, makes, arguments.rounds or HOSTILE_ROUNDS, bar.update)
    cli.write_report(report, arguments.json, worst_step_text(report))
    return cli.PASSED if report["passed"] else cli.FAILED


def step_times(arguments: cli.Arguments, models: dict[str, Any], makes: dict[str, Any]) -> int:
    """Time ordinary steps, then write tables and figures."""
    from tqdm import tqdm

    from softdyn.validation.files import to_json, write_text
    from softdyn.validation.report import step_figures
    from softdyn.validation.timing import step_report
    from softdyn.validation.timing.recording import recorded
    from softdyn.validation.timing.step_time import SAMPLES, MachineLoad, paper_stack, rows_of
    from softdyn.validation.timing.throughput import throughput

    out = Path(arguments.out)
    cli.make_folder(out / "states")
    stack = paper_stack if not arguments.no_stack and has_stack() else None
    rounds = arguments.rounds or -(-SAMPLES // arguments.states)

    load, report = MachineLoad(), dict[str, Any](rows=[])
    total = rounds * len(models)
    with tqdm(total=total, unit="round", disable=None, leave=False) as bar:
        for name, model in models.items():
            bar.set_description(name)
            _, drive = driver(model, makes)
            states = recorded(model, drive, arguments.states, out / "states", name)
            report["rows"] += rows_of(
                name, model, makes, states, rounds, stack, bar.update, arguments.rows
            )
        if arguments.throughput:
            report["throughput"] = [
                throughput(model, name, make=make)
                for model in models.values() for name, make in [driver(model, makes)]
            ]  # fmt: skip
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
