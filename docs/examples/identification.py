"""Find a stiffness and a damping from a measured motion.

The data are a simulation of a finger whose springs are 1.2 times and dampers 0.8 times the file's,
with noise. It prints the two factors with their 95 % intervals.
"""

import numpy as np

import softdyn
from softdyn.identification import Measurements, choose_unknowns, identify
from softdyn.validation import PlantErrors, rollout

model = softdyn.load("finger")
other = PlantErrors(stiffness=1.2, damping=0.8)


def inputs(t):
    """Two slow waves (N m)."""
    return [0.05 * np.sin(3.0 * t), 0.05 * np.sin(2.0 * t)]


log = rollout(model, inputs, duration=1.5, plant=other, period=0.02)
angles = log.q + np.random.default_rng(0).normal(scale=1e-3, size=log.q.shape)  # rad
u = np.vstack((log.u, log.u[-1:]))
data = Measurements(log.t, u, tuple(f"q.{name}" for name in model.joint_names), angles)
found = identify(model, data, choose_unknowns(model, shared=("stiffness", "damping")), hold_out=0.0)
for one in found.estimates:
    print(f"{one.parameter.label}: {one.value:.4f} ± {one.half:.4f} of the file's")
