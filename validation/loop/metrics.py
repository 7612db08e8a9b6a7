"""Means behind the figures of merit of a run (`Log`) and of several.

The figure of a run that ended early is NaN, because a number would depend on the time of the end. A
mean that contains it is None.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from scipy.special import ndtri

from softdyn import InputError
from softdyn.checks import array, number

CM = 100.0  # per m
SIGMAS = float(ndtri(0.975))  # half a 95 % interval, in standard deviations
STEP_TIMES = {"median": 50.0, "p99": 99.0, "p999": 99.9, "max": 100.0}  # percentiles
RESOLUTION = 1e-6  # m; what is smaller is zero
SHOWN = {"m": ("cm", CM), "rad": ("degrees", 180 / math.pi)}  # units of a task's figures


def mean_square(t: np.ndarray, error: np.ndarray, start: float | None = None) -> float:
    """1/(t_N - start) ∫ ‖e‖² dt from `start` to the last sample, by the trapezoidal rule.

    The samples are those of the log: one per control period and the final state. Each is weighted
    by half of both intervals beside it, so that the figure depends on the period only by
    O(period²). If `start` lies between two samples, ‖e‖² is interpolated linearly.

    Parameters
    ----------
    t : np.ndarray, (N + 1,)
        Increasing times (s), at least two.
    error : np.ndarray, (N + 1, 3)
        e at them (m).
    start : float, optional
        Start of the mean (s), the first sample by default.

    Returns
    -------
    float
        The mean (m²); not finite when a sample is not.

    Raises
    ------
    InputError
        The shapes differ, the times do not increase, or `start` lies outside them.
    """
    t = array("t", t, (max(2, len(t)),))
    error = array("error", error, (len(t), 3), finite=False)
    start = t[0] if start is None else number("start", start, lower=t[0])
    if not (np.diff(t) > 0).all() or start >= t[-1]:
        raise InputError("t", f"increasing times beyond {start:g} s", t)
    square = np.einsum("ij,ij->i", error, error)
    later = t > start
    times = np.concatenate(([start], t[later]))
    values = np.concatenate(([np.interp(start, t, square)], square[later]))
    return float(np.trapezoid(values, times) / (t[-1] - start))


def input_change(u: np.ndarray, u_min: np.ndarray, u_max: np.ndarray) -> float | None:
    """Root mean square change of the inputs from one period to the next, as a share of their range.

    Only the second half of the run counts, when a set point should be held. Inputs without a range
    are left out.

    Parameters
    ----------
    u : np.ndarray, (N, nu)
        The inputs of all periods.
    u_min, u_max : np.ndarray, (nu,)
        Their bounds.

    Returns
    -------
    float or None
        The change; None without two periods or without a range.
    """
    free = u_max > u_min
    late = u[len(u) // 2 :, free]
    if len(late) < 2 or not free.any():
        return None
    with np.errstate(all="ignore"):  # a damaged log may state a range of 1e-310
        return float(np.sqrt(np.mean((np.diff(late, axis=0) / (u_max - u_min)[free]) ** 2)))


def mean_std(values: Iterable[float | None]) -> tuple[float | None, float | None]:
    """Mean and population standard deviation; None, None if a value is None or not finite."""
    cases = [math.nan if value is None else float(value) for value in values]
    if not cases or not all(math.isfinite(value) for value in cases):
        return None, None
    return float(np.mean(cases)), float(np.std(cases))


def quantiles(values: np.ndarray) -> dict[str, float | None]:
    """The percentiles `STEP_TIMES` of the values that are finite; None without any."""
    known = values[np.isfinite(values)]
    if not len(known):
        return dict.fromkeys(STEP_TIMES)
    return {name: float(np.percentile(known, p)) for name, p in STEP_TIMES.items()}


def moves(targets: np.ndarray) -> bool:
    """Whether a reference, or the numbers (N + 1, k) of targets, are a trajectory."""
    return bool(np.ptp(targets, axis=0).max(initial=0.0) > RESOLUTION)


def task_figures(
    tasks: Sequence[tuple[str, str]], errors: np.ndarray | None
) -> dict[str, dict[str, Any]]:
    """First, last and rms error of each task (cm, degrees) of errors (N + 1, tasks), by name.

    `tasks` are names and units.
    """
    found: dict[str, dict[str, Any]] = {}
    if errors is None:
        return found
    for k, (name, unit) in enumerate(tasks):
        shown, factor = SHOWN.get(unit, (unit, 1.0))
        values = factor * errors[:, k]
        rms = math.sqrt(float(np.mean(values**2)))
        found[name] = {"unit": shown, "first": float(values[0]), "last": float(values[-1]),
                       "rms": rms}  # fmt: skip
    return found
