"""Other tools' elements in a URDF: one table says which are read, ignored or refused.

A URDF may hold elements of any tool, and softdyn ignores most of them. An element that closes a
loop, adds a joint or a force, or changes mass, gravity, springs or damping describes another robot
than the one that softdyn would load, so it is refused. The known names are those of Gazebo, Drake,
MuJoCo, PyBullet, Isaac, RaiSim and onshape-to-robot. An unknown name is judged by the words in it.
The numbers that are read are those of `softdyn.description.motors`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from lxml import etree

from softdyn.description.strict_xml import Element
from softdyn.description.unknown_names import KNOWN

LOOPS = "a tree of <joint>s, some of which may follow others by <mimic>"
SPRINGS = "springs as <springStiffness> and <springReference>, or as a <tendon> in <softdyn>"
DAMPERS = 'dampers as <dynamics damping="…">, or as a <tendon> in <softdyn>'
GRAVITY = "gravity of 9.81 m/s² along -z on every link"
MASSES = 'masses in <inertial>, and rotors as <joint armature="…"> in <softdyn>'
FORCES = "forces as <tendon> and <actuator> in <softdyn>"
PARTS = "all links and joints right inside <robot>"
MOVES = "links that move as their joints let them"
EXPANDED = "a URDF that xacro has expanded"
REMEDY = ": write it so, or remove it"
OFF, ON = {"0", "false", "no"}, {"1", "true", "yes"}


@dataclass(frozen=True)
class Read:
    """Numbers in the element are read by `softdyn.description.motors`, if it is `used`.

    Another attribute that speaks of the dynamics is refused; `attributes` are those that are read.
    """

    used: Callable[[Element], bool]
    attributes: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Ignored:
    """The element changes no term of the dynamics; what it holds is not searched.

    `about` says in a word what it speaks of.
    """

    about: str = ""


@dataclass(frozen=True)
class Refused:
    """The element changes the robot, unless it is `neutral`; `remedy` is what softdyn reads."""

    remedy: str
    neutral: Callable[[Element], bool] = lambda _: False


@dataclass(frozen=True)
class Searched:
    """The content of the element decides: a function raises an error, or it is ignored."""

    search: Callable[[Element], None]


Verdict = Read | Ignored | Refused | Searched


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


def _said(*values: str) -> Callable[[Element], bool]:
    return lambda element: _value(element).lower() in values


def _all_zero(element: Element) -> bool:
    return not any(_numbers(element))


def _same_pose(element: Element) -> bool:
    """A link's pose must be zero; that of a whole robot may be elsewhere, but not turned."""
    of_robot = bool(element.node.xpath("parent::gazebo[not(@reference)]"))
    return not any(_numbers(element)[3 if of_robot else 0 :])


def _same_inertia(element: Element) -> bool:
    """PyBullet scales inertias in an element of contacts."""
    return all(_float(_value(child)) == 1 for child in element.children("inertia_scaling"))


def _control(element: Element) -> None:
    """Refuse a rotor's inertia in ``<ros2_control>``, where no rule says how it is reduced."""
    for node in element.node.iter(etree.Element):
        words = [word for word in (node.get("name"), etree.QName(node).localname) if word]
        if any(map(is_rotor, words)) and abs(_float(text := str(node.text or ""))) > 0:
            joint = next((str(one.get("name")) for one in node.iterancestors("joint")), "…")
            expected = f'<joint name="{joint}" armature="…"/> in <softdyn>: the inertia there'
            raise element.error(expected, f"{words[0]} {text.strip()!r}{REMEDY}")


def _mujoco(element: Element) -> None:
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


def is_rotor(name: str) -> bool:
    """Whether a name is one that tools give to the inertia of a motor's rotor."""
    return name.replace("_", "").lower() in ("rotorinertia", "motorinertia", "armature")


def holds_rotor(element: Element) -> bool:
    """Whether a rotor's inertia that is not zero stands in an element."""
    nodes = (Element(element.file, node, "") for node in element.node.iter(etree.Element))
    return any(
        is_rotor(etree.QName(one.node).localname) and not _is_zero(_value(one)) for one in nodes
    )


