"""Two tasks in strict order: the tip's place first, then the direction of its axis.

It prints the first and the last error of each task and writes two_tasks.png.
"""

import numpy as np

import softdyn
from softdyn import SetPoint, statics
from softdyn.controllers import Gains, SoftIdClfQp
from softdyn.tasks import AxisTask, PointTask, References, Target, compute_errors
from softdyn.validation import simulate

model = softdyn.load("helix")
goal = statics.settle(model, 0.1 * np.arange(model.nu) / model.nu * model.u_max)  # it can hold it
axis = model.link_poses(goal.q)["tip"][:3, 2]
tasks = [PointTask("tip"), AxisTask("tip", [0.0, 0.0, 1.0], level=1)]
targets = References({"tip": SetPoint(goal.y), "tip.axis": Target(axis)})

law = SoftIdClfQp(model, Gains(Kp=500.0, w2=0.001, w3=0.001), tasks=tasks)
log = simulate(model, law, targets, duration=2.0, period=0.0075)
for name, error in compute_errors(model, tasks, log, targets).items():
    first, last = np.linalg.norm(error[0]), np.linalg.norm(error[-1])
    print(f"{name}: {first:.4f} -> {last:.4f} {'rad' if 'axis' in name else 'm'}")
log.plot("two_tasks.png")
