"""The price of barriers: a step's processor time with and without, in two checkouts."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from softdyn.commands import cli

EPILOG = """\
OLD is a folder with another version of softdyn. Both step through the same states, recorded from
runs of `python -m tests.proof scenes`, in processes that alternate: old, new, new, old. A time is
the smallest of some calls in both processes (processor time), and the mean over the states.

exit codes: 0 done; 2 bad input.
"""
ROBOTS = ("finger", "helix", "spirob")
KINDS = {
    "out of reach": "far", "near, none changes the input": "scene", "near, changed": "scene",
}  # fmt: skip
COLUMNS = (
    ("robot", "robot", ""),
    ("obstacles", "obstacles", ""),
    ("states", "states", "d"),
    ("without (µs)", "without_us", ".0f"),
    ("before (µs)", "old_us", ".0f"),
    ("× without", "old", ".1f"),
    ("now (µs)", "new_us", ".0f"),
    ("× without", "new", ".1f"),
    ("inputs differ, of the range, at most", "differ", ".1g"),
)

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("old", type=Path, metavar="OLD", help="folder of the other checkout")
parser.add_argument("--robots", nargs="+", default=ROBOTS, metavar="ROBOT")
parser.add_argument("--scenes", type=cli.count, default=4, metavar="N", help="default: 4")
parser.add_argument("--states", type=cli.count, default=20, metavar="N", help="default: 20")
parser.add_argument("--rounds", type=cli.count, default=20, metavar="N", help="default: 20")
parser.add_argument("--seed", type=cli.whole, default=90211, metavar="S")
parser.add_argument("--folder", type=Path, default=Path("results/barrier_time"), metavar="DIR",
                    help="where states/ROBOT.npz are, or will be")  # fmt: skip
parser.add_argument("--out", type=Path, metavar="FILE", help="write the table's rows")
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Record what is missing, alternate, report."""
    from softdyn.validation.tables import Table
    from tests.proof.documents.measured_rows import replace_rows

    cli.make_folder(arguments.folder)
    rows: list[dict[str, Any]] = []
    for robot in arguments.robots:
        path = arguments.folder / f"{robot}.npz"
        if not path.exists():
            record(robot, path, arguments.scenes, arguments.states, arguments.seed)
        here = Path(__file__).resolve().parents[2]
        order = (arguments.old, here, here, arguments.old)
        found = [measured(root, robot, path, arguments.rounds) for root in order]
        rows += table_rows(robot, (found[0], found[3]), found[1:3])
    if arguments.out is not None:
        replace_rows(arguments.out, "robot", arguments.robots, rows)
    cli.write_report({"rows": rows}, arguments.json, Table.of(COLUMNS, rows).markdown())
    return cli.PASSED


def record(robot: str, path: Path, count: int, states: int, seed: int) -> None:
    """Save states of scenes' runs, evenly over time, with their references and obstacles."""
    import numpy as np

    import softdyn
    from softdyn.controllers import SoftIdClfQp
    from softdyn.controllers.safety_filter import with_barriers
    from softdyn.validation import simulate
    from softdyn.validation.loop.setups import setup_of
    from tests.proof.safety import scenes

    model, rows, tables = softdyn.load(robot), [], []
    for k, scene in enumerate(scenes.scenes(model, None, count, seed)):
        law, period = with_barriers(SoftIdClfQp, scene.around)(model, None), setup_of(model).period
        log = simulate(model, law, scene.target, duration=scenes.DURATION, period=period,
                       q0=scene.free.q[0])  # fmt: skip
        tables.append(json.dumps(scene.around.table))
        for i in np.linspace(0, log.steps - 1, -(-states // count)).astype(int):
            now = scene.target(float(log.t[i]))
            rows.append((log.q[i], log.v[i], (now.y, now.ydot, now.yddot), k))
    q, v, references, scene_of = (np.array(same) for same in zip(*rows, strict=True))
    np.savez(path, q=q, v=v, now=references, scene=scene_of, tables=np.array(tables))


def measured(root: Path, robot: str, path: Path, rounds: int) -> dict[str, Any]:
    """One process of a checkout."""
    from softdyn import InputError
    from tests.proof.safety import price
    from tests.proof.timing.comparison import THREADS

    words = [sys.executable, "-P", price.__file__, str(rounds), f"{robot}={path.resolve()}"]
    environment = os.environ | THREADS | {"PYTHONPATH": str(root.resolve())}
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        said = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        raise InputError(str(root), "a checkout whose steps can be timed", said)
    found: dict[str, Any] = json.loads(done.stdout)[robot]
    return found


def table_rows(robot: str, old: Any, new: Any) -> list[dict[str, Any]]:
    """A row for each kind of obstacles: means of the states' smallest times."""
    import numpy as np

    import softdyn

    model = softdyn.load(robot)
    changed = np.array(old[0]["changed"])
    apart = np.abs(np.array(old[0]["u"]) - np.array(new[0]["u"])) / (model.u_max - model.u_min)
    chosen = dict(zip(KINDS, (np.ones_like(changed), ~changed, changed), strict=True))
    rows = []
    for obstacles, kind in KINDS.items():
        which = chosen[obstacles]
        if not which.any():
            continue
        (alone, before), (again, now) = (
            [
                float(np.min([one[key] for one in both], axis=0)[which].mean())
                for key in ("without", kind)
            ]
            for both in (old, new)
        )
        rows.append({
            "robot": robot, "obstacles": obstacles, "states": int(which.sum()),
            "without_us": again, "old_us": before, "old": before / alone, "new_us": now,
            "new": now / again, "differ": None if kind == "far" else float(apart[which].max()),
        })  # fmt: skip
    return rows


main = cli.program(parser, command, __name__)
