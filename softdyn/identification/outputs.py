"""The outputs that a motion of the model would give, and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softdyn.checks import instance, instances
from softdyn.description.robot import Robot
from softdyn.dynamics.model import SoftModel, check_model
from softdyn.exceptions import InputError
from softdyn.identification.data import AXES
from softdyn.identification.unknowns.sensor_errors import READ, layout_of

MARKS = ("point.", "pose.", READ)


def of_sensors(robot: Robot, names: Sequence[str], weights: np.ndarray) -> np.ndarray:
    """The weight of the sensor (sensors,) of each output (outputs,); 0 for other outputs."""
    found = {
        READ + name: weight
        for sensor, weight in zip(layout_of(robot).sensors, weights, strict=True)
        for name in sensor.reading_names
    }
    return np.array([found.get(name, 0.0) for name in names])


def compute_outputs(
    model: SoftModel, names: Sequence[str], path: np.ndarray, by: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs (N, outputs) of a path (N, n), and their derivatives from the path's.

    Those of a rotation vector are by a turn in the marker's own axes.
    """
    instances("names", names, str, "an output's name")
    for name, value, axes in (("path", path, 2), ("by", by, 3)):
        shape = instance(name, value, np.ndarray, "an array").shape
        if len(shape) != axes or shape[:2] != (len(path), check_model(model).nv):
            raise InputError(name, f"{axes} axes, the first (N, {model.nv})", f"shape {shape}")
    out, slope = np.empty((len(path), len(names))), np.empty((len(path), len(names), by.shape[2]))
    joints = {f"q.{name}": k for k, name in enumerate(model.joint_names)}
    of_joints = [(k, joints[name]) for k, name in enumerate(names) if name in joints]
    of_tip = [(k, AXES.index(name[-1])) for k, name in enumerate(names) if name.startswith("tip.")]
    lengths = {f"length.{name}": k for k, name in enumerate(model.tendons.names)}
    of_cables = [(k, lengths[name]) for k, name in enumerate(names) if name in lengths]
    for k, j in of_joints:
        out[:, k], slope[:, k] = path[:, j], by[:, j]
    of_marks = [(k, name) for k, name in enumerate(names) if name.startswith(MARKS)]
    if of_tip or of_cables or of_marks:
        still, none = np.zeros(model.nv), np.zeros(model.nu)
        rows: list[tuple[int, int]] = []
        for i, point in enumerate(path):
            state = model.state(model.configuration(point), still)
            for k, axis in of_tip:
                out[i, k], slope[i, k] = state.y[axis], state.J[axis] @ by[i]
            for k, t in of_cables:
                out[i, k], slope[i, k] = state.lengths[t], state.moment_arms[t] @ by[i]
            if of_marks:
                found = model.measure(state, none)
                known = found.components.names
                rows = rows or [(k, known.index(name.partition(".")[2])) for k, name in of_marks]
                for k, row in rows:
                    out[i, k] = found.values[row]
                    slope[i, k] = found.jacobian[row, : model.nv] @ by[i]
    return out, slope
