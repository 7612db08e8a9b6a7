"""The quantities that every run of a robot records, with the names and units of their columns."""

from __future__ import annotations

from collections.abc import Iterable

from softdyn import SoftModel
from softdyn.controllers.channels import LogChannel
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
