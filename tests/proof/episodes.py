"""Steps of the environment beside those of a bare loop, and its memory: docs/environment.md."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from time import perf_counter, process_time
from typing import Any

from softdyn.commands import cli

EPILOG = """\
A bare loop is a `ControlLoop` of the same twin with a controller that returns given inputs. Both
times are of the processor, the least of some rounds. Steps a second are of the wall clock, with one
process and with two. The memory is the largest one of the process so far. The figures go to
tests/proof/documents/measured/episodes.json; then `python -m tests.proof tables` writes the table.

exit codes: 0 done; 2 bad input; 130 interrupted.
"""
ROBOTS, STEPS = ("finger", "helix", "spirob"), 200
SHARE = 0.1  # of the inputs' range, from the least input: no robot diverges
COLUMNS = (
    ("robot", "robot", ""), ("period (ms)", "period_ms", ".2g"), ("µs a step", "us", ".0f"),
    ("of the bare loop", "bare_us", ".0f"), ("more (%)", "more", ".0f"),
    ("steps a second", "steps_per_s", ".0f"), ("with two processes", "two_per_s", ".0f"),
    ("steps in a row", "steps", ""), ("MB after 1000 of them", "before_mb", ".1f"),
    ("MB at the end", "after_mb", ".1f"),
)  # fmt: skip

parser = cli.Parser(__doc__, EPILOG)
parser.option("--rounds", cli.count, "N", "of 200 steps", 20)
parser.option("--steps", cli.count, "N", "for the memory", 100_000)
parser.output("--out", "FILE", "where the figures go")


def command(arguments: cli.Arguments) -> int:
    """Measure, write."""
    from softdyn.validation.files import write_json
    from tests.proof.documents.settings import MEASURED
    from tests.proof.timing.step_report import machine
    from tests.proof.timing.step_time import MachineLoad

    load = MachineLoad()
    rows = [measure(robot, arguments.rounds, arguments.steps) for robot in ROBOTS]
    out = arguments.out or MEASURED / "episodes.json"
    write_json(out, {"rows": rows, "machine": machine() | load.report()})
    print(out)
    return cli.PASSED


def measure(robot: str, rounds: int, steps: int) -> dict[str, Any]:
    """A robot's row."""
    import gymnasium
    import numpy as np

    import softdyn
    from softdyn.controllers.policy import InputScale
    from softdyn.validation.environment import NAME, ReachEnv
    from softdyn.validation.loop.loop import ControlLoop
    from softdyn.validation.loop.plants import plant_of
    from softdyn.validation.loop.settings import RunOptions
    from softdyn.validation.loop.setups import setup_of

    horizon = STEPS * setup_of(softdyn.load(robot)).period
    given: dict[str, Any] = {"horizon": horizon, "targets": [[0.0, 0.0, -0.1]]}
    env = ReachEnv(robot, **given)
    model, grid, scale = env.model, env.grid, InputScale(env.model)
    low = scale.action(model.relaxed)
    drawn = np.random.default_rng(0).uniform(0.0, 2 * SHARE, (STEPS, model.nu))
    rows = np.clip(low + drawn, -1.0, 1.0).astype(np.float32)
    inputs: Iterator[Any] = iter(())
    bare = ControlLoop(model, plant_of(model, RunOptions(), grid.period, grid.timestep),
                       lambda state, target: next(inputs))  # fmt: skip
    times: dict[str, list[float]] = {"env": [], "bare": []}
    for _ in range(rounds):
        env.reset(seed=0)
        began = process_time()
        for row in rows:
            env.step(row)
        times["env"].append(process_time() - began)
        bare.plant.start(model.q0, np.zeros(model.nv))
        inputs = iter(scale.input(rows))
        began = process_time()
        for k in range(STEPS):
            bare.step(k * grid.period, None, grid.substeps)
        times["bare"].append(process_time() - began)
    us, bare_us = (1e6 * min(found) / STEPS for found in times.values())
    before = done = 0.0
    began = perf_counter()
    while done < steps:
        env.reset()
        for row in rows:
            env.step(row)
        done += STEPS
        before = before if done > 1000 else peak_memory()
    rate = done / (perf_counter() - began)
    words = f"softdyn.validation.environment:{NAME}"
    pair = gymnasium.make_vec(words, 2, vectorization_mode="async", robot=robot, **given)
    try:
        pair.reset(seed=0)
        began = perf_counter()
        for row in rows:
            pair.step(np.array([row, row]))
        both = 2 * STEPS / (perf_counter() - began)
    finally:
        pair.close()
    return {
        "robot": robot, "period_ms": 1e3 * grid.period, "us": us, "bare_us": bare_us,
        "more": 100 * (us / bare_us - 1), "steps_per_s": rate, "two_per_s": both,
        "before_mb": before / 1e6, "after_mb": peak_memory() / 1e6, "steps": int(done),
    }  # fmt: skip


def peak_memory() -> float:
    """Largest memory of the process so far (bytes on Linux)."""
    return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


main = cli.program(parser, command, __name__)
