"""Disturbances of a robot whose cables rub: a stuck cable must not be taken for a force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn.actuation import Capstan
from softdyn.description.rig import Sensor
from softdyn.description.rig import SensorKind as KIND
from softdyn.description.robot import JointTerm, Tendon
from softdyn.estimation import Ekf, EkfParameters
from softdyn.sensing import Sensors
from softdyn.statics import rest_after, settle
from tests.support.cable_chains import chain, pulled

PERIOD = 0.01
U = np.array([-2.0, -0.3])
NOISE = (2e-4, 2e-4, 5e-4)


def arm(friction):
    """Four springs in a plane, a cable that rubs and one that does not; lengths, a camera."""
    robot = chain(np.tile([0.0, 1.0, 0.0], (4, 1)), 0.05, stiffness=0.05, lag=0.1)
    arms = (("front", 0.01, 4), ("back", -0.01, 2))
    cables = (
        Tendon(
            name, tuple(JointTerm(f"j{k}", arm) for k in range(1, last + 1)),
            friction=friction if name == "front" else 0.0,
        )
        for name, arm, last in arms
    )  # fmt: skip
    sensors = (
        *(Sensor(name, KIND.LENGTH, tendon=name, noise=(NOISE[0],)) for name, _, _ in arms),
        Sensor("camera", KIND.POSITION, link="tip", noise=(NOISE[2],)),
    )
    return softdyn.build(replace(pulled(robot, *cables), sensors=sensors))


def estimated(model, q, seed, seconds=2.0):
    """The filter after two seconds of noisy readings of an arm that rests at q."""
    ekf = Ekf(model, disturbances=("tip_force",), parameters=EkfParameters(tip_force=0.3))
    ideal = Sensors(model, model.robot.sensors).measure(model.state(q, np.zeros(4)), U).values
    noise, rng = np.repeat(NOISE, [1, 1, 3]), np.random.default_rng(seed)
    for k in range(round(seconds / PERIOD)):
        found = ekf.step(k * PERIOD, ideal + noise * rng.normal(size=5), U)
    return ekf, found


def contains(found):
    """Whether no force at the tip is possible by the stated intervals."""
    low, high = found.interval("tip_force")
    return bool(((low <= 0.0) & (high >= 0.0)).all())


@pytest.mark.parametrize("direction", [1.0, -1.0], ids=["pulled in", "paid out"])
def test_a_stuck_cable_is_no_force_at_the_tip(direction):
    """The rests are those of statics. Without the error by friction no interval contains 0."""
    model = arm(0.3)
    q = rest_after(Capstan(model), U, direction).state.q
    runs = [estimated(model, q, seed) for seed in range(3)]
    assert all(contains(found) for _, found in runs)
    for ekf, found in runs:
        known = np.sqrt(np.diag(ekf._filter.P)[8:11])
        assert (np.abs(found.disturbances["tip_force"]) > 1.96 * known).any()
        assert np.diag(ekf.covariance_of("tip_force")) == pytest.approx(
            found.deviations["tip_force"] ** 2
        )


def test_the_stated_error_is_that_which_the_filter_makes():
    """Half the difference of the estimates at both rests of the cable that rubs, to a third."""
    model = arm(0.3)
    capstan = Capstan(model)
    ends = [rest_after(capstan, U, d).state.q for d in (1.0, -1.0)]
    (ekf, one), (_, other) = (estimated(model, q, 0) for q in ends)
    made = 0.5 * (one.disturbances["tip_force"] - other.disturbances["tip_force"])
    stated = np.sqrt(np.diag(ekf._rubbed))
    assert np.abs(made[[0, 2]]) == pytest.approx(stated[[0, 2]], rel=0.33)
    assert [made[1], stated[1]] == pytest.approx([0, 0], abs=1e-9)  # the arm is planar


def test_nothing_is_added_where_no_cable_rubs():
    model = arm(0.0)
    ekf, found = estimated(model, settle(model, U).q, 0)
    assert found.deviations["tip_force"] == pytest.approx(np.sqrt(np.diag(ekf._filter.P)[8:11]))
    assert contains(found)
