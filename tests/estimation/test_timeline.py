"""The timeline alone, without a filter: the order of its events, its commands and its clock."""

from __future__ import annotations

import math

import numpy as np
import pytest

import softdyn
from softdyn.actuation.drives import Drives
from softdyn.estimation.arrivals import sensor_channels
from softdyn.estimation.timeline import Expected, Span, StepTime, Timeline
from tests.support.rigs import sensors

LAG, DELAY, LATE, PERIOD = 0.02, 0.003, 0.013, 0.005


@pytest.fixture(scope="module")
def model():
    return softdyn.load("finger")


def timeline(model, delay=DELAY, lag=0.0, longest=0.01, **camera):
    drives = Drives([lag] * 2, [delay] * 2, [math.inf] * 2)
    drives.hold(np.zeros(2), 0.0)
    chosen = tuple(sensors(model, **camera))
    found = Timeline(drives, sensor_channels(model, chosen), longest)
    found.skip(0.0)
    return found


def events(found, t, readings=None, stamps=None):
    return list(found.until(t, np.zeros(5) if readings is None else readings, stamps))


def test_a_late_reading_is_expected_at_its_own_time_and_arrives_later(model):
    """Pictures at 125 Hz, 13 ms late: each is expected once, and once it arrives, of that time."""
    found = timeline(model, rate=125.0, latency=LATE)
    expected, arrived = {}, {}
    for k in range(1, 60):
        t, at = k * PERIOD, (k - 1) * PERIOD
        for event in events(found, t):
            if isinstance(event, Span):
                at += event.length
            elif isinstance(event, Expected):
                assert event.time == pytest.approx(at, abs=1e-12)  # in the order of the times
                expected[round(event.time * 125)] = at
            else:
                assert at == pytest.approx(t)
                camera = [one for one in event if one.channel.times.latency > 0]
                arrived |= {round(one.time * 125): t for one in camera}
        assert at == pytest.approx(t)
    assert sorted(expected) == list(range(1, 37))
    for number, t in arrived.items():
        assert number / 125 + LATE <= t + 1e-9
        assert t - PERIOD < number / 125 + LATE + 1e-9 or number <= 0
    assert set(expected) - set(arrived) <= {36}


def test_commands_act_after_their_delay_and_with_their_lag(model):
    """The spans' mean commands are the integral of a first-order lag of the delayed commands."""
    found, shift = timeline(model, lag=LAG), np.array([1.0, -0.5])
    found.send(PERIOD, shift, sent=0.001)  # of the step from 0 to 5 ms
    mean, at = np.zeros(2), 0.0
    for k in range(1, 9):
        for event in events(found, k * PERIOD):
            if isinstance(event, Span):
                mean += event.length * event.commands
                at += event.length
                assert event.length <= 0.01
    left = at - 0.001 - DELAY
    assert mean == pytest.approx(shift * (left - LAG * -math.expm1(-left / LAG)))
    assert found.commands == pytest.approx(shift * -math.expm1(-left / LAG))


def test_a_long_step_has_equal_spans(model):
    found = timeline(model)
    lengths = [one.length for one in events(found, 0.025) if isinstance(one, Span)]
    assert lengths == pytest.approx([0.025 / 3] * 3)


def test_stamps_are_the_times_of_readings(model):
    """Their mean over a channel; one from after now is at most 20 ms younger; NaN says nothing."""
    found, z = timeline(model), np.ones(5)
    for stamps, times, good in (
        ([0.004, 0.002, 0.001, 0.001, 0.001], [0.0018], [5]),
        ([9.0] * 5, [0.04 + 0.02], [5]),
        ([math.nan] + [0.0] * 4, [math.nan], [0]),
    ):
        found.skip(0.0)
        (arriving,) = (
            one for one in events(found, 0.04, z.copy(), np.array(stamps)) if type(one) is list
        )
        assert [one.time for one in arriving] == pytest.approx(times, nan_ok=True)
        assert [one.good for one in arriving] == good


def test_the_clock(model):
    found = timeline(model)
    found.skip(math.nan)
    assert found.accept(math.nan) is StepTime.REFUSED
    assert found.accept(5.0) is StepTime.FIRST
    found.skip(5.0)
    assert found.accept(5.005) is StepTime.NEXT
    assert found.accept(5.6) is StepTime.GAP
    assert found.accept(5.0 + 1e-10) is StepTime.REFUSED
    assert found.accept(2.0) is StepTime.REFUSED
    kinds = [found.accept(3.0 + k * PERIOD) for k in range(10)]
    assert kinds == [StepTime.REFUSED] * 9 + [StepTime.SET_BACK]
