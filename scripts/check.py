#!/usr/bin/env python3
"""Describe a robot and warn of numbers that look wrong; or test a class of your own."""

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
motion near a few equilibria; a comment tells why. docs/gains.md shows an example.

FILE.py:CLASS [ROBOT] tests instead a class of your own with a robot (finger by default). Its
methods tell its kind: a controller, a plant, a driver, a task, a barrier, an observer, a reference
or a force; --as decides. A line is printed for each rule of the kind. For a rule that is broken it
has the call that shows it. A driver is started, gets relaxed commands, and is stopped.

exit codes: 0 no number looks wrong, or every rule is kept; 1 otherwise; 2 bad input.
"""

OWN = ".py:"
TIMED = ("controller", "observer")  # kinds with a period

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT", help="or FILE.py:CLASS, a class of your own")
parser.add_argument("of", nargs="?", metavar="ROBOT", help="the robot of your class")
parser.add_argument("--as", dest="kind", metavar="KIND", help="the kind of your class")
parser.option("--samples", cli.count, "N", "random poses", 100)
parser.add_argument("--gains", action="store_true", help="propose gains, as TOML")
parser.option(
    "--period", cli.positive, "S", "control period of the gains or your class in s", 0.002
)
cli.add_robot_options(parser)
cli.add_force_options(parser)
cli.add_json(parser)
parser.unused(
    "--period", lambda a: not (a.gains or OWN in a.robot), "only --gains and a class have one"
)
parser.unused("--as", lambda a: OWN not in a.robot, "only a class of your own has a kind")


def command(arguments: cli.Arguments) -> int:
    """Load, examine, report."""
    if OWN in arguments.robot:
        return check_class(arguments)
    if arguments.of is not None:
        from softdyn import InputError

        raise InputError("check", "one ROBOT, or FILE.py:CLASS and a ROBOT", arguments.of)
    import warnings

    from softdyn.statics import diagnose

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the report contains them
        model = cli.load_robot(arguments)
    cli.warn_of_no_use(model.robot, arguments)
    if arguments.gains:
        from softdyn.controllers.proposed_gains import propose

        cli.doing("proposes gains")
        proposed = propose(model, arguments.period)
        cli.write_report(proposed.to_dict(), arguments.json, proposed.toml())
        return cli.PASSED
    found = diagnose(model, arguments.samples)
    cli.write_report(found.to_dict(), arguments.json, str(found))
    return cli.FAILED if found.doubts else cli.PASSED


def check_class(arguments: cli.Arguments) -> int:
    """Test a class of the user's own."""
    from softdyn import testing
    from softdyn.controllers import find_controller

    subject = find_controller(arguments.robot)
    kind = testing.kind_of(subject) if arguments.kind is None else arguments.kind
    arguments.robot = arguments.of or "finger"
    model = cli.load_robot(arguments)
    timed = {"period": arguments.period} if parser.was_given("--period") and kind in TIMED else {}
    found = testing.check(subject, model, kind, **timed)
    cli.write_report(found.to_dict(), arguments.json, str(found))
    return cli.PASSED if found.passed else cli.FAILED


main = cli.program(parser, command, __name__)
