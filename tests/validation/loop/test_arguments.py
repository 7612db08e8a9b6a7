"""Arguments of a loop: users' mistakes and their messages."""

import re
import warnings

import numpy as np
import pytest

import softdyn
from softdyn.controllers import Impedance
from softdyn.validation import Log, paper, rollout, simulate
from tests.support import ROOT, robots
from tests.support.cart import TARGET, steer
from tests.support.refused import refused
from tests.support.robots import load, slide, spring

FINGER = (ROOT / "urdf" / "finger.urdf").read_text()


def test_a_class_is_no_controller(cart):
    with refused("controller", "the class Impedance itself"):
        simulate(cart, Impedance, TARGET)


def test_a_period_is_no_longer_than_the_run(cart):
    with refused("period", "0.02 s"):
        simulate(cart, steer, TARGET, duration=0.01, period=0.02)


def test_degrees_are_told_from_radians():
    model = softdyn.load("finger")
    goal, law = paper.set_point("finger", 0.5), Impedance(model)
    with refused("q0", "45: degrees?"):
        simulate(model, law, goal, q0=np.array([45.0, 0, 0, 0]), duration=0.01)
    with refused("q0", 1.7):
        simulate(model, law, goal, q0=np.array([1.7, 0, 0, 0]), duration=0.01)
    pressed = model.upper[0] + 2e-5  # where another run pressed it on its stop
    assert simulate(model, law, goal, q0=np.array([pressed, 0, 0, 0]), duration=0.01).steps == 2


# 0 lies 20 mm below the joint's range
SLIDE = slide(
    0.03,
    1e-4,
    name="reach",
    axis="0 0 -1",
    limit=(0.02, 0.08),
    damping=0.5,
    stiffness=60,
    pull=(-1, 1),
).replace("</robot>", spring("reach", 60, 0.05) + "</robot>")


def test_the_default_start_is_within_the_limits(tmp_path):
    model = load(tmp_path, SLIDE)
    log = rollout(model, np.zeros(1), 0.1)
    assert log.q[0] == pytest.approx(0.02)
    assert np.abs(log.v[: int(0.002 / log.period) + 1]).max() < 0.14  # not thrown by the stop
    assert "reach at 0.02" in log.start
    assert "start: at the limits nearest to 0" in str(log)
    log.save(tmp_path / "run.npz")
    assert Log.load(tmp_path / "run.npz").start == log.start
    push = lambda state, reference: np.zeros(1)  # noqa: E731
    with refused("q0", 0):
        simulate(model, push, TARGET, q0=[0.0], duration=0.01)
    again = simulate(model, push, TARGET, q0=[0.05], duration=0.01)
    assert (again.q[0], again.start) == (0.05, "")


def test_a_stiffness_in_other_units_is_doubted(tmp_path):
    text, count = re.subn(r"<springStiffness>[^<]+", "<springStiffness>5e4", FINGER, count=1)
    assert count == 1
    model = robots.load(tmp_path, text)
    push = lambda state, reference: np.zeros(2)  # noqa: E731
    with pytest.warns(UserWarning, match=r"'joint1': a stiffness of 50000 swings at .* units"):
        simulate(model, push, TARGET, duration=0.002)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulate(softdyn.load("finger"), push, TARGET, duration=0.002)
