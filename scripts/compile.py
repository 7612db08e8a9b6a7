#!/usr/bin/env python3
"""Compile all kernels now and not at their first use, for images and shared installations."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
Compiled code is stored beside the package. From there it is read even if the folder is not writable
later, as in a container. If the folder is not writable now, the code is stored in the user's cache
folder. The variable NUMBA_CACHE_DIR names another folder. The code belongs to this kind of
processor: on another kind it is compiled again.

exit codes: 0 all are compiled; 2 bad input.
"""

# one robot per kind of tendon, because their kernels differ
ROBOTS = ("finger", "spirob")
OBSERVER, OBSTACLE = "observer", "obstacle"

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--jobs", type=cli.count, metavar="N", help="default: one per core")


def command(arguments: cli.Arguments) -> int:
    """Make every controller, `allocate`, an observer and an obstacle for every kind of robot."""
    from softdyn.compiled import COMPILES
    from softdyn.controllers.registry import BEYOND, CONTROLLERS
    from softdyn.validation.processes import in_order

    if not COMPILES:
        cli.say("nothing to compile: SOFTDYN_COMPILE=0 or NUMBA_DISABLE_JIT=1")
        return cli.PASSED
    # the longest first
    names = (*BEYOND, OBSERVER, *CONTROLLERS, OBSTACLE)
    in_order(_warm, [(robot, name) for robot in ROBOTS for name in names], arguments.jobs or -1)
    cli.say("all kernels are compiled")
    return cli.PASSED


def _warm(robot: str, name: str) -> None:
    import numpy as np

    import softdyn
    from softdyn.commands.observe import sensors_of
    from softdyn.controllers import SoftIdClfQp, allocate
    from softdyn.controllers.registry import LAWS, make_controller
    from softdyn.controllers.safety_filter import with_barriers
    from softdyn.dynamics.projection import underlying_tree
    from softdyn.estimation import Ekf
    from softdyn.safety import KeepOutBox, Surroundings

    model = softdyn.load(robot)
    if name == OBSTACLE:  # a box, whose distance from round links is refined
        state = model.state(model.q0, np.zeros(model.nv))
        box = KeepOutBox(state.y + 0.02, np.full(3, 0.01), links="all")
        law = with_barriers(SoftIdClfQp, Surroundings([box]))(model)
        law.reset(0.01)
        law(state, softdyn.SetPoint(state.y))
        allocate(model, state, state.g)
        return
    if name != OBSERVER:
        rubs = "friction" in LAWS[name].options
        make_controller(name, model, {"friction": 0.1} if rubs else None)
        return
    model.tendons.arm_rates(np.zeros(model.nv), *underlying_tree(model)[0].kinematics(model.q0))
    observer = Ekf(model, sensors_of(model, "lengths=0.001,tip=0.001@100+0.015"))
    for k in range(5):  # a late reading arrives, and the wrong ones move joints to their stops
        observer.step(0.01 * k, np.full(observer.components, 0.1), np.zeros(model.nu))


main = cli.program(parser, command, __name__)
