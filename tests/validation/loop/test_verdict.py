"""The verdict on a run, from samples with closed-form answers."""

import math

import numpy as np
import pytest

from tests.support.logs import make_log
from tests.support.refused import refused


def decay(rate=2.0, end=10.0, **changes):
    """A tip that starts 0.2 m short of a point and comes closer as exp(-rate t)."""
    t = np.linspace(0, end, 1001)
    error = np.outer(-0.2 * np.exp(-rate * t), [1.0, 0, 0])
    return make_log(t, error, length=0.5, kind="set_point", **changes)


def test_a_set_point_is_reached_when_it_is_settled():
    found = decay().verdict()
    assert found.reached
    assert found.tolerance == 0.005
    assert found.settling_time == pytest.approx(math.log(40) / 2, abs=0.011)
    assert found.overshoot == 0
    # mean of exp(-4 t) over the last second
    square = 0.04 * (math.exp(-36) - math.exp(-40)) / 4
    assert found.steady_error == pytest.approx(math.sqrt(square), rel=1e-3)
    slow = decay(0.1)
    assert not slow.verdict().reached
    assert slow.verdict().settling_time is None
    assert slow.verdict(0.2).reached
    assert "not reached: |e| fell from 20.000 to 7.358 cm, tolerance 0.5 cm" in slow.summary()
    assert "reached" in slow.summary(tolerance=0.2).splitlines()[-1]
    assert decay(failed=True, reason="it diverged").report()["verdict"] == "failed"


def test_passing_a_target_at_the_end_is_not_reaching_it():
    t = np.linspace(0, 10, 1001)
    error = np.outer(0.2 * np.cos(2.25 * math.pi * t), [1.0, 0, 0])  # a quarter turn more: zero
    log = make_log(t, error, length=0.5)
    assert log.final_error_cm == pytest.approx(0, abs=1e-9)
    assert not log.verdict().reached
    assert log.verdict().overshoot == pytest.approx(1.0, abs=1e-3)


def test_a_trajectory_is_judged_by_the_rms_of_its_last_cycle():
    t = np.linspace(0, 8, 1601)  # omega = 0.5: cycles of 4 s
    late = t >= 4
    error = np.outer(np.where(late, 0.004 * math.sqrt(2) * np.sin(math.pi * t), 0.1), [0, 0, 1.0])
    y_ref = np.outer(np.sin(math.pi / 2 * t), [1.0, 0, 0])
    log = make_log(t, error, y_ref=y_ref, y=y_ref + error, omega=0.5, length=0.5)
    assert log.verdict().steady_error == pytest.approx(0.004, rel=0.02)
    assert log.verdict().reached
    assert log.verdict().overshoot is None
    assert not log.verdict(0.003).reached


def test_inputs_and_deadlines():
    t = np.linspace(0, 1, 101)
    u = np.column_stack((np.resize([0.0, 4.0], 100), np.full(100, 1.0)))  # bang-bang, and still
    log = make_log(
        t, np.zeros((101, 3)), u=u, u_min=np.zeros(2), u_max=np.full(2, 4.0), period=0.01,
        step_us=np.where(np.arange(100) < 7, 10_001.0, 9_999.0),
    )  # fmt: skip
    found = log.verdict()
    assert found.activity == pytest.approx((99 + 0) / 2)
    assert found.at_bound == 0.5
    assert found.missed == 7
    assert "7 of 100 steps took longer than the period of 10 ms" in log.summary()
    unknown = make_log(
        t, np.zeros((101, 3)), u=u, u_min=u[0], u_max=u[0], step_us=np.full(100, np.nan)
    )
    assert unknown.verdict().missed is None
    assert (unknown.verdict().activity, unknown.verdict().at_bound) == (None, None)


@pytest.mark.parametrize("tolerance", [0, -1, math.nan, "a"])
def test_a_tolerance_is_a_number_above_zero(tolerance):
    with refused("tolerance"):
        decay().verdict(tolerance)
