"""Whole closed loops per second of wall clock, twin included, and where their time goes."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np

from softdyn import SoftModel
from softdyn.controllers import find_controller
from softdyn.validation.loop.closed_loop import Schedule, simulate
from softdyn.validation.studies import paper
from softdyn.validation.timing.step_time import quiet
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import Twin

THETA = 0.5  # the set point that is run, in multiples of π


def throughput(
    model: SoftModel, controller: str, duration: float | None = None, repeats: int = 3
) -> dict[str, Any]:
    """One robot's row: a set point of the paper run by `simulate`, the fastest of `repeats`.

    The times of `Twin.__init__` and of MuJoCo's steps are those of a second twin that is given the
    recorded inputs; `model.state` is timed on the recorded states. The controller's is what the log
    says of both less that, and bookkeeping is the rest.

    Parameters
    ----------
    duration : simulated time of a loop (s); the experiment's by default.
    """
    experiment = paper.setup_of(model).set_point(THETA)
    duration = experiment.duration if duration is None else duration
    schedule = Schedule.plan(duration, experiment.period)
    make = find_controller(controller)
    simulate(model, make(model), experiment, duration=min(duration, 0.1))  # warm up
    runs = []
    for _ in range(repeats):
        law = make(model)
        with quiet():
            began = perf_counter()
            log = simulate(model, law, experiment, duration=duration)
            wall = perf_counter() - began
            began = perf_counter()
            twin = Twin(model.robot, timestep=schedule.timestep)
            states = StateMap(model, twin)
            setup = perf_counter() - began
            twin.set_state(*states.to_twin(log.q[0], log.v[0]))
            began = perf_counter()
            for u in log.u:
                twin.advance(u, schedule.substeps)
            plant = perf_counter() - began
            began = perf_counter()
            for q, v in zip(log.q, log.v, strict=True):
                model.state(q, v)
            state = perf_counter() - began
        step = float(np.nansum(log.step_us)) / 1e6
        runs.append((wall, setup, state, step - state, plant, log.steps))
    wall, setup, state, law_s, plant, steps = min(runs)
    parts = {"setup": setup, "state": state, "controller": law_s, "mujoco": plant}
    return {
        "robot": model.bundled or model.name,
        "controller": controller,
        "simulated_s": steps * schedule.period,
        "wall_s": wall,
        "loops_per_s": 1 / wall,
        "times_real_time": steps * schedule.period / wall,
        "control_steps": steps,
        "plant_steps": steps * schedule.substeps,
        **{f"{name}_s": seconds for name, seconds in parts.items()},
        "bookkeeping_s": wall - sum(parts.values()),
    }
