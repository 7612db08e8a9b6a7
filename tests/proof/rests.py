"""Equilibria at the paper's set points, with their pictures: docs/statics_measured.md."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from softdyn.commands import cli, statics

SAMPLES = {"finger": (60, 600), "helix": (20, 200), "spirob": (20, 200)}  # --rays, --spread
EPILOG = """\
Each robot is one run of `softdyn statics ROBOT`. It draws docs/statics_ROBOT.png. Its figures go to
tests/proof/documents/measured/statics.json; then `python -m tests.proof tables` writes the table.
The finger takes 40 s of processor time, SpiRob more than four minutes.

exit codes: 0 done; 2 bad input.
"""

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("robots", nargs="*", metavar="ROBOT", help="default: all of the paper's")


def command(arguments: cli.Arguments) -> int:
    """Run the robots; the rows of each are written when it is done."""
    from softdyn import InputError
    from softdyn.validation.files import read_json
    from tests.proof.documents.measured_rows import replace_rows
    from tests.proof.documents.settings import MEASURED

    path = MEASURED / "statics.json"
    for robot in arguments.robots or SAMPLES:
        if robot not in SAMPLES:
            raise InputError("ROBOT", " or ".join(SAMPLES), robot)
        rays, spread = SAMPLES[robot]
        with TemporaryDirectory() as folder:
            file = Path(folder, "report.json")
            numbers = f"--rays {rays} --spread {spread} --shapes 12".split()
            files = ["--map", f"docs/statics_{robot}.png", "--json", str(file)]
            statics.main([robot, *numbers, *files])
            found = read_json(file, "the report of statics")
        rows = [{"robot": robot, **row_of(target)} for target in found["targets"]]
        replace_rows(path, "robot", [robot], rows, [*SAMPLES])
    return cli.PASSED


def row_of(target: dict[str, Any]) -> dict[str, Any]:
    """The table's row of a target of the report."""
    near, stable = (_numbers(target[kind]) for kind in ("closest", "closest_stable"))
    return {
        "theta": target["theta"], "closest": near,
        "closest_stable": None if near is None or near["stable"] else stable,
    }  # fmt: skip


def _numbers(one: dict[str, Any] | None) -> dict[str, Any] | None:
    return one and {
        "distance_cm": one["distance_cm"], "stable": one["stable"],
        "eigenvalue": one["smallest_eigenvalue"], "pole": one["rightmost_pole"],
        "drift_cm": one["nudged_drift_cm"]["final"], "u": one["u"],
    }  # fmt: skip


main = cli.program(parser, command, __name__)
