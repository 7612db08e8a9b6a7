"""The robot's file with other numbers in it; everything else stays as it was."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from lxml import etree

from softdyn.description.annotations import BLOCK
from softdyn.description.robot import Robot, moving_link_of
from softdyn.description.strict_xml import read
from softdyn.exceptions import InputError

Node = etree._Element
SPRING = {"stiffness": "springStiffness", "rest": "springReference"}
IN_BLOCK = {
    "armature": ("joint", "armature"), "gear": ("actuator", "gear"),
    "tendon_stiffness": ("tendon", "stiffness"), "tendon_damping": ("tendon", "damping"),
}  # fmt: skip
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def rewritten(robot: Robot, values: Mapping[str, Mapping[str, float]]) -> str:
    """The text of the robot's URDF with `values` in place.

    Parameters
    ----------
    robot : Robot
        Whose file is read again.
    values : mapping
        By kind (of `KINDS`) and member, as `member_values` gives them. A mass is a factor on the
        body that the joint of that name moves, its welded links included.

    Raises
    ------
    InputError
        A number that has no place in the URDF, because a file of annotations gives it.
    UrdfError
        A file that can no longer be read.
    """
    root = read(robot.path).node
    for kind, members in values.items():
        for name, value in members.items():
            if kind == "mass":
                _scale_body(root, robot, name, value)
                continue
            places = list(_places(root, kind, name))
            if not places:
                expected = f"a place for the {kind} of {name!r} in the URDF"
                raise InputError(str(robot.path), expected, "none: is it in a file of annotations?")
            for node, attribute in places:
                if attribute:
                    node.set(attribute, _text(value))
                else:
                    node.text = _text(value)
    return etree.tostring(root, encoding="unicode") + "\n"


def _places(root: Node, kind: str, name: str) -> Iterator[tuple[Node, str]]:
    """Elements with the attribute ("": the text) where the number of a member stands."""
    if kind in SPRING:
        for node in root.iterfind("gazebo"):
            if node.get("reference") == name and node.find("springStiffness") is not None:
                if kind == "rest" and node.find(SPRING[kind]) is None:
                    etree.SubElement(node, SPRING[kind])
                yield from ((child, "") for child in node.iterfind(SPRING[kind]))
    if kind in ("stiffness", "damping", "friction"):
        for joint in root.iterfind("joint"):
            for dynamics in joint.iterfind("dynamics") if joint.get("name") == name else ():
                for attribute in {kind, f"spring_{kind}"} & {str(key) for key in dynamics.attrib}:
                    yield dynamics, attribute
    if kind in IN_BLOCK:
        tag, attribute = IN_BLOCK[kind]
        for node in root.iterfind(f"{BLOCK}/{tag}"):
            if node.get("name") == name:
                yield node, attribute


def _scale_body(root: Node, robot: Robot, joint: str, factor: float) -> None:
    """Mass and moments of all links that move with the joint's child."""
    body = next(one.child for one in robot.joints if one.name == joint)
    carrier = moving_link_of(robot)
    for link in root.iterfind("link"):
        if carrier[str(link.get("name"))] == body:
            for node in (*link.iterfind("inertial/mass"), *link.iterfind("inertial/inertia")):
                for key in {"value", *MOMENTS} & {str(key) for key in node.attrib}:
                    node.set(key, _text(factor * float(str(node.get(key)))))


def _text(value: float) -> str:
    return f"{value:.12g}"
