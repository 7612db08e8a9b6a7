#!/usr/bin/env python3
"""The number of joints that an arm needs: convergence of sag, frequencies and bent shapes."""

from __future__ import annotations

from softdyn.commands import cli

EPILOG = """\
FILE is TOML as for `softdyn new`. Errors are relative to the limit that is extrapolated from the
finest arms; for tips they are relative to the arm's length.

exit codes: 0 done; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("file", metavar="FILE", help="TOML")
parser.add_argument(
    "--segments", type=cli.count, nargs="+", default=[5, 10, 20, 40, 80], metavar="N",
    help="joints in each section (default: 5 10 20 40 80)",
)  # fmt: skip
parser.option("--tolerance", cli.positive, "X", "allowed relative error", 1e-3)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Measure, extrapolate and report."""
    from softdyn import design
    from softdyn.validation.rods import convergence

    arm = design.arm_of(cli.read_toml(arguments.file), arguments.file)
    found = convergence.converge(arm, arguments.segments, arguments.tolerance)
    report = {"file": arguments.file, "name": arm.name, **found.to_dict()}
    cli.write_report(report, arguments.json, str(found))
    return cli.PASSED


main = cli.program(parser, command, __name__)
