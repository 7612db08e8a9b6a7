"""Refuse misspelt and misplaced names, which would otherwise be ignored silently.

URDF allows other tools' elements and attributes, and so does softdyn. Two kinds of names are
probably mistakes and are refused: a standard name in a place where it has no meaning, and a name
that is almost a known one.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import SequenceMatcher

from softdyn.description.strict_xml import Element

ORIGIN = ("xyz", "rpy", "quat_xyzw")
# The known children and attributes of each element; some of them are skipped.
KNOWN: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "robot": (
        ("link", "joint", "gazebo", "softdyn", "material", "transmission"), ("name", "version"),
    ),
    "link": (("inertial", "visual", "collision", "origin"), ("name", "type")),
    "inertial": (("origin", "mass", "inertia"), ()),
    "mass": ((), ("value",)),
    "inertia": ((), ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
    "joint": (
        (
            "origin", "parent", "child", "axis", "limit", "dynamics", "mimic", "calibration",
            "safety_controller",
        ),
        ("name", "type"),
    ),
    "origin": ((), ORIGIN),
    "axis": ((), ("xyz",)),
    "parent": ((), ("link",)),
    "child": ((), ("link",)),
    "limit": (
        (), ("lower", "upper", "effort", "velocity", "acceleration", "deceleration", "jerk"),
    ),
    "dynamics": ((), ("damping", "friction", "stiffness", "spring_stiffness")),
    "mimic": ((), ("joint", "multiplier", "offset")),
    "gazebo": (("springStiffness", "springReference"), ("reference",)),
}  # fmt: skip
# They hold numbers as attributes; no tool that reads URDF reads them from elements inside.
VALUES = ("mass", "inertia", "origin", "axis", "limit", "dynamics", "mimic")
# Whoever writes one of these elements expects that it is read, so it must stand in its place.
MEANT = {
    "robot", "link", "joint", "inertial", "mass", "inertia", "origin", "parent", "child", "axis",
    "limit", "dynamics", "mimic", "gazebo", "softdyn", "springStiffness", "springReference",
    "tendon", "actuator", "task", "site",
}  # fmt: skip
# Other tools' sensors are elements inside a link and have none of these attributes.
OF_A_SENSOR = {"tendon", "link", "joint"}
FREE = ("gazebo",)  # holds other tools' elements, which may use any of these names


def check_known_names(robot: Element) -> None:
    """Refuse misplaced and misspelt elements and attributes of standard URDF.

    The ``<softdyn>`` block refuses every unknown name by itself.

    Raises
    ------
    UrdfError
        For the first one.
    """
    for block in robot.node.iter("softdyn"):
        if block is not robot.node and block.getparent() is not robot.node:
            misplaced = Element(robot.file, block, "<softdyn>")
            raise misplaced.error("<softdyn> right inside <robot>", f"inside <{_tag(block)}>")
    _check(robot)


def _check(element: Element) -> None:
    children, attributes = KNOWN[element.tag]
    for name in element.node.attrib:
        meant = _slip(text := str(name), attributes)
        if meant:
            raise element.error(f'attribute {meant}="…"', f"{text} (misspelt?)")
    for child in element.children():
        if child.tag in children:
            if child.tag in KNOWN:
                _check(child)
            continue
        if child.tag in attributes and element.tag in VALUES:
            got = f"an element <{child.tag}>, which is SDF's way"
            raise child.error(f'attribute {child.tag}="…" of <{element.tag}>', got)
        meant = _slip(child.tag, children)
        if meant:
            raise child.error(f"<{meant}>", f"<{child.tag}> (misspelt?)")
        ours = child.tag in MEANT
        ours |= child.tag == "sensor" and not OF_A_SENSOR.isdisjoint(map(str, child.node.attrib))
        if ours and element.tag not in FREE:
            raise child.error("another place", f"<{child.tag}> right inside <{element.tag}>")


def _tag(node: object) -> str:
    return str(getattr(node.getparent(), "tag", ""))  # type: ignore[attr-defined]


def _slip(name: str, known: Iterable[str]) -> str | None:
    """The known name that `name` misspells; None if it is a known name or like none.

    A misspelt name differs in case only, or by about one letter in known names of four to six
    letters, or by about two in longer ones. Length and share of matching letters decide.
    """
    if name in known:
        return None
    for right in known:
        size = len(right)
        apart, share = (2, 0.71) if size > 6 else (1, 0.75) if size > 3 else (0, 1.0)
        matcher = SequenceMatcher(None, name.lower(), right.lower())
        if abs(len(name) - size) <= apart and matcher.ratio() >= share:
            return right
    return None
