"""The texts of a model and of a State are correct for any robot, and raise no error."""

from __future__ import annotations

import math
import re
import subprocess
import sys

import numpy as np
import pytest

import softdyn
from softdyn.dynamics.text import short
from tests.support import robots


def test_a_model_says_its_sizes_and_inputs():
    model = softdyn.load("finger")
    text = str(model)
    assert "4 degrees of freedom, 2 inputs" in text
    for name in (*model.joint_names, "u1", "u2", "tip", str(model.robot.path)):
        assert name in text
    assert "finger" in repr(model)
    assert "\n" not in repr(model)


def test_a_state_says_joints_tip_and_speed():
    model = softdyn.load("helix")
    q, v = np.zeros(36), np.zeros(36)
    q[5], v[7] = 0.25, -0.5
    state = model.state(q, v)
    text = str(state)
    speed = math.sqrt(sum(x * x for x in state.ydot))
    assert f"moving at {speed:.4g} m/s" in text
    assert re.search(rf"{model.joint_names[5]} +0\.25 m, 0 m/s", text)  # it slides
    assert f"{model.joint_names[7]}, -0.5 " in text
    assert "\n" not in repr(state)
    assert "at rest" in str(model.state(q, np.zeros(36)))
    degrees = str(softdyn.load("finger").state([0.5, 0, 0, 0], np.zeros(4)))
    assert "0.5 rad (28.65°)" in degrees


@pytest.mark.parametrize(("name", "options", "said"), [
    ("ur5", {}, "inputs: none"), ("talos_reduced", {"floating": True}, "a floating base"),
    ("panda", {}, "1 of them follow another"),
])  # fmt: skip
def test_robots_without_springs_can_be_printed(name, options, said):
    model = softdyn.load(name, **options)
    assert said in str(model)
    assert str(model.state(model.q0, np.zeros(model.nv)))


def test_the_rig_is_said(tmp_path):
    model = robots.load(tmp_path, robots.WINCHED)
    lines = [line.strip() for line in str(model).splitlines()]
    assert lines[-3:] == [
        "motors flexor: command a length, through a cable of 600 N/m, 4 N s/m, lag 0.02 s, "
        "delay 0.0041 s",
        "motors extensor: command a force, lag 0.01 s, delay 0.003 s",
        "sensors: 1 length, 2 tension, 1 pose, 1 position, 1 accelerometer, 1 gyro, 1 joint",
    ]
    checked = str(softdyn.diagnose(model)).splitlines()
    assert set(lines[-3:]) < set(checked)
    assert any(line.endswith("elastic 50 in tension only; extensor") for line in checked)


def test_a_text_solves_nothing():
    """A text must not compute equilibria, which is the task of `softdyn.statics`."""
    program = (
        "import sys, softdyn\nmodel = softdyn.load('finger')\n"
        "print(model, model.state(model.q0, [0] * 4))\n"
        "assert not [name for name in sys.modules if name.startswith('softdyn.statics')]\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, capture_output=True)


def test_of_many_names_the_first_and_the_last_are_shown():
    names = [f"n{k}" for k in range(13)]
    assert short(names) == "n0, n1, n2, …, n12"
    assert short(names[:12]) == ", ".join(names[:12])
