"""Our robots as MJCF in MuJoCo Warp, many at once: the table of docs/gpu.md.

- `warp_worlds`, `warp_speed`: programs for an environment with mujoco-warp: the difference from
  MuJoCo, and the speed on a GPU
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
writes the table. With --device cuda the speed on a GPU is measured,
too, for measured/batches_gpu.json.

exit codes: 0 done; 2 bad input, or mujoco-warp is not there.
"""
ROBOTS = ("finger", "helix", "spirob")
COLUMNS = (
    ("robot", "robot", ""), ("joints", "nv", ""), ("largest joint value", "moved", ".2f"),
    ("after 20 steps", "after_20", ".0e"), ("200", "after_200", ".0e"),
    ("400", "after_400", ".0e"), ("refused", "refused", ""),
)  # fmt: skip

SPEED = (
    ("robot", "robot", ""), ("worlds", "worlds", ""), ("ms a step", "ms", ".2f"),
    ("million steps a second", "millions", ".3g"), ("times the CPU", "times", ".2g"),
)  # fmt: skip
BESIDE = (
    ("robot", "robot", ""), ("joints", "nv", ""),
    ("million steps a second on the CPU", "cpu_millions", ".2g"),
    ("first step (s)", "first_step_s", ".0f"), ("difference after 400 steps", "after_400", ".0e"),
)  # fmt: skip

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--python", default=sys.executable, metavar="PYTHON")
parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
parser.option("--worlds", cli.count, "N", "copies of each robot", 4)
parser.option("--steps", cli.count, "N", "steps of each", 400)


def command(arguments: cli.Arguments) -> int:
    """Export, step, write."""
    from softdyn.validation.files import write_json
    from tests.proof.documents.settings import MEASURED

    rows = [measure(name, arguments.python, arguments.worlds, arguments.steps) for name in ROBOTS]
    write_json(MEASURED / "batches.json", {"worlds": arguments.worlds, "rows": rows})
    if arguments.device == "cuda":
        speeds = [speed(row, arguments.python, arguments.device) for row in rows]
        write_json(MEASURED / "batches_gpu.json", {"rows": speeds})
    return cli.PASSED


def measure(robot: str, python: str, worlds: int, steps: int) -> dict[str, Any]:
    """A row of the table: the largest difference of a joint from MuJoCo's.

    Raises
    ------
    InputError
        There is no such interpreter, it lacks mujoco-warp, or the program fails.
    """
    found = _measured(robot, python, "warp_worlds.py", str(worlds), str(steps))
    after = {f"after_{steps}": value for steps, value in found.pop("after", {}).items()}
    return {"robot": robot, **found, **after, "refused": found["refused"] or "nothing"}


def speed(row: dict[str, Any], python: str, device: str) -> dict[str, Any]:
    """The speed of a robot on a device, with the difference in its `row`.

    Raises
    ------
    InputError
        As `measure`; there is no such device.
    """
    found = _measured(row["robot"], python, "warp_speed.py", device)
    return {"robot": row["robot"], "after_400": row["after_400"], **found}


def speeds(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each robot and number of worlds."""
    return [
        {
            "robot": row["robot"], "worlds": one["worlds"], "ms": one["ms"],
            "millions": one["steps_per_s"] / 1e6,
            "times": one["steps_per_s"] / row["cpu_steps_per_s"],
        }
        for row in rows for one in row["rows"]
    ]  # fmt: skip


def beside(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each robot."""
    return [{**row, "cpu_millions": row["cpu_steps_per_s"] / 1e6} for row in rows]


def _measured(robot: str, python: str, program: str, *arguments: str) -> dict[str, Any]:
    """The figures of a program about a robot's file."""
    from softdyn import InputError
    from softdyn.validation.mjcf.export import write_mjcf

    with tempfile.TemporaryDirectory() as place:
        file, out = Path(place) / "robot.xml", Path(place) / "out.json"
        write_mjcf(robot, file)
        words = [python, str(Path(__file__).parent / program), str(file), *arguments, str(out)]
        try:
            done = subprocess.run(words, capture_output=True, text=True, check=False)
        except OSError as error:
            raise InputError("--python", "an interpreter", error.strerror or error) from None
        if re.search("No module named '(mujoco|mujoco_warp|warp)'", done.stderr):
            raise InputError("--python", "an environment with mujoco-warp", f"{python}, without it")
        if done.returncode:
            said = (done.stderr.strip().splitlines() or ["no word"])[-1]
            raise InputError("--python", f"{program} to end without an error", said)
        found: dict[str, Any] = json.loads(out.read_text())
        return found


main = cli.program(parser, command, __name__)
