"""Other tools' elements in a URDF: those that are ignored, and those that change the robot.

A URDF may hold elements of any tool, and softdyn ignores most of them. An element that closes a
loop, adds a joint or a force, or changes mass, gravity, springs or damping describes another robot
than the one that softdyn would load, so it is refused. The known names are those of Gazebo, Drake,
MuJoCo, PyBullet and Isaac. An unknown name is judged by the words in it.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator

from lxml import etree

from softdyn.description.strict_xml import Element
from softdyn.description.unknown_names import KNOWN

# They change no term of the dynamics. What they hold is not searched.
IGNORED = {
    # controllers, sensors, looks
    "transmission", "plugin", "sensor", "ros2_control", "material", "calibration",
    "safety_controller", "webots", "projector", "light", "verbose", "frame", "audio_source",
    "audio_sink", "battery", "gripper", "visual", "collision",
    # contacts
    "contact", "surface", "mu", "mu1", "mu2", "fdir1", "kp", "kd", "maxVel", "minDepth",
    "maxContacts", "max_contacts", "laserRetro", "laser_retro", "selfCollide", "self_collide",
    "self_filter", "disable_collisions", "enable_collisions", "proximity_properties",
    # solvers and starts
    "stopCfm", "stopErp", "stopKp", "stopKd", "fudgeFactor", "provideFeedback", "canonicalBody",
    "implicitSpringDamper", "cfmDamping", "disableFixedJointLumping", "preserveFixedJoint",
    "initial_joint_position", "initialJointPosition", "physics", "allow_auto_disable",
    "must_be_base_link", "enable_wind",
    # groups of a planner
    "group", "end_effector", "passive_joint",
}  # fmt: skip
LOOPS = "a tree of <joint>s, some of which may follow others by <mimic>"
SPRINGS = "springs as <springStiffness> and <springReference>, or as a <tendon> in <softdyn>"
DAMPERS = 'dampers as <dynamics damping="…">, or as a <tendon> in <softdyn>'
GRAVITY = "gravity of 9.81 m/s² along -z on every link"
MASSES = 'masses in <inertial>, and rotors as <joint armature="…"> in <softdyn>'
FORCES = "forces as <tendon> and <actuator> in <softdyn>"
PARTS = "all links and joints right inside <robot>"
MOVES = "links that move as their joints let them"
ANOTHER_ROBOT = {
    "sdf", "model", "world", "include", "link", "axis", "axis2", "body", "worldbody",
}  # fmt: skip
# Words, and how softdyn reads what they speak of; the first one that is found counts.
MEANINGS = (
    (r"loop|clos(ed|ure)|constrain|weld|hinge|slider|joint|equality|coupl|mimic|belt", LOOPS),
    (r"spring|stiff|elastic|complian|bushing", SPRINGS),
    (r"damp|visc|decay|drag", DAMPERS),
    (r"gravit|buoyan", GRAVITY),
    (r"mass|inerti|densit|armature", MASSES),
    (r"force|torque|wrench|thrust|tendon|muscle|cable|rope|preload|hydro|deform|magnet", FORCES),
)
HARMLESS = r"sensor|plugin|controller|interface|camera|feedback|state|limit|contact|collision|cost"
OFF, ON = {"0", "false", "no"}, {"1", "true", "yes"}
LETTERS = {"k": SPRINGS, "d": DAMPERS, "c": DAMPERS, "b": DAMPERS}  # alone they name a coefficient
# Parameters of a drive in <dynamics>, which stand together; no simulator reads them.
OF_A_DRIVE = {"K", "D", "mu_coulomb", "mu_viscous"}
REMEDY = ": write it so, or remove it"
OLD_GAZEBO = "http://playerstage.sourceforge.net/gazebo/"  # namespaces of releases before 1.0
DRAKE = "{http://drake.mit.edu}"


def check_other_tools(robot: Element) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Refuse other tools' elements and attributes that change the robot.

    Returns
    -------
    ignored, warnings : tuple of str
        The ignored ones, each with its number, and a line about those that only releases of Gazebo
        before 1.0 (2012) read: joints and links without gravity are left out.

    Raises
    ------
    UrdfError
        For the first one that changes the robot.
    """
    scan = _Scan(robot)
    scan.standard(robot)
    warnings: tuple[str, ...] = ()
    if scan.left_out:
        parts = ", ".join(f"{count} {name}" for name, count in scan.left_out.items())
        warnings = (f"{robot.file}: <gazebo>: left out, for Gazebo before 1.0 only: {parts}",)
    return tuple(f"{count} {name}" for name, count in sorted(scan.ignored.items())), warnings


