#!/usr/bin/env python3
"""Describe the robot of a file, and warn of numbers that look wrong."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
ROBOT is a path to an annotated URDF, a bundled name (finger, helix, spirob, spirob48), or the name
of a robot of example-robot-data.

The report describes joints, springs, tendons and inputs. It says how many directions the inputs
move, and at which poses there are fewer. It says whether stiffness dominates gravity in the
directions that no input moves (the paper's sufficient condition for stable zero dynamics), and at
which pose this fails. It warns of numbers that are legal but look wrong. The poses are q = 0, all
joints at either limit, and --samples random ones. A mimic joint counts with its leader. A floating
base (--floating) is held at its pose in the file. Elements of other tools that are ignored are
listed.

--gains prints instead gains of the paper's controllers for this robot, as TOML for `softdyn run
--gains FILE`. They are for soft-id-clf-qp with the control period of --period, from the robot's
motion near a few equilibria; a comment tells why. docs/your_robot.md shows an example.

exit codes: 0 no number looks wrong; 1 some numbers look wrong; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
parser.option("--samples", cli.count, "N", "random poses", 100)
parser.add_argument("--gains", action="store_true", help="propose gains, as TOML")
parser.option("--period", cli.positive, "S", "control period of the gains in s", 0.002)
cli.add_robot_options(parser)
cli.add_json(parser)
parser.unused("--period", lambda a: not a.gains, "only --gains has a control period")


def command(arguments: cli.Arguments) -> int:
    """Load, examine, report."""
    import warnings

    from softdyn.statics import diagnose

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the report contains them
        model = cli.load_robot(arguments)
    cli.warn_of_no_use(model.robot, arguments)
    if arguments.gains:
        from softdyn.controllers.proposed_gains import propose

        proposed = propose(model, arguments.period)
        cli.write_report(proposed.to_dict(), arguments.json, proposed.toml())
        return cli.PASSED
    found = diagnose(model, arguments.samples)
    cli.write_report(found.to_dict(), arguments.json, str(found))
    return cli.FAILED if found.doubts else cli.PASSED


main = cli.program(parser, command, __name__)
