"""Names of robots, controllers and experiments in tables, figures and pages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from softdyn.controllers.registry import label_of
from softdyn.validation.loop.experiment import ROLLOUT
from softdyn.validation.loop.log_data import LogData

ROBOTS = {
    "finger": "Finger", "helix": "Helix", "spirob": "SpiRob", "spirob48": "SpiRob (48 DOF)",
}  # fmt: skip
SYMBOLS = {"set_point": "θ", "tracking": "ω"}


def controller_title(name: str) -> str:
    """A controller's name for display; FILE.py:CLASS becomes its last part."""
    title = label_of(name)
    return title if title != name else Path(name).name


def robot_title(name: str) -> str:
    """A robot's name for display; a path becomes its last part."""
    return ROBOTS.get(name) or Path(name).stem


def experiment_title(kind: str, value: float) -> str:
    """θ of a set point or ω of a trajectory; `value` is in multiples of π."""
    multiple = {0.0: "0", 1.0: "π"}.get(value, f"{value:g}π")
    return f"{SYMBOLS[kind]} = {multiple}{' rad/s' if kind == 'tracking' else ''}"


def cell_title(kind: str, value: Any) -> str:
    """The target of a table's cell: θ or ω as a multiple of π, a point (m) or a file."""
    if kind in SYMBOLS:
        return f"{SYMBOLS[kind]} = {value:g}π"
    if isinstance(value, str):  # a trajectory of one's own
        return Path(value).name
    return "(" + ", ".join(f"{x:g}" for x in value) + ") m"


def goal(log: LogData) -> str:
    """A run's target in words."""
    if log.theta is not None:
        return f"set point {experiment_title('set_point', log.theta)}"
    if log.omega is not None:
        return f"tracking {experiment_title('tracking', log.omega)}"
    if log.kind == ROLLOUT:
        return "rollout"
    if np.ptp(log.y_ref, axis=0).max() > 0:
        return "tracking"
    return "set point (" + ", ".join(f"{x:g}" for x in log.y_ref[0]) + ") m"


def labels_of(logs: Sequence[LogData]) -> list[str]:
    """The controllers' names; or the robot, the goal and the plant, where they differ."""
    parts: list[list[Any]] = [
        [controller_title(log.controller) for log in logs],
        [log.robot for log in logs],
        [goal(log) for log in logs],
        [log.plant or "simulated" for log in logs],
    ]
    shown = [column for column in parts if len(set(column)) > 1] or parts[:1]
    return [", ".join(column[i] for column in shown) for i in range(len(logs))]
