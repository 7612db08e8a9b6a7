"""What robots, controllers and experiments are called in tables, figures and pages."""

from __future__ import annotations

from pathlib import Path

CONTROLLERS = {
    "soft-id-clf-qp": "Soft ID-CLF-QP",
    "id-clf-qp": "ID-CLF-QP (hard)",
    "clf-qp": "CLF-QP",
    "ic": "IC",
    "uic": "UIC",
    "ic-qp": "IC-QP",
}
ROBOTS = {
    "finger": "Finger", "helix": "Helix", "spirob": "SpiRob", "spirob48": "SpiRob (48 DOF)",
}  # fmt: skip
SYMBOLS = {"set_point": "θ", "tracking": "ω"}


def controller_title(name: str) -> str:
    """A controller's name for people; of a user's FILE.py:CLASS its last part."""
    return CONTROLLERS.get(name) or Path(name).name


def robot_title(name: str) -> str:
    """A robot's name for people; of a path its last part."""
    return ROBOTS.get(name) or Path(name).stem


def experiment_title(kind: str, value: float) -> str:
    """θ of a set point or ω of a trajectory; `value` is in multiples of π."""
    multiple = {0.0: "0", 1.0: "π"}.get(value, f"{value:g}π")
    return f"{SYMBOLS[kind]} = {multiple}{' rad/s' if kind == 'tracking' else ''}"
