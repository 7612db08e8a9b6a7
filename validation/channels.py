"""A quantity that a run records: its name, its columns with their units, and its values."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from softdyn import SoftModel
from softdyn.description.robot import input_units
from softdyn.description.stated_task import ROWS
from softdyn.description.task_mark import TaskMark

BASE = ("x", "y", "z", "qx", "qy", "qz", "qw")  # of a floating base, before the joints
ANGLES = {"prismatic": "m", "revolute": "rad", "continuous": "rad"}
RATES = {"rad": "rad/s", "m": "m/s", "": ""}
AXES = tuple((axis, "m") for axis in "xyz")
UNIT_OF = dict(zip(ROWS, ("m", "m", "m", "rad", "rad", "rad"), strict=True)) | dict.fromkeys(
    ("dx", "dy", "dz"), ""
)  # of a target's numbers


@dataclass(frozen=True, eq=False)
class LogChannel:
    """A quantity of a run.

    Attributes
    ----------
    name : str
        Its attribute of a log.
    columns, units : tuple of str or None, tuple of str
        Name and unit of each of its columns; None for one number per row, maybe with a unit.
    held : bool
        Whether a value is held from one sample to the next, as an input is. A run of N control
        steps has N such values, and N + 1 of any other channel.
    title : str
        First part of its columns' names in CSV, e.g. ``tip``.
    text : bool
        Whether it is text instead of numbers.
    values : np.ndarray, (N,) or (N + 1,), or with a second axis of the columns
        Its values; none before the run.
    """

    name: str
    columns: tuple[str, ...] | None = None
    units: tuple[str, ...] = ()
    held: bool = False
    title: str = ""
    text: bool = False
    values: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(
        cls, name: str, columns: Iterable[tuple[str, str]], title: str = "", held: bool = False
    ) -> LogChannel:
        """A channel from the (name, unit) of its columns."""
        pairs = list(columns)
        return cls(name, tuple(n for n, _ in pairs), tuple(u for _, u in pairs), held, title)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its columns in CSV, e.g. ``tip.x``."""
        title = self.title or self.name
        return (title,) if self.columns is None else tuple(f"{title}.{n}" for n in self.columns)

    @property
    def titles(self) -> tuple[str, ...]:
        """The same with units, e.g. ``tip.x (m)``."""
        units = self.units or ("",) * len(self.names)
        return tuple(f"{n} ({u})" if u else n for n, u in zip(self.names, units, strict=True))

    def empty(self, samples: int) -> np.ndarray:
        """An array for a number of samples, without a value yet: NaN, or no text."""
        rows = samples - self.held
        if self.text:
            return np.full(rows, "", dtype=object)
        return np.full(rows if self.columns is None else (rows, len(self.columns)), np.nan)

    def filled(self, values: np.ndarray) -> LogChannel:
        """The same channel with these values."""
        return replace(self, values=values)


def coordinates(model: SoftModel) -> list[tuple[str, str]]:
    """(name, unit) of every degree of freedom, in the order of v; no unit for a floating base."""
    units = {joint.name: ANGLES[joint.kind] for joint in model.robot.moving_joints}
    return [(name, units.get(name, "")) for name in model.joint_names]


def rates(model: SoftModel) -> list[tuple[str, str]]:
    """(name, unit) of every element of v."""
    return [(name, RATES[unit]) for name, unit in coordinates(model)]


def positions(model: SoftModel) -> list[tuple[str, str]]:
    """(name, unit) of every element of q; a continuous joint has cosine and sine."""
    base, joints = [], coordinates(model)
    if model.robot.floating:
        base = [(f"base.{name}", "m" if name in BASE[:3] else "") for name in BASE]
        joints = joints[6:]
    kinds = {joint.name: joint.kind for joint in model.robot.moving_joints}
    for name, unit in joints:
        circular = kinds.get(name) == "continuous"
        base += [(f"{name}.cos", ""), (f"{name}.sin", "")] if circular else [(name, unit)]
    return base


def inputs(model: SoftModel) -> list[tuple[str, str]]:
    """(name, unit) of every input, as a force."""
    names = [actuator.name for actuator in model.robot.actuators]
    return list(zip(names, input_units(model.robot), strict=True))


def goals(marks: Iterable[TaskMark]) -> list[tuple[str, str]]:
    """(name, unit) of every number of the targets of tasks."""
    return [(name, UNIT_OF[name.rpartition(".")[2]]) for mark in marks for name in mark.columns]


def every_run(model: SoftModel) -> tuple[LogChannel, ...]:
    """The channels of every run of a robot."""
    return (
        LogChannel("t", units=("s",)),
        LogChannel.of("u", inputs(model), held=True),
        LogChannel.of("q", positions(model)), LogChannel.of("v", rates(model)),
        LogChannel.of("y", AXES, "tip"), LogChannel.of("y_ref", AXES, "target"),
        LogChannel.of("error", AXES),
        LogChannel("V", held=True), LogChannel("delta", held=True),
        LogChannel("status", text=True, held=True), LogChannel("step_us", units=("us",), held=True),
    )  # fmt: skip