def _rows(verdict: Verdict, names: str) -> dict[str, Verdict]:
    return dict.fromkeys(names.split(), verdict)


LOOKS = {"visual", "collision"}
PROPERTIES = ("friction", "frictionloss", "damping", "armature")
TABLE: dict[str, Verdict] = {
    # rotors, and onshape-to-robot's numbers of a joint
    **_rows(Read(holds_rotor), "transmission"),
    **_rows(Read(lambda element: any(_numbers(element)), PROPERTIES), "joint_properties"),
    **_rows(Ignored("looks"), "material visual projector light webots"),
    **_rows(Ignored("sensors"), "sensor isaac_sensor lidar audio_source audio_sink"),
    **_rows(Ignored("control"), "plugin calibration safety_controller battery gripper"),
    **_rows(Ignored("names"), "verbose frame fixed_frame joint_index"),
    **_rows(Searched(_control), "ros2_control"),
    **_rows(Ignored("contacts"), """
        surface mu mu1 mu2 fdir1 kp kd maxVel minDepth maxContacts max_contacts laserRetro
        laser_retro selfCollide self_collide self_filter disable_collisions enable_collisions
        proximity_properties collision"""),
    **_rows(Refused(MASSES, _same_inertia), "contact"),
    **_rows(Ignored("solver, start"), """
        stopCfm stopErp stopKp stopKd fudgeFactor provideFeedback canonicalBody implicitSpringDamper
        cfmDamping disableFixedJointLumping preserveFixedJoint initial_joint_position
        initialJointPosition physics allow_auto_disable must_be_base_link enable_wind"""),
    **_rows(Ignored("a planner's groups"), "group end_effector passive_joint"),
    # gravity, motion, damping, place
    **_rows(Refused(GRAVITY, _said(*ON, "0 0 -9.81")), "gravity"),
    **_rows(Refused(GRAVITY, _said(*OFF)), "turnGravityOff"),
    **_rows(Refused(MOVES, _said(*OFF)), "kinematic static"),
    **_rows(Refused(DAMPERS, _all_zero), "dampingFactor velocity_decay"),
    **_rows(Refused(PARTS, _same_pose), "pose"),
    **_rows(Searched(_mujoco), "mujoco"),
}  # fmt: skip
"""Other tools' elements, by name."""
ATTRIBUTES: dict[tuple[str, str], Verdict] = {
    # RaiSim's, and MuJoCo's word: the inertia of the rotor at the joint
    ("dynamics", "rotor_inertia"): Read(lambda _: True),
    ("dynamics", "armature"): Read(lambda _: True),
    # alone, the letters name a coefficient
    **{("dynamics", letter): Refused(SPRINGS) for letter in "kK"},
    **{("dynamics", letter): Refused(DAMPERS) for letter in "dDcCbB"},
}
"""Other tools' attributes of standard elements."""
# Words in unknown names, and how softdyn reads what they speak of; the first that is found counts.
MEANINGS = (
    (("loop", "closed", "closure", "constrain", "weld", "hinge", "slider", "joint", "equality",
      "coupl", "mimic", "belt"), LOOPS),
    (("spring", "stiff", "elastic", "complian", "bushing"), SPRINGS),
    (("damp", "visc", "decay", "drag"), DAMPERS),
    (("gravit", "buoyan"), GRAVITY),
    (("mass", "inerti", "densit", "armature"), MASSES),
    (("force", "torque", "wrench", "thrust", "tendon", "muscle", "cable", "rope", "preload",
      "hydro", "deform", "magnet"), FORCES),
)  # fmt: skip
HARMLESS = ("sensor", "plugin", "controller", "interface", "camera", "feedback", "state", "limit",
            "contact", "collision", "cost")  # fmt: skip
