#!/usr/bin/env python3
"""The slowest control step under hostile numbers: what a controller takes to fall back."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
Every controller of every robot is called with states and references full of NaN, infinities, huge
and denormal numbers, singular Jacobians and input matrices (validation/timing/hostile.py). The time
is the processor's, not the clock's, and of the repetitions of a call the fastest counts, which
takes out what the machine was doing besides; of all calls the slowest is shown. An answer that is
not finite or not within bounds is a failure.

exit codes: 0 all answers finite, within bounds and within the limit; 1 not; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--robots", nargs="+", metavar="ROBOT", help="(default: all bundled)")
parser.add_argument("--controllers", nargs="+", metavar="NAME", help="(default: all)")
parser.add_argument("--repeats", type=cli.count, default=5, metavar="N", help="(default: 5)")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Measure and report."""
    from tqdm import tqdm

    import softdyn
    from softdyn.controllers import CONTROLLERS, find_controller
    from softdyn.validation.timing.worst_step import survey, table

    robots = arguments.robots or softdyn.bundled_names()
    models = {robot: softdyn.load(robot) for robot in robots}
    makes = {name: find_controller(name) for name in arguments.controllers or CONTROLLERS}
    with tqdm(total=len(models) * len(makes), disable=None, leave=False) as bar:
        report = survey(models, makes, arguments.repeats, bar.update)
    cli.write_report(report, arguments.json, table(report))
    return cli.PASSED if report["passed"] else cli.FAILED


main = cli.program(parser, command, __name__)
