"""Presets from a table: a log-spiral arm, a finger."""

from __future__ import annotations

import math

from softdyn.design import finger, log_spiral
from softdyn.design.arm_table import MOTIONS, PAIRS, read_mount, read_name
from softdyn.design.chain import Input
from softdyn.design.shapes import phalanx_mesh, spiral_mesh, stl
from softdyn.exceptions import errors_in
from softdyn.toml_table import TomlTable

TURNS = {name: name for name in MOTIONS if name in ("bend", "bend_y", "bend_z", "twist")}
Files = tuple[str, str, dict[str, bytes]]
"""Name, URDF, and meshes by their path beside it."""


def read_spiral(table: TomlTable) -> Files:
    """A log-spiral arm, from ``[log_spiral]``."""
    name, own = read_name(table), table.needed("log_spiral")
    mount = read_mount(table.table("mount"))
    table.rest()
    count, first = own.count("cables", 3), own.number("angle", "angle", 0.0)
    words = own.words("freedoms", TURNS, ["bend", "twist"])
    with errors_in(own.where):
        spiral = log_spiral.LogSpiral(
            length=own.number("length", "length"),
            mass=own.number("mass", "mass"),
            segments=own.count("segments", 10, 2),
            ratio=own.number("ratio", "none"),
            radius=own.number("radius", "length"),
            stiffness=own.number("joint_stiffness", "stiffness"),
            damping=own.number("joint_damping", "damping"),
            armature=own.number("joint_armature", "inertia", 0.0),
            freedoms=tuple(one for word in words for one in reversed(PAIRS.get(word, (word,)))),
            cable_angles=tuple(math.degrees(first) + 360 * i / count for i in range(count)),
            cable=Input(-1.0, (0, own.number("max_tension", "force"))),
            mount=mount,
            name=name,
        )
    own.rest()
    return name, log_spiral.urdf(spiral), {"meshes/spiral.stl": stl(spiral_mesh())}


def read_finger(table: TomlTable) -> Files:
    """A finger, from ``[finger]`` and its ``[[tendon]]``s."""
    name, own = read_name(table), table.needed("finger")
    mount = table.table("mount")
    tendons = []
    for k, item in enumerate(table.tables("tendon"), 1):
        with errors_in(item.where):
            tendons.append(
                finger.FingerTendon(
                    joints=tuple(
                        int(j) if j.is_integer() else j for j in item.numbers("joints", "none")
                    ),
                    moment_arms=item.numbers("moment_arm", "length", ()),
                    pulleys=item.numbers("pulley", "length", ()),
                    friction=item.number("friction", "none", 0.0),
                    max_tension=item.number("max_tension", "force"),
                    pair=item.flag("pair"),
                    name=item.text("name", f"tendon_{k}"),
                )
            )
        item.rest()
    table.rest()
    with errors_in(own.where):
        made = finger.Finger(
            lengths=own.numbers("lengths", "length"),
            radius=own.profile("radius", "length"),
            density=own.number("density", "density"),
            stiffness=own.profile("joint_stiffness", "stiffness"),
            damping=own.profile("joint_damping", "damping"),
            tendons=tuple(tendons),
            limit=own.number("joint_limit", "angle", math.pi / 2),
            mount=finger.FORWARD if mount is None else read_mount(mount),
            name=name,
        )
    own.rest()
    return name, finger.urdf(made), {"meshes/phalanx.stl": stl(phalanx_mesh())}
