"""A second reading of a robot's file, by another parser, to check the content of `Robot`.

`differences` lists everything that is in the file and not in the parse, or the other way round.
This reading follows docs/format.md and uses expat from the standard library. It shares no code with
softdyn's reader. It does not look for errors, because it only reads accepted files.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from softdyn import Robot
from softdyn.description.robot import Joint
from softdyn.description.stated_task import StatedTask

# Elements whose children softdyn reads; all others belong to other tools.
OURS = {
    "robot", "link", "joint", "inertial", "origin", "mass", "inertia", "parent", "child", "axis",
    "limit", "dynamics", "softdyn", "tendon", "site", "actuator", "sensor", "task",
}  # fmt: skip
COUNTED = ("link", "joint", "tendon", "actuator", "sensor", "site", "softdyn", "inertial")
NUMBERS_OF_A_TASK = {"weight": 1.0, "Kp": None, "level": 0.0}


def differences(robot: Robot, data: bytes, annotations: bytes | None = None) -> list[str]:
    """Differences between the parse and the second reading; empty if nothing was lost.

    Parameters
    ----------
    robot : Robot
        The parse.
    data : bytes
        The URDF.
    annotations : bytes, optional
        The block, if it is in a separate file.
    """
    try:
        root = ElementTree.fromstring(data)
        if annotations is not None:
            _lay_over(root, ElementTree.fromstring(annotations))
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        return [f"the second parser refuses the file: {error}"]
    found = [
        *_counts(robot, root),
        *_links(robot, root),
        *_joints(robot, root),
        *_springs(robot, root),
    ]
    return found + list(_block(robot, root.find("softdyn")))


def _lay_over(root: ElementTree.Element, block: ElementTree.Element) -> None:
    """Write the block into the URDF, with springs and dampers of joints in their usual places."""
    root.append(block)
    joints = {element.get("name"): element for element in root.findall("joint")}
    for element in block.findall("joint"):
        name = element.get("name", "")
        if (damping := element.get("damping")) is not None:
            dynamics = joints[name].find("dynamics")
            if dynamics is None:
                dynamics = ElementTree.SubElement(joints[name], "dynamics")
            dynamics.set("damping", damping)
        for key, tag in (("stiffness", "springStiffness"), ("rest", "springReference")):
            if (value := element.get(key)) is not None:
                spring = ElementTree.SubElement(root, "gazebo", {"reference": name})
                ElementTree.SubElement(spring, tag).text = value


def _counts(robot: Robot, root: ElementTree.Element) -> Iterator[str]:
    """Count all elements of softdyn, so that a misplaced one is not overlooked."""
    inside = Counter(element.tag for element in _ours(root) if not _foreign(element))
    block = root.find("softdyn")
    armatures = 0 if block is None else len(block.findall("joint"))
    terms = sum(len(tendon.terms) for tendon in robot.tendons)
    read = {
        "link": len(robot.links),
        "joint": len(robot.joints) + armatures + terms,
        "tendon": len(robot.tendons),
        "actuator": len(robot.actuators),
        "sensor": len(robot.sensors),
        "site": sum(len(tendon.sites) for tendon in robot.tendons),
        "softdyn": 0 if block is None else 1,
        "inertial": len(root.findall("link/inertial")),
    }
    for tag in COUNTED:
        yield from _same(f"number of <{tag}>", read[tag], inside[tag])


def _foreign(element: ElementTree.Element) -> bool:
    """Whether this is another tool's sensor, which softdyn ignores."""
    return element.tag == "sensor" and not {"tendon", "link", "joint"} & set(element.attrib)


def _ours(element: ElementTree.Element) -> Iterator[ElementTree.Element]:
    yield element
    if element.tag in OURS and not _foreign(element):
        for child in element:
            yield from _ours(child)


def _links(robot: Robot, root: ElementTree.Element) -> Iterator[str]:
    elements = root.findall("link")
    yield from _same("links", [link.name for link in robot.links], _names(elements))
    for link, element in zip(robot.links, elements, strict=False):
        where = f"link {link.name[:30]!r}"
        inertial = element.find("inertial")
        if inertial is None:
            yield from _same(f"mass of {where}", link.inertia.mass, 0.0)
            continue
        rotation, translation = _pose(inertial)
        tensor = inertial.find("inertia")
        xx, xy, xz, yy, yz, zz = (
            _float(tensor, "i" + axes) for axes in ("xx", "xy", "xz", "yy", "yz", "zz")
        )
        local = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        yield from _same(
            f"mass of {where}", link.inertia.mass, _float(inertial.find("mass"), "value")
        )
        yield from _close(f"centre of mass of {where}", link.inertia.com, translation)
        turned = rotation @ local @ rotation.T
        yield from _close(f"inertia of {where}", link.inertia.tensor, turned)