class _Scan:
    """One walk through a file, which counts what is ignored."""

    def __init__(self, robot: Element) -> None:
        self.ignored: Counter[str] = Counter()
        self.left_out: Counter[str] = Counter()
        self._old = any(uri.startswith(OLD_GAZEBO) for uri in robot.node.nsmap.values())
        self._names = {node.get("name") for node in robot.node.iterchildren("link", "joint")}

    def standard(self, element: Element) -> None:
        """Judge what stands in an element of URDF."""
        children, attributes = KNOWN[element.tag]
        if element.tag not in ("origin", "mimic"):  # these refuse every unknown attribute
            self._attributes(element, attributes)
        for child in element.children():
            if child.tag in children and child.tag in KNOWN:
                self.standard(child)
            elif child.tag not in children or child.tag in IGNORED - {"visual", "collision"}:
                self._other(child, "" if element.tag == "robot" else f"<{element.tag}>")

    def _attributes(self, element: Element, known: tuple[str, ...]) -> None:
        names = [name for name in map(str, element.node.attrib) if name not in known]
        dynamics = element.tag == "dynamics"
        spared = OF_A_DRIVE if dynamics and OF_A_DRIVE.issubset(names) else set()
        for name in names:
            local, value = etree.QName(name).localname, str(element.node.get(name))
            self.ignored[f"<{element.tag} {local}>"] += 1
            expected = LETTERS.get(local.lower()) if dynamics else None
            expected = PARTS if local == "drake_ignore" else expected or _meaning(local)
            # a limit's other attributes bound a motion or a motor
            if expected and not _is_zero(value) and name not in spared and element.tag != "limit":
                raise element.error(expected, f'{local}="{value}"{REMEDY}')

    def _other(self, element: Element, inside: str) -> None:
        """Judge an element of another tool."""
        name = etree.QName(element.node)
        tag, space, prefix = name.localname, name.namespace or "", element.node.prefix
        shown = f"<{prefix}:{tag}>" if prefix else f"<{tag}>"
        if space.endswith("xacro"):
            raise element.error("a URDF that xacro has expanded", shown)
        expected = BY_CONTENT.get(tag, self._unknown)(element)
        if expected is None:
            self.ignored[f"{inside}{shown}"] += 1
        elif space.startswith(OLD_GAZEBO) or (self._old and expected == GRAVITY):
            self.left_out[shown] += 1
        else:
            raise element.error(expected, f"{shown}{_said(element)}{REMEDY}")

    def _unknown(self, element: Element) -> str | None:
        """Judge an element by its name, and by the names of all that it holds."""
        name = etree.QName(element.node)
        tag = name.localname
        if tag in IGNORED or re.search(HARMLESS, f"{name.namespace} {tag}".lower()):
            return None
        found = next((meaning for word in _words(element) if (meaning := _meaning(word))), None)
        if found is None and tag in ANOTHER_ROBOT:
            return PARTS
        values = {(node.text or "").strip() for node in element.node.iter(etree.Element)}
        values |= {
            str(x) for node in element.node.iter(etree.Element) for x in node.attrib.values()
        }
        # it ties two parts of the robot together
        return LOOPS if found is None and len(values & self._names) > 1 else found


def _words(element: Element) -> Iterator[str]:
    """The names in an element: of itself, of what it holds, of attributes that are not zero."""
    for node in element.node.iter(etree.Element):
        yield etree.QName(node).localname
        for key, value in node.attrib.items():
            if not _is_zero(str(value)):
                yield etree.QName(key).localname
            if key in ("type", "kind", "class"):
                yield str(value)


def _said(element: Element) -> str:
    """The value of an element, or the first word in it that has a meaning."""
    if value := _value(element):
        return f" {value!r}"
    own, *inner = _words(element)
    word = next((word for word in inner if _meaning(word)), None)
    return "" if word is None or _meaning(own) else f" with {word!r}"


def _meaning(name: str) -> str | None:
    """How softdyn reads what a name speaks of; None if it speaks of no dynamics."""
    lowered = name.lower()
    if name in IGNORED or re.search(HARMLESS, lowered):
        return None
    return next((meaning for words, meaning in MEANINGS if re.search(words, lowered)), None)


def _value(element: Element) -> str:
    """An element's value: Gazebo reads it from the attribute `value`, or from the text."""
    value = element.node.get("value")
    return str(element.node.text or "" if value is None else value).strip()


