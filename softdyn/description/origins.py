"""Versions of URDF, and origins: roll, pitch and yaw, or a quaternion from version 1.1 on."""

from __future__ import annotations

import math
from copy import deepcopy

import numpy as np
from lxml import etree

from softdyn.description.inertia import IDENTITY, ZERO, Origin, Vector
from softdyn.description.strict_xml import Element

VERSIONS = ("1.0", "1.1", "1.2")
QUATERNION = "quat_xyzw"
UNIT = 1e-3  # a quaternion of rounded decimals may be that far from length 1


def version(element: Element) -> str:
    """The URDF version of an element's file.

    Raises
    ------
    UrdfError
        For an unknown version.
    """
    root = element.node.getroottree().getroot()
    stated = str(root.get("version", VERSIONS[0]))
    if stated not in VERSIONS:
        named = Element(element.file, root, f"<{root.tag}>")
        raise named.error(f"a URDF of version {', '.join(VERSIONS)}", f'version="{stated}"')
    return stated


def read_origin(element: Element) -> Origin:
    """An element's ``<origin>``; the identity if there is none.

    Raises
    ------
    UrdfError
        For a wrong number, an unknown attribute, a quaternion beside `rpy`, of a length other than
        1, or before URDF 1.1.
    """
    origin = element.child("origin")
    if origin is None:
        return IDENTITY
    origin.allow("xyz", "rpy", QUATERNION)
    xyz, rpy = origin.vector("xyz", ZERO), origin.vector("rpy", ZERO)
    if (stated := origin.node.get(QUATERNION)) is None:
        return Origin(xyz, rpy)
    words = str(stated).split()
    if len(words) != 4:
        raise origin.error(f"four numbers as {QUATERNION}", repr(stated))
    quaternion = [origin.to_number(word, QUATERNION) for word in words]
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1) > UNIT:
        raise origin.error(f"a quaternion of length 1 as {QUATERNION}", f"length {length:g}")
    angles = _roll_pitch_yaw(quaternion)
    if version(element) == "1.0":
        said = " ".join(f"{angle:.16g}" for angle in angles)
        expected = f'rpy="{said}", or <robot version="1.1">'
        raise origin.error(expected, f"{QUATERNION} in a file of URDF 1.0")
    if origin.node.get("rpy") is not None:
        raise origin.error(f"rpy or {QUATERNION}", "both")
    return Origin(xyz, angles)


def in_rpy(element: Element) -> etree._Element:
    """A copy of an element, whose ``<origin>`` states roll, pitch and yaw.

    Raises
    ------
    UrdfError
        As `read_origin`, if its origin states a quaternion.
    """
    copy = deepcopy(element.node)
    if (origin := copy.find("origin")) is not None:
        set_rpy(origin, element)
    return copy


def set_rpy(copy: etree._Element, element: Element) -> None:
    """Write the roll, pitch and yaw of an element's origin into a copy of the origin.

    Nothing changes if the file states them.
    """
    origin = element.child("origin")
    if origin is not None and origin.node.get(QUATERNION) is not None:
        etree.strip_attributes(copy, QUATERNION)
        copy.set("rpy", " ".join(map(repr, read_origin(element).rpy)))


def _roll_pitch_yaw(quaternion: list[float]) -> Vector:
    """Exact to rounding, also at 90° of pitch, where the file's yaw and roll are not unique."""
    from scipy.spatial.transform import Rotation  # slow to import, and few files need it

    R = Rotation.from_quat(quaternion).as_matrix()
    yaw = math.atan2(R[1, 0], R[0, 0])
    cos, sin = math.cos(yaw), math.sin(yaw)
    roll = math.atan2(sin * R[0, 2] - cos * R[1, 2], cos * R[1, 1] - sin * R[0, 1])
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    return roll + 0.0, pitch + 0.0, yaw + 0.0  # no minus zeros
