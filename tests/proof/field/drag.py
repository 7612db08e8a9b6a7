"""PyElastica's external damping on our rod.

Its `AnalyticalLinearDamper` with one constant ν (1/s) damps velocities with ν m and angular
velocities with ν m too, m the mass of an element; the unit of the second is wrong by m² (its issue
354), but those are the published rollouts.
"""

from __future__ import annotations

import mujoco
import numpy as np

from softdyn.validation.twin.twin import Twin
from tests.proof.field.cases import PERIOD, SECONDS, Case


def roll(case: Case, twin: Twin) -> np.ndarray:
    """Tips (samples, 3) of our rod without damping of its own, in the others' frame."""
    model, data, step = twin.model, twin.data, twin.model.opt.timestep
    mass, root = case.drag * model.body_mass[:, None], model.body_rootid
    data.ctrl[: twin.nu] = case.tensions
    tips, every = [twin.tip], round(PERIOD / step)
    for k in range(1, round(SECONDS / step) + 1):
        turn = data.cvel[:, :3]
        move = data.cvel[:, 3:] + np.cross(turn, data.xipos - data.subtree_com[root])
        data.xfrc_applied[:, :3], data.xfrc_applied[:, 3:] = -mass * move, -mass * turn
        mujoco.mj_step(model, data)
        if k % every == 0:
            tips.append(twin.tip)
    return case.in_their_frame(np.array(tips))
