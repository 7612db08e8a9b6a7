"""Step times of another checkout compared with this one, in alternating processes."""

from __future__ import annotations

from pathlib import Path

from softdyn.commands import cli

ROBOTS = ("finger", "helix", "spirob")
DRIVER = "soft-id-clf-qp"  # of the loops from which states are recorded
CONTROLLERS = ("soft-id-clf-qp", "id-clf-qp", "clf-qp", "ic-qp", "ic", "uic", "best")
EPILOG = """\
OLD is a folder with another version of softdyn, one that has its packages beside softdyn/ included.
Both step through the same recorded states, those of step_time.py, in processes that alternate: old,
new, new, old. A row is the ratio of the medians and its 95 % bootstrap interval over pairs of
processes.

exit codes: 0 no interval above its limit of 1.03; 1 some; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("old", type=Path, metavar="OLD", help="folder of the other checkout")
parser.add_argument("--robots", nargs="+", default=ROBOTS, metavar="ROBOT")
parser.add_argument("--controllers", nargs="+", default=CONTROLLERS, metavar="CONTROLLER")
parser.add_argument("--pairs", type=cli.count, default=10, metavar="N", help="default: 10")
parser.add_argument("--rounds", type=cli.count, default=5, metavar="N", help="default: 5")
parser.option("--states", cli.count, "N", "a robot", 400)
parser.add_argument(
    "--out", type=Path, default=Path("results/step_time"), metavar="DIR",
    help="where states/ROBOT.npz are, or will be (default: results/step_time)",
)  # fmt: skip
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Record what is missing, alternate, report."""
    from tqdm import tqdm

    import softdyn
    from softdyn.controllers import find_controller
    from tests.proof.timing.comparison import compare, comparison_table
    from tests.proof.timing.recording import recorded

    cli.make_folder(arguments.out / "states")
    folder, make = arguments.out / "states", find_controller(DRIVER)
    for robot in arguments.robots:
        recorded(softdyn.load(robot), make, arguments.states, folder, robot)
    states = {robot: folder / f"{robot}.npz" for robot in arguments.robots}
    with tqdm(total=arguments.pairs + 1, disable=None, leave=False, unit="pair") as bar:
        rows = compare(
            arguments.old, states, list(dict.fromkeys(arguments.controllers)),
            pairs=arguments.pairs, rounds=arguments.rounds, tick=bar.update,
        )  # fmt: skip
    cli.write_report({"rows": rows}, arguments.json, comparison_table(rows).text())
    return cli.PASSED if all(row["passed"] for row in rows) else cli.FAILED


main = cli.program(parser, command, __name__)
