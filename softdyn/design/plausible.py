"""Refuse numbers that no soft arm has, by the ratios of `softdyn.plausible`.

Besides density and Young's modulus, three figures are checked: the weight against the bending
stiffness, the angle by which a cable can bend the arm, and the speed of sound in its material.
A measured bending stiffness that contradicts Young's modulus is said.
"""

from __future__ import annotations

import math
import warnings

import numpy as np

from softdyn.checks import beyond, did_you_mean, number
from softdyn.design.cables import Cable, Chamber, Path, along
from softdyn.design.layout import Layout
from softdyn.design.rods import Arm, Section
from softdyn.exceptions import InputError
from softdyn.plausible import (
    BEND,
    PRESSURE,
    STRONG,
    VACUUM,
    WEIGHT,
    emptied_chambers,
    implausible_pressures,
    too_strong,
)

MODULUS = 5e3, 1e12
"""Young's modulus (Pa): gels to diamond."""
DENSITY = 20.0, 25e3
"""kg/m³: foams to platinum."""
SOUND = 14e3
"""Speed of sound √(E/ρ) (m/s); no fibre reaches this."""
STIFFEST = 0.04
"""Least weight against stiffness, ρ g A L³ / EI, of an arm without cables."""
LENGTH = 1e-3, 20.0
"""Length of a section (m)."""
RADIUS = 1e-4, 1.0
"""Radius of a section (m)."""
NOTHING = 1e-9
"""A cable whose moment arms are all below this share of the radius moves nothing."""
SAME = 0.01
"""Two moduli whose ratio differs from 1 by less are one."""
HOLLOW = 0.05
"""A share of a section's area that chambers may leave out without a word."""
MOST = {Cable: "max_tension", Chamber: "max_pressure"}
HINT = "or set unusual = true if it is meant"


def check(layout: Layout) -> None:
    """Refuse misplaced cables and sensors and, unless `arm.unusual`, numbers that no soft arm has.

    An area that is not above 0 within the reach of the inputs is always refused.

    Raises
    ------
    InputError
        For the first of them; it names the section or cable, what was expected and what was got.
    """
    arm = layout.arm
    for cable in arm.paths:
        _check_place(arm, cable)
        _check_effect(layout, cable)
    _check_room(arm)
    _check_growth(layout)
    joints = {spring.name for spring in layout.all_springs}
    for sensor in arm.sensors:
        joint = sensor.reading.joint
        if joint and joint not in joints:
            where = f"sensor {sensor.reading.name!r}: joint"
            raise InputError(where, "the name of a joint", did_you_mean(joint, joints))
    if arm.unusual:
        return
    for section in arm.sections:
        where = f"section {section.name!r}"
        _within(f"{where}: length", section.length, LENGTH, "m")
        for at in (0.0, 1.0):
            _within(f"{where}: radius", along(section.radius, at), RADIUS, "m")
    for section in arm.sections:
        where, material = f"section {section.name!r}", section.material
        if section.mass is None:
            _within(f"{where}: density", material.density, DENSITY, "kg/m^3")
        _say_modulus(section)
        if section.bending_stiffness is None:
            E = material.youngs_modulus
            _within(f"{where}: Young's modulus", E, MODULUS, "Pa")
            sound = math.sqrt(E / material.density)
            _within(f"{where}: sqrt(E / density)", sound, (0.0, SOUND), "m/s")
    _say_hollows(arm)
    moment = 9.81 * arm.length * sum(body.mass for body in layout.bodies)
    for chamber in arm.chambers:
        where = _named(chamber)
        for line in implausible_pressures(where, chamber.min_pressure, chamber.max_pressure):
            expected = (
                f"{PRESSURE[0]:g} to {PRESSURE[1]:g} Pa, no vacuum below {-VACUUM:g} Pa ({HINT})"
            )
            raise InputError(f"{where}: pressure", expected, line.removeprefix(f"{where}: "))
    for cable in arm.paths:
        bend, most = _bend(layout, cable), f"{_named(cable)}: {MOST[type(cable)]}"
        if bend:
            what = f"{_named(cable)}: bend at {MOST[type(cable)]}, by Young's modulus and radius"
            _within(what, bend, BEND, "rad")
        pull = cable.largest_force * float(np.abs(layout.coefficients(cable)).max())
        if too_strong(bend, pull / moment):
            expected = f"at most {STRONG[1]:g} times the moment of the arm's weight ({HINT})"
            raise InputError(most, expected, f"{pull / moment:.3g}")
    # with inputs, the bend above is the better check: short and light arms hardly sag
    low = 0.0 if arm.paths else STIFFEST
    what = "weight against stiffness, m g L^2 / EI, by Young's modulus, density and size"
    _within(what, _weight(layout), (low, WEIGHT), "")


