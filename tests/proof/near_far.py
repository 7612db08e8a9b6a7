"""Set points of soft ID-CLF-QP with an obstacle far away, and with two near the arm's end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from softdyn.commands import cli

EPILOG = """\
Each robot runs without obstacles, with a ball four lengths away, with a ball beside the end of the
first run, and with one that this end cuts. The plant does not know the balls. ROBOT is as for
`softdyn run`; its gains are the published ones, or those of `check --gains`. Rows of other robots
that `--out` has already are kept.

exit codes: 0 all errors and depths are within the aim; 1 one is not; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robots", nargs="+", metavar="ROBOT")
parser.add_argument(
    "--target", type=cli.finite, nargs=3, metavar=("X", "Y", "Z"), help="set point in m"
)
parser.add_argument("--duration", type=cli.positive, default=3.0, metavar="S")
parser.add_argument("--out", type=Path, metavar="FILE", help="write the table's rows")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Run, judge and report."""
    import softdyn
    from softdyn.validation.files import read_json, write_json
    from softdyn.validation.tables import Table
    from tests.proof.safety import near_far

    out, found, kept = arguments.out, list[dict[str, Any]](), list[dict[str, Any]]()
    models = [softdyn.load(name) for name in arguments.robots]
    if out is not None and out.is_file():
        rows = read_json(out, "rows of a table")["rows"]
        kept = [row for row in rows if row["robot"] not in [model.name for model in models]]
    for model in models:
        for row in near_far.runs(model, arguments.target, arguments.duration):
            found.append(row)
            if out is not None:
                write_json(out, {"rows": kept + found})
    cli.write_report({"rows": found}, arguments.json, Table.of(near_far.COLUMNS, found).markdown())
    return cli.PASSED if all(row["passed"] for row in found) else cli.FAILED


main = cli.program(parser, command, __name__)
