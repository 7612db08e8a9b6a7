"""Compare every controller with the paper's text, with all unknowns explicit and another solver."""

from __future__ import annotations

from softdyn.commands import cli

ROBOTS = ("finger", "helix", "spirob", "spirob48")
LAWS = ("soft-id-clf-qp", "id-clf-qp", "ic-qp", "clf-qp", "ic", "uic")
EPILOG = """\
Random states, near to and far from references that move and accelerate. The oracle is quadprog
(pip install quadprog). CLF-QP has many minimisers: where the oracle's is another, costs are judged.

exit codes: 0 all within 1e-6 of the input range; 1 some are not; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--robots", nargs="+", default=ROBOTS, choices=ROBOTS, metavar="ROBOT")
parser.add_argument("--controllers", nargs="+", default=LAWS, choices=LAWS, metavar="CONTROLLER")
parser.option("--states", cli.count, "N", "a robot and law", 300)
parser.option("--seed", cli.whole, "S", "of the states", 0)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Compare, report."""
    from tqdm import tqdm

    import softdyn
    from softdyn.validation.tables import Table
    from tests.proof.laws.agreement import COLUMNS, compare

    total = len(arguments.robots) * len(arguments.controllers) * arguments.states
    with tqdm(total=total, disable=None, leave=False, unit="state") as bar:
        rows = [
            compare(softdyn.load(robot), law, arguments.states, arguments.seed, bar.update)
            for robot in arguments.robots
            for law in arguments.controllers
        ]
    cli.write_report({"rows": rows}, arguments.json, Table.of(COLUMNS, rows).text())
    return cli.PASSED if all(row["passed"] for row in rows) else cli.FAILED


main = cli.program(parser, command, __name__)
