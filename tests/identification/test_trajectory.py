"""The model's motion: its derivatives, joints whose motion is known, and dry friction."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

import softdyn
from softdyn import identification
from softdyn.dynamics.mimic import build
from softdyn.identification import trajectory
from softdyn.identification.parameters import apply_values
from softdyn.identification.trajectory import Driven, Start, follow
from softdyn.identification.unknowns.friction import friction_of
from softdyn.identification.unknowns.kinds import Around
from softdyn.validation.identification.trials import Excitation, trial
from tests.support import cart
from tests.support.control_cases import robot


@pytest.fixture(scope="module")
def finger() -> softdyn.SoftModel:
    return softdyn.load("finger")


def rubbing(model, friction):
    """The robot with dry friction (N m, N) in every joint."""
    robot = identification.KINDS["friction"].amended(
        model.robot, dict.fromkeys(model.joint_names, friction)
    )
    return build(robot)


@pytest.mark.parametrize(("stopped", "rubs"), [(False, False), (True, False), (False, True)])
def test_the_trajectory_s_derivatives(finger, stopped, rubs, monkeypatch):
    """Derivatives by all parameters and the first state against central differences.

    Joints with given motion depend on none of these.
    """
    rng = np.random.default_rng(6)
    monkeypatch.setattr(trajectory, "TOLERANCE", 1e-12)  # limit of the differences' accuracy
    finger = rubbing(finger, 1e-3 if rubs else 0.0)
    kinds = ("friction",) if rubs else ("stiffness", "damping", "mass", "gear")
    several = [one for kind in kinds for one in identification.parameters(finger, kind)]
    samples = 12 if stopped else 20
    t = np.cumsum(rng.uniform(0.003, 0.008, samples))
    u = rng.uniform(finger.u_min, finger.u_max, (samples, finger.nu))
    theta = np.array([one.nominal for one in several])
    theta = theta * rng.uniform(0.8, 1.2, len(theta))
    z = np.concatenate((theta, rng.uniform(-0.2, 0.2, 2 * finger.nv)))
    n, count = finger.nv, len(several)
    eyes = np.zeros((2, n, len(z)))
    eyes[0, :, count : count + n] = eyes[1, :, count + n :] = np.eye(n)
    driven = None
    if stopped:
        given = np.sin(np.stack((9 * t, 5 * t), 1))
        driven = Driven(np.array([1, 3]), make_interp_spline(t, given))
        eyes[:, driven.joints] = 0

    def path(at):
        start = Start(at[count : count + n], at[count + n :], *eyes)
        changed = apply_values(finger, several, at[:count])
        return follow(changed, several, t, u, start, driven, around=Around(finger))

    _, slope = path(z)
    for k in rng.choice(len(z), 8, replace=False):
        step = np.zeros(len(z))
        step[k] = 1e-5 * max(abs(z[k]), 0.1)
        difference = (path(z + step)[0] - path(z - step)[0]) / (2 * step[k])
        assert np.allclose(slope[:, :, k], difference, atol=1e-6 * np.abs(difference).max() + 1e-9)


def test_joints_that_are_driven_along_the_motion_change_nothing(finger):
    t = np.arange(0, 0.4, 0.002)
    u = np.tile(finger.u_max, (len(t), 1))
    path, _ = follow(finger, (), t, u, Start(np.zeros(4), np.zeros(4), *np.zeros((2, 4, 0))))
    # a spline cannot follow the initial jerk
    motion, late = make_interp_spline(t, path), slice(100, None)
    start = Start(path[100], motion(t[100], 1), *np.zeros((2, 4, 0)))
    joints, rest = np.array([0, 2]), path[late]
    for values, least, most in ((rest, 0.0, 1e-5), (0 * rest, 0.1, np.inf)):
        driven = Driven(joints, make_interp_spline(t[late], values[:, joints], k=5))
        found, _ = follow(finger, (), t[late], u[late], start, driven)
        assert least <= np.abs(found - rest)[:, [1, 3]].max() / np.ptp(rest) <= most


def test_dry_friction_is_tanh_1_of_its_size_at_a_hundredth_of_the_range_a_second(finger):
    rub = friction_of(finger)
    rates = 0.01 * (finger.upper - finger.lower)
    assert rub.signs(rates) == pytest.approx(np.tanh(np.ones(4)))
    assert rub.signs(-100 * rates) == pytest.approx(-np.ones(4))
    other = robot("sliding and turning")  # a slide, a joint without limits, two that turn
    range_ = other.upper - other.lower
    assert np.isfinite(range_).tolist() == [True, False, True, True]
    range_[1] = 2 * np.pi
    assert friction_of(other).slow == pytest.approx(0.01 * range_)


def test_dry_friction_takes_the_same_off_each_swing():
    """Coulomb friction takes 2 F / k off the amplitude in each half swing, at any amplitude."""
    k, friction = 8.0, 0.08
    model = rubbing(cart.cart(stiffness=k, damping=0, limit=(-1, 1)), friction)
    t = np.linspace(0, 4 * np.pi * np.sqrt(cart.MASS / k), 401)  # two swings
    start = Start(np.array([0.5]), np.zeros(1), *np.zeros((2, 1, 0)))
    path, _ = follow(model, (), t, np.zeros((401, 1)), start)
    swings = np.abs(path[::100, 0])
    assert -np.diff(swings) == pytest.approx(2 * friction / k, rel=0.03)


def test_dry_friction_of_a_twin_is_found_and_written(finger, tmp_path):
    rubs = rubbing(finger, 0.001)
    several = [one for kind in ("stiffness", "damping", "friction")
               for one in identification.parameters(rubs, kind, shared=True)]  # fmt: skip
    joints = [f"q.{n}" for n in finger.joint_names]
    one = trial(
        rubs, several, joints, Excitation(1.0, rate=100.0, amplitude=1.0, timestep=5e-4), 1.0, 0
    )
    assert np.abs(one.scores).max() < 4
    assert np.abs(one.relative).max() < 0.1
    path = tmp_path / "robot.urdf"
    text = finger.robot.path.read_text()
    path.write_text(re.sub(r"(<dynamics damping=[^/]*)/>", r'\1 friction="0.001"/>', text))
    found = one.found.values()
    path.write_text(identification.rewrite_urdf(softdyn.load(path).robot, found))
    written = {joint.name: joint.friction for joint in softdyn.load(path).robot.moving_joints}
    assert written == pytest.approx(found["friction"])
