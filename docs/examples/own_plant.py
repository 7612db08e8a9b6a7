"""A plant of your own: the finger on a base that shakes.

It prints the tip's error (cm) on a base at rest and on the shaken one, and writes own_plant.png.
"""

import math

import softdyn
from softdyn.controllers import SoftIdClfQp
from softdyn.validation import Twin, paper, simulate


class Shaken(Twin):
    """The base moves along x by 2 cm, once a second. Seen from it, gravity gets a part along x."""

    def advance(self, u, steps=1):
        rate = 2 * math.pi
        for _ in range(steps):
            self.model.opt.gravity[0] = 0.02 * rate**2 * math.sin(rate * self.time)
            super().advance(u, 1)


model = softdyn.load("finger")
target = paper.set_point("finger", theta=0.5)
for name, plant in (("at rest", Twin), ("shaken", Shaken)):
    log = simulate(model, SoftIdClfQp(model), target, plant=plant, duration=3.0)
    late = log.error[log.t >= 2.0]
    print(f"base {name}: largest error from 2 s on {100 * late.max():.3f} cm")
log.plot("own_plant.png")
