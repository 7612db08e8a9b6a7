"""Own times of readings: negative and huge times, rates, and how many late readings wait."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn.estimation import Ekf
from softdyn.estimation.arrivals import MOST_ROWS, sensor_channels
from softdyn.sensing import Sensor, SensorKind, Sensors
from tests.support.refused import refused
from tests.support.rigs import sensors

PERIOD = 0.005


@pytest.fixture(scope="module")
def model():
    return softdyn.load("finger")


def test_the_variance_of_a_rounded_reading(model):
    """That of noise and rounding together, from many rounded readings."""
    noise, step = 2e-4, 1.5e-3
    length = replace(sensors(model)[0], noise=(noise,), resolution=(step,))
    (channel,) = sensor_channels(model, (length,))
    rng = np.random.default_rng(0)
    true = rng.uniform(0, 1, 100_000)
    read = np.round((true + noise * rng.normal(size=len(true))) / step) * step
    assert channel.variance == pytest.approx((read - true).var(), rel=0.02)


@pytest.mark.parametrize("rate", [0.0, 60.0, 1000.0])
@pytest.mark.parametrize("latency", [0.0, 0.03])
@pytest.mark.parametrize("begin", [-1.0, -0.1, 3600.0])
def test_time_has_no_origin(model, rate, latency, begin):
    """A recorder with a trigger has negative times; its sensors are read as at any other time."""
    chosen = tuple(sensors(model, rate=rate, latency=latency))
    reader, u = Sensors(model, chosen), np.array([0.1, -0.1])
    rng = np.random.default_rng(0)
    rows = [
        reader.measure(model.state(np.full(4, 0.002 * k), np.zeros(4)), u).values
        + 1e-3 * rng.normal(size=5)
        for k in range(60)
    ]
    found = []
    for start in (0.0, begin):  # multiples of all intervals
        ekf = Ekf(model, chosen)
        states = [ekf.step(start + PERIOD * k, row, u).q for k, row in enumerate(rows)]
        found.append((states, ekf.counts))
    assert np.allclose(found[0][0], found[1][0], atol=1e-7)
    assert found[0][1] == found[1][1]
    assert found[0][1].used > 2 * 60 + 3 * 12


@pytest.mark.parametrize("t", [1e22, 1e300, -1e22, np.float64(1e11), 10**400])
def test_a_time_that_no_clock_has_is_refused_at_once(model, t):
    ekf, z = Ekf(model, sensors(model, rate=1e6, latency=0.03)), np.zeros(5)
    before = ekf.step(0.0, z, np.zeros(2))
    for _ in range(20):
        again = ekf.step(t, z, np.zeros(2))
    assert np.array_equal(before.q, again.q)
    assert (ekf.counts.refused, ekf.counts.gaps) == (20, 0)
    assert ekf.step(PERIOD, z, np.zeros(2)).used >= 2


@pytest.mark.parametrize("t", ["0.1", b"1", None, True, [0.1], 1j])
def test_a_time_that_is_no_number_is_refused(model, t):
    with refused("t"):
        Ekf(model, sensors(model)).step(t, np.zeros(5), np.zeros(2))


def test_steps_of_no_length_are_refused(model):
    ekf, z = Ekf(model, sensors(model, latency=0.03)), np.zeros(5)
    for t in (0.0, 5e-324, 1e-12, PERIOD):
        ekf.step(t, z, np.zeros(2))
    assert (ekf.counts.refused, ekf.counts.restarts) == (2, 0)


@pytest.mark.parametrize(("rate", "latency"), [(1000.0, 0.6), (0.0, 0.6), (1000.0, 10.0)])
def test_late_readings_that_wait_are_bounded(model, rate, latency):
    """A step costs the square of their number; those that wait are evenly apart."""
    ekf = Ekf(model, sensors(model, rate=rate, latency=latency))
    waiting, most = {}, 0
    for k in range(700):
        ekf.step(1e-3 * k, np.zeros(5), np.zeros(2))
        waiting |= dict.fromkeys(late.time for late in ekf._filter.late._waiting)
        most = max(most, len(ekf._filter.P))
    assert most <= 8 + MOST_ROWS + 3
    apart = np.diff(list(waiting))
    assert apart == pytest.approx(latency / (MOST_ROWS // 3), abs=1.1e-3)
    if latency < 0.7:
        assert most >= 8 + MOST_ROWS - 6
        assert ekf.counts.used > 2 * 700 + 3 * 5


def test_as_many_as_fit_all_wait(model):
    """Three markers at 120 Hz, 40 ms late."""
    given = tuple(
        Sensor(f"m{k}", SensorKind.POSITION, link=model.robot.task, rate=120.0, latency=0.04)
        for k in range(3)
    )
    ekf, still = Ekf(model, given), model.state(model.q0, np.zeros(4))
    z = Sensors(model, given).measure(still, np.zeros(2)).values
    for k in range(400):
        ekf.step(2e-3 * k, z, np.zeros(2))
    assert ekf.counts.unmatched == 9 * 5  # of own times before the first step
    assert ekf.counts.used > 9 * 85


@pytest.mark.parametrize("field", [("rate", -1.0), ("rate", 1e300), ("latency", 11.0)])
def test_impossible_sensors_are_one_line(model, field):
    name, value = field
    with refused(f"sensor 'tendon_a': {name}"):
        Ekf(model, [replace(sensors(model)[0], **{name: value})])


def test_commands_that_are_sent_late(model):
    """The estimate is that of motors with a delay of the same time."""
    late = 0.003
    actuators = tuple(replace(one, delay=late) for one in model.robot.actuators)
    delayed = softdyn.build(replace(model.robot, actuators=actuators))
    ekf, other = (Ekf(one, sensors(one)) for one in (model, delayed))
    rng = np.random.default_rng(8)
    for k in range(40):
        z, u = 1e-2 * rng.standard_normal(5), rng.uniform(-1, 1, 2)
        found = ekf.step(0.01 * k, z, u, sent=0.01 * (k - 1) + late)
        expected = other.step(0.01 * k, z, u)
        assert found.q == pytest.approx(expected.q, abs=1e-12)
        assert found.v == pytest.approx(expected.v, abs=1e-9)
