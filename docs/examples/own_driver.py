"""Drive a rig by a driver of your own; here the rig is a simulation that keeps pace with the clock.

It prints why the run ended (None: as planned) and its last error, and writes own_driver.png.
"""

import time
import tomllib
from pathlib import Path

import numpy as np

import softdyn
from softdyn import SetPoint, design, statics
from softdyn.controllers import Gains, SoftIdClfQp
from softdyn.validation import Twin, drive


class Bench:
    """start, read, send and stop: all that a driver needs."""

    def __init__(self, model):
        self.model, self.twin, self.u = model, Twin(model, timestep=1e-3), np.zeros(model.nu)

    def start(self):
        self.began = time.monotonic()

    def read(self):
        behind = int(1000 * (time.monotonic() - self.began - self.twin.time))
        self.twin.advance(self.u, min(max(behind, 0), 50))
        lengths = self.model.tendon_lengths(self.twin.qpos)
        return lengths, np.full(len(lengths), time.monotonic())  # values and their times

    def send(self, commands):
        self.u = np.array(commands)

    def stop(self):
        self.u = np.zeros(self.model.nu)


table = tomllib.loads(Path(__file__).with_name("dynamixel_finger.toml").read_text("utf-8"))
table["sensor"] = [{"name": "encoder", "type": "length", "noise_mm": 0.1}]
del table["motor"]  # the cables pull with the forces that they are told
Path("own_driver.urdf").write_text(design.read(table).text, encoding="utf-8")
model = softdyn.load("own_driver.urdf")
target = SetPoint(statics.settle(model, np.array([3.0, 0.5])).y)  # N
controller = SoftIdClfQp(model, Gains(Kp=400.0, eps=0.05, w2=0.01, w3=0.001))
log = drive(model, controller, target, Bench(model), period=0.02, duration=1.0, watchdog=False)
print(f"reason: {log.reason}, final error {log.final_error_cm:.3f} cm")
log.plot("own_driver.png")
