"""The rig in the ``<softdyn>`` block: ``<actuator>`` and ``<sensor>``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from softdyn.description.rig import (
    LONGEST_DELAY,
    MOST_GROWTH,
    PASCAL,
    SMALLEST_WINCH,
    Actuator,
    CommandKind,
    Sensor,
    SensorKind,
)
from softdyn.description.robot import ZERO, Joint, Link, Tendon
from softdyn.description.strict_xml import Element

A_LINK, A_TENDON, A_JOINT = (f"the name of a {part}" for part in ("link", "tendon", "joint"))
SPRING = "a spring"
MOTOR = (
    "name", "tendon", "gear", "lower", "upper", "command", "lag", "rate", "delay", "offset", "unit",
    "area_growth", "area_length",
)  # fmt: skip
WINCH = ("stiffness", "damping", "length_lower", "length_upper")
COMMANDS = tuple(kind.value for kind in CommandKind)
SENSORS = {kind.value: kind for kind in SensorKind}
ERRORS = ("noise", "bias", "rate", "latency", "resolution", "lower", "upper")


def moving_joint(element: Element, joints: Mapping[str, Joint], attribute: str = "name") -> Joint:
    """The joint that an attribute names; refuses a fixed one."""
    name = element.one_of(attribute, joints, A_JOINT)
    if not joints[name].moves:
        raise element.error("a joint that moves", f"fixed joint {name!r}")
    return joints[name]


def check_position(element: Element, joint: Joint, what: str) -> None:
    """Refuse `what` on a continuous or fixed joint: its position has no unique value."""
    if joint.kind not in ("revolute", "prismatic"):
        raise element.error(
            f"{what} on a revolute or prismatic joint", f"{joint.kind} joint {joint.name!r}"
        )


def read_actuator(
    element: Element, tendons: Mapping[str, Tendon], joints: Mapping[str, Joint]
) -> Actuator:
    """Read a motor or a winch.

    Raises
    ------
    UrdfError
        For every misuse. A winch must only pull, and so must an input on a slack tendon.
    """
    element.allow(*MOTOR, *WINCH)
    tendon = tendons[element.one_of("tendon", tendons, A_TENDON)]
    gear, lower, upper = (
        element.number("gear", 1.0),
        element.number("lower"),
        element.number("upper"),
    )
    if lower > upper:
        raise element.error("lower <= upper", f"lower={lower} upper={upper}")
    actuator = Actuator(
        element.text("name"), tendon.name, gear, lower, upper,
        CommandKind(element.choice("command", COMMANDS, CommandKind.FORCE.value)),
        lag=element.non_negative("lag"),
        rate=element.number("rate", math.inf),
        delay=_delay(element, "delay"),
        offset=element.number("offset", 0.0),
        unit=_unit(element),
        area_growth=element.numbers("area_growth", MOST_GROWTH),
        area_length=element.non_negative("area_length"),
    )  # fmt: skip
    if actuator.rate <= 0:
        raise element.error("rate > 0", actuator.rate)
    if actuator.is_chamber and not gear > 0:
        raise element.error("gear > 0, the area (m²) of a chamber", gear)
    _check_growth(element, actuator, tendon, joints)
    if actuator.is_chamber and actuator.is_winch:
        raise element.error(f'command="force" beside unit="{PASCAL}"', actuator.command.value)
    if actuator.pushes and (tendon.slack or actuator.is_winch):
        reason = "a winch" if actuator.is_winch else f"an input on slack tendon {tendon.name!r}"
        got = f"gear={gear} lower={lower} upper={upper}"
        raise element.error(f"gear * u <= 0 from lower to upper, as {reason} only pulls", got)
    if element.node.get("offset") is not None and actuator.command is not CommandKind.LENGTH:
        expected = 'command="length" beside offset'
        raise element.error(expected, f'command="{actuator.command.value}"')
    if actuator.is_winch:
        return _winch(element, actuator, tendon, joints)
    for name in WINCH:
        if element.node.get(name) is not None:
            expected = f'command="length" or "velocity" beside {name}'
            raise element.error(expected, f'command="{actuator.command.value}"')
    return actuator


def _unit(element: Element) -> str:
    """The unit of an input, if it is stated."""
    if element.node.get("unit") is None:
        return ""
    return element.one_of("unit", (PASCAL,), f'unit="{PASCAL}"')


def _check_growth(
    element: Element, actuator: Actuator, tendon: Tendon, joints: Mapping[str, Joint]
) -> None:
    """Refuse an area that changes, of an input that is no chamber or has no length."""
    if actuator.area_growth and not actuator.is_chamber:
        raise element.error(f'unit="{PASCAL}" beside area_growth', "none")
    if bool(actuator.area_growth) != (actuator.area_length > 0):
        got = f"an area_length of {actuator.area_length:g} m"
        raise element.error("area_growth and an area_length > 0, both or neither", got)
    for term in tendon.terms if actuator.area_growth else ():
        check_position(element, joints[term.joint], "a chamber whose area changes")


def _delay(element: Element, attribute: str) -> float:
    """A delay (s) in an attribute."""
    value = element.non_negative(attribute)
    if value > LONGEST_DELAY:
        raise element.error(f"{attribute} <= {LONGEST_DELAY:g} s", value)
    return value


def _winch(
    element: Element, actuator: Actuator, tendon: Tendon, joints: Mapping[str, Joint]
) -> Actuator:
    """The actuator with its cable's spring and bounds of the free length."""
    winch = replace(
        actuator,
        stiffness=element.number("stiffness"),
        damping=element.non_negative("damping"),
        length_lower=element.number("length_lower", -math.inf),
        length_upper=element.number("length_upper", math.inf),
    )
    if winch.stiffness < SMALLEST_WINCH:
        raise element.error("stiffness > 0 of a winch's cable", winch.stiffness)
    if abs(winch.gear) < SMALLEST_WINCH:
        raise element.error("a gear other than 0 of a winch", winch.gear)
    if winch.length_lower > winch.length_upper:
        got = f"length_lower={winch.length_lower} length_upper={winch.length_upper}"
        raise element.error("length_lower <= length_upper", got)
    for name in ("length_lower", "length_upper"):
        if tendon.sites and math.isfinite(bound := getattr(winch, name)) and bound < 0:
            raise element.error(f"{name} >= 0, the length of a path", bound)
    if tendon.armature > 0:  # the rotor is behind the cable's spring, which has no mass
        raise element.error(
            f"no armature of tendon {tendon.name!r} beside a winch", f"{tendon.armature:g}"
        )
    for term in tendon.terms:
        check_position(element, joints[term.joint], "a winch")
    return winch


