"""Figures of merit against values worked out by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest

from softdyn import InputError
from softdyn.validation import paper
from softdyn.validation.loop import metrics
from tests.support.logs import make_log
from tests.support.refused import refused


def test_final_error_is_the_last_samples():
    log = make_log([0, 1, 2], [[1, 0, 0], [0, 1, 0], [0.03, 0, 0.04]])
    assert log.final_error_cm == pytest.approx(5.0, rel=1e-15)


def test_mse_weights_uneven_samples():
    # ‖e‖² = 0.01, 0.04, 0 at t = 0, 1, 3: (0.025 · 1 + 0.02 · 2) / 3 m²
    log = make_log([0, 1, 3], [[0.1, 0, 0], [0, 0.2, 0], [0, 0, 0]])
    assert log.mse_cm2 == pytest.approx(1e4 * 0.065 / 3, rel=1e-14)


def test_mse_of_a_constant_error_is_its_square_whatever_the_samples():
    for t in ([0, 2], [0, 0.1, 2], np.linspace(0, 2, 77)):
        log = make_log(t, np.tile([0.03, 0.04, 0.0], (len(t), 1)))
        assert log.mse_cm2 == pytest.approx(25.0, rel=1e-13)


def test_mse_converges_to_the_integral_at_second_order():
    def mse(period):
        t = np.append(np.arange(0, 2, period), 2.0)
        return metrics.mean_square(t, np.outer(np.exp(-t), [1, 0, 0]))

    exact = (1 - math.exp(-4)) / 4
    coarse, fine = (abs(mse(period) - exact) for period in (0.1, 0.05))
    assert fine < 1e-3
    assert 3.5 < coarse / fine < 4.5


def test_mean_square_from_between_two_samples():
    # ‖e‖² falls from 4 to 0 over [0, 2]: 1 at 1.5, so its mean over [1.5, 2] is a half
    assert metrics.mean_square([0, 2], [[2, 0, 0], [0, 0, 0]], start=1.5) == pytest.approx(0.5)


def test_input_change():
    """The second half of a run, as a share of each input's range."""
    u = np.array([[0, 0], [9, 5], [1, 5], [3, 5], [1, 5], [3, 5]], float)
    low, high = np.array([-5.0, 0.0]), np.array([5.0, 8.0])
    # steps of 2 in 10 for one input, none for the other
    assert metrics.input_change(u, low, high) == pytest.approx(0.2 / math.sqrt(2), rel=1e-12)
    assert metrics.input_change(u, low, np.array([5.0, 0.0])) == pytest.approx(
        0.2
    )  # one without a range
    assert metrics.input_change(u, low, low) is None
    assert metrics.input_change(u[:2], low, high) is None
    random = np.random.default_rng(0)
    noise = random.normal(size=(20_000, 2)) * (high - low) * 0.01
    # white noise of 1 % changes by √2 % a period
    assert metrics.input_change(noise, low, high) == pytest.approx(0.01 * math.sqrt(2), rel=0.02)


def test_second_cycle():
    t = np.linspace(0, 4, 401)  # two cycles at ω = π
    error = np.where(t[:, None] < 2, 0.5, 0.01) * [1, 0, 0]
    log = make_log(t, error, omega=1.0, kind="tracking")
    assert paper.second_cycle_mse_cm2(log) == pytest.approx(1.0, rel=1e-12)
    assert log.mse_cm2 > 1000
    assert math.isnan(paper.second_cycle_mse_cm2(replace(log, complete=False)))
    for changes in ({"omega": None}, {"duration": 3.0}):
        with refused("log", "tracking"):
            paper.second_cycle_mse_cm2(replace(log, **changes))


def test_a_run_that_ended_early_has_no_figures():
    log = make_log([0, 1], [[1, 0, 0], [0, 0, 0]], complete=False, duration=10.0)
    assert math.isnan(log.final_error_cm)
    assert math.isnan(log.mse_cm2)


def test_mean_and_population_deviation():
    mean, std = metrics.mean_std([2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0])
    assert (mean, std) == (5.0, 2.0)
    assert metrics.mean_std([3.0]) == (3.0, 0.0)


@pytest.mark.parametrize("values", [[], [1.0, math.nan], [math.inf, 2.0]])
def test_a_mean_without_all_its_cases_is_none(values):
    assert metrics.mean_std(values) == (None, None)


def test_step_times():
    log = make_log(np.arange(1002), np.zeros((1002, 3)))  # 1 … 1001 µs
    expected = {"median": 501.0, "p99": 991.0, "p999": 1000.0, "max": 1001.0}
    assert log.step_times_us == pytest.approx(expected)
    empty = make_log([0.0], [[0, 0, 0]])
    assert empty.step_times_us == dict.fromkeys(expected)


@pytest.mark.parametrize(
    ("t", "error", "start"),
    [
        ([0.0], [[0, 0, 0]], None),
        ([0.0, 0.0], np.zeros((2, 3)), None),
        ([1.0, 0.0], np.zeros((2, 3)), None),
        ([0.0, math.nan], np.zeros((2, 3)), None),
        ([0.0, 1.0], np.zeros((2, 2)), None),
        ([0.0, 1.0], np.zeros((3, 3)), None),
        ([0.0, 1.0], np.zeros((2, 3)), 1.0),
        ([0.0, 1.0], np.zeros((2, 3)), -0.5),
        ([0.0, 1.0], np.zeros((2, 3)), math.nan),
        ([0.0, 1.0], np.zeros((2, 3)), "0"),
    ],
)
def test_mean_square_refuses(t, error, start):
    with pytest.raises(InputError):
        metrics.mean_square(t, error, start)


def test_mean_square_of_samples_that_are_not_finite():
    assert math.isnan(metrics.mean_square([0, 1], [[math.nan, 0, 0], [0, 0, 0]]))
