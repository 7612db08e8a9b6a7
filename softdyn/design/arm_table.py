"""An arm from a table, as `softdyn new` reads it from TOML; ``docs/design.md`` lists the keys."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from softdyn.checks import number
from softdyn.description.inertia import ZERO, Vector
from softdyn.description.rig import CommandKind, Sensor, SensorKind
from softdyn.description.robot import EARTH, NO_FLUID, Fluid
from softdyn.description.stated_task import StatedTask, read_tasks
from softdyn.description.strict_xml import Element
from softdyn.design.cables import ArmSensor, Cable, CableMotor, Chamber, rotor_armature
from softdyn.design.layout import FREEDOMS, lay_out
from softdyn.design.quadrature import RULES
from softdyn.design.rods import (
    Arm,
    Damping,
    Material,
    Mount,
    Payload,
    Plate,
    Section,
    starts,
)  # fmt: skip
from softdyn.exceptions import InputError, UrdfError, errors_in
from softdyn.toml_table import TomlTable

ROUTINGS = {"channel": False, "discs": True}
"""Whether a cable runs straight from disc to disc."""
MOTIONS = {name: name for name in ("bend", *FREEDOMS, "shear")}  # bend and shear name a pair each
MOST_FITTED = 2  # degree of the polynomial through measured areas
PAIRS = {"bend": ("bend_y", "bend_z"), "shear": ("shear_y", "shear_z")}


def read_arm(table: TomlTable) -> Arm:
    """An arm of sections.

    Raises
    ------
    InputError
        For a bad table; it names file, table and key, what was expected and what was got.
    """
    material = _material(table.table("material"), None)
    sections = tuple(
        _section(item, k, material) for k, item in enumerate(table.tables("section"), 1)
    )
    if not sections:
        raise InputError(table.where, "[[section]]", "none")
    names = [section.name for section in sections]
    if len(set(names)) < len(names):
        raise InputError(table.where, "a unique name of each [[section]]", ", ".join(names))
    groups: dict[str, tuple[str, ...]] = {}
    cables: list[Cable] = []
    for k, item in enumerate(table.tables("cable"), 1):
        found = _cables(item, k, names)
        groups[item.text("name", f"cable_{k}")] = tuple(cable.name for cable in found)
        cables += found
    pushed: dict[str, tuple[str, ...]] = {}
    chambers: list[Chamber] = []
    for k, item in enumerate(table.tables("chamber"), 1):
        made = _chambers(item, k, names)
        pushed[item.text("name", f"chamber_{k}")] = tuple(chamber.name for chamber in made)
        chambers += made
    labels = [cable.name for cable in cables] + [chamber.name for chamber in chambers]
    if len(set(labels)) < len(labels):
        kind = "cable and chamber" if chambers else "cable"
        raise InputError(table.where, f"a unique name of each {kind}", ", ".join(labels))
    groups = {cable.name: (cable.name,) for cable in cables} | groups
    pushed = {chamber.name: (chamber.name,) for chamber in chambers} | pushed
    motors = tuple(_motor(item, groups) for item in table.tables("motor"))
    motors += tuple(_valve(item, pushed) for item in table.tables("valve"))
    lines = groups, pushed
    sensors = tuple(
        _sensor(item, k, lines, sections) for k, item in enumerate(table.tables("sensor"), 1)
    )
    with errors_in(table.where):
        arm = Arm(
            sections=sections,
            cables=tuple(cables),
            chambers=tuple(chambers),
            damping=_damping(table.table("damping")),
            mount=read_mount(table.table("mount")),
            fluid=_fluid(table.table("fluid")),
            payload=_payload(table.table("payload")),
            tip=table.vector("tip", "length", (0.0, 0.0, 0.0)),
            rule=table.choice("joints", RULES, "gauss"),
            unusual=table.flag("unusual"),
            name=read_name(table),
            motors=motors,
            sensors=sensors,
        )
        tasks, frames = _tasks(table, arm)
        return replace(arm, tasks=tasks, frames=frames)


def read_name(table: TomlTable) -> str:
    """The robot's name."""
    name: str = table.text("name", "arm")
    if not name or not name.isprintable():
        raise table.error("name", "a name of printable letters", repr(name))
    return name


def _fluid(table: TomlTable | None) -> Fluid:
    """The fluid around the arm; by default there is none."""
    if table is None:
        return NO_FLUID
    with errors_in(table.where):
        fluid = Fluid(
            table.number("density", "density", 0.0), table.number("viscosity", "viscosity", 0.0)
        )
    table.rest()
    return fluid


