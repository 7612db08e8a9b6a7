#!/usr/bin/env python3
"""Show one or several saved runs, as a page without a server or as a figure."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
LOG is a file of run.py --log or benchmark.py (results/runs/ROBOT/CONTROLLER/CASE.npz), or the same
as CSV. A CSV that a rig recorded needs --robot, and columns t and q.JOINT. Several logs play
together in one place, or with --side-by-side next to each other. The page has a timeline with the
error of each run, and colours cables by tension. It opens from the file system. --plot draws errors
and inputs, with or without a page.

exit codes: 0 written; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("logs", nargs="+", metavar="LOG")
parser.output("--html", "FILE", "the page to write")
parser.output("--plot", "FILE", "errors and inputs over time: .png or .pdf")
parser.add_argument("--labels", nargs="+", metavar="NAME", help="a name for each log")
parser.add_argument(
    "--side-by-side", action="store_true", help="next to each other, not in one place"
)
parser.add_argument("--robot", metavar="ROBOT", help="the logs' robot (default: from the logs)")
cli.add_robot_options(parser)
parser.unused(
    "--annotations --floating --repair-inertia", lambda a: a.robot is None, "only with --robot"
)
parser.unused("--side-by-side", lambda a: a.html is None, "--plot shows no robot")
parser.unused("--side-by-side", lambda a: a.html and len(a.logs) == 1, "there is one log")


def command(arguments: cli.Arguments) -> int:
    """Read the logs and write the page."""
    import softdyn
    from softdyn.validation.loop.pictures.replay import replay, show_runs

    if arguments.html is None and arguments.plot is None:
        raise softdyn.InputError("arguments", "--html FILE or --plot FILE", "neither")
    if arguments.plot is not None:
        from softdyn.validation.loop.pictures.time_figures import look, save_comparison

        look.check_path(arguments.plot)
    if arguments.labels is not None and len(arguments.labels) != len(arguments.logs):
        raise softdyn.InputError(
            "--labels", f"one for each of {len(arguments.logs)} logs", len(arguments.labels)
        )
    own = None if arguments.robot is None else cli.load_robot(arguments)
    logs = [cli.read_log(path, own) for path in arguments.logs]
    cli.doing("draws")
    if arguments.plot is not None:
        save_comparison(arguments.plot, logs, arguments.labels)
        print(arguments.plot)
    if arguments.html is None:
        return cli.PASSED
    if own is None:
        sources = {log.source.digest: log.source for log in logs}
        robots = {digest: source.model() for digest, source in sources.items()}
    else:
        for path, log in zip(arguments.logs, logs, strict=True):
            log.source.check(own, f"--robot for {path}")
        robots = {own.robot.digest: own}
    if len(logs) == 1 and arguments.labels is None:
        page = replay(logs[0], robots[logs[0].source.digest])
    else:
        models = [robots[log.source.digest] for log in logs]
        page = show_runs(logs, models, arguments.labels, arguments.side_by_side)
    page.save(arguments.html)
    print(arguments.html)
    return cli.PASSED


main = cli.program(parser, command, __name__)
