"""The recorder of the reference implementation, on a made checkout of three steps."""

import json
import subprocess
import sys

import numpy as np

from tests.proof.laws import record_reference

UTILS = """
import types
import numpy as np
class Robot:
    def __init__(self):
        self.data = types.SimpleNamespace(
            qpos=np.zeros(2), qvel=np.ones(2), ctrl=np.zeros(3), mocap_pos=np.ones((1, 3)))
    def initialize_simulation_state(self):
        pass
    def step_simulation(self):
        self.data.qpos += 1
def simulate_model(headless, control_scheme, model_name, experiment, omega):
    print("chatter")
    robot = Robot()
    robot.initialize_simulation_state()
    for _ in range(3):
        robot.step_simulation()
    return {"task_error": np.array([0.1, 0.2]), "u": np.array([[0.0], [3.0]])}
"""
CELL = "finger_uic_omega0.5"
LOG = "# a comment\ntime,task_error,u0\n0,0.1,0.5\n1,0.3,3\n"


def test_a_cell_is_recorded_step_by_step_and_held_against_its_log(tmp_path):
    checkout, folder = tmp_path / "checkout", tmp_path / "out"
    logs = checkout / "results/tendon/uosc"
    logs.mkdir(parents=True)
    (checkout / "utils.py").write_text(UTILS)
    (logs / "tracking_uosc_omg5.csv").write_text(LOG)
    subprocess.run(
        [sys.executable, record_reference.__file__, checkout, folder, CELL, f"{CELL}_nudge3"],
        check=True,
    )
    with np.load(folder / f"{CELL}_nudge3.npz") as kept:
        assert 0 < np.abs(kept["v"] - 1).max() < 1e-8
    with np.load(folder / f"{CELL}.npz") as kept:
        np.testing.assert_array_equal(kept["q"][:, 0], [0, 1, 2])  # before each step
        assert {name: kept[name].shape for name in kept} == {
            "q": (3, 2), "v": (3, 2), "ctrl": (3, 3), "target": (3, 3),
        }  # fmt: skip
    said = json.loads((folder / f"{CELL}.json").read_text())
    assert said["apart"] == 0.5
    np.testing.assert_allclose([said["figure"], said["log"]], [250, 500])  # cm², means of squares


def test_without_a_log_there_is_nothing_to_hold_a_run_against(tmp_path):
    errors, inputs = record_reference.read_log(tmp_path / "none.csv")
    assert not len(errors)
    assert not len(inputs)
    assert record_reference.figure(np.array([0.3, 0.02]), "pos1") == 2.0
