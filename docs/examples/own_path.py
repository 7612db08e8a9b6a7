"""Track a path of your own: any function of time that returns a softdyn.Reference.

It prints the largest error of the second half of the run (cm) and writes own_path.png.
"""

import math

import numpy as np

import softdyn
from softdyn.controllers import SoftIdClfQp
from softdyn.validation import simulate

CENTRE, SIZE, RATE = np.array([0.14, 0.0, -0.14]), 0.02, math.pi  # m, m, rad/s


def figure_eight(t):
    """A lying eight in the finger's plane, with its velocity and acceleration."""
    a, b = RATE * t, 2 * RATE * t
    along, up = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.5])
    y = CENTRE + SIZE * (math.sin(a) * along + math.sin(b) * up)
    ydot = SIZE * RATE * (math.cos(a) * along + 2 * math.cos(b) * up)
    yddot = -SIZE * RATE**2 * (math.sin(a) * along + 4 * math.sin(b) * up)
    return softdyn.Reference(y, ydot, yddot)


model = softdyn.load("finger")
log = simulate(model, SoftIdClfQp(model), figure_eight, duration=4.0, period=0.005)
print(f"largest error from 2 s on: {100 * log.error[log.t >= 2.0].max():.3f} cm")
log.plot("own_path.png")
