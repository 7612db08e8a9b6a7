"""Runs whose errors are drawn: the random values and the changes of a sweep, one draw at a time.

A sweep runs every sample and every change. Here each draw takes one of the samples and one of the
changes. Sample k has the values that it has in a sweep with the same tables.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from softdyn import InputError, SoftModel
from softdyn.toml_table import TomlTable
from softdyn.validation.loop import setups
from softdyn.validation.studies.axes import Axis
from softdyn.validation.studies.engine.case import FILES, KINDS
from softdyn.validation.studies.sweep import GROUPS, RUN, TARGETS, by_group, place, run_options
from softdyn.validation.studies.sweep_file import read_axes

KEYS = (*GROUPS, "changes", "samples")
SAMPLES = {"count": 1000, "seed": 0}  # without a table of `samples`
# keys of [run] that an episode does not vary
FIXED = ("duration", "period", *FILES)


@dataclass(frozen=True)
class DrawnRun:
    """One draw.

    Attributes
    ----------
    change : str
        The name of the change, ``none`` without one.
    sample : int
        The number of the sample; -1 if nothing is random.
    values : dict of str to Any
        The drawn values by their names in a sweep, such as ``plant.mass``.
    options : dict of str to Any
        The same as keywords of `RunOptions`.
    """

    change: str
    sample: int
    values: dict[str, Any]
    options: dict[str, Any]


class DrawnRuns:
    """Errors of a plant and a rig, drawn from tables in the form of a sweep file.

    Parameters
    ----------
    table : mapping
        The tables `run`, `plant`, `rig`, `changes` and `samples` of a sweep. A random value has one
        value for each sample, of a list each draw takes one value. By default there are 1000
        samples of seed 0.
    model : SoftModel
        The robot.
    where : str
        Name of the tables, for messages.

    Raises
    ------
    InputError
        What the reader of a sweep refuses; gains, durations, periods and files.
    """

    def __init__(
        self, table: Mapping[str, Any], model: SoftModel, where: str = "randomised"
    ) -> None:
        given = TomlTable(table, where).rest(KEYS)
        reader, self._axes, self._changes, _ = read_axes(
            {"samples": SAMPLES, **given}, where, model
        )
        self._count = reader.count or 1
        axes = [*self._axes, *(axis for change in self._changes.values() for axis in change)]
        for axis in axes:
            group, key, _ = place(axis.name)
            if group not in GROUPS or (group == RUN and key in FIXED):
                expected = "values of plant, rig and run, without durations, periods and files"
                raise InputError(where, expected, axis.name)
        self.random = any(axis.drawn for axis in axes)
        self.varies = bool(axes)

    def draw(self, rng: np.random.Generator) -> DrawnRun:
        """One draw."""
        sample = int(rng.integers(self._count))
        change = list(self._changes)[int(rng.integers(len(self._changes)))]
        values = {axis.name: self._value(axis, sample, rng) for axis in self._axes}
        values |= {axis.name: self._value(axis, sample, rng) for axis in self._changes[change]}
        options = run_options(by_group(values))
        return DrawnRun(change, sample if self.random else -1, values, options)

    @staticmethod
    def _value(axis: Axis, sample: int, rng: np.random.Generator) -> Any:
        return axis.values[sample if axis.drawn else int(rng.integers(len(axis.values)))]


def target_points(table: Mapping[str, Any], model: SoftModel, where: str = "targets") -> np.ndarray:
    """The points (N, 3) (m) of a sweep's table of targets: values of `theta` and `point`.

    A random one gives 1000 points of seed 0.

    Raises
    ------
    InputError
        What the reader of a sweep refuses, and targets that move.
    """
    _, _, _, axes = read_axes({"samples": SAMPLES, "targets": dict(table)}, where, model)
    setup, found = setups.setup_of(model), []
    for axis in axes:
        if axis.name not in ("theta", "point"):
            raise InputError(where, "theta and point, which do not move", axis.name)
        make = KINDS[TARGETS[axis.name]]
        found += [make(setup, value).reference(0.0).y for value in axis.values]
    return np.array(found)
