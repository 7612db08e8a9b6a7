"""A log as CSV, with units in the header; `softdyn identify` reads it."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING

import numpy as np

from softdyn.description.robot import input_units
from softdyn.description.stated_task import ROWS
from softdyn.exceptions import InputError
from softdyn.validation.loop.experiment import ROLLOUT

if TYPE_CHECKING:
    from softdyn.validation.loop.log import Log

BASE = ("x", "y", "z", "qx", "qy", "qz", "qw")  # of a floating base, before the joints
UNITS = {"prismatic": "m", "revolute": "rad", "continuous": "rad"}
UNIT_OF = dict(zip(ROWS, ("m", "m", "m", "rad", "rad", "rad"), strict=True)) | dict.fromkeys(
    ("dx", "dy", "dz"), ""
)  # of a target's numbers
RATES = {"rad": "rad/s", "m": "m/s", "": ""}


def csv_text(log: Log) -> str:
    """Every sample of a run as a row: time, inputs, coordinates, velocities, tip and target.

    A run with a rig has further columns: the commands, the inputs that act as forces, the sensors'
    readings, and the q and v that the controller saw. Estimated disturbances with their deviations,
    errors and targets (goal) of tasks and the reserves of barriers follow if there are any.

    The last row is the final state. No input begins there, so the row repeats the last input, the
    last command and the last state that the controller saw.

    Raises
    ------
    InputError, UrdfError
        The log has no control step, or lacks its robot's text, which has the names and units.
    """
    if not log.steps:
        raise InputError("log", "at least one control step", "none")
    model = log.source.model()
    units = {joint.name: UNITS[joint.kind] for joint in model.robot.moving_joints}
    coordinates = [(name, units.get(name, "")) for name in log.joint_names]
    rates = [(name, RATES[unit]) for name, unit in coordinates]
    if model.nq != model.nv:
        place = [(f"base.{name}", "m" if name in BASE[:3] else "") for name in BASE]
        coordinates = [*place, *coordinates[6:]]
    names = [actuator.name for actuator in model.robot.actuators]
    inputs = list(zip(names, input_units(model.robot), strict=True))
    axes = [(axis, "m") for axis in "xyz"]
    commands, readings = (
        list(zip(named, units or [""] * len(named), strict=True))
        for named, units in ((names, log.command_units), (log.sensor_names, log.sensor_units))
    )
    estimated = list(zip(log.disturbance_names, log.disturbance_units, strict=True))
    barriers = [(name, "m") for name in (log.surroundings.names if log.surroundings else ())]
    goals = [
        (name, UNIT_OF[name.rpartition(".")[2]]) for mark in log.marks for name in mark.columns
    ]
    groups = [
        ("u", inputs, log.u), ("q", coordinates, log.q), ("v", rates, log.v), ("tip", axes, log.y),
        ("target", axes, None if log.kind == ROLLOUT else log.y_ref),
        ("command", commands, log.command), ("acting", inputs, log.acting),
        ("measured", readings, log.measured),
        ("stamp", [(name, "s") for name, _ in readings], log.stamps),
        ("q_seen", coordinates, log.q_seen), ("v_seen", rates, log.v_seen),
        ("estimated", estimated, log.disturbances), ("deviation", estimated, log.deviations),
        ("task", list(zip(log.task_names, log.task_units, strict=True)), log.tasks),
        ("goal", goals, log.targets),
        ("reserve", barriers, log.reserve),
    ]  # fmt: skip
    there = [(kind, named, values) for kind, named, values in groups if values is not None]
    columns = [("t", "s")] + [
        (f"{kind}.{name}", unit) for kind, named, _ in there for name, unit in named
    ]
    samples = [np.concatenate([values, values[-1:]])[: len(log.t)] for _, _, values in there]
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow([f"{name} ({unit})" if unit else name for name, unit in columns])
    rows.writerows(np.column_stack([log.t, *samples]).tolist())
    return text.getvalue()
