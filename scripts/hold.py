#!/usr/bin/env python3
"""How Soft ID-CLF-QP does with different horizons of its dynamics: a table against tau / eps."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48), a path to an annotated URDF, or the name
of a robot of example-robot-data. For every horizon the four set points of the paper and one
trajectory with the published gains, or of any other robot, which needs --gains, five points that it
can rest at. The plant is the twin at 0.5 ms.

exit codes: 0 done; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
parser.add_argument(
    "--shares", type=float, nargs="+", metavar="S",
    help="horizons, as shares of eps (default: 0.0 0.5 0.8 1.0 1.2 2.0)",
)  # fmt: skip
parser.add_argument("--period", type=cli.positive, metavar="S", help="default: the robot's")
cli.add_own_options(parser)
parser.add_argument("--jobs", type=cli.count, default=1, metavar="N", help="processes")
parser.option("--out", str, "DIR", "what ran lies here, and is not run again", "results/hold")
cli.add_ensemble_options(parser)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Run every case, print the table."""
    from pathlib import Path

    from softdyn.validation.studies import hold

    cli.check_outputs(arguments.json, arguments.keep)
    cli.make_folder(Path(arguments.out))
    cells = hold.cells(
        arguments.robot, arguments.shares or hold.SHARES, arguments.period,
        cli.own_gains(arguments), arguments.annotations,
    )  # fmt: skip
    found = cli.distributions(arguments, cells)
    cli.write_report(cli.summaries(found), arguments.json, hold.markdown(found))
    return cli.PASSED


main = cli.program(parser, command, __name__)
