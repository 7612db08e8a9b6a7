#!/usr/bin/env python3
"""Pinocchio against MuJoCo: one robot in two engines, each quantity and trajectories."""

from __future__ import annotations

import sys

from softdyn.commands import cli

EPILOG = """\
ROBOT is a bundled name (finger, helix, spirob, spirob48), a path to an annotated URDF, or the name
of a robot of example-robot-data.

At random states inside the limits each quantity is computed by both engines, and
error = max|a - b| / max(|a|, |b|, scale). Limits, contacts and dry friction are off. If the file
has a rig, winches, tensions, sensors and a trajectory with lag and delay are compared too.

exit codes: 0 everything agrees; 1 something differs; 2 bad input.
"""


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robot", metavar="ROBOT")
cli.add_robot_options(parser)
cli.add_force_options(parser)
parser.add_argument("--states-only", action="store_true", help="random states, and no trajectories")
parser.option("--samples", cli.count, "N", "random states", 20)
parser.option("--seed", cli.whole, "S", "seed of the random states", 0)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Load, compare and report."""
    from softdyn.validation import Twin, crosscheck

    model = cli.load_robot(arguments)
    show = sys.stderr.isatty()
    result = crosscheck(
        model,
        Twin(model, limits=False),
        samples=arguments.samples,
        seed=arguments.seed,
        trajectories=not arguments.states_only,
        progress=say if show else None,
    )
    if show:
        say("")
    cli.write_report(result.to_dict(), arguments.json, str(result))
    return cli.PASSED if result.passed else cli.FAILED


def say(text: str) -> None:
    """Replace the progress line on stderr."""
    print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)


main = cli.program(parser, command, __name__)
