"""The tip near an obstacle: the published controller, that over a horizon, that with barriers."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48), a path to an annotated URDF, or the name
of a robot of example-robot-data. A robot that is not bundled needs --gains. Its set point is
--target, or an equilibrium that its statics find.

A ball stands half-way to the set point, so that the path of the published controller cuts it. The
second run is the same controller over a horizon of eps of its gains. The third also has the ball as
a barrier, and with --limits the file's joint limits. --runs adds runs to random targets beside
random balls, all with barriers. A target is the tip of a random configuration, and its ball lies
beside the line to it.

exit codes: 0 no barrier was violated by more than 1 mm or 0.01 rad; 1 one was; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
cli.add_robot_options(parser)
parser.option("--theta", cli.finite, "T", "set point", 0.0)
parser.add_argument(
    "--target", type=cli.finite, nargs=3, metavar=("X", "Y", "Z"), help="set point in m"
)
parser.add_argument("--gains", metavar="FILE", help="gains, a TOML file")
parser.add_argument("--duration", type=cli.positive, default=3.0, metavar="S")
parser.add_argument("--limits", action="store_true", help="joint limits are barriers too")
parser.add_argument("--runs", type=int, default=0, metavar="N", help="random runs (default: 0)")
parser.add_argument("--seed", type=int, default=0, metavar="S")
parser.output("--html", "FILE", "write a page that replays the three runs")
parser.add_argument("--log", metavar="PREFIX", help="save the three runs, for replay.py")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Run, judge and report."""
    from softdyn.controllers import SoftIdClfQp
    from softdyn.controllers.gains import from_table
    from tests.proof.safety import obstacle

    model = cli.load_robot(arguments)
    table = cli.read_toml(arguments.gains) if arguments.gains else {}
    met = obstacle.meet(
        model,
        arguments.theta,
        arguments.duration,
        limits=arguments.limits,
        random=arguments.runs,
        seed=arguments.seed,
        gains=from_table(model, SoftIdClfQp.published, table),
        target=arguments.target,
    )
    if arguments.log is not None:
        for name, log in met.logs.items():
            log.save(f"{arguments.log}-{name.replace(' ', '-')}.npz")
    if arguments.html is not None:
        from softdyn.validation.loop.pictures.replay import show_runs

        logs, labels = [*met.logs.values()], [*met.logs]
        show_runs(logs, [model] * len(logs), labels).save(arguments.html)
    cli.write_report(met.report, arguments.json, str(met))
    return cli.PASSED if met.report["passed"] else cli.FAILED


main = cli.program(parser, command, __name__)