def _named(path: Path) -> str:
    return f"{type(path).__name__.lower()} {path.name!r}"


def _say_modulus(section: Section) -> None:
    """Warn where E gives the stiffness of a translation, and a measured EI another E."""
    if section.bending_stiffness is None:
        return
    E, at = section.material.relaxed * section.material.youngs_modulus, np.linspace(0, 1, 5)
    stated = [section.bending(x) / section.second_moment(x) for x in at]
    if np.abs(np.array(stated) / E - 1).max() <= SAME:
        return
    for name, rigidity, measured in (
        ("extension", Section.stretching, "axial_stiffness"),
        ("shear", Section.shearing, "shear_stiffness"),
    ):
        moves = any(one.partition("_")[0] == name for one in section.freedoms)
        if moves and getattr(section, measured) is None:
            warnings.warn(
                f"section {section.name!r}: {measured} is {rigidity(section, 0.0):.4g} N at its"
                f" begin, from Young's modulus {E:.3g} Pa; the measured bending_stiffness has"
                f" {min(stated):.3g} to {max(stated):.3g} Pa. State {measured}_N if it is measured",
                stacklevel=2,
            )


def _say_hollows(arm: Arm) -> None:
    """Warn of sections whose EI is not stated and counts large hollows of chambers as full."""
    for k, section in enumerate(arm.sections):
        hollow = sum(one.section_area for one in _inside(arm, k) if not one.straight)
        share = hollow / section.area(0.0)
        if section.bending_stiffness is None and share > HOLLOW:
            warnings.warn(
                f"section {section.name!r}: its bending stiffness, from Young's modulus and radius,"
                f" counts its chambers as full, {100 * share:.3g} % of its area. State"
                " bending_stiffness_Nm2, and the mass",
                stacklevel=2,
            )


def _inside(arm: Arm, k: int) -> list[Chamber]:
    """The chambers in section k."""
    return [one for one in arm.chambers if one.start <= k <= one.end % len(arm.sections)]


def _within(what: str, value: float, limits: tuple[float, float], unit: str) -> None:
    number(what, value)
    low, high = limits
    if beyond(low, value) or beyond(value, high):
        bounds = f"{low:g} to {high:g}".replace("0 to", "at most") if low == 0 else (
            f"{low:g} to {high:g}"
        )  # fmt: skip
        got = f"{value:.3g}"
        if unit == "m" and low <= value * (1e-3 if value > high else 1e3) <= high:
            got += ": in mm?" if value > high else ": in m, not in mm?"
        raise InputError(what, f"{bounds} {unit} ({HINT})".replace("  ", " "), got)


def _check_place(arm: Arm, cable: Path) -> None:
    """Refuse a line outside the rod, and a straight one without discs or outside them."""
    start, end = arm.way(cable)
    for k in range(cable.start, cable.end % len(arm.sections) + 1):
        section, where = (
            arm.sections[k],
            f"{_named(cable)} in section {arm.sections[k].name!r}",
        )
        if cable.straight and not section.discs:
            raise InputError(where, "discs that lead it", "a section without discs")
        for at in np.linspace(0, 1, 17):
            offset = along(
                cable.offset, (arm.starts[k] + at * section.length - start) / (end - start)
            )
            limit = along(section.radius, at)
            if cable.straight and section.disc is not None:
                limit = max(limit, section.disc.radius)
            if beyond(offset, limit):
                inside = f"an offset inside the body, at most {limit:.4g} m there"
                raise InputError(where, inside, f"{offset:.4g} m")


