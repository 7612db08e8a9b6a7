"""An observer in a loop of your own: noisy readings in, an estimate of q and its rate out.

It prints the error of the tip (mm) from the readings alone and from the estimate.
"""

import numpy as np

import softdyn
from softdyn.controllers import SoftIdClfQp
from softdyn.estimation import Ekf
from softdyn.sensing import Sensor, SensorKind
from softdyn.validation import Twin, paper

PERIOD, NOISE = 0.005, 0.002  # s, m
model = softdyn.load("finger")
encoders = [
    Sensor(tendon.name, SensorKind.LENGTH, tendon=tendon.name, noise=(1e-4,))
    for tendon in model.robot.tendons
]
camera = Sensor("camera", SensorKind.POSITION, link="tip", noise=(NOISE,))
observer = Ekf(model, [*encoders, camera])
controller, target = SoftIdClfQp(model), paper.set_point("finger", theta=0.5).reference(0.0)
twin, rng, u = Twin(model, timestep=5e-4), np.random.default_rng(0), np.zeros(model.nu)
raw, estimated = [], []
for k in range(400):
    true = model.state(twin.qpos, twin.qvel)
    lengths = model.tendon_lengths(true.q) + rng.normal(scale=1e-4, size=len(encoders))
    seen = true.y + rng.normal(scale=NOISE, size=3)
    estimate = observer.step(k * PERIOD, np.concatenate((lengths, seen)), u)
    state = model.state(estimate.q, estimate.v)
    raw.append(seen - true.y)
    estimated.append(state.y - true.y)
    u = controller(state, target).u
    twin.advance(u, 10)
for name, errors in (("camera", raw), ("estimate", estimated)):
    print(f"{name}: {1000 * np.sqrt(np.mean(np.square(errors[100:]))):.3f} mm rms")
