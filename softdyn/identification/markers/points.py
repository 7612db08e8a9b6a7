"""The places of markers on the robot, and the sensors that stand for them.

A marker is read from a TOML file and becomes a position or pose sensor of the robot. Its column in
the data is ``point.NAME.x`` or ``pose.NAME.x``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from softdyn.checks import did_you_mean, instance, instances
from softdyn.description.inertia import ZERO, Vector
from softdyn.description.rig import Sensor, SensorKind
from softdyn.description.robot import Robot
from softdyn.design.layout import Layout
from softdyn.exceptions import InputError
from softdyn.toml_table import TomlTable

BEYOND = 1.1  # times the arm's length; a marker may stand out at the tip
PREFIX = {SensorKind.POSITION: "point.", SensorKind.POSE: "pose."}


@dataclass(frozen=True)
class Marker:
    """A marker on a link, or at a place along an arm that a TOML file describes.

    Attributes
    ----------
    name : str
    link : str
        Empty if `along` is given.
    along : float, optional
        Distance from the arm's base along its straight axis (m).
    xyz, rpy : tuple of float
        Its frame in the link's axes (m, rad), or in those of the arm's piece at `along`.
    pose : bool
        Whether its orientation is measured too.
    """

    name: str
    link: str = ""
    along: float | None = None
    xyz: Vector = ZERO
    rpy: Vector = ZERO
    pose: bool = False


def read_points(path: str | Path) -> tuple[Marker, ...]:
    """The markers of a file.

    Each ``[[point]]`` or ``[[pose]]`` has a ``name`` and either a ``link`` with ``xyz_mm``, or
    ``s_mm`` along the arm with ``offset_mm``. A pose has ``rpy_deg`` too.

    Raises
    ------
    InputError
        For a bad file; it names the table and the key.
    """
    return markers_of(TomlTable.read(path).values, str(path))


def markers_of(values: Mapping[str, Any], path: str) -> tuple[Marker, ...]:
    """The markers in a table, as `read_points` reads it."""
    table = TomlTable(values, path)
    found = [_marker(one, False) for one in table.tables("point")]
    found += [_marker(one, True) for one in table.tables("pose")]
    table.rest()
    if not found:
        raise InputError(path, "[[point]] or [[pose]]", "none")
    names = [one.name for one in found]
    for name in names:
        if names.count(name) > 1:
            raise InputError(path, "each name once", repr(name))
    return tuple(found)


def _marker(table: TomlTable, pose: bool) -> Marker:
    along, link = table.number("s", "length", None), table.text("link", "")
    if (along is None) == (not link):
        raise InputError(table.where, "link or s_mm", "both" if link else "none")
    key = "xyz" if link else "offset"
    xyz = table.vector(key, "length", ZERO)
    rpy = table.vector("rpy", "angle", ZERO) if pose else ZERO
    marker = Marker(table.text("name"), link, along, xyz, rpy, pose)
    table.rest()
    return marker


def marked(robot: Robot, markers: Sequence[Marker], layout: Layout | None = None) -> Robot:
    """The robot with a sensor for each marker, after its own sensors.

    Parameters
    ----------
    robot : Robot
    markers : sequence of Marker
    layout : Layout, optional
        The arm's layout, for markers at a place along it.

    Raises
    ------
    InputError
        For an unknown link, a place beyond the arm or on a robot that is no such arm, and a name
        that a sensor has.
    """
    instance("robot", robot, Robot, "a Robot")
    instance("layout", layout, (Layout, type(None)), "a Layout")
    links = [link.name for link in robot.links]
    sensors = list(robot.sensors)
    for one in instances("markers", markers, Marker, "a Marker"):
        where, link, xyz = f"marker {one.name!r}", one.link, one.xyz
        if any(one.name == sensor.name for sensor in sensors):
            raise InputError(where, "a name that no sensor has", repr(one.name))
        if one.along is not None:
            if layout is None:
                raise InputError(where, "a link; s is for arms of sections from a TOML", "s")
            if not 0 <= one.along <= BEYOND * layout.arm.length:
                expected = f"s from 0 to {layout.arm.length:g} m"
                raise InputError(where, expected, f"{one.along:g} m")
            link, xyz = layout.place(one.along, xyz)
        if link not in links:
            raise InputError(where, f"a link of {robot.name!r}", did_you_mean(link, links))
        kind = SensorKind.POSE if one.pose else SensorKind.POSITION
        sensors.append(Sensor(one.name, kind, link=link, xyz=xyz, rpy=one.rpy))
    return replace(robot, sensors=tuple(sensors))
