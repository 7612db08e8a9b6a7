"""A robot of your own from a table of sizes and materials, and where it rests under a pull.

It prints the tip of the hanging arm and of the pulled arm, and writes own_robot.urdf and .html.
"""

import tomllib
from pathlib import Path

import numpy as np

import softdyn
from softdyn import design, statics

TABLE = """
name = "own_robot"
[material]
youngs_modulus_MPa = 0.4
density_kg_m3 = 1070
[[section]]
length_mm = 200
radius_mm = [16, 12]
segments = 5
[[cable]]
name = "pull"
count = 3
offset_mm = [12, 9]
routing = "channel"
max_tension_N = 30
"""

made = design.read(tomllib.loads(TABLE), "own_robot.toml")
Path("own_robot.urdf").write_text(made.text, encoding="utf-8")
model = softdyn.load("own_robot.urdf")
hanging, pulled = statics.rest(model), statics.settle(model, np.array([8.0, 0.0, 0.0]))  # N
print("hanging tip (m):", hanging.y.round(4))
print("pulled tip (m): ", pulled.y.round(4), "stable" if pulled.stable else "unstable")
softdyn.show(model, pulled.q, u=pulled.u).save("own_robot.html")
