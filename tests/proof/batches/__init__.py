"""Our robots as MJCF in MuJoCo Warp, many at once: the table of docs/gpu.md.

- `warp_worlds`: a program for an environment with mujoco-warp
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from softdyn.commands import cli

EPILOG = """\
--python is the interpreter of an environment with mujoco-warp, which neither softdyn nor its extras
install: python -m venv warp; warp/bin/pip install mujoco-warp. Without it the program says so. The
figures go to tests/proof/documents/measured/batches.json; then `python -m tests.proof tables`
writes the table.

exit codes: 0 done; 2 bad input, or mujoco-warp is not there.
"""
ROBOTS = ("finger", "helix", "spirob")
COLUMNS = (
    ("robot", "robot", ""), ("joints", "nv", ""), ("largest joint value", "moved", ".2f"),
    ("after 20 steps", "after_20", ".0e"), ("200", "after_200", ".0e"),
    ("400", "after_400", ".0e"), ("refused", "refused", ""),
)  # fmt: skip

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--python", default=sys.executable, metavar="PYTHON")
parser.option("--worlds", cli.count, "N", "copies of each robot", 4)
parser.option("--steps", cli.count, "N", "steps of each", 400)


def command(arguments: cli.Arguments) -> int:
    """Export, step, write."""
    from softdyn.validation.files import write_json
    from tests.proof.documents.settings import MEASURED

    rows = [measure(name, arguments.python, arguments.worlds, arguments.steps) for name in ROBOTS]
    write_json(MEASURED / "batches.json", {"worlds": arguments.worlds, "rows": rows})
    return cli.PASSED


def measure(robot: str, python: str, worlds: int, steps: int) -> dict[str, Any]:
    """A row of the table: the largest difference of a joint from MuJoCo's.

    Raises
    ------
    InputError
        There is no such interpreter, it lacks mujoco-warp, or the program fails.
    """
    from softdyn import InputError
    from softdyn.validation.mjcf.export import write_mjcf

    with tempfile.TemporaryDirectory() as place:
        file, out = Path(place) / "robot.xml", Path(place) / "out.json"
        write_mjcf(robot, file)
        program = str(Path(__file__).parent / "warp_worlds.py")
        words = [python, program, str(file), str(worlds), str(steps), str(out)]
        try:
            done = subprocess.run(words, capture_output=True, text=True, check=False)
        except OSError as error:
            raise InputError("--python", "an interpreter", error.strerror or error) from None
        if re.search("No module named '(mujoco|mujoco_warp|warp)'", done.stderr):
            raise InputError("--python", "an environment with mujoco-warp", f"{python}, without it")
        if done.returncode:
            said = (done.stderr.strip().splitlines() or ["no word"])[-1]
            raise InputError("--python", "warp_worlds.py to end without an error", said)
        found: dict[str, Any] = json.loads(out.read_text())
    after = {f"after_{steps}": value for steps, value in found.pop("after", {}).items()}
    return {"robot": robot, **found, **after, "refused": found["refused"] or "nothing"}


main = cli.program(parser, command, __name__)
