"""The time of a control step by n and m, on generated chains."""

from __future__ import annotations

from pathlib import Path

from softdyn.commands import cli

ROUNDS = 20
EPILOG = """\
Soft ID-CLF-QP runs on serial chains (tests/support/long_chains.py), all in turn.

exit codes: 0 done; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument(
    "--out", type=Path, default=Path("results/scaling"), metavar="DIR", help="default: %(default)s"
)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Measure, then tables and the figure."""
    from tqdm import tqdm

    from softdyn.validation.tables import Table
    from tests.proof.timing import growth, step_scaling
    from tests.proof.timing.step_report import STEP

    columns = (
        ("n", "n", ""),
        ("m", "m", ""),
        *(column for column in STEP[2:10] if column[1] not in ("p99_us", "p999_us")),
        ("solver's own", "solver_us", ".1f"),
    )
    cli.make_folder(arguments.out)
    with tqdm(total=ROUNDS, unit="round", disable=None, leave=False) as bar:
        found = step_scaling.scaling(rounds=ROUNDS, tick=bar.update)
    growth.growth(found, arguments.out / "scaling")
    parts = [f"### Against {axis}\n\n{Table.of(columns, rows).markdown()}"
             for axis, rows in found.items()]  # fmt: skip
    cli.write_report(found, arguments.json, "\n\n".join(parts))
    return cli.PASSED


main = cli.program(parser, command, __name__)
