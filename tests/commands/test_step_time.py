"""`softdyn step-time`: the figures of a robot and a controller, and refusals. No time is judged."""

from __future__ import annotations

import json

import pytest

from tests.support import robots
from tests.support.command import command

OWN = """
import numpy as np
class Slow:
    def __init__(self, model):
        self.calls, self.model = 0, model
    def __call__(self, state, reference):
        self.calls += 1
        return np.full(self.model.nu, np.nan if self.calls == LAST else 0.0)
"""


def test_the_figures_of_a_controller():
    words = ("step-time", "finger", "soft-id-clf-qp", "--seconds", 0.2)
    done = command(*words, "--json", "-")
    assert done.code == 0, done.err
    found = json.loads(done.out)
    assert (found["robot"], found["controller"]) == ("finger", "soft-id-clf-qp")
    assert (found["period_us"], found["steps"]) == (5000, 40)
    assert 0 < found["median_us"] <= found["p99_us"]
    assert "% of the control period of 5000 us (40 steps)" in command(*words).out


def test_an_own_robot_and_controller(tmp_path):
    (tmp_path / "own.py").write_text(OWN.replace("LAST", "-1"))
    robot = robots.write(tmp_path, robots.GRIPPER)
    own = f"{tmp_path}/own.py:Slow"
    done = command("step-time", robot, own, "--seconds", 0.1, "--period", 0.01, "--json", "-")
    assert done.code == 0, done.err
    assert json.loads(done.out)["steps"] == 10


def test_a_loop_that_fails_has_exit_code_1(tmp_path):
    (tmp_path / "own.py").write_text(OWN.replace("LAST", "5"))
    done = command("step-time", "finger", f"{tmp_path}/own.py:Slow", "--seconds", 0.1)
    assert done.code == 1
    assert "the controller failed at t = 0.02 s" in done.out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("nobody", "ic"), "nobody"),
        (("finger", "nobody"), "nobody"),
        (("finger", "ic", "--target", "20", "0", "0"), "within the robot's reach"),
        (("finger", "ic", "--seconds", "0"), "> 0"),
    ],
)
def test_refusals(words, said):
    done = command("step-time", *words)
    assert done.code == 2
    assert said in done.err
    assert done.err.count("\n") == 1
