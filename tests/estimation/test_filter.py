"""The filter alone, without a timeline: late corrections, and filters that begin anew."""

from __future__ import annotations

import numpy as np
import pytest

import softdyn
from softdyn.estimation import Disturbance, EkfParameters
from softdyn.estimation.arrivals import sensor_channels
from softdyn.estimation.filter import Filter, FilteredModel, Fused
from softdyn.estimation.timeline import Reading
from tests.support.rigs import sensors

STEP, U = 0.005, np.array([0.2, -0.1])
SMALL = EkfParameters(spread=1e-5, process=1e-5, least_process=1e-5, tip_force=1e-5)


@pytest.fixture(scope="module")
def model():
    return softdyn.load("finger")


def made(model, disturbances=(Disturbance.TIP_FORCE,), scale=1.0):
    filtered = FilteredModel(model, disturbances, SMALL)
    return Filter(filtered, np.full(4, 0.1), np.zeros(4), U, scale)


def reading(model, late, at):
    """Readings of the camera that differ a little from those at a filter's estimate."""
    chosen = tuple(sensors(model, rate=100.0, latency=late))
    camera = sensor_channels(model, chosen)[-1]
    values = np.add(camera.expect(at.q, at.v, U, at.P).values, [1e-3, 0.0, -2e-3])
    return lambda own: Reading(camera, own, values.copy(), 3, False)


def test_a_late_correction_is_that_of_a_filter_that_waited(model):
    """To first order in the errors, which are small here: one filter waits, one replays."""
    waited, replayed = made(model), made(model)
    for one in (waited, replayed):
        assert one.predict(U, STEP)
    given = reading(model, 2 * STEP, waited)
    assert replayed.correct(STEP, [given(STEP)], U, Fused.none(5))
    given_late = given(STEP)
    waited.wait(given_late.channel, STEP, U)
    assert len(waited.P) == len(replayed.P) + 3
    for one in (waited, replayed):
        assert one.predict(U, STEP)
        assert one.predict(0.5 * U, STEP)
    before = waited.q.copy()
    assert waited.correct(3 * STEP, [given_late], U, Fused.none(5))
    assert len(waited.P) == len(replayed.P)
    moved = np.abs(waited.q - before).max()
    assert moved > 1e-8
    assert np.abs(waited.q - replayed.q).max() < 1e-3 * moved
    assert waited.forces == pytest.approx(replayed.forces, abs=1e-3 * np.abs(waited.forces).max())
    deviations = np.sqrt(np.diag(replayed.P))
    assert (np.abs(waited.P - replayed.P) < 1e-4 * np.outer(deviations, deviations)).all()


def test_nothing_waits_for_a_reading_of_another_time(model):
    one, fused = made(model), Fused.none(5)
    assert one.predict(U, STEP)
    assert one.correct(STEP, [reading(model, 0.03, one)(-0.02)], U, fused)
    assert (fused.used, fused.unmatched) == (0, 3)
    assert np.isnan(fused.residuals).all()


def test_a_restart_is_a_new_filter(model):
    """The past has no part in a new filter; one that is widened goes on at the estimate."""
    old, fresh = made(model), made(model)
    for _ in range(3):
        assert old.predict(U, STEP)
    wide = old.widened(100.0)
    assert (wide.q == old.q).all()
    assert wide.P.diagonal()[:8] == pytest.approx(100 * fresh.P.diagonal()[:8])
    assert (wide.P.diagonal()[8:] == fresh.P.diagonal()[8:]).all()
    again = Filter(old._filtered, np.full(4, 0.1), np.zeros(4), U)
    for one in (again, fresh):
        assert one.predict(U, STEP)
    for name in ("q", "v", "d", "P", "held"):
        np.testing.assert_array_equal(getattr(again, name), getattr(fresh, name))


def test_a_prediction_without_a_solution_is_none(model):
    lost = made(model)
    lost.v[:] = np.nan
    assert not lost.predict(U, STEP)
