"""Make a robot's files from a table: an arm of sections, or one of the presets."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from softdyn.checks import did_you_mean
from softdyn.design.arm_file import urdf
from softdyn.design.arm_table import read_arm
from softdyn.design.layout import lay_out
from softdyn.design.plausible import check
from softdyn.design.preset_tables import Files, read_finger, read_spiral
from softdyn.design.rods import Arm
from softdyn.exceptions import InputError, errors_in
from softdyn.toml_table import TomlTable


@dataclass(frozen=True)
class Design:
    """The files of one robot, before they are written.

    Attributes
    ----------
    name : str
        The robot's name.
    text : str
        Its annotated URDF.
    meshes : mapping of str to bytes
        Mesh files that the URDF names, by their path below its folder.
    figures : mapping of str to float
        Key figures such as mass and first frequency, by name and unit.
    """

    name: str
    text: str
    meshes: Mapping[str, bytes] = field(default_factory=dict)
    figures: Mapping[str, float] = field(default_factory=dict)


PRESETS: dict[str, Callable[[TomlTable], Files]] = {
    "log_spiral": read_spiral,
    "finger": read_finger,
}
"""The reader of each preset, by the name of its table."""


def read(values: Mapping[str, Any], file: str = "table") -> Design:
    """The robot that a table describes, as `softdyn new` reads it from TOML.

    Parameters
    ----------
    values : mapping
        The table.
    file : str
        The table's file, for messages.

    Raises
    ------
    InputError
        For a bad table; it names file, table and key, what was expected and what was got.
    """
    table = TomlTable(values, file)
    for name, preset in PRESETS.items():
        if name in values:
            return Design(*preset(table))
    if "section" not in values:
        said = [did_you_mean(key, ("section", *PRESETS)) for key in values]
        near = [one for one in said if one.endswith("?")]
        expected = f"[[section]] or [{'] or ['.join(PRESETS)}]"
        raise InputError(file, expected, ", ".join(near or values) or "nothing")
    return design(make_arm(values, file))


def make_arm(values: Mapping[str, Any], file: str = "table") -> Arm:
    """The arm of sections that a table describes; see `read`."""
    table = TomlTable(values, file)
    arm = read_arm(table)
    table.rest()
    with errors_in(file):
        check(lay_out(arm))
    return arm


def design(arm: Arm) -> Design:
    """The files and key figures of an arm."""
    layout = lay_out(arm)
    figures = {
        "length_m": arm.length,
        "mass_kg": sum(body.mass for body in layout.bodies),
        "degrees_of_freedom": len(layout.all_springs),
        "inputs": len(arm.paths),
        "first_frequency_Hz": float(layout.rates[0]) / 2 / math.pi,
        "fastest_mode_rad_s": float(layout.rates[-1]),
    }
    return Design(arm.name, urdf(arm), {}, figures)
