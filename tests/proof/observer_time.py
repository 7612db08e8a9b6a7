"""The time of an observer's step, on the readings of a recorded closed loop.

The loop follows the robot's last experiment of `recording.experiments_of` with the true state. The
observer then gets the loop's readings and commands, several times from the start. The first steps,
in which the filter settles, are not counted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter_ns
from typing import Any, NamedTuple

import numpy as np

import softdyn
from softdyn import InputError, SoftModel
from softdyn.commands import cli
from softdyn.commands.observe import sensors_of
from softdyn.controllers import find_controller
from softdyn.estimation.arrivals import sensor_channels
from softdyn.validation.loop.observation import make_observer
from softdyn.validation.simulate import simulate
from softdyn.validation.tables import Table
from softdyn.validation.twin.rig import Rig
from tests.proof.timing import step_report
from tests.proof.timing.recording import DRIVER, DURATION, ROBOTS, experiments_of
from tests.proof.timing.step_time import SAMPLES, WARM_UP, MachineLoad, quiet

EPILOG = """\
WHICH is softdyn's filter with the disturbances that are named, or a class as FILE.py:CLASS. It gets
all measurements of a control period. Its readings are those of a loop behind a rig with these
sensors, "file" or a list as in softdyn observe. Steps in which a reading with a latency arrives
have their own columns.

exit codes: 0 done; 2 bad input; 130 interrupted.
"""
SENSORS = "lengths=0.0005@1000,tip=0.001@60+0.03"
COLUMNS = (
    ("Robot", "robot", ""),
    ("n", "n", "d"),
    ("Readings", "readings", "d"),
    ("Period ms", "period_ms", ".2f"),
    ("median µs", "median_us", ".1f"),
    ("p99", "p99_us", ".0f"),
    ("p99.9", "p999_us", ".0f"),
    ("late: steps", "late_samples", "d"),
    ("late: median µs", "late_median_us", ".1f"),
    ("late: p99.9", "late_p999_us", ".0f"),
)


parser = cli.Parser(__doc__, EPILOG)
parser.add_argument("--robots", nargs="+", default=ROBOTS, metavar="ROBOT")
parser.option("--observer", str, "WHICH", "names, or FILE.py:CLASS", "")
parser.option("--sensors", str, "WHICH", "file, or a list", SENSORS)
parser.option("--controller", str, "CONTROLLER", "of the loops", DRIVER)
parser.add_argument(
    "--rounds", type=cli.count, metavar="N", help="over the steps (default: 10000 samples)"
)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Time an observer's steps and print the table."""
    from tqdm import tqdm

    load, rows = MachineLoad(), []
    with tqdm(unit="round", disable=None, leave=False) as bar:
        for name in dict.fromkeys(arguments.robots):
            model = softdyn.load(name)
            rig = Rig(sensors=sensors_of(model, arguments.sensors), seed=0)
            make_observer(model, rig, arguments.observer)  # it may refuse its words
            loop = observed_loop(model, find_controller(arguments.controller), rig)
            rounds = arguments.rounds or -(-SAMPLES // len(loop.steps))
            observers = [make_observer(model, rig, arguments.observer) for _ in range(rounds)]
            rows.append(observer_row(name, model, observers, loop, bar.update))
    report = {"rows": rows, "machine": step_report.machine() | load.report()}
    cli.write_report(report, arguments.json, observer_text(report))
    return cli.PASSED


class ObservedLoop(NamedTuple):
    """The arguments of an observer's steps in one loop.

    Attributes
    ----------
    period : float
        The control period (s).
    steps : list of (float, ndarray, ndarray)
        Time, readings, and commands of the step before.
    late : ndarray of bool, (steps,)
        Whether a reading with a latency arrives.
    """

    period: float
    steps: list[tuple[float, np.ndarray, np.ndarray]]
    late: np.ndarray


def observed_loop(
    model: SoftModel, make: Callable[[SoftModel], Any], rig: Rig, duration: float = DURATION
) -> ObservedLoop:
    """Record a loop behind a rig.

    Parameters
    ----------
    model : SoftModel
        The robot.
    make : callable
        Builds the controller.
    rig : Rig
        It has the sensors.
    duration : float
        Duration of the loop (s).

    Raises
    ------
    InputError
        A rig without sensors, or a loop that ends before the steps that are not counted.
    """
    log = simulate(model, make(model), experiments_of(model)[-1], rig=rig, duration=duration)
    if log.measured is None or log.measured.shape[1] == 0:
        raise InputError("sensors", "at least one", "none")
    if log.steps <= WARM_UP:
        raise InputError(f"the loop of {model.name}", f"more than {WARM_UP} steps", f"{log.steps}")
    commands = log.u if log.command is None else log.command
    sent = [commands[0], *commands]
    rows = [(float(log.t[k]), log.measured[k].copy(), sent[k].copy()) for k in range(log.steps)]
    rigged = softdyn.build(rig.robot(model.robot), model.bundled)
    channels = [
        one for one in sensor_channels(rigged, rigged.robot.sensors) if one.times.latency > 0
    ]
    # a reading from before the first step tells nothing
    late = np.array(
        [sum([one.arrives(t) and t >= one.times.latency for one in channels]) > 0 for t, *_ in rows]
    )
    return ObservedLoop(log.period, rows, late)


def observer_row(
    robot: str,
    model: SoftModel,
    observers: Sequence[Any],
    loop: ObservedLoop,
    tick: Callable[[], Any] = lambda: None,
) -> dict[str, Any]:
    """The row of one robot.

    Parameters
    ----------
    robot : str
        Its name in the table.
    model : SoftModel
        Its model.
    observers : sequence of Observer
        One for each round over the loop, each new.
    loop : ObservedLoop
        The loop.
    tick : callable
        Called after every round.
    """
    times = np.empty((len(observers), len(loop.steps)))
    with quiet():
        for observer, row in zip(observers, times, strict=True):
            for k, step in enumerate(loop.steps):
                began = perf_counter_ns()
                observer.step(*step)
                row[k] = perf_counter_ns() - began
            tick()
    times, late = times[:, WARM_UP:] / 1e3, loop.late[WARM_UP:]
    return {
        "robot": robot, "n": model.nv, "readings": len(loop.steps[0][1]),
        "period_ms": 1e3 * loop.period,
        **_percentiles(times, ""), "samples": times.size,
        **_percentiles(times[:, late], "late_"), "late_samples": times[:, late].size,
    }  # fmt: skip


def observer_text(report: dict[str, Any]) -> str:
    """The table for a terminal."""
    return Table.of(COLUMNS, report["rows"]).text()


def _percentiles(times: np.ndarray, prefix: str) -> dict[str, float | None]:
    names = {"median_us": 50, "p99_us": 99, "p999_us": 99.9}
    return {
        prefix + name: float(np.percentile(times, share)) if times.size else None
        for name, share in names.items()
    }


main = cli.program(parser, command, __name__)
