#!/usr/bin/env python3
"""Play with a robot in the browser: drag its target, push its links, change its controller."""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

from softdyn.commands import cli

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48), a path to an annotated URDF, or the name
of a robot of example-robot-data. The first CONTROLLER acts (best by default); each further one, a
class of your own as FILE.py:CLASS, joins the registry's in the page's menu. --gains and --rig are
as for run. With a rig the page shows the inputs that act, and its delay and noise replace the
rig's unless they are 0. With --observer, as for run, the ghost is the estimate.

The plant runs in real time in this process, the pages' server in another. So a slow page loses
frames, but delays nothing. The page lists its keys on "?". The printed address contains a random
token. From another machine: ssh -L PORT:127.0.0.1:PORT, and the same address. Ctrl-C ends it.

--task pose has a target of three axes, --task axis an arrow; drag them, and turn them with t. A
radian counts as much as the robot's length in a pose, and as a third of it for a direction. --task
file has the <task>s of the robot's file. Controllers of your own then get tasks=[...].

--obstacles FILE is as for run: they are solid unless they say "contact = false", all controllers of
the menu keep clear of them, and the page shows them.

exit codes: 0 ended by Ctrl-C or SIGTERM; 2 bad input.
"""


KEPT = 500  # number of periods after which the pace is judged

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
parser.add_argument("controllers", nargs="*", metavar="CONTROLLER")
parser.add_argument(
    "--target", type=cli.finite, nargs=3, metavar=("X", "Y", "Z"), help="first target in m"
)
parser.settings("period", "rig", "observer", "surroundings")
parser.add_argument(
    "--gains", metavar="FILE", help="TOML: of the first CONTROLLER, or a table for each by its name"
)
parser.add_argument(
    "--task", choices=("pose", "axis", "file"),
    help="drag the tip's pose, its position and direction, or the tasks of the robot's file",
)  # fmt: skip
cli.add_robot_options(parser)
cli.add_force_options(parser)
cli.add_server_options(parser)


def command(arguments: cli.Arguments) -> int:
    """Build, serve and run until the command is ended."""
    with cli.ends_cleanly() as over:
        from softdyn.validation.live.playing import drive, open_play_page
        from softdyn.view.live.pacing import Clock

        session = make_session(arguments)
        with open_play_page(session, arguments.port, arguments.origin) as channel:
            cli.offer(channel, arguments)
            drive(session, channel, Clock(session.period, keep=KEPT), over, warn)
    return cli.PASSED


def warn(text: str) -> None:
    """Print a line beside the address."""
    print(f"warning: {text}", file=sys.stderr, flush=True)


def make_session(arguments: cli.Arguments) -> Any:
    """Make the session for the command line."""
    from softdyn.commands.run import make_rig, make_surroundings, naming
    from softdyn.validation import paper
    from softdyn.validation.live.menu import menu_of
    from softdyn.validation.live.session import Session
    from softdyn.view.live.messages import OPEN_LOOP

    model = cli.load_robot(arguments)
    first = arguments.controllers[0] if arguments.controllers else "best"
    law = first if model.nu else OPEN_LOOP
    around = make_surroundings(arguments.surroundings, model)
    own = controllers_of(arguments, first, around)
    if arguments.target is not None:
        paper.check_reach(model, arguments.target)
    menu = menu_of(model, own, around)
    read = {"rig": make_rig(arguments.rig, model), "surroundings": around}
    with naming(model):
        session = Session(
            model, menu, law, target=arguments.target, tasks=tasks_for(model, arguments.task),
            **parser.given(arguments) | read,
        )  # fmt: skip
    note = cli.best_note(model, law, arguments.gains)
    if note:
        print(note, file=sys.stderr, flush=True)
    return session


def tasks_for(model: Any, which: str | None) -> Any:
    """The tasks to drag; the tip's position alone needs none."""
    from softdyn.tasks import PoseTask, direction_tasks, make_tasks

    if which == "pose":  # the robot's length counts as much as 1 rad
        weight = [1.0] * 3 + [model.robot.length**2] * 3
        return [PoseTask(model.robot.task, weight=weight)]
    if which == "axis":
        return direction_tasks(model)
    return make_tasks(model) if which == "file" else ()


def controllers_of(arguments: cli.Arguments, first: str, around: Any = None) -> dict[str, Any]:
    """Controllers of the command line by name, each made as ``make(model)``."""
    from softdyn import InputError
    from softdyn.controllers.registry import find_controller, make_controller
    from softdyn.controllers.safety_filter import with_barriers
    from softdyn.view.live.messages import OPEN_LOOP

    said = (*arguments.controllers, *([first] if arguments.gains else []))
    names = [name for name in dict.fromkeys(said) if name != OPEN_LOOP]
    own = {name: with_barriers(find_controller(name), around) for name in names}
    if arguments.gains is None:
        return own
    table = cli.read_toml(arguments.gains)
    tables = {name: table.pop(name) for name in names if name in table}
    if table:
        if first == OPEN_LOOP or first in tables:
            expected = f"a table for one of {', '.join(names)}"
            raise InputError(f"{arguments.gains}: {next(iter(table))}", expected, "another key")
        tables[first] = table
    return own | {
        name: partial(
            make_controller, name, parameters=table, cls=own[name], source=arguments.gains
        )
        for name, table in tables.items()
    }


main = cli.program(parser, command, __name__)
