"""A process of `comparison`: the step times of one checkout of softdyn, of any layout.

Run it as a program, ``python -P checkout.py ROUNDS LAW,LAW,… ROBOT=STATES …``, with the checkout on
PYTHONPATH. It prints {robot: {law: median (µs)}}. It must work with older checkouts, so it imports
nothing else from this folder.
"""

from __future__ import annotations

import gc
import json
import random
import sys
from importlib import import_module
from pathlib import Path
from time import perf_counter_ns

import numpy as np

import softdyn


def medians(robot: str, states: str, laws: list[str], rounds: int) -> dict[str, float]:
    """Median (µs) of each controller's step (q, v) → u over recorded states, taking turns."""
    # older checkouts have packages beside softdyn
    nested = (Path(softdyn.__file__).parent / "controllers").exists()
    find = import_module("softdyn.controllers" if nested else "controllers").find_controller
    model, now, shuffle = softdyn.load(robot), perf_counter_ns, random.Random(0).shuffle
    with np.load(states) as file:
        columns = [file[name] for name in ("q", "v", "y", "ydot", "yddot")]
    steps = [(q, v, softdyn.Reference(*target)) for q, v, *target in zip(*columns, strict=True)]
    made = [(law, find(law)(model)) for law in laws]
    times: dict[str, list[int]] = {law: [] for law in laws}
    for k in range(rounds + 1):
        shuffle(made)
        for name, law in made:
            for q, v, reference in steps:
                began = now()
                law(model.state(q, v), reference)
                times[name].append(now() - began)
        if k == 0:  # warm
            gc.collect()
            gc.disable()
            times = {law: [] for law in laws}
    return {law: float(np.median(found)) / 1e3 for law, found in times.items()}


if __name__ == "__main__":
    rounds, laws, *robots = sys.argv[1:]
    pairs = (robot.split("=", 1) for robot in robots)
    print(json.dumps({r: medians(r, file, laws.split(","), int(rounds)) for r, file in pairs}))
