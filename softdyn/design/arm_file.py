"""An arm as annotated URDF: links, joints, cables, looks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from softdyn.description.rig import PASCAL, Sensor
from softdyn.description.robot import ZERO, Joint, JointTerm, Robot, Tendon
from softdyn.description.urdf_writer import write
from softdyn.design.cables import ArmSensor, Cable, Path, along
from softdyn.design.chain import (
    GENERATED,
    X_TO_Z,
    Chain,
    Input,
    collision,
    cylinder,
    site,
    sphere,
    vector,
    visual,
)  # fmt: skip
from softdyn.design.layout import Layout, Spring, disc_places, lay_out
from softdyn.design.plausible import check
from softdyn.design.rods import Arm, Section

SHADES = ((0.16, 0.46, 0.52), (0.80, 0.50, 0.26), (0.50, 0.44, 0.66), (0.42, 0.58, 0.34))
"""Colours of the sections in turn; every second link is a little lighter."""
COOL = (SHADES[0], *SHADES[2:])
"""Those of an arm with chambers, whose tubes turn orange and red."""
DARK = (0.2, 0.22, 0.26)
GEAR = -1.0
"""A positive input is a tension."""
SMALL = 1e-9
"""Moment arms below this share of the largest are rounding."""


def urdf(arm: Arm) -> str:
    """The annotated URDF of an arm.

    A cable in a channel, or a chamber in the body, becomes a fixed tendon. At a constant offset its
    length is linear in the bends. A cable that runs straight from disc to disc becomes a spatial
    tendon over sites.

    Raises
    ------
    InputError
        For numbers that no soft arm has, unless `arm.unusual`: see `softdyn.design.plausible`.
    """
    return write(robot(lay_out(arm)))


def robot(layout: Layout) -> Robot:
    """The robot that `urdf` writes.

    Raises
    ------
    InputError
        As in `urdf`.
    """
    check(layout)
    arm = layout.arm
    chain = Chain(arm.name, comment(layout), _colors(arm))
    last = 0.0
    for k, (x, group, body) in enumerate(
        zip(layout.stations, layout.springs, layout.bodies, strict=True)
    ):
        lifted = layout.buoyancy[k]
        place: Sequence[float] = (float(x) - last, 0.0, 0.0)
        angles = ZERO
        if k == 0:
            place, angles = arm.mount.position, arm.mount.angles
        joints = [_joint(spring) for spring in group]
        chain.add(f"segment_{k}", body, _looks(layout, k), joints, place, angles, lifted)
        last = float(x)
    for name, s, offset in arm.frames:
        chain.mark(name, *layout.place(s, offset))
    tip = (arm.length - last + arm.tip[0], *map(float, arm.tip[1:]))
    words = {name: motor.words for motor in arm.motors for name in motor.cables}
    rotors = {name: motor.armature for motor in arm.motors for name in motor.cables}
    for cable in arm.cables:
        bounds = Input(GEAR, (0, cable.max_tension))
        tendon = replace(_tendon(layout, cable), armature=rotors.get(cable.name, 0.0))
        chain.pull(tendon, bounds, **words.get(cable.name, {}))
    for one in arm.chambers:
        pressures = Input(one.section_area, (one.min_pressure, one.max_pressure))
        growth = {"area_growth": one.growth, "area_length": layout.length(one)}
        chain.pull(
            _tendon(layout, one), pressures, unit=PASCAL, **(growth if one.growth else {}),
            **words.get(one.name, {}),
        )  # fmt: skip
    sensors = [placed for sensor in arm.sensors for placed in _sensors(layout, sensor)]
    return chain.finish(
        tip, sensors=sensors, tasks=arm.tasks, gravity=arm.mount.gravity, fluid=arm.fluid
    )


def comment(layout: Layout) -> str:
    """A summary of the arm, the first comment of its file."""
    arm = layout.arm
    mass = sum(body.mass for body in layout.bodies)
    pushed = f", {len(arm.chambers)} chambers" if arm.chambers else ""
    lines = [
        f"{arm.name}: {arm.length:.6g} m, {mass:.6g} kg, {len(layout.all_springs)} degrees of"
        f" freedom, {len(arm.cables)} cables{pushed}; straight and weightless its first natural"
        f" frequency is {layout.rates[0] / 2 / math.pi:.4g} Hz.",
    ]
    for k, section in enumerate(arm.sections):
        rigid = section.bending(0), section.bending(1)
        lines.append(
            f"Section {section.name}: {section.segments} joints of {', '.join(section.freedoms)};"
            f" EI {rigid[0]:.4g} to {rigid[1]:.4g} N m^2, from {arm.starts[k]:.4g} m on."
        )
    lines.append(GENERATED)
    return "\n" + "".join(f"  {line}\n" for line in lines)


def _joint(spring: Spring) -> Joint:
    # a larger translation would turn the joint's piece of rod inside out
    reach = math.pi if spring.freedom.turns else spring.weight / 2
    return Joint(
        spring.name, "revolute" if spring.freedom.turns else "prismatic",
        direction=vector(spring.freedom.axis), lower=-reach, upper=reach,
        stiffness=spring.stiffness, rest=spring.rest, damping=spring.damping,
        relaxation=spring.relaxation,
    )  # fmt: skip


def _tendon(layout: Layout, cable: Path) -> Tendon:
    own = ("stiffness", "damping", "rest", "slack", "friction")
    spring: dict[str, Any] = {
        name: getattr(cable, name) for name in own if isinstance(cable, Cable)
    }
    if not cable.straight:
        arms = layout.coefficients(cable)
        least = SMALL * np.abs(arms).max()
        terms = [
            JointTerm(spring.name, float(arm))
            for spring, arm in zip(layout.all_springs, arms, strict=True)
            if abs(arm) > least
        ]
        return Tendon(cable.name, terms=tuple(terms), **spring)
    start, end = layout.arm.way(cable)
    places = [start, *disc_places(layout.arm, cable)]
    sites = []
    for x in places:
        k = layout.body_at(x)
        point = cable.place((x - start) / (end - start))
        point[0] = x - layout.stations[k]
        sites.append(site(f"segment_{k}", point))
    return Tendon(cable.name, sites=tuple(sites), **spring)


def _sensors(layout: Layout, sensor: ArmSensor) -> Iterator[Sensor]:
    """The sensors of a group, each on its cable, link or joint."""
    reading = sensor.reading
    names = iter(sensor.names)
    for cable in sensor.cables:
        yield replace(reading, name=next(names), tendon=cable)
    for point in sensor.points:
        link, xyz = layout.place(point, reading.xyz)
        yield replace(reading, name=next(names), link=link, xyz=vector(xyz))
    if reading.joint:
        yield reading


# --- looks --------------------------------------------------------------------------------------


def _colors(arm: Arm) -> dict[str, tuple[float, ...]]:
    colors: dict[str, tuple[float, ...]] = {"dark": DARK}
    shades = COOL if arm.chambers else SHADES
    for k in range(len(arm.sections)):
        shade = shades[k % len(shades)]
        colors[f"section_{k}_even"] = shade
        colors[f"section_{k}_odd"] = tuple(round(0.85 * c + 0.15, 3) for c in shade)
    return colors


def _looks(layout: Layout, k: int) -> list[str]:
    """The shapes of body k: round pieces, a ball at its joint, discs, plates."""
    arm, begin, end = layout.arm, layout.stations[k], layout.ends[k]
    parts = []
    for i, (start, section) in enumerate(zip(arm.starts, arm.sections, strict=False)):
        low, high = max(begin, start), min(end, start + section.length)
        color = f"section_{i}_{'odd' if k % 2 else 'even'}"
        if high > low:
            parts += _round(section, low - start, high - start, start - begin, color, k > 0)
        for j in range(section.discs):
            x = start + section.length * (j + 1) / section.discs
            if section.disc is not None and layout.body_at(x) == k:
                shape = cylinder(section.disc.radius, section.disc.thickness)
                parts.append(visual(shape, "dark", (float(x - begin), 0.0, 0.0), X_TO_Z))
        x = start + section.length
        if section.plate is not None and layout.body_at(x) == k:
            shape = cylinder(section.plate.radius, section.plate.thickness)
            middle = float(x - begin + section.plate.thickness / 2)
            parts.append(visual(shape, "dark", (middle, 0.0, 0.0), X_TO_Z))
    if k == 0:
        r = along(arm.sections[0].radius, 0.0)
        parts.append(visual(cylinder(1.4 * r, 0.5 * r), "dark", (-0.25 * r, 0.0, 0.0), X_TO_Z))
    if arm.payload is not None and k == len(layout.bodies) - 1:
        ahead = float(arm.length - begin + arm.payload.ahead)
        parts.append(visual(sphere(arm.payload.radius), "dark", (ahead, 0.0, 0.0)))
    return parts


def _round(
    section: Section, low: float, high: float, shift: float, color: str, ball: bool
) -> list[str]:
    """Cylinders from low to high (m of the section), a ball at the joint, a contact shape."""
    ends = [along(section.radius, x / section.length) for x in (low, high)]
    pieces = 1 + min(int(abs(ends[1] - ends[0]) / (0.04 * max(ends))), 4)
    edges = np.linspace(low, high, pieces + 1)
    parts = []
    if ball and low + shift < 1e-12:  # this piece begins at the joint
        parts.append(visual(sphere(0.99 * ends[0]), color, name="skin"))
    for a, b in pairwise(edges):
        middle = (a + b) / 2
        shape = cylinder(along(section.radius, middle / section.length), float(b - a))
        parts.append(visual(shape, color, (float(middle + shift), 0.0, 0.0), X_TO_Z, "skin"))
    middle = (low + high) / 2
    shape = cylinder(0.96 * min(ends), 0.6 * float(high - low))
    parts.append(collision(shape, (float(middle + shift), 0.0, 0.0), X_TO_Z))
    return parts
