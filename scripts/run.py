#!/usr/bin/env python3
"""Run one closed loop: a controller on the analytic model against the MuJoCo twin."""

from __future__ import annotations

import sys
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from softdyn.commands import cli

if TYPE_CHECKING:
    from softdyn import SoftModel
    from softdyn.validation import Log
    from softdyn.validation.loop.closed_loop import ClosedLoop
    from softdyn.validation.report.live import Shown

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48), a path to an annotated URDF, or the name
of a robot of example-robot-data.

CONTROLLER is soft-id-clf-qp, id-clf-qp, clf-qp, ic, uic or ic-qp; best or mpc, which need no gains
for any robot (--gains may give best a schedule, as those in controllers/schedules/, and mpc fields
of softdyn.controllers.MpcParameters); or a class of your own as FILE.py:CLASS,
built once as CLASS(model), or CLASS(model, table) with --gains, and called as
controller(state, reference); what it returns needs an attribute u.

--theta and --omega are multiples of pi on the paper's ellipse. For a robot that is not bundled the
ellipse is scaled to its length, the summed joint offsets from base to tip, as for the finger
(L/3 by L/8, its far end at distance L below and before the origin); --target needs no length.

--gains FILE is TOML with the fields of softdyn.controllers.Gains, e.g. "Kp = 500" and "eps = 0.05".
Bundled robots have the paper's gains by default; others need some.

exit codes: 0 the loop ended closer to its reference than it began; 1 it failed or diverged;
2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
cli.add_robot_options(parser)
parser.add_argument("controller", metavar="CONTROLLER")
goal = parser.add_mutually_exclusive_group(required=True)
goal.add_argument("--theta", type=cli.finite, metavar="T", help="set point at T pi, 10 s")
goal.add_argument("--omega", type=cli.positive, metavar="W", help="track at W pi rad/s, two cycles")
goal.add_argument(
    "--target", type=cli.finite, nargs=3, metavar=("X", "Y", "Z"), help="set point in m, 10 s"
)
parser.add_argument("--duration", type=cli.positive, metavar="S", help="length of the run in s")
parser.add_argument(
    "--period",
    type=cli.positive,
    metavar="S",
    help="control period in s (default: the paper's, 0.002 for other robots)",
)
parser.add_argument("--gains", metavar="FILE", help="gains, a TOML file")
parser.add_argument("--contacts", action="store_true", help="let the links touch")
parser.add_argument("--log", metavar="FILE", help="write the run as NPZ")
parser.add_argument("--html", metavar="FILE", help="write the run as a page that replays it")
parser.add_argument("--view", action="store_true", help="show the run live in the browser")
parser.option("--speed", cli.positive, "X", "pace of --view, simulated seconds per second", 1.0)
cli.add_server_options(parser)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Build, simulate, report."""
    from softdyn.controllers.registry import one_line_errors
    from softdyn.validation import paper
    from softdyn.validation.loop.closed_loop import ClosedLoop

    cli.check_outputs(arguments.log, arguments.json, arguments.html)
    model = cli.load_robot(arguments)
    experiment = paper.experiment(
        model,
        theta=arguments.theta,
        omega=arguments.omega,
        target=arguments.target,
        period=arguments.period,
    )
    controller = make_controller(model, arguments.controller, arguments.gains)
    shown = None
    with one_line_errors(arguments.controller, "a command"):
        loop = ClosedLoop(
            model,
            controller,
            experiment,
            duration=arguments.duration,
            contacts=arguments.contacts,
            name=arguments.controller,
        )
        if arguments.view:
            log, shown = watch(loop, arguments)
        else:
            log = loop.run(progress=True)
    if arguments.log is not None:
        log.save(arguments.log)
    if arguments.html is not None:
        from softdyn.validation.files import write_text
        from softdyn.validation.report.replay import replay

        write_text(arguments.html, replay(log, model).html())
    text = log.summary(paper.beside(log))
    report = log.report()
    if shown is not None:
        text += f"\n{shown}"
        report["viewer"] = asdict(shown)
    cli.write_report(report, arguments.json, text)
    return cli.FAILED if log.failed else cli.PASSED


def watch(loop: ClosedLoop, arguments: cli.Arguments) -> tuple[Log, Shown]:
    """Run the loop while the browser shows it."""
    from softdyn.validation.report import live as view
    from softdyn.view.server import Viewer

    with Viewer(view.live_page(loop), arguments.port) as viewer:
        print(viewer.url, file=sys.stderr, flush=True)
        if not arguments.no_open:
            viewer.open()
        viewer.wait(view.WAIT)
        return view.watch(loop, viewer, arguments.speed)


def make_controller(model: SoftModel, name: str, file: str | None) -> Any:
    """A controller by its command-line name, with the parameters in a file where there is one."""
    from softdyn import InputError
    from softdyn.controllers import registry

    if file is None:
        return registry.make_controller(name, model)
    table, cls = cli.read_toml(file), registry.find_controller(name)
    try:
        return registry.make_controller(name, model, table, cls)
    except InputError as error:
        if registry.is_own(error.name):  # it says which line of the user's code
            raise
        where = f"{file}: {error.name}"
        raise InputError(where, error.expected, error.got) from None


main = cli.program(parser, command, __name__)
