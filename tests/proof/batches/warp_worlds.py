"""Copies of an MJCF in MuJoCo Warp, beside MuJoCo; runs in an environment with mujoco-warp.

    python warp_worlds.py FILE.xml WORLDS STEPS OUT.json

Each world starts at rest and holds random inputs of its own for a tenth of a second at a time.
"""

from __future__ import annotations

import json
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

HOLD = 0.1  # s
SHARE = 0.3  # of the inputs' bounds
AFTER = (20, 200, 400)  # steps


def refused(model: mujoco.MjModel) -> str:
    """MuJoCo Warp's reason to refuse a model; empty if it takes the model."""
    try:
        mjw.put_model(model)
    except (NotImplementedError, ValueError) as error:
        return str(error)
    return ""


def main() -> None:
    """Step both, compare, write the figures."""
    wp.config.quiet = True
    file, worlds, steps, out = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
    model = mujoco.MjModel.from_xml_path(file)
    found: dict[str, Any] = {
        "mujoco": mujoco.__version__, "mujoco_warp": version("mujoco-warp"),
        "device": str(wp.get_device()), "refused": refused(model),
    }  # fmt: skip
    if found["refused"]:
        Path(out).write_text(json.dumps(found))
        return
    random, hold = np.random.default_rng(0), round(HOLD / model.opt.timestep)
    low, high = model.actuator_ctrlrange.T
    held = random.uniform(SHARE * low, SHARE * high, (-(-steps // hold), worlds, model.nu))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    there = mjw.put_model(model)
    batch = mjw.put_data(model, data, nworld=worlds)
    qpos = np.empty((worlds, steps, model.nq))
    singles = [mujoco.MjData(model) for _ in range(worlds)]
    largest = np.zeros(steps)
    for k in range(steps):
        u = held[k // hold]
        for world, single in enumerate(singles):
            single.ctrl[:] = u[world]
            mujoco.mj_step(model, single)
            qpos[world, k] = single.qpos
        batch.ctrl.assign(u.astype(np.float32))
        mjw.step(there, batch)
        largest[k] = np.abs(batch.qpos.numpy() - qpos[:, k]).max()
    found |= {
        "nv": model.nv, "timestep": model.opt.timestep, "moved": float(np.abs(qpos).max()),
        "after": {n: float(largest[n - 1]) for n in AFTER if n <= steps},
    }  # fmt: skip
    Path(out).write_text(json.dumps(found))


if __name__ == "__main__":
    main()