def _joints(robot: Robot, root: ElementTree.Element) -> Iterator[str]:
    elements = root.findall("joint")
    yield from _same("joints", [joint.name for joint in robot.joints], _names(elements))
    block = root.find("softdyn")
    armatures = {e.get("name"): e for e in (() if block is None else block.findall("joint"))}
    for joint, element in zip(robot.joints, elements, strict=False):
        where = f"joint {joint.name[:30]!r}"
        ends = [_attribute(element.find(tag), "link") for tag in ("parent", "child")]
        yield from _same(f"type of {where}", joint.kind, element.get("type"))
        yield from _same(f"ends of {where}", [joint.parent, joint.child], ends)
        rotation, translation = _pose(element)
        yield from _close(f"origin of {where}", joint.origin.translation, translation)
        yield from _close(f"rotation of {where}", joint.origin.rotation, rotation)
        if joint.kind == "fixed":
            continue
        yield from _mimic(joint, {e.get("name", ""): e.find("mimic") for e in elements})
        axis = element.find("axis")
        vector = np.array([1.0, 0.0, 0.0]) if axis is None else _vector(axis, "xyz")
        yield from _close(f"axis of {where}", joint.axis, vector / np.linalg.norm(vector))
        if joint.kind in ("revolute", "prismatic"):
            limit = element.find("limit")
            bounds = [_float(limit, "lower"), _float(limit, "upper")]
            yield from _same(f"limits of {where}", [joint.lower, joint.upper], bounds)
        dynamics = element.find("dynamics")
        losses = [_float(dynamics, "damping"), _float(dynamics, "friction")]
        yield from _same(f"damping of {where}", [joint.damping, joint.friction], losses)
        armature = _float(armatures.get(joint.name), "armature")
        yield from _same(f"armature of {where}", joint.armature, armature)


def _mimic(joint: Joint, mimics: dict[str, ElementTree.Element | None]) -> Iterator[str]:
    """A chain of followers is a composition of lines: the joint's is followed to its end."""
    said: tuple[str, float, float] | None = None
    mimic = mimics[joint.name]
    while mimic is not None:
        multiplier = 1.0 if mimic.get("multiplier") is None else _float(mimic, "multiplier")
        offset, leader = _float(mimic, "offset"), mimic.get("joint", "")
        _, m, o = said or ("", 1.0, 0.0)
        said = (leader, m * multiplier, m * offset + o)
        mimic = mimics[leader]
    mine = joint.mimic and (joint.mimic.leader, joint.mimic.multiplier, joint.mimic.offset)
    yield from _same(f"mimic of joint {joint.name[:30]!r}", mine, said)


def _springs(robot: Robot, root: ElementTree.Element) -> Iterator[str]:
    stiffness = {joint.name: 0.0 for joint in robot.joints}
    rest = dict(stiffness)
    for element in root.findall("joint"):
        dynamics = element.find("dynamics")
        for alias in ("stiffness", "spring_stiffness"):
            if dynamics is not None and dynamics.get(alias) is not None:
                stiffness[element.get("name", "")] = _float(dynamics, alias)
    for element in root.findall("gazebo"):
        for tag, table in (("springStiffness", stiffness), ("springReference", rest)):
            for child in element.findall(tag):
                text = child.get("value", "".join(child.itertext()))
                table[element.get("reference", "")] = float(text)
    mine = {joint.name: joint.stiffness for joint in robot.joints}
    yield from _same("joint stiffness", mine, stiffness)
    yield from _same("joint rest", {joint.name: joint.rest for joint in robot.joints}, rest)


