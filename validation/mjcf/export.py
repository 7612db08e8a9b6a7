"""Robots written in the other format, read back, and compared with their source."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from softdyn.description.library import find
from softdyn.description.urdf import parse
from softdyn.description.urdf_writer import write
from softdyn.dynamics.forces import check_forces
from softdyn.exceptions import UrdfError
from softdyn.toml_table import TomlTable
from softdyn.validation.files import write_text
from softdyn.validation.mjcf.comparison.comparison import compare_neutral
from softdyn.validation.mjcf.comparison.finding import beyond_urdf
from softdyn.validation.mjcf.comparison.from_urdf import from_urdf
from softdyn.validation.mjcf.comparison.neutral import FLUID, RELAXATION, Neutral, Numbers
from softdyn.validation.mjcf.comparison.result import Comparison
from softdyn.validation.mjcf.comparison.side import Side, neutral
from softdyn.validation.mjcf.mjcf_file import Contents
from softdyn.validation.mjcf.to_mjcf import lost, to_mjcf
from softdyn.validation.mjcf.to_urdf import to_urdf
from softdyn.validation.mjcf.urdf_shapes import Looks, looks_of
from softdyn.validation.twin.rig import Rig

# fields of a `Rig` that an actuator of the file has
MOTORS = ("lag", "delay", "rate", "command", "stiffness", "damping")
Outcome = tuple[Comparison, tuple[str, ...]]


def write_mjcf(
    source: str | Path,
    target: str | Path,
    *,
    annotations: str | Path | None = None,
    floating: bool = False,
    repair_inertia: bool = False,
    root: str | Path | None = None,
    shapes: bool = True,
    contacts: bool = False,
    forces: Iterable[Any] = (),
    motors: Mapping[str, Any] | None = None,
) -> Outcome:
    """Write a URDF as MJCF.

    Parameters
    ----------
    source : str or Path
        The robot; `annotations`, `floating`, `repair_inertia` and `root` too are arguments of
        `softdyn.load`.
    target : str or Path
        The file to write.
    shapes : bool
        Whether to write the visual shapes.
    contacts : bool
        Whether the collision shapes can touch.
    forces : iterable of Force
        Forces of one's own that act on the robot; no MJCF states them.
    motors : mapping, optional
        Fields of a `Rig` that replace those of the file's motors, some of `MOTORS`.

    Returns
    -------
    tuple[Comparison, tuple[str, ...]]
        The comparison with the written file, and the properties that it does not state.

    Raises
    ------
    UrdfError
        For a file that cannot be used.
    InputError
        For motors that cannot be used.
    """
    robot = parse(
        find(source), annotations=annotations, floating=floating, repair_inertia=repair_inertia,
        root=root,
    )  # fmt: skip
    robot = replace(robot, forces=check_forces(tuple(forces)))
    if motors is not None:
        robot = Rig(**TomlTable(motors, "motors").rest(MOTORS)).robot(robot)
    write_text(str(target), to_mjcf(robot, shapes=shapes, contacts=contacts))
    return _compared(from_urdf(robot), neutral(target)), tuple(lost(robot))


def write_urdf(
    source: str | Path, target: str | Path, *, shapes: bool = True, root: Path | None = None
) -> Outcome:
    """Write an MJCF, or a URDF, as an annotated URDF; arguments and result as `write_mjcf`.

    Parameters
    ----------
    source, target : str or Path
        The file to read, and the one to write.
    shapes : bool
        Whether to write the shapes of an MJCF. Those of a URDF are left out.
    root : Path, optional
        A folder below which includes and meshes may lie, beside the file's own folder.

    Raises
    ------
    UrdfError
        The file cannot be used, or a URDF cannot describe the robot; the message says why.
    """
    side = Side.of(source, Contents(root=root))
    robot = side.neutral
    sensors = [sensor.name for sensor in side.robot.sensors] if not side.is_mjcf else [
        words.get("name", tag) for tag, words in side.mjcf.sensors
    ]  # fmt: skip
    looks, unseen = _looks(side) if shapes else ({}, ())
    converted = to_urdf(robot, side.path.stem, looks)
    write_text(str(target), write(converted.robot))
    floating = any(part.kind == "free" for part in robot.parts)
    return _compared(robot, neutral(target, floating=floating)), (
        *converted.lost,
        *unseen,
        *unsaid(robot),
        *(f"sensor {name!r}" for name in sensors),
    )


def _looks(side: Side) -> tuple[Looks, tuple[str, ...]]:
    """The shapes that a URDF can state, and a line for each body whose shapes it cannot."""
    if not side.is_mjcf:
        count = sum(bool(link.looks) for link in side.robot.links)
        return {}, (f"shapes of {count} links",) if count else ()
    try:
        return looks_of(side.scene, side.neutral)
    except UrdfError as error:  # such as a missing mesh, which the dynamics do not need
        return {}, (f"all shapes: {error}",)


def unsaid(robot: Neutral) -> Iterator[str]:
    """A file's properties that a URDF cannot state, a line for each object."""
    for part in robot.parts:
        even = part.more.get("jnt_actfrcrange", (0.0, 0.0))
        known = {"jnt_actfrcrange"} if even[0] == -even[1] else set()  # equal to a URDF effort
        known.add(RELAXATION)
        own = {field: value for field, value in part.more.items() if field not in known}
        yield from _unsaid(f"joint {part.name!r}", own)
        if part.buoyancy is None:
            for link, share in part.gravcomp.items():
                yield f"link {link!r}: body_gravcomp {share:g}"
    for tendon in robot.cables:
        yield from _unsaid(f"tendon {tendon.name!r}", tendon.more)
    for motor in (m for m in robot.motors if not m.law):  # the others are left out
        yield from _unsaid(f"actuator {motor.name!r}", motor.more)
    for tie in robot.couplings:
        yield from _unsaid(f"that {tie.joint!r} follows {tie.leader!r}", tie.more)
    for equality in robot.equalities:
        yield f"equality {equality.kind}: {' and '.join(equality.ends)}"
    for field, value in robot.features.items():
        if field not in FLUID:
            yield f"{field} {_text(value)}"


def _unsaid(where: str, fields: dict[str, Numbers]) -> Iterator[str]:
    if said := [f"{name} {_text(value)}" for name, value in beyond_urdf(fields).items()]:
        yield f"{where}: {', '.join(said)}"


def _text(values: Numbers) -> str:
    return " ".join(f"{value:g}" for value in np.trim_zeros(values, "b")) or "0"


def _compared(one: Neutral, other: Neutral) -> Comparison:
    return compare_neutral(
        one, other, mapping=None, strict=False, samples=4, seed=0, begin=time.perf_counter()
    )
