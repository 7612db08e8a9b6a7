#!/usr/bin/env python3
"""How Soft ID-CLF-QP does with different horizons of its dynamics: a table against tau / eps."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48). For every horizon the four set points of
the paper and one trajectory, published gains, plant as everywhere: the twin at 0.5 ms.

exit codes: 0 done; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
parser.add_argument(
    "--shares", type=float, nargs="+", metavar="S",
    help="horizons, as shares of eps (default: 0.0 0.5 0.8 1.0 1.2 2.0)",
)  # fmt: skip
parser.add_argument("--period", type=cli.positive, metavar="S", help="default: the robot's")
parser.add_argument("--jobs", type=cli.count, default=1, metavar="N", help="processes")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Run every case, print the table."""
    from softdyn.validation.studies import hold, paper

    cli.check_outputs(arguments.json)
    paper.setup(arguments.robot)
    shares = arguments.shares or hold.SHARES
    rows = hold.report(arguments.robot, shares, arguments.period, arguments.jobs)
    cli.write_report({"robot": arguments.robot, "rows": rows}, arguments.json, hold.markdown(rows))
    return cli.PASSED


main = cli.program(parser, command, __name__)