def read_mount(table: TomlTable | None) -> Mount:
    """The arm's mount; by default the arm hangs down from the origin."""
    if table is None:
        return Mount()
    with errors_in(table.where):
        mount = Mount(
            table.vector("position", "length", (0.0, 0.0, 0.0)),
            table.vector("direction", "none", (0.0, 0.0, -1.0)),
            table.number("roll", "angle", 0.0),
            table.vector("gravity", "acceleration", EARTH),
        )
    table.rest()
    return mount


def _material(table: TomlTable | None, default: Material | None) -> Material | None:
    if table is None:
        return default
    with errors_in(table.where):
        material = Material(
            table.number("youngs_modulus", "modulus"),
            table.number("poissons_ratio", "none", 0.49),
            table.number("density", "density", 1070.0),
            tuple((g, t) for g, t in table.rows("relaxation", "none", 2) or ()),
            table.text("modulus", ""),
        )
    table.rest()
    return material


def _section(table: TomlTable, k: int, material: Material | None) -> Section:
    own = _material(table.table("material"), material)
    if own is None:
        raise InputError(table.where, "[material], here or above all sections", "none")
    words = table.words("freedoms", MOTIONS, ["bend"])
    freedoms = tuple(name for word in words for name in PAIRS.get(word, (word,)))
    rest = table.table("rest_strain")
    strains = {}
    if rest is not None:
        for name, freedom in FREEDOMS.items():
            kind = "curvature" if freedom.turns else "none"
            strains[name] = rest.number(name, kind, 0.0)
        rest.rest()
    with errors_in(table.where):
        section = Section(
            length=table.number("length", "length"),
            radius=table.profile("radius", "length"),
            material=own,
            segments=table.count("segments", 10),
            freedoms=freedoms,
            inner_radius=table.profile("inner_radius", "length", 0.0),
            bending_stiffness=table.profile("bending_stiffness", "rigidity", None),
            torsional_stiffness=table.profile("torsional_stiffness", "rigidity", None),
            axial_stiffness=table.profile("axial_stiffness", "force", None),
            shear_stiffness=table.profile("shear_stiffness", "force", None),
            mass=table.number("mass", "mass", None),
            rest=strains,
            discs=table.count("discs", 0, 0),
            disc=_plate(table.table("disc"), own),
            plate=_plate(table.table("plate"), own),
            name=table.text("name", f"section_{k}"),
        )
    table.rest()
    return section


def _plate(table: TomlTable | None, material: Material) -> Plate | None:
    """A plate with a measured mass, or with a density, by default the section's."""
    if table is None:
        return None
    radius, thickness = (table.number(name, "length") for name in ("radius", "thickness"))
    density = table.number("density", "density", material.density)
    mass = table.number("mass", "mass", density * math.pi * radius * radius * thickness)
    with errors_in(table.where):
        plate = Plate(radius, thickness, mass)
    table.rest()
    return plate


def _damping(table: TomlTable | None) -> Damping:
    if table is None:
        return Damping(ratio=0.1)
    with errors_in(table.where):
        damping = Damping(
            table.number("ratio", "none", None),
            table.number("time_constant", "time", None),
            table.number("viscosity", "viscosity", None),
        )
    table.rest()
    return damping


def _payload(table: TomlTable | None) -> Payload | None:
    if table is None:
        return None
    with errors_in(table.where):
        payload = Payload(
            table.number("mass", "mass"),
            table.number("radius", "length"),
            table.number("ahead", "length", 0.0),
        )
    table.rest()
    return payload


def _cables(table: TomlTable, k: int, sections: list[str]) -> list[Cable]:
    """The `count` cables of one table, evenly spaced around the axis."""
    count = table.count("count", 1)
    name, first = table.text("name", f"cable_{k}"), table.number("angle", "angle", 0.0)
    places = {section: index for index, section in enumerate(sections)}
    common: dict[str, Any] = {
        "offset": table.profile("offset", "length"),
        "straight": table.choice("routing", ROUTINGS),
        "max_tension": table.number("max_tension", "force"),
        "start": table.choice("from", places, sections[0]),
        "end": table.choice("to", places, sections[-1]),
        "turns": table.number("turns", "none", 0.0),
        "stiffness": table.number("stiffness", "cable stiffness", 0.0),
        "damping": table.number("damping", "cable damping", 0.0),
        "rest": table.number("rest", "length", None),
        "slack": table.flag("slack"),
        "friction": table.number("friction", "none", 0.0),
    }
    with errors_in(table.where):
        found = [
            Cable(
                angle=first + 2 * math.pi * i / count,
                name=name if count == 1 else f"{name}_{i + 1}",
                **common,
            )
            for i in range(count)
        ]
    table.rest()
    return found


