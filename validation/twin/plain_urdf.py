"""The part of a URDF that the twin needs, as yourdfpy can read it.

yourdfpy reads URDF 1.0, and stops at a shape that it does not know. So quaternions and capsules are
read here, from the file, and shapes that the twin has no use for are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import mujoco
import numpy as np
from lxml import etree

from softdyn.exceptions import UrdfError

NEEDED = {"robot": ("link", "joint"), "link": ("inertial", "collision")}
SIZES = {
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "capsule": ("radius", "length"),
}


@dataclass(eq=False)
class PlainUrdf:
    """Text for yourdfpy, and what it would not read.

    Attributes
    ----------
    text : bytes
        Links with inertias and collision shapes, joints; a capsule is written as a cylinder.
    turned : dict
        The pose (4, 4) of each origin with a quaternion, by the name of its joint, or of its link
        and the number of its collision shape; the link's inertia has number -1.
    capsules : set
        The capsules, by link and number of the collision shape.
    skipped : list of str
        The shapes that are left out, each with the reason.
    """

    text: bytes = b""
    turned: dict[str | tuple[str, int], np.ndarray] = field(default_factory=dict)
    capsules: set[tuple[str, int]] = field(default_factory=set)
    skipped: list[str] = field(default_factory=list)


def plain_urdf(path: Path, mended: str = "") -> PlainUrdf:
    """Read a URDF that has passed the strict parse.

    Parameters
    ----------
    path : Path
        The file.
    mended : str
        Text to read instead of the file's; none by default.

    Raises
    ------
    UrdfError
        For a file that cannot be read, and for a collision shape with a wrong number.
    """
    try:
        parser = etree.XMLParser(resolve_entities=False)
        root = etree.fromstring(mended.encode() if mended else path.read_bytes(), parser)
    except (OSError, etree.XMLSyntaxError) as error:
        raise UrdfError(path, "file", "a URDF", error) from None
    found = PlainUrdf()
    for node in (root, *root.iterchildren("link")):
        for child in list(node):
            if child.tag not in NEEDED[node.tag]:
                node.remove(child)
    for joint in root.iterchildren("joint"):
        _turn(found, joint, str(joint.get("name")))
    for link in root.iterchildren("link"):
        name = str(link.get("name"))
        for inertial in link.iterchildren("inertial"):
            _turn(found, inertial, (name, -1))
        for collision in list(link.iterchildren("collision")):
            if kind := _unusable(path, name, collision):
                place = f"{path}:{collision.sourceline}"
                found.skipped.append(f"{place}: collision shape of link {name!r}: {kind}")
                link.remove(collision)
        for number, collision in enumerate(link.iterchildren("collision")):
            _turn(found, collision, (name, number))
            for capsule in collision.iterfind("geometry/capsule"):
                long = float(capsule.get("length")) > 0
                capsule.tag = "cylinder" if long else "sphere"
                found.capsules |= {(name, number)} if long else set()
    found.text = etree.tostring(root)
    return found


def _turn(found: PlainUrdf, node: etree._Element, key: str | tuple[str, int]) -> None:
    origin = node.find("origin")
    if origin is None or (words := origin.get("quat_xyzw")) is None:
        return
    x, y, z, w = map(float, words.split())
    quaternion, rotation = np.array([w, x, y, z]), np.empty(9)
    mujoco.mju_quat2Mat(rotation, quaternion / np.linalg.norm(quaternion))
    pose = np.eye(4)
    pose[:3, :3] = rotation.reshape(3, 3)
    pose[:3, 3] = [float(word) for word in origin.get("xyz", "0 0 0").split()]
    found.turned[key] = pose


def _unusable(path: Path, link: str, collision: etree._Element) -> str:
    """Why a collision shape is no primitive with an extent; an empty text if it is one."""
    geometry = collision.find("geometry")
    shapes = [] if geometry is None else list(geometry.iterchildren(etree.Element))
    if not shapes:
        return "no geometry"
    shape = shapes[0]
    if shape.tag not in SIZES:
        return f"{etree.QName(shape).localname} is not supported"
    sizes: list[float] = []
    for attribute in SIZES[shape.tag]:
        text = shape.get(attribute, "")
        try:
            sizes += [float(word) for word in text.split()]
        except ValueError:
            sizes.append(np.nan)
    count = 3 if shape.tag == "box" else len(SIZES[shape.tag])
    if len(sizes) != count or not np.isfinite(sizes).all():
        label = f'<link name="{link}"><collision><geometry><{shape.tag}>'
        expected = f"{count} numbers as {', '.join(SIZES[shape.tag])}"
        stated = [(str(key), str(value)) for key, value in shape.attrib.items()]
        got = " ".join(f'{key}="{value}"' for key, value in stated) or "none"
        line = cast("int | None", shape.sourceline)  # missing in the type stubs
        raise UrdfError(path, label, expected, got, line)
    needed = sizes[:1] if shape.tag == "capsule" and sizes[1] >= 0 else sizes
    return "" if min(needed) > 0 else f"{shape.tag} without extent"
