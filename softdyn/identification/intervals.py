"""Intervals of a fit's unknowns, unknowns that the data do not determine, white residuals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import t as student

from softdyn.checks import instance, number
from softdyn.exceptions import InputError
from softdyn.identification.blocks import ResidualBlock, reduced
from softdyn.identification.data import Measurements
from softdyn.identification.parameters import Parameter

WIDEST = 0.5  # a relative standard deviation above which a parameter is not identified
LAGS = 20  # number of lags of the residuals' autocorrelation
FEWEST = 10  # samples; a smoothing spline needs half of them
SHARE = 0.975  # of the distribution below the upper end of a 95 % interval


def deviations(R: np.ndarray) -> np.ndarray:
    """Standard deviations (P,) of θ if residuals have variance 1."""
    return np.linalg.norm(np.linalg.pinv(R), axis=1)


def half_widths(block: ResidualBlock, groups: np.ndarray) -> np.ndarray:
    """Half of each 95 % interval (P,) from whitened residuals of variance 1.

    Residuals of one group, such as the markers of one pose, may share an error of the model. The
    interval is the wider one of two: with independent residuals, and with independent groups
    (Liang and Zeger 1986, with the correction of small samples), each by Student's t.

    Parameters
    ----------
    block : ResidualBlock
        The residuals and their derivatives, without unknowns of runs.
    groups : ndarray of int, (rows,)
        The group of each residual.
    """
    e, J = block.residual, block.shared
    inverse = np.linalg.pinv(reduced([block]).R)
    spent = max(len(e) - J.shape[1], 1)
    alone = np.linalg.norm(inverse, axis=1) * float(student.ppf(SHARE, spent))
    members = np.unique(groups, return_inverse=True)[1]
    count = int(members.max(initial=0)) + 1
    if count < 2:
        return alone
    scores = np.zeros((count, J.shape[1]))
    np.add.at(scores, members, J * e[:, None])
    factor = count / (count - 1) * max(len(e) - 1, 1) / spent
    together = np.linalg.norm(inverse @ inverse.T @ scores.T, axis=1) * np.sqrt(factor)
    return np.maximum(alone, together * float(student.ppf(SHARE, count - 1)))


def unidentifiable(
    unknowns: Sequence[Parameter], R: np.ndarray, theta: np.ndarray
) -> tuple[set[int], list[str]]:
    """Indices of parameters that are not identifiable, and the reasons as text.

    First come all parameters that would not be identifiable even if all others were known. If there
    are none, it is one parameter of the worst combination. Deviations are relative to the larger
    one of the file's value and that found, because the file's may be a guess that is far too small.
    """
    scaled = R * np.maximum([p.scale for p in unknowns], np.abs(theta))
    alone = np.flatnonzero(np.linalg.norm(scaled, axis=0) * WIDEST < 1)
    if alone.size:
        return set(map(int, alone)), [unknowns[int(k)].label for k in alone]
    _, singular, directions = np.linalg.svd(scaled)
    if singular[-1] * WIDEST >= 1:
        return set(), []
    share = np.abs(directions[-1]) / np.abs(directions[-1]).max()
    # drop only the worst parameter, so that a combination such as a common scale loses one member
    worst = int(np.argmax(share))
    terms = [unknowns[int(k)].label for k in np.argsort(-share) if share[k] > 0.3]
    text = " together with ".join(terms[:6]) + (" and others" if len(terms) > 6 else "")
    return {worst}, [f"{text} (relative deviation {1 / max(singular[-1], 1e-300):.2g})"]


def fit_length(data: Measurements, hold_out: float) -> int:
    """The number of samples to fit if the share `hold_out` of the data is held out."""
    if not 0 <= number("hold_out", hold_out) < 0.9:
        raise InputError("hold_out", "a part from 0 to 0.9", hold_out)
    instance("data", data, Measurements, "Measurements")
    return max(FEWEST, round(len(data.t) * (1 - hold_out)))


def autocorrelation(residuals: np.ndarray) -> np.ndarray:
    """ρ at lags 1 … LAGS (LAGS, outputs) in each output's own samples, those without NaN.

    A camera is slower than the rows, so a lag in rows would be no lag of its own. The sum over
    all pairs is over that of all squares, as the test of Ljung and Box assumes. Means of both would
    call a third of short white series coloured.
    """
    lags = min(LAGS, len(residuals) - 2)
    found = np.zeros((lags, residuals.shape[1]))
    for j, column in enumerate(residuals.T):
        own = column[np.isfinite(column)]
        power = float(own @ own)
        for lag in range(1, min(lags, len(own) - 2) + 1 if power > 0 else 0):
            found[lag - 1, j] = own[lag:] @ own[:-lag] / power
    return found


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
