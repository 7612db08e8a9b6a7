"""The same robot as a different URDF: every link's frame is turned at random."""

from __future__ import annotations

import numpy as np
from lxml import etree

from tests.support.defects import numbers, put, rpy


def other_hand(text: str, seed: int) -> str:
    """The URDF with all link frames except the root's turned; the robot stays the same."""
    rng = np.random.default_rng(seed)
    root = etree.fromstring(text.encode())
    parents = {joint.find("child").get("link"): joint for joint in root.findall("joint")}
    turns = {
        link.get("name"): rpy(rng.uniform(-3, 3, 3)) if link.get("name") in parents else np.eye(3)
        for link in root.findall("link")
    }
    for name, joint in parents.items():
        outer = turns[joint.find("parent").get("link")]
        _place(joint, outer.T, turns[name])
        if (axis := joint.find("axis")) is not None:
            put(axis, "xyz", turns[name].T @ numbers(axis, "xyz"))
        elif joint.get("type") != "fixed":
            put(etree.SubElement(joint, "axis"), "xyz", turns[name].T @ [1.0, 0.0, 0.0])
    for link in root.findall("link"):
        for thing in link:
            _place(thing, turns[link.get("name")].T, np.eye(3))
    for site in root.findall("softdyn/tendon/site"):
        put(site, "xyz", turns[site.get("link")].T @ numbers(site, "xyz"))
    return etree.tostring(root, encoding="unicode")


def _place(node: etree._Element, before: np.ndarray, after: np.ndarray) -> None:
    """An <origin> with a rotation before it and one after it."""
    origin = node.find("origin")
    if origin is None:
        origin = etree.Element("origin")
        node.insert(0, origin)
    R = before @ rpy(numbers(origin, "rpy")) @ after
    put(origin, "xyz", before @ numbers(origin, "xyz"))
    pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    put(origin, "rpy", [np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])
