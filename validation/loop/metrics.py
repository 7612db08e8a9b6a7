"""The paper's figures of merit (section Results), from the log of a run.

SP is the final error ‖e(T)‖ in cm, TT the time-mean of ‖e‖² in cm², each as mean ± population
standard deviation over its cases. A run that ended early has neither: its figures are NaN, never a
number that depends on when it was stopped, and a mean that contains it is None.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from softdyn import InputError
from softdyn.checks import array, number
from softdyn.validation.loop.log import Log
from softdyn.validation.studies.paper import CYCLES

CM = 100.0  # per m


def final_error_cm(log: Log) -> float:
    """‖e(T)‖ (cm) of the run's final state; NaN when the run ended early."""
    return CM * float(np.linalg.norm(log.error[-1])) if log.complete else math.nan


def mse_cm2(log: Log) -> float:
    """Time-mean of ‖e‖² (cm²) over the whole run; NaN when the run ended early.

    See `mean_square` for the samples and their weights.
    """
    return CM**2 * mean_square(log.t, log.error) if log.complete else math.nan


def second_cycle_mse_cm2(log: Log) -> float:
    """Time-mean of ‖e‖² (cm²) over the second of a trajectory's two cycles; NaN as `mse_cm2`.

    Raises
    ------
    InputError
        For a run that is not a whole tracking experiment, which has no cycles.
    """
    if log.omega is None or not math.isclose(log.duration, 2 * CYCLES / log.omega):
        raise InputError("log", "a tracking experiment of two cycles", log.kind)
    if not log.complete:
        return math.nan
    return CM**2 * mean_square(log.t, log.error, start=log.duration / CYCLES)


def mean_square(t: np.ndarray, error: np.ndarray, start: float | None = None) -> float:
    """1/(t_N - start) ∫ ‖e‖² dt from `start` to the last sample, by the trapezoidal rule.

    Samples are those of the log: one per control period and the final state, each weighted by half
    of both intervals beside it, so the figure does not depend on the period beyond O(period²). At a
    `start` between two samples ‖e‖² is interpolated linearly.

    Parameters
    ----------
    t : (N + 1,) increasing times (s), at least two.
    error : (N + 1, 3) e at them (m).
    start : begin of the mean (s), the first sample by default.

    Returns
    -------
    float
        The mean (m²); not finite when a sample is not.
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


def mean_std(values: Iterable[float]) -> tuple[float | None, float | None]:
    """Mean and population standard deviation over all cases; None, None if one is not finite."""
    cases = [float(value) for value in values]
    if not cases or not all(math.isfinite(value) for value in cases):
        return None, None
    return float(np.mean(cases)), float(np.std(cases))


def step_times_us(log: Log) -> dict[str, float | None]:
    """Median, 99 %, 99.9 % and maximum (µs) of the control step; None for a run without any."""
    times = log.step_us
    shares = {"median": 50.0, "p99": 99.0, "p999": 99.9, "max": 100.0}
    if not len(times):
        return dict.fromkeys(shares)
    return {name: float(np.percentile(times, share)) for name, share in shares.items()}
