"""Cables around round bodies: random robots against MuJoCo and central differences."""

from __future__ import annotations

from pathlib import Path

from softdyn.commands import cli

EPILOG = """\
Random robots with cables around cylinders and spheres, outside and inside. At random states, each
length and its moment arms are compared with MuJoCo's, and with central differences; likewise the
Hessians of the lengths and the power of cables and springs. A state is left out of the differences
if a cable touches or leaves a body within two steps, and counted. Trajectories of robots without
inner bends are compared with MuJoCo's. Robots with inner bends are cross-checked, and the largest
errors are printed beside the tolerances that `softdyn crosscheck` has for them.

exit codes: 0 all within the bars; 1 otherwise; 2 bad input.
"""
parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--count", type=int, default=200, help="robots (default: 200)")
parser.add_argument("--first", type=int, default=0, metavar="SEED", help="of a robot (default: 0)")
parser.add_argument("--states", type=int, default=10, help="states of each (default: 10)")
parser.add_argument("--trajectories", type=int, default=50, metavar="N",
                    help="robots whose trajectories are compared (default: 50)")  # fmt: skip
parser.output("--plot", "FILE", "instead, draw moment arms where cables touch and leave: .png")


def command(arguments: cli.Arguments) -> int:
    """Measure and print, or draw."""
    if arguments.plot is not None:
        from tests.proof.crosschecks.lift_off import draw

        draw(Path(arguments.plot))
        print(arguments.plot)
        return cli.PASSED
    from softdyn.validation.crosschecks.crosscheck import TOLERANCE_INSIDE
    from tests.support.wrap_errors import BARS, measure

    seeds = range(arguments.first, arguments.first + arguments.count)
    found = measure(seeds, arguments.states, arguments.trajectories)
    print(
        f"{arguments.count} robots, {sum(found.contacts.values())} pieces: {dict(found.contacts)}"
    )
    print(f"differences at {found.compared} states, {found.left_out} left out near an edge")
    for name, error in found.errors.items():
        print(
            f"  {name:22} {error:9.1e}  bar {BARS[name]:.0e}  robot, state {found.worst.get(name)}"
        )
    for quantity, error in found.inside.items():
        if (bar := TOLERANCE_INSIDE.get(quantity)) is not None:
            print(f"  inside, {quantity:14} {error:9.1e}  tolerance {bar:.0e}")
    return cli.FAILED if found.missed else cli.PASSED


main = cli.program(parser, command, __name__)
