#!/usr/bin/env python3
"""All set points at several control periods and all trajectories, of one controller."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
Set points run at 1 ms, 2 ms and the robot's published control period, trajectories at the
published one. TT in brackets: the second of the two cycles alone. docs/beyond.md discusses them.

exit codes: 0 every case ran, failed loops included; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
cli.add_trial_options(parser)


def command(arguments: cli.Arguments) -> int:
    """Run, report."""
    from softdyn.validation.studies import beyond

    cli.check_trials(arguments)
    rows = beyond.report(arguments.robots, arguments.controller, arguments.jobs or -1)
    cli.write_report({"rows": rows}, arguments.json, beyond.markdown(rows))
    return cli.PASSED


main = cli.program(parser, command, __name__)
