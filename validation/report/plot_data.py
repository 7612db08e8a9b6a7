"""The data of each run for the figures; long logs are thinned so that peaks remain."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from softdyn.controllers import SoftIdClfQp
from softdyn.validation.loop.log import Log
from softdyn.validation.loop.metrics import CM
from softdyn.validation.loop.pictures.time_figures import finite_errors
from softdyn.validation.studies.engine.case import Case

OURS = SoftIdClfQp.name  # the paper's controller
# the target in figures of a single example, in multiples of π
EXAMPLE = {"set_point": 0.5, "tracking": 0.2}
Value = TypeVar("Value")
FLOOR = 1e-12  # smallest V/V(0) in a figure, because of the logarithm


@dataclass(frozen=True, eq=False)
class PlottedRun:
    """A case and its log up to the first sample that is not finite, the last of a diverged run.

    Attributes
    ----------
    case : Case
        The case that was run.
    log : Log
        N + 1 samples.
    error : np.ndarray, (N + 1,)
        ‖e‖ (cm).
    """

    case: Case
    log: Log
    error: np.ndarray

    @classmethod
    def load(cls, case: Case, path: Path) -> PlottedRun:
        """Read a case's log."""
        log = Log.load(path)
        n = log.finite_samples
        kept = {name: getattr(log, name)[:n] for name in ("t", "y", "y_ref", "u", "V")}
        return cls(case, log.altered(**kept), finite_errors(log))

    @property
    def path(self) -> np.ndarray:
        """(N + 1, 2) the tip's x and z (cm)."""
        return CM * self.log.y[:, [0, 2]]

    @property
    def goal(self) -> np.ndarray:
        """(N + 1, 2) the reference's x and z (cm)."""
        return CM * self.log.y_ref[:, [0, 2]]

    @property
    def progress(self) -> np.ndarray:
        """(N + 1,) time as a share of the planned duration."""
        return self.log.t / self.log.duration


def of(
    runs: Iterable[PlottedRun],
    robot: str | None = None,
    controller: str | None = None,
    kind: str | None = None,
    value: float | None = None,
) -> list[PlottedRun]:
    """The runs of a robot, a controller, a kind and a value; None stands for all."""
    wanted = {"robot": robot, "controller": controller, "kind": kind, "value": value}
    given = {key: item for key, item in wanted.items() if item is not None}
    return [run for run in runs if all(getattr(run.case, k) == v for k, v in given.items())]


def distinct(runs: Iterable[PlottedRun], field: str) -> list[Any]:
    """The values of a field of the runs' cases, in the order of the runs."""
    return list(dict.fromkeys(getattr(run.case, field) for run in runs))


def preferred(values: Sequence[Value], value: Value) -> Value:
    """`value` where it is among `values`, else the first of them."""
    return value if value in values else values[0]


def main_controller(runs: Sequence[PlottedRun]) -> tuple[str, list[PlottedRun]]:
    """The controller for figures of a single one (the paper's if it ran), and its runs."""
    names = distinct(runs, "controller")
    name = preferred(names, OURS) if names else OURS
    return name, of(runs, controller=name)


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
    """Geometric mean, minimum and maximum of several positive curves over common bins.

    Attributes
    ----------
    s : np.ndarray, (K,)
        The curve parameter, 0 … 1 over the planned duration.
    mean, low, high : np.ndarray, (K,)
        Over the runs that lasted so long.
    ends : list[tuple[float, float]]
        (s, value) of the last sample of each failed run.
    """

    s: np.ndarray
    mean: np.ndarray
    low: np.ndarray
    high: np.ndarray
    ends: list[tuple[float, float]]


def lyapunov_band(runs: Sequence[PlottedRun], bins: int = 300) -> Band | None:
    """V/V(0) of the runs; None if no run has a V.

    A bin takes all samples of its time, so that `high` shows even a short peak. Runs with V(0) = 0
    are left out, because they have no normalised V.
    """
    curves = [
        (run, np.maximum(run.log.V / run.log.V[0], FLOOR))
        for run in runs
        if len(run.log.V) and np.isfinite(run.log.V).all() and run.log.V[0] > 0
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
        [(float(run.progress[len(V) - 1]), float(V[-1])) for run, V in curves if run.log.failed],
    )
