#!/usr/bin/env python3
"""A controller away from its model: other targets, plants, delayed inputs, a noisy tip."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
For each robot set points at theta = 0.25 and 1.25 pi and a trajectory at 0.25 pi rad/s, none of
them the paper's. Then each change by itself: an ellipse of 0.7 times the axes; masses, stiffnesses
and damping of the plant alone at 0.8, 0.9, 1.1 and 1.2 times the model's; inputs that come 5 ms
late; 1 mm of noise on each coordinate of the tip. All loops at --period.

exit codes: 0 no run failed with a plant within 10 %; 1 one did; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
cli.add_trial_options(parser)
parser.add_argument("--period", type=cli.positive, default=0.005, metavar="S")


def command(arguments: cli.Arguments) -> int:
    """Run, report."""
    from softdyn.validation.studies import robustness

    cli.check_trials(arguments)
    rows = robustness.report(
        arguments.robots, arguments.controller, arguments.period, arguments.jobs or -1
    )
    cli.write_report({"rows": rows}, arguments.json, robustness.markdown(rows))
    return cli.FAILED if robustness.nearby_failures(rows) else cli.PASSED


main = cli.program(parser, command, __name__)
