"""Load a model by name or from a file: `softdyn.load`."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from softdyn.description.library import bundled_file, bundled_name, find
from softdyn.description.robot import EARTH
from softdyn.description.urdf import parse, parse_text
from softdyn.dynamics.mimic import build
from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.projection import underlying_tree
from softdyn.dynamics.tree import TreeModel
from softdyn.exceptions import UrdfError
from softdyn.plausible import emptied_chambers


def load(
    source: str | Path,
    *,
    annotations: str | Path | None = None,
    floating: bool = False,
    repair_inertia: bool = False,
    gravity: Sequence[float] | None = None,
    forces: Iterable[Any] = (),
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
    gravity : array_like, (3,), optional
        Acceleration of gravity in the world's axes (m/s²), such as that of a tilted base; by
        default the file's, or 0 0 -9.81.
    forces : iterable of Force, optional
        Forces of one's own that act on the robot, as for `SoftModel.with_forces`.
    root : str or Path, optional
        A folder below which meshes may lie, too; by default only the robot's own folder.

    Raises
    ------
    InputError
        If there is no such robot or folder, for a force that does not meet
        `softdyn.dynamics.Force`, and for a gravity of another shape or one that is not finite.
    UrdfError
        If the file cannot be used, or states another gravity; if a chamber's area is not above 0 at
        a stretch that the inputs reach. The message names file, element, expected and got.
    """
    path = find(source)
    robot = parse(
        path, annotations=annotations, floating=floating, repair_inertia=repair_inertia,
        gravity=gravity, root=root,
    )  # fmt: skip
    # published gains belong to the unchanged bundled file only
    changed = annotations or floating or robot.gravity != EARTH
    bundled = None if changed else bundled_name(path)
    model = build(robot, bundled, forces=forces)
    _check_areas(underlying_tree(model)[0])
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
    gravity: Sequence[float] | None = None,
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
    gravity : array_like, (3,), optional
        Acceleration of gravity (m/s²), if it is not the text's.

    Raises
    ------
    UrdfError
        If the text cannot be used.
    """
    robot = parse_text(text, annotations, path=Path(path), floating=floating, gravity=gravity)
    file = None if bundled is None else bundled_file(bundled)
    same = file is not None and parse(file).digest == robot.digest
    return build(robot, bundled if same else None)


def _check_areas(tree: TreeModel) -> None:
    """Refuse an area that is not above 0 within the stretches that the inputs reach."""
    if tree.areas is None:
        return
    arms = tree.tendon_moment_arms(tree.q0)[tree.actuated]
    forces = np.sort(tree.gear * np.array([tree.u_min, tree.u_max]), axis=0)
    motors = tree.robot.actuators
    growths, lengths = zip(*((one.area_growth, one.area_length) for one in motors), strict=True)
    for k, expected, got in emptied_chambers(arms, tree.stiffness, forces, growths, lengths):
        where = f'<softdyn><actuator name="{motors[k].name}">'
        raise UrdfError(tree.robot.path, where, expected, got)
