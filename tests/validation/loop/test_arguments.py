"""Arguments of a loop: users' mistakes and their messages."""

import re
import warnings

import numpy as np
import pytest

import softdyn
from softdyn import InputError
from softdyn.controllers import Impedance
from softdyn.validation import paper, simulate
from tests.support import ROOT
from tests.support.cart import TARGET, steer

FINGER = (ROOT / "urdf" / "finger.urdf").read_text()


def test_a_class_is_no_controller(cart):
    message = r"as Impedance\(model\), got the class Impedance itself"
    with pytest.raises(InputError, match=message):
        simulate(cart, Impedance, TARGET)


def test_a_period_is_no_longer_than_the_run(cart):
    with pytest.raises(InputError, match=r"at most the run's 0\.01 s, got 0\.02 s"):
        simulate(cart, steer, TARGET, duration=0.01, period=0.02)


def test_degrees_are_told_from_radians():
    model = softdyn.load("finger")
    goal, law = paper.set_point("finger", 0.5), Impedance(model)
    with pytest.raises(InputError, match=r"'joint1' turns from -1\.57 to 1\.57, got 45: degrees\?"):
        simulate(model, law, goal, q0=np.array([45.0, 0, 0, 0]), duration=0.01)
    # beyond a stop, but an angle
    assert simulate(model, law, goal, q0=np.array([1.7, 0, 0, 0]), duration=0.01).steps == 2


def test_a_stiffness_in_other_units_is_doubted(tmp_path):
    text, count = re.subn(r"<springStiffness>[^<]+", "<springStiffness>5e4", FINGER, count=1)
    assert count == 1
    (tmp_path / "stiff.urdf").write_text(text)
    model = softdyn.load(tmp_path / "stiff.urdf")
    push = lambda state, reference: np.zeros(2)  # noqa: E731
    with pytest.warns(UserWarning, match=r"'joint1': a stiffness of 50000 swings at .* units"):
        simulate(model, push, TARGET, duration=0.002)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulate(softdyn.load("finger"), push, TARGET, duration=0.002)
