"""A sweep in Python: two controllers, each on plants of another stiffness and delay.

It prints a table of the final errors (cm). `softdyn sweep` does it from a file, on all cores.
"""

from itertools import product

import softdyn
from softdyn.controllers import ImpedanceQp, SoftIdClfQp
from softdyn.validation import PlantErrors, Rig, paper, simulate

model = softdyn.load("finger")
target = paper.set_point("finger", theta=0.5)
print("stiffness  delay  " + "  ".join(law.__name__ for law in (SoftIdClfQp, ImpedanceQp)))
for stiffness, delay in product((0.8, 1.0, 1.2), (0.0, 0.005)):
    rig = Rig(delay=delay, plant=PlantErrors(stiffness=stiffness))
    errors = [
        simulate(model, law(model), target, rig=rig, duration=1.0).final_error_cm
        for law in (SoftIdClfQp, ImpedanceQp)
    ]
    print(f"{stiffness:9.1f}  {1000 * delay:2.0f} ms  " + "  ".join(f"{e:11.3f}" for e in errors))
