"""A MuJoCo file of your own as the plant: the finger with a post in its way.

It prints how the two files differ and whether the tip arrives, and writes mjcf_plant.png.
"""

from pathlib import Path

import softdyn
from softdyn.controllers import SoftIdClfQp
from softdyn.validation import Scene, paper, simulate

model = softdyn.load("finger")
scene = Scene(model, Path(__file__).with_name("finger_scene.xml"))
print(scene)
log = simulate(
    model, SoftIdClfQp(model), paper.set_point("finger", theta=0.5), plant=scene, duration=1.0
)
print(f"reached: {log.verdict().reached}, final error {log.final_error_cm:.3f} cm")
log.plot("mjcf_plant.png")
