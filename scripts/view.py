#!/usr/bin/env python3
"""Show a robot in the browser: at rest, then what each of its inputs does."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

import cli
import live

if TYPE_CHECKING:
    from softdyn import SoftModel
    from softdyn.page import Page

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
    live.add_server_options(found)
    cli.add_robot_options(found)
    return found


def main(argv: list[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    return cli.start(parser(), command, argv)


def command(arguments: argparse.Namespace) -> int:
    """Write the page, or serve it until somebody ends it."""
    import threading

    with live.ends_cleanly():
        from validation.files import write_text

        cli.check_outputs(arguments.html)
        page = at_rest(cli.load_robot(arguments))
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


def at_rest(model: SoftModel) -> Page:
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
        "one input after the other" if sweep.u.any() else "one joint after the other",
        aims=False,
        full=np.abs(sweep.u).max(axis=0) if sweep.u.any() else None,
    )
    run = Run("", (track,), loop=True, notes=sweep.notes)
    return Page(model.name, (figure,), (run,))


if __name__ == "__main__":
    sys.exit(main())