def _chambers(table: TomlTable, k: int, sections: list[str]) -> list[Chamber]:
    """The `count` chambers of one table, evenly spaced around the axis."""
    count = table.count("count", 1)
    name, first = table.text("name", f"chamber_{k}"), table.number("angle", "angle", 0.0)
    places = {section: index for index, section in enumerate(sections)}
    if table.text("section", None) is None:
        start = table.choice("from", places, sections[0])
        end = table.choice("to", places, sections[-1])
    else:
        start = end = table.choice("section", places)
    common: dict[str, Any] = {
        "offset": table.profile("offset", "length"),
        "straight": table.choice("routing", ROUTINGS, "channel"),
        "max_pressure": table.number("max_pressure", "pressure"),
        "min_pressure": table.number("min_pressure", "pressure", 0.0),
        **_area(table),
        "radius": table.number("radius", "length", None),
        "start": start,
        "end": end,
    }
    if common["area"] is None and common["radius"] is None:
        raise InputError(table.where, "area_mm2 or radius_mm", "none")
    with errors_in(table.where):
        found = [
            Chamber(
                angle=first + 2 * math.pi * i / count,
                name=name if count == 1 else f"{name}_{i + 1}",
                **common,
            )
            for i in range(count)
        ]
    table.rest()
    return found


def _area(table: TomlTable) -> dict[str, Any]:
    """The area of a chamber: a number, coefficients of λ - 1, or values at stretches λ."""
    given, measured = table.profile("area", "area", None), table.rows("areas", "area", 2)
    if measured is not None:
        if given is not None:
            raise table.error("areas", "areas or area, not both", "both")
        stretch, area = np.array(measured).T
        degree = min(len(set(stretch.tolist())) - 1, MOST_FITTED)
        if degree == 0 or stretch.min() <= 0:
            expected = "areas at two stretches > 0 or more"
            raise table.error("areas", expected, ", ".join(f"{x:g}" for x in stretch))
        given = np.polynomial.polynomial.polyfit(stretch - 1.0, area, degree).tolist()
    if given is None or isinstance(given, float):
        return {"area": given}
    first, *more = given
    with errors_in(table.where):
        number("area at the stretch 1", first, above=0.0)
    return {"area": first, "growth": tuple(one / first for one in more)}


def _tasks(
    table: TomlTable, arm: Arm
) -> tuple[tuple[StatedTask, ...], tuple[tuple[str, float, Vector], ...]]:
    """The tasks of an arm, and the frames of those along it; at the tip by default.

    They are read by the rules of ``<task>`` in a URDF. A place ``s`` stands for a frame.
    """
    block, frames = etree.Element("arm"), dict[tuple[float, Vector], str]()
    for item in table.tables("task"):
        s, place = item.number("s", "length", None), {}
        if s is not None:
            if "frame" in item.values:
                raise InputError(item.where, "frame or s_mm", "both")
            at = (s, item.vector("offset", "length", ZERO))
            usual = f"at_{1e3 * s:g}mm".replace(".", "_")
            alike = sum(name.startswith(usual) for name in frames.values())
            place["frame"] = frames.setdefault(at, f"{usual}_{alike + 1}" if alike else usual)
        words = place | {
            key: " ".join(map(str, value)) if isinstance(value, list) else str(value)
            for key, value in item.rest(item.values).items()
        }
        try:
            etree.SubElement(block, "task", {"frame": "tip"} | words)
        except ValueError:
            raise InputError(item.where, "words that a URDF can hold", repr(words)) from None
    segments = [f"segment_{k}" for k in range(len(lay_out(arm).stations))]
    links, expected = ["tip", *segments, *frames.values()], f"tip, or {segments[0]} …"
    try:
        tasks = read_tasks(Element(Path(table.where), block, ""), links, expected)
        return tasks, tuple((name, *at) for at, name in frames.items())
    except UrdfError as error:
        raise InputError(error.element, error.expected, error.got) from None


# --- the rig ------------------------------------------------------------------------------------

COMMANDS = {kind.value: kind for kind in CommandKind}
RATES = {
    CommandKind.FORCE: "force rate",
    CommandKind.LENGTH: "speed",
    CommandKind.VELOCITY: "acceleration",
}
# a place along the arm names one link
SENSORS = {kind.value: kind for kind in SensorKind if "to" not in kind.form.place}


def _motor(table: TomlTable, groups: Mapping[str, tuple[str, ...]]) -> CableMotor:
    command = table.choice("command", COMMANDS, CommandKind.FORCE.value)
    with errors_in(table.where):
        motor = CableMotor(
            _named_cables(table, groups),
            command,
            table.number("stiffness", "cable stiffness", 0.0),
            table.number("damping", "cable damping", 0.0),
            table.number("length_lower", "length", -math.inf),
            table.number("length_upper", "length", math.inf),
            table.number("lag", "time", 0.0),
            table.number("rate", RATES[command], math.inf),
            table.number("delay", "time", 0.0),
            _rotor(table),
        )
    table.rest()
    return motor


