"""The time of a step of `best`, `mpc` and the observer in closed loops: docs/real_time.md."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from softdyn.commands import cli
from tests.proof.observer_time import SENSORS

EPILOG = """\
A controller's steps are those of `softdyn step-time ROBOT CONTROLLER`: a loop of 5 s at the paper's
set point and period. The observer's are those of `observer-time`. The figures go to
tests/proof/documents/measured/loop_time.json; then `python -m tests.proof tables` writes the table.

Times are meaningful only on an idle machine; the table states its load.

exit codes: 0 done; 2 bad input; 130 interrupted.
"""
ROBOTS, CONTROLLERS = ("finger", "helix", "spirob"), ("best", "mpc")
OBSERVER = "observer"
COLUMNS = (
    ("robot", "robot", ""),
    ("step of", "step", ""),
    ("median µs", "median_us", ".0f"),
    ("p99 µs", "p99_us", ".0f"),
    ("period ms", "period_ms", ".2g"),
    ("p99, % of the period", "share", ".0f"),
    ("rate that p99 allows (Hz)", "rate_hz", ".0f"),
)

parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--robots", nargs="+", default=ROBOTS, metavar="ROBOT")
parser.option("--seconds", cli.positive, "S", "length of a controller's loop", 5.0)
parser.add_argument(
    "--rounds", type=cli.count, metavar="N", help="of the observer (default: 10000 samples)"
)
parser.output("--out", "FILE", "where the figures go")


def command(arguments: cli.Arguments) -> int:
    """Measure, write."""
    from softdyn.validation.files import write_json
    from tests.proof.documents.settings import MEASURED
    from tests.proof.timing.step_report import machine
    from tests.proof.timing.step_time import MachineLoad

    load, rows = MachineLoad(), []
    for robot in arguments.robots:
        rows += [controller_row(robot, name, arguments.seconds) for name in CONTROLLERS]
        rows.append(observer_row(robot, arguments.rounds))
    for row in rows:
        row["share"] = row["p99_us"] / row["period_ms"] / 10
        row["rate_hz"] = 1e6 / row["p99_us"]
    out = arguments.out or MEASURED / "loop_time.json"
    write_json(out, {"rows": rows, "machine": machine() | load.report()})
    print(out)
    return cli.PASSED


def controller_row(robot: str, controller: str, seconds: float) -> dict[str, Any]:
    """The times of a controller's steps in its own loop."""
    from softdyn import InputError
    from softdyn.commands import step_time
    from softdyn.validation.files import read_json

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "times.json"
        words = [robot, controller, "--seconds", str(seconds), "--json", str(file)]
        if step_time.main(words) != cli.PASSED:
            raise InputError(f"{robot}, {controller}", "a loop that ends", "one that failed")
        found = read_json(file, "times")
    return {
        "robot": robot, "step": controller, "median_us": found["median_us"],
        "p99_us": found["p99_us"], "period_ms": found["period_us"] / 1e3,
    }  # fmt: skip


def observer_row(robot: str, rounds: int | None = None) -> dict[str, Any]:
    """The times of the default observer's steps."""
    import softdyn
    from softdyn.commands.observe import sensors_of
    from softdyn.controllers import find_controller
    from softdyn.validation.loop.observation import make_observer
    from softdyn.validation.twin.rig import Rig
    from tests.proof import observer_time
    from tests.proof.timing.recording import DRIVER
    from tests.proof.timing.step_time import SAMPLES

    model = softdyn.load(robot)
    rig = Rig(sensors=sensors_of(model, SENSORS), seed=0)
    loop = observer_time.observed_loop(model, find_controller(DRIVER), rig)
    count = rounds or -(-SAMPLES // len(loop.steps))
    observers = [make_observer(model, rig, "") for _ in range(count)]
    found = observer_time.observer_row(robot, model, observers, loop)
    names = "robot", "median_us", "p99_us", "period_ms"
    return {"step": OBSERVER, **{name: found[name] for name in names}}


main = cli.program(parser, command, __name__)