def _check_room(arm: Arm) -> None:
    """Refuse more chambers in a section than fit: by their areas and, of round ones, their circles.

    Bellows between discs lie outside the body, so only their circles count.
    """
    for k, section in enumerate(arm.sections):
        here = _inside(arm, k)
        where = f"section {section.name!r}: chambers"
        for at in np.linspace(0, 1, 17) if here else ():
            room, full = section.area(at), sum(c.section_area for c in here if not c.straight)
            if beyond(full, room):
                expected = f"at most {1e6 * room:.4g} mm² of cross-sections, its own"
                raise InputError(where, expected, f"{1e6 * full:.4g} mm²")
            _check_circles(arm, k, float(at), here, where)


def _check_circles(arm: Arm, k: int, at: float, chambers: list[Chamber], where: str) -> None:
    """Refuse round chambers that meet each other, or a wall, at s / length of section k."""
    section = arm.sections[k]
    outer, inner = along(section.radius, at), along(section.inner_radius, at)
    before: list[tuple[str, float, np.ndarray]] = []
    for one in chambers:
        if (radius := one.radius) is None:
            continue
        start, end = arm.way(one)
        place = one.place((arm.starts[k] + at * section.length - start) / (end - start))
        middle = float(np.linalg.norm(place))
        if not one.straight and beyond(middle + radius, outer):
            expected = f"chamber {one.name!r} inside the radius of {1e3 * outer:.4g} mm"
            raise InputError(where, expected, f"its outer edge at {1e3 * (middle + radius):.4g} mm")
        if not one.straight and inner > 0 and beyond(inner, middle - radius):
            expected = f"chamber {one.name!r} outside the inner radius of {1e3 * inner:.4g} mm"
            raise InputError(where, expected, f"its inner edge at {1e3 * (middle - radius):.4g} mm")
        for name, size, there in before:
            apart, least = float(np.linalg.norm(place - there)), radius + size
            if beyond(least, apart):
                expected = f"{name!r} and {one.name!r} at least {1e3 * least:.4g} mm apart"
                raise InputError(where, expected, f"{1e3 * apart:.4g} mm")
        before.append((one.name, radius, place))


def _check_growth(layout: Layout) -> None:
    """Refuse a chamber whose area is not above 0 at a stretch that the inputs reach."""
    paths = layout.arm.paths
    if not any(isinstance(one, Chamber) and one.growth for one in paths):
        return
    arms = np.array([layout.coefficients(one) for one in paths])
    stiffness = np.array([spring.stiffness for spring in layout.all_springs])
    forces = np.array([
        (one.section_area * one.min_pressure, one.section_area * one.max_pressure)
        if isinstance(one, Chamber) else (-one.max_tension, 0.0)
        for one in paths
    ]).T  # fmt: skip
    growths = [one.growth if isinstance(one, Chamber) else () for one in paths]
    lengths = [layout.length(one) for one in paths]
    for k, expected, got in emptied_chambers(arms, stiffness, forces, growths, lengths):
        raise InputError(f"{_named(paths[k])}: area", expected, got)


def _check_effect(layout: Layout, cable: Path) -> None:
    """Refuse a cable in a channel whose length no joint changes, such as one on a bending axis."""
    if cable.straight:
        return
    arm = layout.arm
    if np.abs(layout.coefficients(cable)).max() <= NOTHING * along(arm.sections[0].radius, 0.0):
        kinds = dict.fromkeys(spring.strain for spring in layout.all_springs)
        expected = "an offset from the axis, or a freedom such as extension that changes its length"
        got = f"a length that {', '.join(kinds)} do not change"
        raise InputError(_named(cable), expected, got)


def _bend(layout: Layout, cable: Path) -> float:
    """Angle (rad) by which one input bends the weightless arm; 0 if no joint can bend."""
    bends = [
        cable.largest_force * arm / spring.stiffness
        for spring, arm in zip(layout.all_springs, layout.coefficients(cable), strict=True)
        if spring.freedom.rigidity is Section.bending
    ]
    return float(np.abs(bends).sum())


def _weight(layout: Layout) -> float:
    """m g L² / EI, with the arm's mean 1 / EI."""
    arm = layout.arm
    at = np.linspace(0, 1, 33)
    compliance = sum(
        section.length * float(np.mean([1 / section.bending(x) for x in at]))
        for section in arm.sections
    )
    mass = sum(body.mass for body in layout.bodies)
    return mass * 9.81 * arm.length * compliance
