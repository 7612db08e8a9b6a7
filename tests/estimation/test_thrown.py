"""An arm that its motors throw into its stops, which give way in MuJoCo and not in the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from softdyn import SetPoint
from softdyn.estimation import Ekf, EkfParameters, chi_squared_bounds
from softdyn.estimation.filter import Filter, FilteredModel
from softdyn.validation import simulate
from softdyn.validation.twin.plant_errors import PlantErrors
from softdyn.validation.twin.rig import rig_of
from tests.support.bench import bench_arm
from tests.support.robots import BENCH, build, changed

PERIOD, WINDOW = 0.005, 40  # s; steps, as the bench judges an estimate


def thrown(push: float, soft: bool = False):
    """The arm, and a run in which its motors push one way for 0.5 s, then the other way."""

    def law(state, reference):
        calls.append(1)
        return push * np.array([1.0, -1.0]) * (1 if len(calls) <= 100 else -1)

    model, calls = bench_arm(), []
    rig = replace(rig_of("file"), plant=PlantErrors(soft_stops=soft))
    return model, simulate(model, law, SetPoint(np.zeros(3)), duration=1.0, period=PERIOD, rig=rig)


def judged(model, log, **parameters) -> tuple[int, int]:
    """Windows whose innovations no consistent filter has, and readings that were doubted."""
    ekf, figures = Ekf(model, parameters=EkfParameters(**parameters)), []
    for k in range(len(log.command)):
        estimate = ekf.step(log.t[k], log.measured[k], log.command[max(k - 1, 0)])
        figures.append((estimate.nis, estimate.used))
    nis, used = (np.convolve(one, np.ones(WINDOW), "valid") for one in np.array(figures).T)
    bounds = {int(n): chi_squared_bounds(int(n), level=1 - 2e-6)[1] for n in set(used)}
    return sum(x > bounds[int(n)] for x, n in zip(nis, used, strict=True)), ekf.counts.doubted


@pytest.mark.parametrize("push", [45.0, 60.0])
def test_a_rig_that_is_thrown_into_its_stops_keeps_its_estimate(push):
    """At up to 11 rad/s it goes on by 7 mrad and bounces; a joint known exactly there is lost."""
    model, log = thrown(push)
    beyond = np.maximum(log.q - model.upper, model.lower - log.q).max()
    assert beyond > 1e-3
    assert judged(model, log) == (0, 0)
    assert judged(model, log, stops=1e-9)[0] > 20


def test_soft_stops_have_a_deviation_of_their_own():
    """MuJoCo's default stops give way by 27 mrad at 4 rad/s."""
    model, log = thrown(30.0, soft=True)
    assert np.maximum(log.q - model.upper, model.lower - log.q).max() > 0.02
    assert judged(model, log, stops=1e-9)[1] > 5
    assert judged(model, log, stops=5e-3)[1] == 0


def test_only_a_joint_that_meets_its_stop_makes_joints_at_stops_uncertain():
    """One that hits its stop shakes the other one off its own; at rest both are known exactly."""
    model, u = bench_arm(), np.array([60.0, -60.0])
    known = FilteredModel(model, (), EkfParameters(stops=1e-3))
    filtered = Filter(known, np.array([1.198, -1.2]), np.array([0.5, 0.0]), u)
    assert filtered.predict(u, PERIOD)
    assert filtered.held.tolist() == [1, -1]
    # a time of the step, all equally likely; the joint's range is over 1
    at_once = (0.5 * PERIOD) ** 2 / 12
    assert filtered.P.diagonal()[:2] == pytest.approx(at_once)
    for _ in range(40):
        assert filtered.predict(u, PERIOD)
    assert filtered.P.diagonal()[:2].max() < 1e-3 * at_once
    resting = Filter(known, np.array([1.2, -1.2]), np.zeros(2), u)
    assert resting.predict(u, PERIOD)
    assert resting.P.diagonal()[:2] == pytest.approx(0.0, abs=0.0)


def test_joints_of_short_ranges_are_less_uncertain():
    """A millimetre in a joint that slides by 20 mm is lost at once."""
    short = ('lower="-1.2" upper="1.2"', 'lower="-0.01" upper="0.01"')
    model = build(changed(BENCH, short))
    known = FilteredModel(model, (), EkfParameters(stops=1e-3))
    filtered = Filter(known, np.zeros(2), np.full(2, 5.0), np.zeros(2))
    assert filtered.predict(np.zeros(2), PERIOD)
    assert filtered.held.all()
    assert filtered.P.diagonal()[:2] == pytest.approx((1e-3 * 0.02) ** 2)


def test_tension_is_that_of_the_motor_now():
    """A motor with a lag is at the end of a step elsewhere than in its mean."""
    model, log = thrown(12.0)
    ekf = Ekf(model)
    for k in range(20):
        estimate = ekf.step(log.t[k], log.measured[k], log.command[max(k - 1, 0)])
        assert abs(estimate.normalised[2]) < 5
    assert estimate.residuals[2] == pytest.approx(0, abs=2.5)  # N, of 12