def _float(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan


def _is_zero(text: str) -> bool:
    return text.strip().lower() in OFF or _float(text) == 0


def _numbers(element: Element) -> list[float]:
    """All numbers in an element and inside it; NaN for another word."""
    nodes = element.node.iter(etree.Element)
    texts = (text for node in nodes for text in (node.text or "", *node.attrib.values()))
    return [_float(word) for text in texts for word in str(text).split()]


def _unless(neutral: set[str], expected: str) -> Callable[[Element], str | None]:
    return lambda element: None if _value(element).lower() in neutral else expected


def _damping(element: Element) -> str | None:
    return DAMPERS if any(_numbers(element)) else None


def _pose(element: Element) -> str | None:
    """A link's pose must be zero; that of a whole robot may be elsewhere, but not turned."""
    of_robot = bool(element.node.xpath("parent::gazebo[not(@reference)]"))
    return PARTS if any(_numbers(element)[3 if of_robot else 0 :]) else None


def _contact(element: Element) -> str | None:
    """PyBullet scales inertias in an element of contacts."""
    scales = [_float(_value(child)) for child in element.children("inertia_scaling")]
    return MASSES if any(scale != 1 for scale in scales) else None


def _transmission(element: Element) -> str | None:
    """Drake's rotors: an armature of rotor_inertia · gear_ratio²."""
    for actuator in element.children("actuator"):
        rotor = actuator.child(f"{DRAKE}rotor_inertia")
        if rotor is None:
            continue
        gear, joint = actuator.child(f"{DRAKE}gear_ratio"), next(element.children("joint"), None)
        armature = _float(_value(rotor)) * (_float(_value(gear)) if gear else 1.0) ** 2
        name = joint.node.get("name") if joint else "…"
        if armature != 0:
            expected = f'<joint name="{name}" armature="{armature:g}"/> in <softdyn>'
            raise rotor.error(expected, f"<drake:rotor_inertia>{REMEDY}")
    return None


def _mujoco(element: Element) -> str | None:
    """MuJoCo's settings may stand in a URDF; some make another robot of it."""
    for child in element.children():
        if child.tag not in SETTINGS:
            expected = {"actuator": FORCES}.get(child.tag, _meaning(child.tag) or PARTS)
            raise child.error(expected, f"<{child.tag}> in <mujoco>{REMEDY}")
        for part in (child, *child.children("flag")):
            for name, value in ((str(key), str(text)) for key, text in part.node.attrib.items()):
                change = CHANGES.get((part.tag, name))
                if change is not None and not change[0](value.strip().lower()):
                    raise part.error(change[1], f'{name}="{value}"{REMEDY}')
    return None


SETTINGS = {
    "compiler", "option", "size", "visual", "statistic", "custom", "asset", "extension", "contact",
    "sensor", "keyframe",
}  # fmt: skip
# MuJoCo's attributes that change a robot: the test of a value that does not, the meaning.
CHANGES: dict[tuple[str, str], tuple[Callable[[str], object], str]] = {
    ("compiler", "boundmass"): (_is_zero, MASSES),
    ("compiler", "boundinertia"): (_is_zero, MASSES),
    ("compiler", "settotalmass"): (lambda text: _float(text) <= 0, MASSES),
    ("compiler", "inertiafromgeom"): (lambda text: text != "true", MASSES),
    ("option", "gravity"): (lambda text: [*map(_float, text.split())] == [0, 0, -9.81], GRAVITY),
    ("option", "density"): (_is_zero, FORCES),
    ("option", "viscosity"): (_is_zero, FORCES),
    ("flag", "gravity"): (lambda text: text == "enable", GRAVITY),
    ("flag", "passive"): (lambda text: text == "enable", SPRINGS),
    ("flag", "spring"): (lambda text: text == "enable", SPRINGS),
    ("flag", "damper"): (lambda text: text == "enable", DAMPERS),
}
# Elements that are judged by what they hold: None, or what softdyn expects instead.
BY_CONTENT: dict[str, Callable[[Element], str | None]] = {
    "gravity": _unless({*ON, "0 0 -9.81"}, GRAVITY),
    "turnGravityOff": _unless(OFF, GRAVITY),
    "kinematic": _unless(OFF, MOVES),
    "static": _unless(OFF, MOVES),
    "dampingFactor": _damping,
    "velocity_decay": _damping,
    "pose": _pose,
    "contact": _contact,
    "transmission": _transmission,
    "mujoco": _mujoco,
}