def _rotor(table: TomlTable) -> float:
    """The inertia of a motor's rotor along its cable (kg)."""
    inertia = table.number("rotor_inertia", "inertia", 0.0, lower=0.0)
    return (
        0.0
        if not inertia
        else rotor_armature(
            inertia,
            table.number("reduction", default=1.0, above=0.0),
            table.number("drum_radius", "length", above=0.0),
        )
    )


def _valve(table: TomlTable, groups: Mapping[str, tuple[str, ...]]) -> CableMotor:
    """The valves of chambers, whose commands are pressures."""
    if not groups:
        raise InputError(table.where, "a [[chamber]] for it", "none")
    with errors_in(table.where):
        valve = CableMotor(
            _named_cables(table, groups, "chambers"),
            lag=table.number("lag", "time", 0.0),
            rate=table.number("rate", "pressure rate", math.inf),
            delay=table.number("delay", "time", 0.0),
        )
    table.rest()
    return valve


def _named_cables(
    table: TomlTable, groups: Mapping[str, tuple[str, ...]], key: str = "cables"
) -> tuple[str, ...]:
    """The cables of the key, by their names or their tables'; all by default."""
    every = {cable: cable for cables in groups.values() for cable in cables}
    words = table.words(key, {name: name for name in groups}, list(every))
    return tuple(dict.fromkeys(cable for word in words for cable in groups[word]))


def _sensor(
    table: TomlTable,
    k: int,
    lines: tuple[dict[str, tuple[str, ...]], dict[str, tuple[str, ...]]],
    sections: Sequence[Section],
) -> ArmSensor:
    """A sensor of an arm with these cables and chambers, by their names and their tables'."""
    kind = table.choice("type", SENSORS)
    cables: tuple[str, ...] = ()
    points: tuple[float, ...] = ()
    joint, units = "", tuple(dict.fromkeys(kind.form.quantities))
    frame: dict[str, Any] = {}
    place = kind.form.place
    if kind is SensorKind.PRESSURE:
        if not lines[1]:
            raise InputError(table.where, "a [[chamber]] for it", "none")
        cables = _named_cables(table, lines[1], "chambers")
    elif "tendon" in place:
        cables = _named_cables(table, lines[0] | lines[1])
    elif "joint" in place:
        joint = table.text("joint")
        freedom = FREEDOMS.get(joint.rpartition("_")[0])
        if freedom is None:
            raise table.error("joint", "a freedom and a number, such as bend_y_1", repr(joint))
        units = ("angle" if freedom.turns else "length",)
    else:
        points = _points(table, sections)
        frame["xyz"] = table.vector("offset", "length", (0.0, 0.0, 0.0))
        if "rpy" in place:
            frame["rpy"] = table.vector("rpy", "angle", (0.0, 0.0, 0.0))
    errors: dict[str, Any] = {
        name: _components(table, name, units, kind.size) for name in ("noise", "bias", "resolution")
    }
    with errors_in(table.where):
        reading = Sensor(
            table.text("name", f"{kind.value}_{k}"), kind, joint=joint, **frame, **errors,
            rate=table.number("rate", "frequency", 0.0),
            latency=table.number("latency", "time", 0.0),
        )  # fmt: skip
        sensor = ArmSensor(reading, cables, points)
    table.rest()
    return sensor


def _points(table: TomlTable, sections: Sequence[Section]) -> tuple[float, ...]:
    """Places along the arm (m): those of ``s``, or that of disc number ``disc``."""
    places = [
        start + section.length * (j + 1) / section.discs
        for start, section in zip(starts(sections), sections, strict=False)
        for j in range(section.discs)
    ]
    along = table.profile("s", "length", None)
    disc = table.count("disc", None)
    if (along is None) == (disc is None):
        raise InputError(table.where, "s_mm or disc", "none" if disc is None else "both")
    if disc is None:
        return along if isinstance(along, tuple) else (along,)
    if disc > len(places):
        raise table.error("disc", f"one of the arm's {len(places)} discs", disc)
    return (float(places[disc - 1]),)


def _components(table: TomlTable, name: str, units: Sequence[str], size: int) -> tuple[float, ...]:
    """An error of a sensor: one number, or one per component; a pose has two units."""
    parts = []
    for unit in units:
        value = table.profile(name, unit, 0.0)
        part = value if isinstance(value, tuple) else (value,)
        if len(part) not in (1, share := size // len(units)):
            expected = "one number" if share == 1 else f"one number or {share}"
            raise table.error(name, f"{expected} [{unit}]", list(part))
        parts.append(part)
    if len(parts) == 1 or not any(map(any, parts)):
        return parts[0]
    return tuple(number for part in parts for number in (part if len(part) == 3 else 3 * part))
