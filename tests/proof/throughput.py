"""Closed loops per second of wall clock, twin included, and the parts of their time."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np

import softdyn
from softdyn import SoftModel
from softdyn.commands import cli
from softdyn.controllers import find_controller
from softdyn.validation.loop import setups
from softdyn.validation.loop.closed_loop import ClosedLoop
from softdyn.validation.loop.settings import RunOptions
from softdyn.validation.simulate import simulate
from softdyn.validation.studies.study_targets import study_experiments
from softdyn.validation.tables import Table
from tests.proof.timing import step_report
from tests.proof.timing.recording import DRIVER, ROBOTS
from tests.proof.timing.step_time import MachineLoad, quiet

THETA = 0.5  # the set point of the run, in multiples of π
COLUMNS = (
    ("Robot", "robot", ""),
    ("simulated s", "simulated_s", ".0f"),
    ("wall s", "wall_s", ".2f"),
    ("loops/s", "loops_per_s", ".2f"),
    ("× real time", "times_real_time", ".1f"),
    ("set-up s", "setup_s", ".3f"),
    ("state", "state_s", ".3f"),
    ("controller", "controller_s", ".3f"),
    ("MuJoCo", "mujoco_s", ".3f"),
    ("bookkeeping", "bookkeeping_s", ".3f"),
)

parser = cli.Parser(__doc__, "exit codes: 0 done; 2 bad input; 130 interrupted.\n")
parser.add_argument("--robots", nargs="+", default=ROBOTS, metavar="ROBOT")
parser.option("--controller", str, "CONTROLLER", "of every loop", DRIVER)
cli.add_json(parser)


def command(arguments: cli.Arguments) -> int:
    """Run the loops and print the table."""
    load = MachineLoad()
    rows = [throughput(softdyn.load(robot), arguments.controller) for robot in arguments.robots]
    on = step_report.machine() | load.report()
    text = f"{Table.of(COLUMNS, rows).text()}\n\n{step_report.machine_text(on)}"
    cli.write_report({"rows": rows, "machine": on}, arguments.json, text)
    return cli.PASSED


def throughput(
    model: SoftModel,
    controller: str,
    duration: float | None = None,
    repeats: int = 3,
) -> dict[str, Any]:
    """One robot's row: the fastest of some runs to a set point, the paper's or an equilibrium.

    The log has the time of `model.state` and the controller together. The controller's time is
    this, less that of `model.state` timed on the recorded states. The rest is bookkeeping.

    Parameters
    ----------
    model : SoftModel
        The robot.
    controller : str
        Name of the controller.
    duration : float, optional
        Simulated time of a loop (s); the experiment's by default.
    repeats : int
        Number of runs.

    Returns
    -------
    dict
        Times (s) of the run and of its parts, and its number of steps.
    """
    if model.bundled in setups.ROBOTS:
        experiment = setups.setup_of(model).set_point(THETA)
    else:
        experiment = study_experiments(model, 1)[0]
    duration = experiment.duration if duration is None else duration
    make = find_controller(controller)
    simulate(model, make(model), experiment, duration=min(duration, 0.1))  # warm up
    runs = []
    for _ in range(repeats):
        law = make(model)
        with quiet():
            began = perf_counter()
            loop = ClosedLoop(model, law, experiment, RunOptions(duration=duration))
            setup = perf_counter() - began
            plant = 0.0
            while loop.control() is not None:
                held = perf_counter()
                loop.advance()
                plant += perf_counter() - held
            log = loop.log()
            wall = perf_counter() - began
            began = perf_counter()
            for q, v in zip(log.q, log.v, strict=True):
                model.state(q, v)
            state = perf_counter() - began
        step = float(np.nansum(log.step_us)) / 1e6
        runs.append((wall, setup, state, step - state, plant, log.steps))
    wall, setup, state, law_s, plant, steps = min(runs)
    grid = loop.grid
    parts = {"setup": setup, "state": state, "controller": law_s, "mujoco": plant}
    return {
        "robot": model.bundled or model.name,
        "controller": controller,
        "simulated_s": steps * grid.period,
        "wall_s": wall,
        "loops_per_s": 1 / wall,
        "times_real_time": steps * grid.period / wall,
        "control_steps": steps,
        "plant_steps": steps * grid.substeps,
        **{f"{name}_s": seconds for name, seconds in parts.items()},
        "bookkeeping_s": wall - sum(parts.values()),
    }


main = cli.program(parser, command, __name__)
