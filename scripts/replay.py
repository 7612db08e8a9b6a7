#!/usr/bin/env python3
"""Show saved runs, one or several to compare: as a page without a server, or as a figure."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
LOG is what run.py --log or benchmark.py wrote (results/runs/ROBOT/CONTROLLER/CASE.npz). Several
logs play together in one place, or with --side-by-side next to each other. The page has a timeline
with the error of each run, shows cables by tension, and works from the file system. --plot draws
errors and inputs instead, or too.

exit codes: 0 written; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("logs", nargs="+", metavar="LOG")
parser.add_argument("--html", metavar="FILE", help="the page to write")
parser.add_argument("--plot", metavar="FILE", help="errors and inputs over time, a PNG")
parser.add_argument("--labels", nargs="+", metavar="NAME", help="a name for each log")
parser.add_argument(
    "--side-by-side", action="store_true", help="next to each other, not in one place"
)
parser.add_argument("--robot", metavar="ROBOT", help="the logs' robot, where it is no bundled one")
cli.add_robot_options(parser)


def command(arguments: cli.Arguments) -> int:
    """Read the logs, write the page."""
    import softdyn
    from softdyn.validation import Log
    from softdyn.validation.files import write_text
    from softdyn.validation.report.replay import comparison, replay

    if arguments.html is None and arguments.plot is None:
        raise softdyn.InputError("arguments", "--html FILE or --plot FILE", "neither")
    cli.check_outputs(arguments.html, arguments.plot)
    if arguments.labels is not None and len(arguments.labels) != len(arguments.logs):
        raise softdyn.InputError(
            "--labels", f"one for each of {len(arguments.logs)} logs", len(arguments.labels)
        )
    logs = [Log.load(path) for path in arguments.logs]
    if arguments.plot is not None:
        from softdyn.validation.report.time_figures import save_comparison

        save_comparison(arguments.plot, logs, arguments.labels)
        print(arguments.plot)
    if arguments.html is None:
        return cli.PASSED
    if arguments.robot is None:
        robots = {log.robot: softdyn.load(log.robot) for log in logs}
    else:
        robots = dict.fromkeys((log.robot for log in logs), cli.load_robot(arguments))
    if len(logs) == 1 and arguments.labels is None:
        page = replay(logs[0], robots[logs[0].robot])
    else:
        models = [robots[log.robot] for log in logs]
        page = comparison(logs, models, arguments.labels, arguments.side_by_side)
    write_text(arguments.html, page.html())
    print(arguments.html)
    return cli.PASSED


main = cli.program(parser, command, __name__)
