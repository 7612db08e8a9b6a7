"""The inputs of a rollout: constant, in rows, as a function of time, or from a CSV file."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.checks import array, beyond, did_you_mean, length, number
from softdyn.csv_columns import columns, numbers, once
from softdyn.validation.loop.experiment import DEFAULT_PERIOD
from softdyn.validation.loop.time_grid import TimeGrid

Inputs = np.ndarray | Callable[[float], Any]
EVEN = 0.01  # of a step; times from a recorder jitter
ROUNDING = 1e-9  # of an input's range


@dataclass(frozen=True, eq=False)
class InputRows:
    """Inputs of a CSV file.

    Attributes
    ----------
    u : np.ndarray, (rows, nu)
        The inputs; each is held until the next row.
    hold : float
        Time from row to row (s).
    seconds : float
        Time of the last row (s).
    """

    u: np.ndarray
    hold: float
    seconds: float


def held_inputs(
    model: SoftModel,
    inputs: Any,
    duration: float,
    hold: float | None = None,
    period: float | None = None,
    timestep: float | None = None,
) -> tuple[TimeGrid, np.ndarray]:
    """The time grid of a rollout, and the input (steps, nu) of each of its periods.

    Parameters are those of `rollout`.

    Raises
    ------
    InputError
        Inputs of another shape, not finite or beyond the robot's bounds, too few rows, and times
        that cannot be run.
    """
    number("duration", duration, above=0.0)
    form = np.ndarray | list | tuple
    rows = inputs if isinstance(inputs, form) and _is_nested(inputs) else None
    if hold is not None and rows is None:
        raise InputError("hold", "none where the inputs are no rows", hold)
    if rows is not None:
        rows = array("inputs", rows, (length("inputs", rows), model.nu), finite=False)
        hold = duration / max(len(rows), 1) if hold is None else number("hold", hold, above=0.0)
        if beyond(duration, len(rows) * hold):
            expected = f"rows for {duration:g} s, held {hold:g} s each"
            raise InputError("inputs", expected, f"{len(rows)} rows")
        each = max(1, math.ceil(hold / DEFAULT_PERIOD - 1e-9))
        if period is not None:
            each = round(hold / number("period", period, above=0.0))
            if not math.isclose(each * period, hold, rel_tol=1e-9):
                raise InputError("period", f"an integer part of a row's {hold:g} s", period)
        grid = TimeGrid.plan(duration, hold / each, timestep)
        rows = rows[np.minimum(np.arange(grid.steps) // each, len(rows) - 1)]
    else:
        grid = TimeGrid.plan(duration, DEFAULT_PERIOD if period is None else period, timestep)
        if isinstance(inputs, form):
            constant = array("inputs", inputs, (model.nu,), finite=False)
            rows = np.broadcast_to(constant, (grid.steps, model.nu))
        elif callable(inputs):
            times = grid.times()[:-1].tolist()
            rows = [array("inputs(t)", inputs(t), (model.nu,), finite=False) for t in times]
        else:
            expected = f"({model.nu},), (steps, {model.nu}) or a function t -> ({model.nu},)"
            raise InputError("inputs", expected, repr(inputs))
    return grid, _within_bounds(model, np.array(rows), grid.period)


def _is_nested(inputs: Any) -> bool:
    """Whether inputs have rows."""
    return bool(len(inputs)) and isinstance(inputs[0], np.ndarray | list | tuple)


def read_files(paths: Sequence[str], model: SoftModel) -> dict[str, InputRows]:
    """`read_inputs` of several files, by the files' names without their ends.

    Raises
    ------
    InputError
        Also for files of the same name, and for rows that are not equally far apart in all files.
    """
    names = [Path(path).stem for path in paths]
    if len(set(names)) < len(names):
        raise InputError("--inputs", "files with different names", ", ".join(names))
    found = [read_inputs(path, model) for path in paths]
    for path, rows in zip(paths, found, strict=True):
        if not math.isclose(rows.hold, found[0].hold, rel_tol=1e-9):
            expected = f"rows {found[0].hold:g} s apart, as in {paths[0]}"
            raise InputError(path, expected, f"{rows.hold:g} s")
    return dict(zip(names, found, strict=True))


def read_inputs(path: str | Path, model: SoftModel) -> InputRows:
    """Inputs from a CSV file with the columns ``t`` (s) and ``u.NAME`` for every input.

    The times begin at 0 and have even steps. Other columns, such as those of a log, are ignored.

    Raises
    ------
    InputError
        A file that cannot be read, an unknown, missing or doubled column, a cell that is no finite
        number, times that jump.
    """
    names = ["t", *(f"u.{actuator.name}" for actuator in model.robot.actuators)]
    _, header, rows = columns(path)
    for name in header:
        if name.startswith("u.") and name not in names:
            raise InputError(f"{path}: header", ", ".join(names), did_you_mean(name, names))
    once(path, header, names)
    kept = [header.index(name) for name in names]
    if len(rows) < 2:
        raise InputError(str(path), "two rows or more", f"{len(rows)}")
    table = numbers(path, names, [[row[k] for k in kept] for row in rows])
    t = table[:, 0]
    hold = (t[-1] - t[0]) / (len(t) - 1)
    late = np.flatnonzero(~(np.abs(np.diff(t, prepend=-hold) - hold) <= EVEN * hold))
    if late.size:
        k = int(late[0])
        expected = f"times from 0 in even steps, of {hold:g} s on average"
        raise InputError(f"{path}:{k + 2}: column t", expected, f"{t[k]:g}")
    return InputRows(table[:, 1:], hold, float(t[-1]))


def _within_bounds(model: SoftModel, rows: np.ndarray, period: float) -> np.ndarray:
    """The inputs (steps, nu), rid of rounding beyond the robot's bounds.

    Raises
    ------
    InputError
        An input that is not finite or farther beyond them.
    """
    room = ROUNDING * np.maximum(np.abs(model.u_min), np.abs(model.u_max))
    fits = (rows >= model.u_min - room) & (rows <= model.u_max + room) & np.isfinite(rows)
    for k, j in np.argwhere(~fits)[:1]:
        raise InputError(
            f"input {model.robot.actuators[j].name!r} at t = {k * period:g} s",
            f"{model.u_min[j]:g} to {model.u_max[j]:g}, its bounds",
            f"{rows[k, j]:g}",
        )
    return np.clip(rows, model.u_min, model.u_max)
