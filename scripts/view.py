#!/usr/bin/env python3
"""Show a robot in the browser: at rest, then what each of its inputs does."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48), a path to a URDF, or the name of a robot
of example-robot-data.

The robot settles under gravity and then follows its own analytic dynamics while one input after
the other rises and falls; of a robot without inputs, each joint moves in turn. The page is served
on this machine only, until Ctrl-C.

exit codes: 0 ended by Ctrl-C or SIGTERM, or the file is written; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
parser.add_argument("--html", metavar="FILE", help="write the page to a file and serve nothing")
cli.add_server_options(parser)
cli.add_robot_options(parser)


def command(arguments: cli.Arguments) -> int:
    """Write the page, or serve it until somebody ends it."""
    import threading

    with cli.ends_cleanly():
        from softdyn.validation.files import write_text
        from softdyn.view.rest_sweep import rest_page

        cli.check_outputs(arguments.html)
        page = rest_page(cli.load_robot(arguments))
        if arguments.html is not None:
            write_text(arguments.html, page.html())
            print(arguments.html)
            return cli.PASSED
        from softdyn.view.server import Viewer

        with Viewer(page, arguments.port) as viewer:
            print(f"{viewer.url}\nCtrl-C ends it", flush=True)
            if not arguments.no_open:
                viewer.open()
            threading.Event().wait()
    return cli.PASSED


main = cli.program(parser, command, __name__)
