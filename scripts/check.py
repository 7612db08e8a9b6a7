#!/usr/bin/env python3
"""What a robot's file amounts to, and what in it looks wrong."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
ROBOT is a path to an annotated URDF, a bundled name (finger, helix, spirob, spirob48), or the name
of a robot of example-robot-data.

Explains joints, springs, tendons and inputs; how many directions the inputs move and at which poses
fewer; whether stiffness dominates gravity in the directions that no input moves (the paper's
sufficient condition for stable zero dynamics) and at which pose it ceases to; and numbers that are
legal but look wrong. Poses: q = 0, all joints at either limit, and --samples random ones.

exit codes: 0 the file is sound, whatever it amounts to; 1 some numbers look wrong; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
parser.option("--samples", cli.count, "N", "random poses", 100)
cli.add_robot_options(parser)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Load, examine, report."""
    import warnings

    from softdyn.statics import diagnose

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # they are in the report
        model = cli.load_robot(arguments)
    found = diagnose(model, arguments.samples)
    cli.write_report(found.to_dict(), arguments.json, str(found))
    return cli.FAILED if found.doubts else cli.PASSED


main = cli.program(parser, command, __name__)
