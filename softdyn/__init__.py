"""softdyn: analytic models and controllers for underactuated soft robots."""

from __future__ import annotations

import warnings
from pathlib import Path

from softdyn._version import __version__
from softdyn.catalogue import bundled_name, bundled_names, find
from softdyn.exceptions import InputError, SoftdynError, UrdfError
from softdyn.model import SoftModel
from softdyn.references import Ellipse, Reference, SetPoint
from softdyn.state import State
from softdyn.urdf import Robot, parse


def load(source: str | Path) -> SoftModel:
    """Load a robot: a bundled name, a path to an annotated URDF, or an example-robot-data name.

    Raises
    ------
    InputError
        No such robot.
    UrdfError
        A file that cannot be used; the message names file, element, expected and got.
    """
    path = find(source)
    robot = parse(path)
    model = SoftModel(robot, bundled_name(path))
    for warning in robot.warnings:
        warnings.warn(warning, stacklevel=2)
    return model


__all__ = [
    "Ellipse",
    "InputError",
    "Reference",
    "Robot",
    "SetPoint",
    "SoftModel",
    "SoftdynError",
    "State",
    "UrdfError",
    "__version__",
    "bundled_names",
    "load",
    "parse",
]
