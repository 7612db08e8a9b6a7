"""The filter over recorded data of a rig: estimates, and residuals by sensor."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from softdyn.csv_table import CsvTable
from softdyn.dynamics.model import SoftModel
from softdyn.estimation.ekf import Ekf
from softdyn.estimation.estimate import StateEstimate
from softdyn.estimation.parameters import EkfCounts
from softdyn.exceptions import InputError

BIASED = 5.0  # standard deviations of a mean residual; with more it is no chance
SETTLED = 0.25  # of the data; residuals before are of the start


@dataclass(frozen=True)
class SensorResiduals:
    """Residuals of one reading after the first quarter of the data.

    Attributes
    ----------
    name : str
        The reading, e.g. ``camera.x``.
    used : int
        Readings used.
    mean, error : float
        Mean residual, in the reading's unit, and the standard deviation of this mean: a bias that
        the file does not state, or a force that the model lacks.
    rms : float
        Root mean square of the residuals.
    normalised : float
        Root mean square in deviations; 1 in a consistent filter.
    """

    name: str
    used: int
    mean: float
    error: float
    rms: float
    normalised: float

    @property
    def biased(self) -> bool:
        """Whether the mean is too far from zero for chance: a bias, or a force that lacks.

        One reading alone has no standard deviation and says nothing.
        """
        return abs(self.mean) > BIASED * self.error > 0


@dataclass(frozen=True, eq=False)
class ObservedData:
    """Estimates over recorded data.

    Attributes
    ----------
    t : ndarray, (N,)
        Times (s).
    estimates : tuple of StateEstimate, (N,)
        The estimate at each.
    residuals : tuple of SensorResiduals
        One for each reading.
    counts : EkfCounts
        What the filter did with the data.
    """

    t: np.ndarray
    estimates: tuple[StateEstimate, ...]
    residuals: tuple[SensorResiduals, ...]
    counts: EkfCounts

    def to_dict(self) -> dict[str, Any]:
        """The figures as plain data, with the last estimate."""
        last = self.estimates[-1]
        found = {}
        for name, value in last.disturbances.items():
            low, high = last.interval(name)
            found[name] = {"value": value.tolist(), "low": low.tolist(), "high": high.tolist()}
        return {
            "samples": len(self.t), "q": last.q.tolist(), "disturbances": found,
            "residuals": [{**vars(one), "bias": one.biased} for one in self.residuals],
            "counts": vars(self.counts),
        }  # fmt: skip

    def __str__(self) -> str:
        width = max(len(one.name) for one in self.residuals)
        head = f"{'reading':{width}}   used        mean ± error         rms  in deviations"
        lines = [
            f"{one.name:{width}} {one.used:6}  {one.mean:10.3g} ± {one.error:<8.2g} "
            f"{one.rms:9.3g}  {one.normalised:13.2f}"
            + (f"   bias? {abs(one.mean) / one.error:.0f} standard errors" if one.biased else "")
            for one in self.residuals
        ]
        for name, found in self.to_dict()["disturbances"].items():
            parts = zip(found["value"], found["low"], found["high"], strict=True)
            lines += [f"{name}: {value:.4g} [{low:.4g}, {high:.4g}]" for value, low, high in parts]
        odd = {name: n for name, n in vars(self.counts).items() if n and name != "used"}
        lines += [f"{name}: {n}" for name, n in odd.items()]
        return "\n".join([head, *lines])


class RecordedRows(NamedTuple):
    """The rows of recorded data.

    Attributes
    ----------
    t : ndarray, (N,)
        Times (s).
    readings : ndarray, (N, k)
        The sensors' readings, NaN for one that is not there.
    sent : ndarray, (N, nu)
        The commands of the row before, as `Ekf.step` takes them.
    """

    t: np.ndarray
    readings: np.ndarray
    sent: np.ndarray


def observe_data(model: SoftModel, observer: Ekf, path: str | Path) -> ObservedData:
    """Run a filter over a CSV file, see `read_rows`.

    Parameters
    ----------
    model : SoftModel
        The robot.
    observer : Ekf
        Its filter.
    path : str or Path
        The file.

    Raises
    ------
    InputError
        As `read_rows` does.
    """
    rows = read_rows(model, observer.reading_names, path)
    observer.reset()
    estimates = tuple(observer.step(*row) for row in zip(*rows, strict=True))
    first = int(SETTLED * len(rows.t))
    raw, normalised = (
        np.array([getattr(one, name) for one in estimates[first:]])
        for name in ("residuals", "normalised")
    )
    return ObservedData(
        rows.t, estimates,
        tuple(
            _residuals(name, raw[:, k], normalised[:, k])
            for k, name in enumerate(observer.reading_names)
        ),
        observer.counts,
    )  # fmt: skip


def read_rows(model: SoftModel, reading_names: Iterable[str], path: str | Path) -> RecordedRows:
    """Read a CSV file of a rig.

    Its columns are ``t`` (s), for every input ``command.INPUT``, or ``u.INPUT`` where the file has
    no commands, held from a row to the next, and for every reading ``measured.NAME``. Cells of
    readings may be empty. A log's CSV is such a file; other columns are left out.

    Parameters
    ----------
    model : SoftModel
        The robot.
    reading_names : sequence of str
        The readings, `Ekf.reading_names`.
    path : str or Path
        The file.

    Raises
    ------
    InputError
        A file that cannot be read, a column that is not there or is there twice, a cell that is no
        number, no row.
    """
    file = CsvTable(path)
    inputs = [actuator.name for actuator in model.robot.actuators]
    kind = "command" if any(name.startswith("command.") for name in file.names) else "u"
    names = ["t", *(f"{kind}.{name}" for name in inputs)]
    names += [f"measured.{name}" for name in reading_names]
    table = file.numbers(names, ("measured.",))
    if len(table) < 2:
        raise InputError(str(path), "at least two rows", str(len(table)))
    u = table[:, 1 : 1 + len(inputs)]
    sent = np.vstack((np.zeros(len(inputs)), u[:-1]))
    return RecordedRows(table[:, 0], table[:, 1 + len(inputs) :], sent)


def _residuals(name: str, raw: np.ndarray, normalised: np.ndarray) -> SensorResiduals:
    raw, normalised = raw[np.isfinite(normalised)], normalised[np.isfinite(normalised)]
    if not len(raw):
        return SensorResiduals(name, 0, np.nan, np.nan, np.nan, np.nan)
    return SensorResiduals(
        name, len(raw), float(raw.mean()), float(raw.std() / np.sqrt(len(raw))),
        float(np.sqrt(np.mean(raw**2))), float(np.sqrt(np.mean(normalised**2))),
    )  # fmt: skip