def read_sensor(
    element: Element,
    links: Mapping[str, Link],
    joints: Mapping[str, Joint],
    tendons: Mapping[str, Tendon],
    actuators: Mapping[str, Actuator],
) -> Sensor:
    """Read a sensor of a robot with these parts.

    Raises
    ------
    UrdfError
        For every misuse.
    """
    kind = SENSORS[element.choice("type", tuple(SENSORS))]
    place = kind.form.place
    element.allow("name", "type", *place, *ERRORS)
    tendon = link = joint = to = ""
    if "tendon" in place:
        tendon = element.one_of("tendon", tendons, A_TENDON)
        pulling = [one for one in actuators.values() if one.tendon == tendon]
        _check_tendon(element, kind, tendons[tendon], joints, pulling)
    elif "joint" in place:
        found = moving_joint(element, joints, "joint")
        check_position(element, found, "a sensor")
        joint = found.name
    else:
        link = element.one_of("link", links, A_LINK)
    if "to" in place:
        to = element.one_of("to", links, A_LINK)
        if to == link:
            raise element.error(f"to another link than {link!r}", repr(to))
    noise, bias, resolution = (
        element.components(name, kind.size) for name in ("noise", "bias", "resolution")
    )
    for name, values in (("noise", noise), ("resolution", resolution)):
        if min(values) < 0:
            raise element.error(f"{name} >= 0", min(values))
    lower = element.components("lower", kind.size, -math.inf)
    upper = element.components("upper", kind.size, math.inf)
    if (np.broadcast_to(lower, kind.size) >= np.broadcast_to(upper, kind.size)).any():
        got = " ".join(f'{name}="{element.node.get(name)}"' for name in ("lower", "upper"))
        raise element.error("lower < upper", got)
    return Sensor(
        element.text("name"), kind, tendon, link, joint,
        element.vector("xyz", ZERO), element.vector("rpy", ZERO),
        noise=noise, bias=bias, resolution=resolution,
        rate=element.non_negative("rate"), latency=_delay(element, "latency"),
        lower=lower, upper=upper, to=to,
    )  # fmt: skip


def _check_tendon(
    element: Element,
    kind: SensorKind,
    tendon: Tendon,
    joints: Mapping[str, Joint],
    pulling: Sequence[Actuator],
) -> None:
    """Refuse the length of a path over continuous joints, and a tension or pressure of nothing."""
    if kind is SensorKind.LENGTH:
        for term in tendon.terms:
            check_position(element, joints[term.joint], "a length sensor")
    elif kind is SensorKind.PRESSURE:
        if (count := sum(one.is_chamber for one in pulling)) != 1:
            got = f"{tendon.name!r} with {count}" if count else f"{tendon.name!r} without"
            raise element.error("a tendon with one chamber", got)
    elif not pulling and not (tendon.stiffness or tendon.damping):
        expected = "a tendon with an actuator, a spring or a damper"
        raise element.error(expected, f"{tendon.name!r} without")
