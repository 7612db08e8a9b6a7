"""Readings with stamps: their own times count, not the file's rates and latencies."""

from __future__ import annotations

import numpy as np
import pytest

from softdyn import SetPoint
from softdyn.estimation import Ekf
from softdyn.validation import Rig, simulate
from tests.support.bench import bench_arm


@pytest.fixture(scope="module")
def run():
    """A swinging arm: its model and the log of its true motion, sampled every millisecond."""
    model = bench_arm()

    def law(state, reference):
        calls.append(1)
        return np.array([6.0, -6.0]) * (1 if len(calls) % 400 < 200 else -1)

    calls: list[int] = []
    return model, simulate(model, law, SetPoint(np.zeros(3)), duration=0.8, period=0.001, rig=Rig())


def camera_error(run, late, stamped):
    """The largest normalised error of a camera whose pictures are `late` steps old."""
    model, log = run
    found = np.array([model.measure(model.state(q, v), np.zeros(2)).values
                      for q, v in zip(log.q, log.v, strict=True)])  # fmt: skip
    ekf, worst = Ekf(model), 0.0
    for n, k in enumerate(range(0, 800, 5)):
        age = late + n % 4
        values, stamps = found[k].copy(), np.full(6, log.t[k])
        values[2] = np.nan  # the tension needs the motors' own inputs
        values[3:], stamps[3:] = found[max(k - age, 0), 3:], log.t[max(k - age, 0)]
        if n % 3 or k < age:
            values[3:] = np.nan
        command = log.command[max(k - 1, 0)]
        if stamped:
            estimate = ekf.step(log.t[k], values, command, stamps)
        else:
            estimate = ekf.step(log.t[k], values, command)
        if k > 300 and not np.isnan(values[3]):
            worst = max(worst, float(np.nanmax(np.abs(estimate.residuals[3:]), initial=0.0)))
    return worst


@pytest.mark.parametrize("late", [-4, 3, 13, 21, 37])  # -4: measured after the step's time
def test_the_stamp_is_the_time_of_a_reading(run, late):
    assert camera_error(run, late, stamped=True) < 1.5e-3


@pytest.mark.parametrize("late", [4, 9, 15])
def test_a_stamped_late_reading_of_a_moving_arm_is_of_its_own_time(run, late):
    """Encoders without a latency in the file whose stamps are old: no prediction waits for them.

    The arm turns by 0.01 rad and more in that time, and the readings are known to 3e-4 rad.
    """
    model, log = run
    ekf, errors, moved = Ekf(model), [], []
    for k in range(0, 800, 5):
        old = max(k - late, 0)
        values, stamps = np.full((2, 6), np.nan)
        values[:2], stamps[:2] = log.q[old], log.t[old]
        estimate = ekf.step(log.t[k], values, log.command[max(k - 1, 0)], stamps)
        if k > 300:
            errors.append(np.abs(estimate.q - log.q[k]).max())
            moved.append(np.abs(log.q[k] - log.q[old]).max())
    assert max(moved) > 0.01
    assert np.median(errors) < 0.25 * np.median(moved)
