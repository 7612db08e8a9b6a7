"""Numbers of a joint that other tools state in elements of their own, and that softdyn reads.

- A rotor's inertia J behind a gear of ratio n is an armature n² J at its joint: ``<motorInertia>``
  and ``<mechanicalReduction>`` in a ``<transmission>`` of ROS, ``<drake:rotor_inertia>`` and
  ``<drake:gear_ratio>`` there.
- ``rotor_inertia`` of RaiSim, and ``armature``, in ``<dynamics>`` are inertias at the joint.
- ``<joint_properties friction="…" damping="…">`` of onshape-to-robot.

A ``<joint armature="…">`` in ``<softdyn>`` replaces what is read here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from lxml import etree

from softdyn.description.other_tools import PROPERTIES, REMEDY, is_rotor
from softdyn.description.robot import Joint
from softdyn.description.strict_xml import Element

REDUCTIONS = ("mechanicalreduction", "gearratio")
FIELDS = {"frictionloss": "friction"}
"""Attributes of ``<joint_properties>`` that are called otherwise in `Joint`."""


def read_motors(robot: Element, joints: dict[str, Joint]) -> tuple[str, ...]:
    """Write rotor inertias, friction and damping of other tools into `joints`.

    Returns
    -------
    tuple of str
        A line for each number that is read.

    Raises
    ------
    UrdfError
        For a number that is wrong, or that contradicts another, and for a transmission with an
        inertia whose joint or gear is not clear.
    """
    found = []
    armatures: dict[str, float] = {}
    statements = (*_of_dynamics(robot), *_of_transmissions(robot, joints))
    for name, words, value in statements:
        if joints[name].moves:
            armatures[name] = armatures.get(name, 0.0) + value
            found.append(f"{words} as armature {value:g} of {name!r}")
    for name, value in armatures.items():
        joints[name] = replace(joints[name], armature=value)
    return (*found, *_properties(robot, joints))


def _of_dynamics(robot: Element) -> Iterator[tuple[str, str, float]]:
    """(joint, words, armature) of attributes of ``<dynamics>``."""
    for element in robot.children("joint"):
        dynamics = element.child("dynamics")
        for name in ("rotor_inertia", "armature") if dynamics is not None else ():
            assert dynamics is not None
            if (value := dynamics.non_negative(name)) > 0:
                yield element.text("name"), f"<dynamics {name}>", value


def _of_transmissions(robot: Element, joints: dict[str, Joint]) -> Iterator[tuple[str, str, float]]:
    """(joint, words, armature) of transmissions with a rotor's inertia."""
    for element in robot.children("transmission"):
        rotors = [part for part in _inside(element) if is_rotor(_local(part))]
        rotors = [part for part in rotors if _number(part) != 0]
        if not rotors:
            continue
        (rotor, *more), named = rotors, list(element.children("joint"))
        gears = [part for part in _inside(element) if _plain(part) in REDUCTIONS]
        for kind, parts in (("rotor inertia", more), ("joint", named[1:]), ("gear", gears[1:])):
            if parts or not named:
                expected = f'one {kind}, or <joint name="…" armature="…"/> in <softdyn>'
                got = f"{len(parts) + 1} of them" if parts else "no <joint>"
                raise rotor.error(expected, f"{got}{REMEDY}")
        name = named[0].one_of("name", joints, "the name of a joint")
        ratio = _number(gears[0]) if gears else 1.0
        inertia = _number(rotor)
        if inertia < 0:
            raise rotor.error("an inertia >= 0", inertia)
        yield name, f"<{_local(rotor)}> {inertia:g} at a ratio of {ratio:g}", inertia * ratio**2


def _properties(robot: Element, joints: dict[str, Joint]) -> Iterator[str]:
    """Write ``<joint_properties>`` into the joints."""
    for element in robot.children("joint"):
        name = element.text("name")
        stated = element.child("joint_properties")
        if stated is None or not joints[name].moves:
            continue
        for word in PROPERTIES:
            field = FIELDS.get(word, word)
            if stated.node.get(word) is None or (value := stated.non_negative(word)) == 0:
                continue
            before = getattr(joints[name], field)
            if before not in (0.0, value):
                raise stated.error(f"one {field} of joint {name!r}", f"{before:g} and {value:g}")
            given: dict[str, Any] = {field: value}
            joints[name] = replace(joints[name], **given)
            yield f"<joint_properties {word}> as {field} {value:g} of {name!r}"


def _inside(element: Element) -> Iterator[Element]:
    """All elements in an element."""
    for child in element.children():
        yield child
        yield from _inside(child)


def _local(element: Element) -> str:
    return etree.QName(element.node).localname


def _plain(element: Element) -> str:
    return _local(element).replace("_", "").lower()


def _number(element: Element) -> float:
    """The number of an element: Drake's as attribute `value`, ROS' as text."""
    value = element.node.get("value")
    text = str(element.node.text or "" if value is None else value).strip()
    return element.to_number(text, _local(element))
