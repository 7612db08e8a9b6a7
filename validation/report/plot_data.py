"""What the figures show of each run, and how long logs become short ones without losing peaks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from softdyn.validation.loop.log import Log
from softdyn.validation.studies.benchmark import Case

OURS = "soft-id-clf-qp"  # the paper's controller
EXAMPLE = {"set_point": 0.5, "tracking": 0.2}  # what single examples show, in multiples of π
Value = TypeVar("Value")
CM = 100.0  # per m
FLOOR = 1e-12  # what V/V(0) is drawn at least as, for the logarithm


@dataclass(frozen=True, eq=False)
class Run:
    """A case and the part of its log that the figures need.

    Attributes
    ----------
    t : (N + 1,) time (s).
    y, y_ref : (N + 1, 3) tip and reference (cm).
    error : (N + 1,) ‖e‖ (cm).
    u, u_min, u_max, u_unit : (N, nu) input, its bounds (nu,) and its unit.
    V : (N,) Lyapunov function, NaN where the controller has none.
    duration : the planned one (s).
    complete, failed : whether it reached its end, and whether it counts as failed.
    """

    case: Case
    t: np.ndarray
    y: np.ndarray
    y_ref: np.ndarray
    error: np.ndarray
    u: np.ndarray
    u_min: np.ndarray
    u_max: np.ndarray
    u_unit: str
    V: np.ndarray
    duration: float
    complete: bool
    failed: bool

    @classmethod
    def load(cls, case: Case, path: Path) -> Run:
        """Read a case's log; samples that are not finite, a diverged run's last, are left out."""
        log = Log.load(path)
        error = finite_errors(log)
        n = len(error)
        return cls(
            case,
            log.t[:n],
            CM * log.y[:n],
            CM * log.y_ref[:n],
            error,
            log.u[:n],
            log.u_min,
            log.u_max,
            log.u_unit,
            log.V[:n],
            log.duration,
            log.complete,
            log.failed,
        )

    @property
    def progress(self) -> np.ndarray:
        """(N + 1,) time as a part of the planned duration."""
        return self.t / self.duration


def finite_errors(log: Log) -> np.ndarray:
    """‖e‖ (cm) of a log's samples, up to the first that is not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        error = CM * np.linalg.norm(log.error, axis=1)
    return error if np.isfinite(error).all() else error[: np.argmin(np.isfinite(error))]


def of(
    runs: Iterable[Run],
    robot: str | None = None,
    controller: str | None = None,
    kind: str | None = None,
    value: float | None = None,
) -> list[Run]:
    """The runs of a robot, a controller, a kind, a value: of those that are given."""
    wanted = {"robot": robot, "controller": controller, "kind": kind, "value": value}
    given = {key: item for key, item in wanted.items() if item is not None}
    return [run for run in runs if all(getattr(run.case, k) == v for k, v in given.items())]


def distinct(runs: Iterable[Run], field: str) -> list[Any]:
    """The values of a field of the runs' cases, in the order of the runs."""
    return list(dict.fromkeys(getattr(run.case, field) for run in runs))


def preferred(values: Sequence[Value], value: Value) -> Value:
    """`value` where it is among `values`, else the first of them."""
    return value if value in values else values[0]


def main_controller(runs: Sequence[Run]) -> tuple[str, list[Run]]:
    """The controller that figures of one controller show, the paper's if it ran, and its runs."""
    names = distinct(runs, "controller")
    name = preferred(names, OURS) if names else OURS
    return name, of(runs, controller=name)


def thin(*columns: np.ndarray, bins: int = 400) -> np.ndarray:
    """Indices that draw the same curves: the ends and, in each bin, every column's extremes.

    Parameters
    ----------
    columns : (N,) each, of one length and finite.
    bins : parts of equal length that the samples are divided into.

    Returns
    -------
    (K,) increasing indices, K ≤ 2 · bins · number of columns + 2; all where that is not fewer.
    """
    n = len(columns[0])
    if n <= 2 * bins * len(columns) + 2:
        return np.arange(n)
    edges = np.linspace(0, n, bins + 1).astype(int)
    keep = {0, n - 1}
    for column in columns:
        for begin, end in pairwise(edges):
            part = column[begin:end]
            keep |= {begin + int(part.argmin()), begin + int(part.argmax())}
    return np.array(sorted(keep))


def thin_path(points: np.ndarray, tolerance: float) -> np.ndarray:
    """Indices of a path's ends and of every point farther than `tolerance` from the one before.

    Every point left out lies within `tolerance` of one that is kept.
    """
    kept = [0]
    last, limit = points[0], tolerance**2
    for i, point in enumerate(points):
        step = point - last
        if step @ step > limit:
            kept.append(i)
            last = point
    return np.unique([*kept, len(points) - 1])


@dataclass(frozen=True, eq=False)
class Band:
    """Several positive curves as one: geometric mean, lowest and highest, over common bins.

    Attributes
    ----------
    s : (K,) the curve parameter, 0 … 1 over the planned duration.
    mean, low, high : (K,) over the runs that got there.
    ends : (s, value) of the last sample of each failed run.
    """

    s: np.ndarray
    mean: np.ndarray
    low: np.ndarray
    high: np.ndarray
    ends: list[tuple[float, float]]


def lyapunov_band(runs: Sequence[Run], bins: int = 300) -> Band | None:
    """V/V(0) of the runs, None where no run has a V; a bin holds every sample of its time.

    A peak shows in `high` however short it is. Runs from V(0) = 0 have no normalised V.
    """
    curves = [
        (run, np.maximum(run.V / run.V[0], FLOOR))
        for run in runs
        if len(run.V) and np.isfinite(run.V).all() and run.V[0] > 0
    ]
    if not curves:
        return None
    bins = max(1, min(bins, *(int(len(V) / run.progress[-1]) for run, V in curves)))
    logs, lows, highs = (np.full((len(curves), bins + 1), np.nan) for _ in range(3))
    for i, (run, V) in enumerate(curves):
        where = np.minimum((run.progress[: len(V)] * bins + 1e-9).astype(int), bins - 1)
        starts = np.flatnonzero(np.diff(where, prepend=-1))
        filled, counts = where[starts] + 1, np.diff(starts, append=len(V))
        logs[i, filled] = np.add.reduceat(np.log(V), starts) / counts
        lows[i, filled] = np.minimum.reduceat(V, starts)
        highs[i, filled] = np.maximum.reduceat(V, starts)
        logs[i, 0], lows[i, 0], highs[i, 0] = 0.0, 1.0, 1.0
    s = np.concatenate(([0.0], (np.arange(bins) + 0.5) / bins))
    alive = np.isfinite(logs).any(axis=0)
    return Band(
        s[alive],
        np.exp(np.nanmean(logs[:, alive], axis=0)),
        np.nanmin(lows[:, alive], axis=0),
        np.nanmax(highs[:, alive], axis=0),
        [(float(run.progress[len(V) - 1]), float(V[-1])) for run, V in curves if run.failed],
    )
