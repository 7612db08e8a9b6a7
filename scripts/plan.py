#!/usr/bin/env python3
"""Plan inputs that move a robot's tip to a point through a fold of its equilibria."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48), a path to an annotated URDF, or the name
of a robot of example-robot-data.

The plan begins at the stable equilibrium to which slowly changed inputs bring the tip nearest to
the point, and goes to the equilibrium that best mpc would hold there. It takes about 10 s to
compute. The twin then follows it with its gains, and mpc holds the end.

exit codes: 0 the twin's tip ended within --tolerance; 1 it did not, or there is no plan; 2 bad
input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
cli.add_robot_options(parser)
goal = parser.add_mutually_exclusive_group(required=True)
goal.add_argument("--theta", type=cli.finite, metavar="T", help="the set point at T pi")
goal.add_argument(
    "--target", type=cli.finite, nargs=3, metavar=("X", "Y", "Z"), help="a point in m"
)
parser.option("--lag", cli.finite, "S", "time constant of the actuators in s", 0.0)
parser.option("--delay", cli.finite, "S", "delay of the inputs in s", 0.0)
parser.option("--seconds", cli.positive, "S", "length of the twin's run in s", 5.0)
parser.option("--tolerance", cli.positive, "M", "tolerance in m", 0.005)
parser.output("--html", "FILE", "write the twin's run as a page that replays it")
parser.output("--plot", "FILE", "draw the twin's errors and inputs: .png")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Plan, simulate and report."""
    from softdyn.validation import paper
    from softdyn.validation.crosschecks.plan_report import plan_report

    model = cli.load_robot(arguments)
    experiment = paper.experiment(model, theta=arguments.theta, target=arguments.target)
    point = experiment.reference(0.0).y
    found = plan_report(model, point, arguments.lag, arguments.delay, arguments.seconds)
    if arguments.html is not None:
        from softdyn.validation.report.replay import replay

        replay(found.log, model).save(arguments.html)
    if arguments.plot is not None:
        found.log.plot(arguments.plot)
    cli.write_report(found.to_dict(), arguments.json, str(found))
    return cli.PASSED if found.log.verdict(arguments.tolerance).reached else cli.FAILED


main = cli.program(parser, command, __name__)
