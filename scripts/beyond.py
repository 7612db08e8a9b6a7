#!/usr/bin/env python3
"""All set points at several control periods and all trajectories, of one controller."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
Set points run at 1 ms, 2 ms and the robot's published control period, trajectories at the
published one. docs/beyond.md discusses them.

exit codes: 0 every case ran, failed loops included; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
cli.add_trial_options(parser, "results/beyond")


def command(arguments: cli.Arguments) -> int:
    """Run, report."""
    from softdyn.validation import paper
    from softdyn.validation.studies import beyond

    for robot in arguments.robots:
        paper.setup(robot)
    cli.check_trials(arguments)
    cells = cli.distributions(arguments, beyond.cells(arguments.robots, arguments.controller))
    cli.write_report(cli.summaries(cells), arguments.json, beyond.markdown(cells))
    return cli.PASSED


main = cli.program(parser, command, __name__)
