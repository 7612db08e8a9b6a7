"""softdyn: analytic models and controllers for underactuated soft robots."""

from __future__ import annotations

import warnings
from pathlib import Path

from softdyn._version import __version__
from softdyn.catalogue import bundled_name, bundled_names, find
from softdyn.exceptions import InputError, SoftdynError, UrdfError
from softdyn.mimic import build
from softdyn.model import SoftModel
from softdyn.references import Ellipse, Reference, SetPoint
from softdyn.state import State
from softdyn.urdf import Robot, parse


def load(
    source: str | Path,
    *,
    annotations: str | Path | None = None,
    floating: bool = False,
    repair_inertia: bool = False,
) -> SoftModel:
    """Load a robot: a bundled name, a path to an annotated URDF, or an example-robot-data name.

    Parameters
    ----------
    source : which robot.
    annotations : a file that holds the ``<softdyn>`` block, for a URDF without one.
    floating : let the root link move freely: q then starts with its position and a quaternion
        (x, y, z, w), v with its velocity and angular velocity in its own axes.
    repair_inertia : replace impossible inertias by the nearest possible ones, with a warning each.

    Raises
    ------
    InputError
        No such robot.
    UrdfError
        A file that cannot be used; the message names file, element, expected and got.
    """
    path = find(source)
    robot = parse(path, annotations=annotations, floating=floating, repair_inertia=repair_inertia)
    # published gains belong to the bundled file as it is
    model = build(robot, None if annotations or floating else bundled_name(path))
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
    "build",
    "bundled_names",
    "load",
    "parse",
]
