"""Rows at rest in data over time: where the inputs are held long enough, and the robot is still."""

from __future__ import annotations

import warnings

import numpy as np

from softdyn.checks import instance, number
from softdyn.exceptions import InputError
from softdyn.identification.data import Measurements, spread

HELD = 1e-3  # of an input's range in the data; a held input may vary by so much
STILL = 2e-3  # of an output's range in the data; a robot at rest may move by so much
SURE = 4.0  # standard errors of a mean; a smaller difference may be noise
FEWEST = 4  # samples of a mean


def rest_rows(data: Measurements, hold: float = 1.0) -> tuple[Measurements, int]:
    """One row for each stretch in which the inputs are held, of the means over its last half.

    The robot counts as still if the two halves of this last half have means that differ by at most
    0.2 % of the output's range in the data, or by 4 standard errors. The rows keep the order of the
    data, so that the fit knows in which direction each cable slid last.

    Parameters
    ----------
    data : Measurements
        Data over time.
    hold : float
        The shortest stretch (s).

    Returns
    -------
    tuple[Measurements, int]
        The rows, with the time of the end of each stretch, and the number of stretches that were
        left out because an output still moved.

    Raises
    ------
    InputError
        Fewer than three rows at rest.
    """
    instance("data", data, Measurements, "Measurements")
    number("hold", hold, above=0.0)
    kept, moving = [], 0
    for begin, end in _held(data, hold):
        first = int(np.searchsorted(data.t, (data.t[begin] + data.t[end - 1]) / 2))
        tail = data.outputs[first:end]
        if len(tail) < 2 * FEWEST:
            continue
        if _moves(tail, spread(data.outputs)):
            moving += 1
        else:
            kept.append((data.t[end - 1], data.u[first:end].mean(0), _mean(tail)))
    if len(kept) < 3:
        got = f"{len(kept)}" + (f", and {moving} in which an output still moves" if moving else "")
        raise InputError("data", f"three stretches of {hold:g} s or more at rest", got)
    t, u, outputs = (np.array(part) for part in zip(*kept, strict=True))
    return Measurements(t, u, data.names, outputs), moving


def _held(data: Measurements, hold: float) -> list[tuple[int, int]]:
    """The stretches (begin, end) in which no input leaves its first value."""
    near = HELD * np.ptp(data.u, axis=0)
    found, begin = [], 0
    for k in range(1, len(data.t) + 1):
        if k == len(data.t) or (np.abs(data.u[k] - data.u[begin]) > near).any():
            if data.t[k - 1] - data.t[begin] >= hold:
                found.append((begin, k))
            begin = k
    return found


def _moves(tail: np.ndarray, range_: np.ndarray) -> bool:
    """Whether an output (samples, outputs) moves from its first half to its second one."""
    halves = np.array_split(tail, 2)
    means = np.array([_mean(half) for half in halves])
    error = np.sqrt(sum(_spoilt(half) for half in halves))
    far = np.maximum(STILL * range_, SURE * error)
    return bool((np.abs(means[1] - means[0]) > far).any())  # NaN, without a reading: not judged


def _spoilt(half: np.ndarray) -> np.ndarray:
    """The variance (outputs,) of a mean, by differences of neighbours: a drift adds little."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # an output without two readings in a row
        noise = np.nanmean(np.diff(half, axis=0) ** 2, axis=0) / 2
    found: np.ndarray = np.nan_to_num(noise) / len(half)
    return found


def _mean(rows: np.ndarray) -> np.ndarray:
    """The mean (outputs,) of the readings that are there; NaN without any."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        found: np.ndarray = np.nanmean(rows, axis=0)
    return found
