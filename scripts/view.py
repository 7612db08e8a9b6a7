#!/usr/bin/env python3
"""Show a robot in the browser: at rest, then what each of its inputs does."""

from __future__ import annotations

import argparse
import sys

import cli

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48), a path to a URDF, or the name of a robot
of example-robot-data.

The robot settles under gravity and then follows its own analytic dynamics while one input after
the other rises and falls; of a robot without inputs, each joint moves in turn. The page is served
on this machine only, until Ctrl-C.

exit codes: 0 ended by Ctrl-C or SIGTERM, or the file is written; 2 bad input.
"""


def parser() -> cli.Parser:
    """The command line."""
    found = cli.Parser(description=__doc__, epilog=EPILOG)
    found.add_argument("robot", metavar="ROBOT")
    found.add_argument("--html", metavar="FILE", help="write the page to a file and serve nothing")
    found.add_argument(
        "--port", type=cli.count, metavar="P", help="default: a free one from 7000 on"
    )
    found.add_argument(
        "--no-open", action="store_true", help="print the address and open no browser"
    )
    return found


def main(argv: list[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    arguments = parser().parse_args(argv)
    cli.one_thread()
    return cli.run(command, arguments)


def command(arguments: argparse.Namespace) -> int:
    """Write the page, or serve it until somebody ends it."""
    import threading

    from live import ends_cleanly

    with ends_cleanly():
        import softdyn
        from validation.files import check_writable, write_text

        if arguments.html is not None:
            check_writable(arguments.html)
        page = at_rest(softdyn.load(arguments.robot))
        if arguments.html is not None:
            write_text(arguments.html, page.html())
            print(arguments.html)
            return cli.PASSED
        from softdyn.viewer import Viewer

        with Viewer(page, arguments.port) as viewer:
            print(f"{viewer.url}\nCtrl-C ends it", flush=True)
            if not arguments.no_open:
                viewer.open()
            threading.Event().wait()
    return cli.PASSED


def at_rest(model):
    """A page with a robot's rest and the response to each of its inputs."""
    import warnings

    import numpy as np

    from softdyn.figure import Figure
    from softdyn.page import Page, Run, Track, frames
    from softdyn.rest_sweep import rest_sweep

    figure = Figure.of(model)
    for problem in figure.problems:
        warnings.warn(problem, stacklevel=2)
    sweep = rest_sweep(model)
    track = Track(
        0,
        frames(model, sweep.t, sweep.q, sweep.u, sweep.y, sweep.y),
        "one input after the other" if model.nu else "one joint after the other",
        aims=False,
        full=np.abs(sweep.u).max(axis=0) if model.nu else None,
    )
    run = Run("", (track,), loop=True, notes=sweep.notes)
    return Page(model.name, (figure,), (run,))


if __name__ == "__main__":
    sys.exit(main())
