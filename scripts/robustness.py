#!/usr/bin/env python3
"""A controller away from its model: other targets, plants, delayed inputs, a noisy tip."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
For each of the paper's robots set points at theta = 0.25 and 1.25 pi and a trajectory at
0.25 pi rad/s, none of them the paper's; for anyone's robot three points that it can rest at. Then
each change by itself: an ellipse of 0.7 times the axes; masses, stiffnesses and damping of the
plant alone at 0.8, 0.9, 1.1 and 1.2 times the model's; inputs that come 5 ms late, or follow with a
lag; 1 mm of noise on each coordinate of the tip; friction in cables and joints; and what the plant
of the paper's reference implementation has: contacts, soft stops, both, one plant step a control
period.

exit codes: 0 no run failed with masses, springs and damping within 10 %; 1 one did; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
cli.add_trial_options(parser, "results/robustness")
parser.add_argument("--period", type=cli.positive, metavar="S", help="default: each robot's own")
cli.add_own_options(parser)


def command(arguments: cli.Arguments) -> int:
    """Run, report."""
    from softdyn.validation.studies import robustness

    cli.check_trials(arguments)
    cells = robustness.cells(
        arguments.robots, arguments.controller, arguments.period, cli.own_gains(arguments),
        arguments.annotations,
    )  # fmt: skip
    found = cli.distributions(arguments, cells)
    cli.write_report(cli.summaries(found), arguments.json, robustness.markdown(found))
    return cli.FAILED if robustness.nearby_failures(found) else cli.PASSED


main = cli.program(parser, command, __name__)
