"""The test for white residuals, with each formula written out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from softdyn.identification.intervals import LAGS, autocorrelation, ljung_box, widening


def test_autocorrelation_and_what_follows_from_it():
    rng = np.random.default_rng(4)
    white = rng.normal(size=(300, 2))
    series = white.copy()
    for k in range(1, 300):
        series[k, 1] += 0.6 * series[k - 1, 1]
    series[40:50, 0] = np.nan
    rho = autocorrelation(series)
    assert rho.shape == (LAGS, 2)
    for lag in (1, 2, 7, LAGS):
        for j in (0, 1):
            x = series[np.isfinite(series[:, j]), j]
            pairs = [a * b for a, b in zip(x[lag:], x[:-lag], strict=True)]
            assert rho[lag - 1, j] == pytest.approx(np.sum(pairs) / np.sum(x**2))
    samples = np.array([290, 300])
    statistic, freedoms = ljung_box(rho, samples)
    expected = sum(
        n * (n + 2) * rho[k - 1, j] ** 2 / (n - k)
        for j, n in enumerate(samples) for k in range(1, LAGS + 1)
    )  # fmt: skip
    assert (statistic, freedoms) == (pytest.approx(expected), 2 * LAGS)
    assert ljung_box(rho, np.array([290, 4 * LAGS]))[1] == LAGS  # too few samples tell nothing
    wide = [
        1 + 2 * sum((1 - k / (LAGS + 1)) * rho[k - 1, j] for k in range(1, LAGS + 1)
                    if abs(rho[k - 1, j]) > 2 / np.sqrt(samples[j]))
        for j in (0, 1)
    ]  # fmt: skip
    np.testing.assert_allclose(widening(rho, samples), np.maximum(wide, 1))
    assert widening(rho, samples)[1] > 2


def test_short_white_series_are_called_white():
    rng, statistics = np.random.default_rng(6), []
    for _ in range(300):
        rho = autocorrelation(rng.normal(size=(128, 9)))
        statistic, freedoms = ljung_box(rho, np.full(9, 128))
        statistics.append(chi2.sf(statistic, freedoms))
    assert np.mean(np.array(statistics) < 0.01) < 0.05


def test_a_slow_sensor_has_lags_in_its_own_samples():
    own = np.random.default_rng(5).normal(size=(200, 1))
    rows = np.full((1000, 1), np.nan)
    rows[::5] = own
    np.testing.assert_array_equal(autocorrelation(rows), autocorrelation(own))
    assert not autocorrelation(np.full((30, 1), np.nan)).any()
