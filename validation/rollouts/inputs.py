"""The inputs of a rollout: constant, in rows, as a function of time, or from a CSV file.

An input is a force, or the command of a motor behind its rig: a free length, a velocity, a force.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.checks import array, beyond, did_you_mean, length, number
from softdyn.csv_table import CsvTable
from softdyn.description.rig import CommandKind
from softdyn.validation.loop.experiment import DEFAULT_PERIOD
from softdyn.validation.loop.time_grid import TimeGrid
from softdyn.validation.twin.readings import command_units
from softdyn.validation.twin.rig import Rig, rig_of

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
    commands : tuple of str
        Names of the inputs that are commands of their motors.
    """

    u: np.ndarray
    hold: float
    seconds: float
    commands: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Commanded:
    """The inputs that are commands, and the bounds of all inputs.

    Attributes
    ----------
    direct : np.ndarray of bool, (nu,)
        Whether each input is the command of its motor.
    lower, upper : np.ndarray, (nu,)
        Bounds of u, or of the command: of a free length (m); a velocity has none.
    """

    direct: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    @classmethod
    def of(cls, model: SoftModel, names: Sequence[str], rig: Rig | str | None) -> Commanded:
        """The inputs of these names are commands of this rig's motors.

        Raises
        ------
        InputError
            An unknown name, and names without a rig.
        """
        if isinstance(names, str) or not all(isinstance(name, str) for name in names):
            raise InputError("commands", "names of inputs", repr(names))
        known = [actuator.name for actuator in model.robot.actuators]
        for name in names:
            if name not in known:
                raise InputError("commands", ", ".join(known), did_you_mean(name, known))
        direct = np.array([name in names for name in known], bool)
        lower, upper = model.u_min.copy(), model.u_max.copy()
        if direct.any():
            if (wanted := rig_of(rig)) is None:
                raise InputError("commands", "none without a rig", ", ".join(names))
            for k, actuator in enumerate(wanted.robot(model.robot).actuators):
                if direct[k] and actuator.command is CommandKind.LENGTH:
                    lower[k] = actuator.length_lower - actuator.zero
                    upper[k] = actuator.length_upper - actuator.zero
                elif direct[k] and actuator.is_speed:
                    lower[k], upper[k] = -math.inf, math.inf
        return cls(direct, lower, upper)


