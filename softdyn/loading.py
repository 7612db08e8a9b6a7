"""Load a model by name or from a file: `softdyn.load`."""

from __future__ import annotations

import warnings
from pathlib import Path

from softdyn.description.library import bundled_file, bundled_name, find
from softdyn.description.urdf import parse, parse_text
from softdyn.dynamics.mimic import build
from softdyn.dynamics.model import SoftModel


def load(
    source: str | Path,
    *,
    annotations: str | Path | None = None,
    floating: bool = False,
    repair_inertia: bool = False,
    root: str | Path | None = None,
) -> SoftModel:
    """Load a robot: a bundled name, a path to an annotated URDF, or an example-robot-data name.

    Parameters
    ----------
    source : str or Path
        The robot's name or path.
    annotations : str or Path, optional
        A file that holds the ``<softdyn>`` block, for a URDF without one.
    floating : bool
        Let the root link move freely. Then q starts with its position and a quaternion
        (x, y, z, w), and v with its velocity and angular velocity in its own axes.
    repair_inertia : bool
        Replace impossible inertias by the nearest possible ones, with a warning each.
    root : str or Path, optional
        A folder below which meshes may lie, too; by default only the robot's own folder.

    Raises
    ------
    InputError
        If there is no such robot or folder.
    UrdfError
        If the file cannot be used; the message names file, element, expected and got.
    """
    path = find(source)
    robot = parse(
        path, annotations=annotations, floating=floating, repair_inertia=repair_inertia, root=root
    )
    # published gains belong to the unchanged bundled file only
    model = build(robot, None if annotations or floating else bundled_name(path))
    for warning in robot.warnings:
        warnings.warn(warning, stacklevel=2)
    return model


def load_text(
    text: str,
    annotations: str = "",
    *,
    path: str | Path,
    floating: bool = False,
    bundled: str | None = None,
) -> SoftModel:
    """Load a robot from its text, as a log holds it.

    Parameters
    ----------
    text, annotations : str
        `Robot.text` and `Robot.annotations`.
    path : str or Path
        The text's former file; meshes are searched beside it.
    floating : bool
        Let the root link move freely.
    bundled : str, optional
        The bundled robot's name, if it was one. It is ignored if the bundled file has changed.

    Raises
    ------
    UrdfError
        If the text cannot be used.
    """
    robot = parse_text(text, annotations, path=Path(path), floating=floating)
    file = None if bundled is None else bundled_file(bundled)
    same = file is not None and parse(file).digest == robot.digest
    return build(robot, bundled if same else None)
