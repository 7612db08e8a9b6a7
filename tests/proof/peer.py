"""Compare M, C v, g, K and the tip of an arm of two sections with SoRoMoX's, at a random state."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
SoRoMoX (extra `peers`) has piecewise constant strains. The output has the time of an evaluation of
each.

exit codes: 0 done; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument(
    "--segments", type=cli.count, nargs="+", default=[5, 10, 20, 40, 80], metavar="N",
    help="joints in each section (default: 5 10 20 40 80)",
)  # fmt: skip
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Compare, report."""
    from tests.proof.rods import peer

    found = peer.compare(sorted({n for n in arguments.segments if n <= peer.MOST}))
    report = {**found, "ladders": [ladder.to_dict() for ladder in found["ladders"]]}
    cli.write_report(report, arguments.json, peer.peer_table(found))
    return cli.PASSED


main = cli.program(parser, command, __name__)
