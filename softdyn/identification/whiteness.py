"""Tests whether residuals are white, and widens the intervals if they are not."""

from __future__ import annotations

import numpy as np

LAGS = 20  # number of lags of the residuals' autocorrelation


def autocorrelation(residuals: np.ndarray) -> np.ndarray:
    """ρ at lags 1 … LAGS (LAGS, outputs), over pairs without NaN."""
    lags = min(LAGS, len(residuals) - 2)
    found = np.zeros((lags, residuals.shape[1]))
    count = np.maximum(np.isfinite(residuals).sum(0), 1)  # avoids 0/0 if a joint is held throughout
    power = np.nansum(residuals**2, axis=0) / count
    for lag in range(1, lags + 1):
        product = residuals[lag:] * residuals[:-lag]
        pairs = np.isfinite(product).sum(0)
        total = np.nansum(product, axis=0) / np.maximum(pairs, 1)
        found[lag - 1] = total / np.where(power > 0, power, np.inf)
    return np.nan_to_num(found)


def widening(correlation: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Factor of the variance for coloured residuals, 1 + 2 Σ w ρ (Newey and West 1987)."""
    lags = len(correlation)
    weights = 1 - np.arange(1, lags + 1) / (lags + 1)
    band = 2 / np.sqrt(np.maximum(samples, 1))
    significant = np.where(np.abs(correlation) > band, correlation, 0)
    return np.maximum(1.0, 1 + 2 * weights @ significant)


def ljung_box(correlation: np.ndarray, samples: np.ndarray) -> tuple[float, int]:
    """The statistic over all outputs, and its degrees of freedom (Ljung and Box 1978)."""
    lags = np.arange(1, len(correlation) + 1)[:, None]
    use = samples > 4 * len(correlation)
    counted = samples[use]
    terms = counted * (counted + 2) * correlation[:, use] ** 2 / np.maximum(counted - lags, 1)
    return float(terms.sum()), max(1, int(terms.size))
