"""Keep the tip out of a ball that stands in its way.

It prints the least distance from the ball without and with a barrier, and writes barrier.html.
"""

import numpy as np

import softdyn
from softdyn.controllers import SoftIdClfQp
from softdyn.safety import KeepOutSphere, Surroundings
from softdyn.validation import paper, show_runs, simulate

model = softdyn.load("finger")
target = paper.set_point("finger", theta=0.5)
free = simulate(model, SoftIdClfQp(model, horizon=0.03), target, duration=2.0)
half = free.y[(free.error < 0.5 * free.error[0]).argmax()]  # the tip is half-way there
ball = KeepOutSphere(half + np.array([0.012, 0.0, -0.012]), 0.02, name="ball", contact=False)  # m

logs = {}
for name, barriers in (("without", []), ("with", [ball])):
    law = SoftIdClfQp(model, horizon=0.03, barriers=barriers)
    around = Surroundings([ball])
    logs[name] = simulate(model, law, target, duration=2.0, surroundings=around)
    least, last = 1000 * logs[name]["reserve"].min(), logs[name].final_error_cm
    print(f"{name} a barrier: least distance {least:.1f} mm, final error {last:.3f} cm")
show_runs([*logs.values()], [model, model], labels=[*logs]).save("barrier.html")