def held_inputs(
    model: SoftModel,
    inputs: Any,
    duration: float,
    hold: float | None = None,
    period: float | None = None,
    timestep: float | None = None,
    commanded: Commanded | None = None,
) -> tuple[TimeGrid, np.ndarray]:
    """The time grid of a rollout, and the input (steps, nu) of each of its periods.

    Parameters are those of `rollout`. By default no input is a command.

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
    commanded = commanded or Commanded.of(model, (), None)
    return grid, _within_bounds(model, np.array(rows), grid.period, commanded)


def read_files(
    paths: Sequence[str], model: SoftModel, rig: Rig | str | None = None
) -> dict[str, InputRows]:
    """`read_inputs` of several files, by the files' names without their ends.

    Raises
    ------
    InputError
        Also for files of the same name, for rows that are not equally far apart in all files, and
        for files with commands of other motors.
    """
    names = [Path(path).stem for path in paths]
    if len(set(names)) < len(names):
        raise InputError("--inputs", "files with different names", ", ".join(names))
    found = [read_inputs(path, model, rig) for path in paths]
    for path, rows in zip(paths, found, strict=True):
        if not math.isclose(rows.hold, found[0].hold, rel_tol=1e-9):
            expected = f"rows {found[0].hold:g} s apart, as in {paths[0]}"
            raise InputError(path, expected, f"{rows.hold:g} s")
        if rows.commands != found[0].commands:
            expected = f"commands of {_listed(found[0].commands)}, as in {paths[0]}"
            raise InputError(path, expected, _listed(rows.commands))
    return dict(zip(names, found, strict=True))


def read_inputs(path: str | Path, model: SoftModel, rig: Rig | str | None = None) -> InputRows:
    """Inputs from a CSV file with the columns ``t`` (s) and ``u.NAME`` for every input.

    With a rig ``command.NAME`` may stand in place of ``u.NAME``. A file may have both, such as the
    log of a run behind a rig: the commands count with a rig, the forces without one. The times
    begin at 0 and have even steps. Other columns, such as those of a log, are ignored.

    Raises
    ------
    InputError
        A file that cannot be read, an unknown, missing or doubled column, commands alone without a
        rig, commands in another unit, a cell that is no finite number, times that jump.
    """
    inputs = [actuator.name for actuator in model.robot.actuators]
    file = CsvTable(path)
    for kind in ("u.", "command."):
        known = [kind + name for name in inputs]
        for name in file.names:
            if name.startswith(kind) and name not in known:
                expected = ", ".join(["t", *known])
                raise InputError(f"{path}: header", expected, did_you_mean(name, known))
    commands = tuple(
        name for name in inputs
        if f"command.{name}" in file.names and (rig is not None or f"u.{name}" not in file.names)
    )  # fmt: skip
    if commands:
        _check_commands(path, file.titles, commands, model, rig)
    names = ["t", *(f"command.{name}" if name in commands else f"u.{name}" for name in inputs)]
    table = file.numbers(names)
    if len(table) < 2:
        raise InputError(str(path), "two rows or more", f"{len(table)}")
    t = table[:, 0]
    hold = (t[-1] - t[0]) / (len(t) - 1)
    late = np.flatnonzero(~(np.abs(np.diff(t, prepend=-hold) - hold) <= EVEN * hold))
    if late.size:
        k = int(late[0])
        expected = f"times from 0 in even steps, of {hold:g} s on average"
        raise InputError(f"{path}:{k + 2}: column t", expected, f"{t[k]:g}")
    return InputRows(table[:, 1:], hold, float(t[-1]), commands)


def _check_commands(
    path: str | Path,
    titles: Sequence[str],
    commands: tuple[str, ...],
    model: SoftModel,
    rig: Rig | str | None,
) -> None:
    """Refuse commands without a rig, and in other units than its motors have."""
    wanted = rig_of(rig)
    if wanted is None:
        expected = f"u.{commands[0]}, or --rig, with which motors take commands"
        raise InputError(f"{path}: header", expected, f"command.{commands[0]}")
    robot = wanted.robot(model.robot)
    for actuator, unit in zip(robot.actuators, command_units(robot), strict=True):
        column = f"command.{actuator.name}"
        for title in titles:
            if title.startswith(f"{column} (") and title != f"{column} ({unit})":
                raise InputError(f"{path}: header", f"{column} in {unit or '1'}", repr(title))


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "no motor"


def _is_nested(inputs: Any) -> bool:
    """Whether inputs have rows."""
    return bool(len(inputs)) and isinstance(inputs[0], np.ndarray | list | tuple)


def _within_bounds(
    model: SoftModel, rows: np.ndarray, period: float, commanded: Commanded
) -> np.ndarray:
    """The inputs (steps, nu), rid of rounding beyond their bounds.

    Raises
    ------
    InputError
        An input that is not finite or farther beyond them.
    """
    low, high = commanded.lower, commanded.upper
    largest = [np.abs(np.where(np.isfinite(bound), bound, 0.0)) for bound in (low, high)]
    room = ROUNDING * np.maximum(*largest)
    fits = (rows >= low - room) & (rows <= high + room) & np.isfinite(rows)
    for k, j in np.argwhere(~fits)[:1]:
        kind = "command of" if commanded.direct[j] else "input"
        raise InputError(
            f"{kind} {model.robot.actuators[j].name!r} at t = {k * period:g} s",
            f"{low[j]:g} to {high[j]:g}, its bounds",
            f"{rows[k, j]:g}",
        )
    return np.clip(rows, low, high)