def _block(robot: Robot, block: ElementTree.Element | None) -> Iterator[str]:
    tendons = [] if block is None else block.findall("tendon")
    actuators = [] if block is None else block.findall("actuator")
    yield from _same("tendons", [t.name for t in robot.tendons], _names(tendons))
    yield from _same("actuators", [a.name for a in robot.actuators], _names(actuators))
    for tendon, element in zip(robot.tendons, tendons, strict=False):
        where = f"tendon {tendon.name[:30]!r}"
        rest = None if element.get("rest") is None else _float(element, "rest")
        said = [_float(element, "stiffness"), _float(element, "damping"), rest]
        said += [element.get("slack") == "true", _float(element, "friction")]
        mine = [tendon.stiffness, tendon.damping, tendon.rest, tendon.slack, tendon.friction]
        yield from _same(f"numbers of {where}", mine, said)
        terms = [(e.get("name"), _float(e, "coef")) for e in element.findall("joint")]
        yield from _same(f"terms of {where}", [(t.joint, t.coef) for t in tendon.terms], terms)
        sites = [(e.get("link"), *_vector(e, "xyz")) for e in element.findall("site")]
        mine_sites = [(s.link, *s.xyz) for s in tendon.sites]
        yield from _same(f"sites of {where}", mine_sites, sites)
    for actuator, element in zip(robot.actuators, actuators, strict=False):
        gear = 1.0 if element.get("gear") is None else _float(element, "gear")
        bounds = [element.get("tendon"), gear, _float(element, "lower"), _float(element, "upper")]
        read = [actuator.tendon, actuator.gear, actuator.lower, actuator.upper]
        yield from _same(f"actuator {actuator.name[:30]!r}", read, bounds)
    yield from _rig(robot, actuators, [] if block is None else block.findall("sensor"))
    tasks = [] if block is None else block.findall("task")
    if tasks:
        yield from _same("task", robot.task, tasks[0].get("frame"))
        stated = [
            (e.get("frame"), e.get("kind", "position"), tuple((e.get("axes") or "").split()),
             *(_float(e, key) if e.get(key) else usual for key, usual in NUMBERS_OF_A_TASK.items()))
            for e in tasks
        ]  # fmt: skip
        read_tasks = [
            (t.frame, t.kind.value, t.axes, t.weight, t.Kp, t.level)
            for t in robot.tasks or (StatedTask(robot.task, robot.task),)
        ]
        yield from _same("tasks", read_tasks, stated)


def _rig(
    robot: Robot, actuators: list[ElementTree.Element], sensors: list[ElementTree.Element]
) -> Iterator[str]:
    """Commands, lags and delays of the actuators, and the sensors."""
    unbounded = {"length_lower": -math.inf, "length_upper": math.inf, "rate": math.inf}
    for actuator, element in zip(robot.actuators, actuators, strict=False):
        yield from _same(
            f"command of {actuator.name[:30]!r}",
            actuator.command.value,
            element.get("command", "force"),
        )
        for name in ("stiffness", "damping", "lag", "delay", "offset", *unbounded):
            said = _float(element, name) if element.get(name) else unbounded.get(name, 0.0)
            yield from _same(f"{name} of {actuator.name[:30]!r}", getattr(actuator, name), said)
    yield from _same("sensors", [sensor.name for sensor in robot.sensors], _names(sensors))
    for sensor, element in zip(robot.sensors, sensors, strict=False):
        where = f"sensor {sensor.name[:30]!r}"
        yield from _same(f"type of {where}", sensor.kind.value, element.get("type"))
        mine = [sensor.tendon, sensor.link, sensor.joint]
        place = [element.get(name, "") for name in ("tendon", "link", "joint")]
        yield from _same(f"place of {where}", mine, place)
        for name in ("xyz", "rpy"):
            yield from _close(
                f"{name} of {where}", np.array(getattr(sensor, name)), _vector(element, name)
            )
        for name in ("noise", "bias", "resolution"):
            numbers = tuple(float(word) for word in element.get(name, "0").split())
            yield from _same(f"{name} of {where}", getattr(sensor, name), numbers)
        for name in ("rate", "latency"):
            yield from _same(f"{name} of {where}", getattr(sensor, name), _float(element, name))


def _names(elements: Iterable[ElementTree.Element]) -> list[str | None]:
    return [element.get("name") for element in elements]


def _attribute(element: ElementTree.Element | None, name: str) -> str | None:
    return None if element is None else element.get(name)


def _float(element: ElementTree.Element | None, name: str) -> float:
    return float(_attribute(element, name) or 0.0)


def _vector(element: ElementTree.Element | None, name: str) -> np.ndarray:
    text = _attribute(element, name)
    return np.zeros(3) if text is None else np.array([float(word) for word in text.split()])


def _pose(element: ElementTree.Element) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and translation (3,) of an element's <origin>."""
    origin = element.find("origin")
    turn = Rotation.from_euler("xyz", _vector(origin, "rpy"))  # rotations about fixed axes
    if (quaternion := _attribute(origin, "quat_xyzw")) is not None:
        turn = Rotation.from_quat([float(word) for word in quaternion.split()])
    return turn.as_matrix(), _vector(origin, "xyz")


def _same(what: str, read: object, said: object) -> Iterator[str]:
    if read != said:
        yield f"{what}: read {str(read)[:200]}, the file says {str(said)[:200]}"


def _close(what: str, read: np.ndarray, said: np.ndarray) -> Iterator[str]:
    scale = max(float(np.abs(said).max()), 1e-300)
    if read.shape != said.shape or not float(np.abs(read - said).max()) <= 1e-9 * scale:
        yield from _same(what, read.tolist(), said.tolist())
    if not math.isfinite(float(np.abs(read).max())):
        yield f"{what}: not finite"
