"""A log as CSV, with units in the header; `softdyn identify` reads it."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING

import numpy as np

from softdyn.description.robot import input_units
from softdyn.exceptions import InputError

if TYPE_CHECKING:
    from softdyn.validation.loop.log import Log

BASE = ("x", "y", "z", "qx", "qy", "qz", "qw")  # of a floating base, before the joints
UNITS = {"prismatic": "m", "revolute": "rad", "continuous": "rad"}
RATES = {"rad": "rad/s", "m": "m/s", "": ""}


def csv_text(log: Log) -> str:
    """Every sample of a run as a row: time, inputs, coordinates, velocities, tip and target.

    The last row is the final state. No input begins there, so the row repeats the last input and
    all columns have the same length.

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
    inputs = zip((a.name for a in model.robot.actuators), input_units(model.robot), strict=True)
    axes = [(axis, "m") for axis in "xyz"]
    columns = [("t", "s")] + [
        (f"{kind}.{name}", unit)
        for kind, named in (("u", inputs), ("q", coordinates), ("v", rates), ("tip", axes),
                            ("target", axes))
        for name, unit in named
    ]  # fmt: skip
    u = np.concatenate([log.u, log.u[-1:]])
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow([f"{name} ({unit})" if unit else name for name, unit in columns])
    rows.writerows(np.column_stack([log.t, u, log.q, log.v, log.y, log.y_ref]).tolist())
    return text.getvalue()
