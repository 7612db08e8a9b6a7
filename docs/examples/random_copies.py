"""Copies of a robot with random springs, dampers and masses, in one batch of MuJoCo Warp.

It prints how far each copy is from MuJoCo's own run of its numbers. It needs mujoco_warp.
"""

import subprocess
import sys

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

COPIES, STEPS, FILE = 4, 400, "finger.xml"
SPRINGS = "jnt_stiffness", "dof_damping"
MASSES = "body_mass", "body_inertia", "body_subtreemass", "body_invweight0", "dof_invweight0"
command = sys.executable, "-m", "softdyn.commands", "export", "finger", "--mjcf", FILE
subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
random = np.random.default_rng(0)


def changed():
    """A model whose springs, dampers and bodies are within 20 % of the file's."""
    model = mujoco.MjModel.from_xml_path(FILE)
    for name in SPRINGS:
        getattr(model, name)[:] *= random.uniform(0.8, 1.2, len(getattr(model, name)))
    factors = random.uniform(0.8, 1.2, model.nbody)
    model.body_mass[:] *= factors
    model.body_inertia[:] *= factors[:, None]
    mujoco.mj_setConst(model, mujoco.MjData(model))  # the other masses follow
    return model


models = [changed() for _ in range(COPIES)]
there = mjw.put_model(models[0])
for name in (*SPRINGS, *MASSES):  # a row for each copy
    rows = np.array([getattr(model, name) for model in models])
    setattr(there, name, wp.array(rows, dtype=getattr(there, name).dtype))
batch = mjw.put_data(models[0], mujoco.MjData(models[0]), nworld=COPIES)
u = 0.3 * random.uniform(*models[0].actuator_ctrlrange.T)
batch.ctrl.assign(np.tile(u, (COPIES, 1)).astype(np.float32))
for _ in range(STEPS):
    mjw.step(there, batch)
for model, found in zip(models, batch.qpos.numpy(), strict=True):
    data = mujoco.MjData(model)
    data.ctrl[:] = u
    mujoco.mj_step(model, data, STEPS)
    print(f"q {data.qpos.round(4)} differs by {np.abs(found - data.qpos).max():.1e}")
