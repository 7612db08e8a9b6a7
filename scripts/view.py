#!/usr/bin/env python3
"""Show a robot in the browser: at rest, then moved by each of its inputs."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from softdyn.commands import cli

if TYPE_CHECKING:
    from softdyn import SoftModel

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48), a path to a URDF, or the name of a robot
of example-robot-data.

The robot settles under gravity. Then it follows its own analytic dynamics while one input after the
other rises and falls. If it has no inputs, each joint moves in turn. The page is served only on
this machine, until Ctrl-C.

With --sliders you set the joints or the inputs. The inputs lead to an equilibrium (statics, no
simulation). The ellipsoid at the tip shows its compliance to a force. Where this branch of
equilibria is unstable, the unstable one is drawn, too. With --html the file only has the sliders of
joints.

exit codes: 0 ended by Ctrl-C or SIGTERM, or the file is written; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
parser.output("--html", "FILE", "write the page to a file and serve nothing")
parser.add_argument("--sliders", action="store_true", help="set joints or inputs by slider")
cli.add_server_options(parser)
cli.add_robot_options(parser)
parser.unused("--port --no-open --origin", lambda a: a.html, "--html serves no page")


def command(arguments: cli.Arguments) -> int:
    """Write the page, or serve it until the command is ended."""
    with cli.ends_cleanly() as over:
        import softdyn
        from softdyn.view.rest_sweep import rest_page

        model = cli.load_robot(arguments)
        if arguments.sliders and arguments.html is None:
            return sliders(model, arguments, over)
        page = softdyn.show(model).page if arguments.sliders else rest_page(model)
        if arguments.html is not None:
            page.save(arguments.html)
            print(arguments.html)
            return cli.PASSED
        cli.serve(page, arguments, over)
    return cli.PASSED


def sliders(model: SoftModel, arguments: cli.Arguments, over: Callable[[], bool]) -> int:
    """Serve the robot with its sliders."""
    from softdyn.view.live.explorer import explore, open_explorer_page

    with open_explorer_page(model, arguments.port, arguments.origin) as channel:
        cli.offer(channel, arguments)
        explore(model, channel, over)
    return cli.PASSED


main = cli.program(parser, command, __name__)
