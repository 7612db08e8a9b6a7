"""A table of an arm with a rig, as a base of the fuzzer, and its second reading."""

from __future__ import annotations

from pathlib import Path

from softdyn import design
from softdyn.description.stated_task import StatedTask
from softdyn.description.urdf import parse_text
from softdyn.files import read_toml

ARM = """name = "arm"
[material]
youngs_modulus_MPa = 0.25
density_kg_m3 = 1070
[[section]]
length_mm = 200
radius_mm = [15, 10]
segments = 3
discs = 2
[[cable]]
name = "cable"
count = 3
offset_mm = [12, 8]
routing = "channel"
max_tension_N = 5
friction = 0.1
[[cable]]
name = "spare"
offset_mm = 8
routing = "discs"
max_tension_N = 5
stiffness_N_m = 100
slack = true
[[motor]]
cables = ["cable"]
command = "length"
stiffness_N_m = 900
length_lower_mm = -40
lag_ms = 20
rate_mm_s = 80
[[motor]]
cables = ["spare"]
delay_ms = 5
[[sensor]]
type = "length"
cables = ["cable_2"]
noise_mm = 0.1
rate_Hz = 200
[[sensor]]
name = "imu"
type = "gyro"
s_mm = [60, 180]
offset_mm = [0, 5, 0]
noise_deg_s = [1, 2, 3]
[[sensor]]
name = "camera"
type = "pose"
disc = 2
bias_mm = [1, 0, 0]
latency_ms = 40
[[sensor]]
type = "joint"
joint = "bend_y_2"
resolution_deg = 0.5
[[task]]
weight = 2
[[task]]
name = "way"
kind = "axis"
direction = [1, 0, 0]
level = 1
[[task]]
name = "turn"
kind = "pose"
axes = ["x", "y", "rz"]
Kp = 50
"""


def read_arm(data: bytes, path: Path) -> str:
    """Read an arm; its robot must have every name, cable, motor, sensor and task of the table."""
    path.write_bytes(data)
    table = read_toml(path)
    robot = parse_text(design.read(table, str(path)).text, path=path)
    cables, motors, sensors = (table.get(name, []) for name in ("cable", "motor", "sensor"))
    lags = {0.0} | {motor.get("lag_ms", 0.0) / 1e3 for motor in motors}
    checks = {
        "name": robot.name == table.get("name", "arm"),
        "cables": len(robot.actuators) == sum(cable.get("count", 1) for cable in cables),
        "lags": {round(actuator.lag, 12) for actuator in robot.actuators}
        <= {round(lag, 12) for lag in lags | {m["lag_s"] for m in motors if "lag_s" in m}},
        "sensors": len(robot.sensors) >= len(sensors),
        "tasks": [task.weight for task in robot.tasks or (StatedTask("tip", "tip"),)]
        == [task.get("weight", 1.0) for task in table.get("task", [{}])],
        "friction": {t.friction for t in robot.tendons} == {c.get("friction", 0.0) for c in cables},
        "slack": any(t.slack for t in robot.tendons) is any(c.get("slack") for c in cables),
    }
    return ", ".join(name for name, right in checks.items() if not right)