ANOTHER_ROBOT = {
    "sdf", "model", "world", "include", "link", "axis", "axis2", "body", "worldbody",
}  # fmt: skip
# Parameters of a drive in <dynamics>, which stand together; no simulator reads them.
OF_A_DRIVE = {"K", "D", "mu_coulomb", "mu_viscous"}
OLD_GAZEBO = "http://playerstage.sourceforge.net/gazebo/"  # namespaces of releases before 1.0
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
            elif child.tag not in children or child.tag in TABLE.keys() - LOOKS:
                self._other(child, "" if element.tag == "robot" else f"<{element.tag}>")

    def _attributes(self, element: Element, known: tuple[str, ...]) -> None:
        names = [name for name in map(str, element.node.attrib) if name not in known]
        spared = element.tag == "dynamics" and OF_A_DRIVE.issubset(names)
        for name in names:
            local, value = etree.QName(name).localname, str(element.node.get(name))
            verdict = ATTRIBUTES.get((element.tag, local))
            if isinstance(verdict, Read):
                continue
            self.ignored[f"<{element.tag} {local}>"] += 1
            expected = verdict.remedy if isinstance(verdict, Refused) else _meaning(local)
            expected = PARTS if local == "drake_ignore" else expected
            # a limit's other attributes bound a motion or a motor
            harmless = element.tag == "limit" or (spared and name in OF_A_DRIVE)
            if expected and not _is_zero(value) and not harmless:
                raise element.error(expected, f'{local}="{value}"{REMEDY}')

    def _other(self, element: Element, inside: str) -> None:
        """Judge an element of another tool."""
        name = etree.QName(element.node)
        tag, space, prefix = name.localname, name.namespace or "", element.node.prefix
        shown = f"<{prefix}:{tag}>" if prefix else f"<{tag}>"
        if space.endswith("xacro"):
            raise element.error(EXPANDED, shown)
        verdict = TABLE.get(tag) or self._unknown(element)
        if isinstance(verdict, Searched):
            verdict.search(element)
        if isinstance(verdict, Read) and verdict.attributes is not None:
            self._attributes(element, verdict.attributes)
        if isinstance(verdict, Read) and verdict.used(element):
            return
        if not isinstance(verdict, Refused) or verdict.neutral(element):
            about = getattr(verdict, "about", "")
            self.ignored[f"{inside}{shown}{about and f' ({about})'}"] += 1
        elif space.startswith(OLD_GAZEBO) or (self._old and verdict.remedy == GRAVITY):
            self.left_out[shown] += 1
        else:
            raise element.error(verdict.remedy, f"{shown}{_shown(element)}{REMEDY}")

    def _unknown(self, element: Element) -> Verdict:
        """Judge an element by its name, and by the names of all that it holds."""
        name = etree.QName(element.node)
        tag = name.localname
        if _holds(f"{name.namespace} {tag}", HARMLESS):
            return Ignored()
        found = next((meaning for word in _words(element) if (meaning := _meaning(word))), None)
        if found is None and tag in ANOTHER_ROBOT:
            found = PARTS
        if found is None:
            nodes = list(element.node.iter(etree.Element))
            values = {(node.text or "").strip() for node in nodes}
            values |= {str(x) for node in nodes for x in node.attrib.values()}
            # it ties two parts of the robot together
            found = LOOPS if len(values & self._names) > 1 else None
        return Ignored() if found is None else Refused(found)


def _words(element: Element) -> Iterator[str]:
    """The names in an element: of itself, of what it holds, of attributes that are not zero."""
    for node in element.node.iter(etree.Element):
        yield etree.QName(node).localname
        for key, value in node.attrib.items():
            if not _is_zero(str(value)):
                yield etree.QName(key).localname
            if key in ("type", "kind", "class"):
                yield str(value)


def _shown(element: Element) -> str:
    """The value of an element, or the first word in it that has a meaning."""
    if value := _value(element):
        return f" {value!r}"
    own, *inner = _words(element)
    word = next((word for word in inner if _meaning(word)), None)
    return "" if word is None or _meaning(own) else f" with {word!r}"


def _holds(text: str, words: tuple[str, ...]) -> bool:
    lowered = text.lower()
    return any(word in lowered for word in words)


def _meaning(name: str) -> str | None:
    """How softdyn reads what a name speaks of; None if it speaks of no dynamics."""
    if isinstance(TABLE.get(name), Ignored | Read) or _holds(name, HARMLESS):
        return None
    return next((meaning for words, meaning in MEANINGS if _holds(name, words)), None)
