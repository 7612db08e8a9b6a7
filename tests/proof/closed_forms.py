"""Compare rods of jointed links with closed forms: the tables of docs/rods.md, as Markdown."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
Joints at Gauss-Legendre nodes and at midpoints stand against Euler-Bernoulli, Rayleigh, Timoshenko,
the elastica and constant curvature.

exit codes: 0 done; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument(
    "--segments", type=cli.count, nargs="+", default=[5, 10, 20, 40, 80], metavar="N",
    help="joints in each section (default: 5 10 20 40 80)",
)  # fmt: skip
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Measure, report."""
    from tests.proof.rods import tables

    found = tables.run(sorted(set(arguments.segments)))
    report = {rule: [ladder.to_dict() for ladder in ladders] for rule, ladders in found.items()}
    cli.write_report(report, arguments.json, tables.rod_tables(found))
    return cli.PASSED


main = cli.program(parser, command, __name__)
