"""Speed of MuJoCo Warp on a GPU beside MuJoCo's rollout on all CPU threads.

    python warp_speed.py FILE.xml DEVICE OUT.json

It runs in an environment with mujoco-warp. A step is captured as a graph where the device has
graphs; 200 steps are timed after 20. The inputs are random, up to 30 % of their bounds.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from time import perf_counter
from typing import Any

import mujoco
import mujoco.rollout
import mujoco_warp as mjw
import numpy as np
import warp as wp

SHARE = 0.3  # of the inputs' bounds
WORLDS = (1, 256, 4096, 16384, 65536)
BEFORE, TIMED = 20, 200  # steps
ON_CPU = 16  # copies for each thread of the CPU


def main() -> None:
    """Time both, write the figures."""
    wp.config.quiet = True
    file, device, out = sys.argv[1:]
    model = mujoco.MjModel.from_xml_path(file)
    found: dict[str, Any] = {"nv": model.nv, "device": wp.get_device(device).name}
    low, high = model.actuator_ctrlrange.T
    random = np.random.default_rng(0)
    with wp.ScopedDevice(device):
        rows: list[dict[str, float]] = []
        for worlds in WORLDS:
            u = random.uniform(SHARE * low, SHARE * high, (worlds, model.nu))
            began = perf_counter()
            seconds = per_step(model, u)
            if not rows:
                found["first_step_s"] = perf_counter() - began
            rows.append({"worlds": worlds, "ms": 1e3 * seconds, "steps_per_s": worlds / seconds})
    found |= {"rows": rows, "threads": os.cpu_count(), "cpu_steps_per_s": on_cpu(model, random)}
    Path(out).write_text(json.dumps(found))


def per_step(model: mujoco.MjModel, u: np.ndarray) -> float:
    """Seconds of a step of all worlds, under inputs (worlds, nu)."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    there = mjw.put_model(model)
    batch = mjw.put_data(model, data, nworld=len(u))
    batch.ctrl.assign(u.astype(np.float32))
    mjw.step(there, batch)  # it compiles
    if wp.get_device().is_cuda:
        with wp.ScopedCapture() as capture:
            mjw.step(there, batch)
    for k in range(BEFORE + TIMED):
        if k == BEFORE:
            wp.synchronize()
            began = perf_counter()
        if wp.get_device().is_cuda:
            wp.capture_launch(capture.graph)
        else:
            mjw.step(there, batch)
    wp.synchronize()
    return (perf_counter() - began) / TIMED


def on_cpu(model: mujoco.MjModel, random: np.random.Generator) -> float:
    """Steps a second of MuJoCo's rollout on all threads."""
    threads = os.cpu_count() or 1
    copies = ON_CPU * threads
    low, high = model.actuator_ctrlrange.T
    u = random.uniform(SHARE * low, SHARE * high, (copies, 1, model.nu)).repeat(TIMED, axis=1)
    datas = [mujoco.MjData(model) for _ in range(threads)]
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.empty(mujoco.mj_stateSize(model, full))
    mujoco.mj_getState(model, datas[0], start, full)
    begin = np.tile(start, (copies, 1))
    mujoco.rollout.rollout(model, datas, begin, u[:, :BEFORE])
    began = perf_counter()
    mujoco.rollout.rollout(model, datas, begin, u)
    return copies * TIMED / (perf_counter() - began)


if __name__ == "__main__":
    main()
