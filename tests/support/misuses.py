"""A valid micro-robot, and every misuse of the format as one change to it.

Tests raise each of these errors. ``python -m tests.support.misuses`` writes the table of messages
in ``docs/format.md``, and a test compares the two.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

from softdyn.description.urdf import parse
from softdyn.exceptions import UrdfError
from tests.support import ROOT

INERTIAL = (
    '<inertial><origin xyz="0.05 0 0"/><mass value="0.1"/>'
    '<inertia ixx="1e-5" ixy="0" ixz="0" iyy="9e-5" iyz="0" izz="9e-5"/></inertial>'
)
LIMIT = '<limit lower="-1" upper="1" effort="9" velocity="9"/>'
A_BRANCH = "a stiffness and a time > 0 of each branch as relaxation"
ARM = f"""\
<robot name="arm">
  <link name="world"/>
  <link name="base"/>
  <link name="knuckle"/>
  <link name="finger">{INERTIAL}</link>
  <link name="pad">
    <inertial>
      <mass value="0.01"/><inertia ixx="1e-6" ixy="0" ixz="0" iyy="1e-6" iyz="0" izz="1e-6"/>
    </inertial>
  </link>
  <link name="slider">{INERTIAL}</link>
  <link name="wheel">{INERTIAL}</link>
  <joint name="mount" type="fixed"><parent link="world"/><child link="base"/></joint>
  <joint name="bend" type="revolute">
    <parent link="base"/><child link="knuckle"/>
    <axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="1.5" effort="9" velocity="9"/>
    <dynamics damping="0.02" friction="0.001"/>
  </joint>
  <joint name="twist" type="revolute">
    <parent link="knuckle"/><child link="finger"/>
    <axis xyz="1 0 0"/>{LIMIT}<dynamics damping="0.01" stiffness="0.2"/>
  </joint>
  <joint name="glue" type="fixed">
    <parent link="finger"/><child link="pad"/><origin xyz="0.1 0 0" rpy="0 0 0.3"/>
  </joint>
  <joint name="slide" type="prismatic">
    <parent link="pad"/><child link="slider"/><origin xyz="0.02 0 0"/>
    <axis xyz="0 0 2"/>{LIMIT}
  </joint>
  <joint name="spin" type="continuous"><parent link="slider"/><child link="wheel"/></joint>
  <gazebo reference="bend">
    <springStiffness>0.5</springStiffness><springReference>0.1</springReference>
  </gazebo>
  <gazebo reference="spin"/>
  <softdyn version="1">
    <joint name="bend" armature="0.005"/>
    <tendon name="flexor" stiffness="3" damping="0.1" rest="0.2">
      <joint name="bend" coef="1"/>
      <joint name="twist" coef="-0.5"/>
    </tendon>
    <tendon name="cable">
      <site link="base" xyz="0 0 0.02"/>
      <site link="finger" xyz="0.05 0 0.02"/>
      <site link="pad" xyz="0 0 0.01"/>
    </tendon>
    <tendon name="drive"><joint name="spin" coef="1"/></tendon>
    <actuator name="u1" tendon="flexor" gear="0.1" lower="-1" upper="1"/>
    <actuator name="u2" tendon="cable" gear="-1" lower="0" upper="5"/>
    <task frame="wheel"/>
  </softdyn>
</robot>
"""


@dataclass(frozen=True)
class Misuse:
    """A change of `ARM` and the words its error must contain.

    `change` is (old, new), where old occurs exactly once, or the whole file. `element` is the
    element that the message names. `title` is the text of its row in the document; None leaves it
    out.
    """

    title: str
    change: tuple[str, str] | str | bytes
    element: str
    expected: str
    got: str
    row: bool = True

    @property
    def data(self) -> bytes:
        if isinstance(self.change, bytes):
            return self.change
        if isinstance(self.change, str):
            return self.change.encode()
        old, new = self.change
        assert ARM.count(old) == 1, f"{old!r} occurs {ARM.count(old)} times"
        return ARM.replace(old, new).encode()

    def error(self, folder: Path) -> UrdfError:
        """The exception that parsing the file raises."""
        path = folder / "arm.urdf"
        path.write_bytes(self.data)
        try:
            parse(path)
        except UrdfError as error:
            return error
        raise AssertionError(f"{self.title}: accepted")


def inside(new: str) -> tuple[str, str]:
    """Insert text inside the block."""
    return '<task frame="wheel"/>', f'<task frame="wheel"/>\n{new}'


def beside(new: str) -> tuple[str, str]:
    """Insert text into the robot, beside the block."""
    return "</robot>", f"{new}\n</robot>"


def number(text: str) -> tuple[str, str]:
    """Replace a number by another text."""
    return 'damping="0.02"', f'damping="{text}"'


def mimic(element: str) -> tuple[str, str]:
    """Let the slide follow another joint."""
    return '<axis xyz="0 0 2"/>', f'<axis xyz="0 0 2"/>{element}'


FLEXOR, CABLE = '<tendon name="flexor">', '<tendon name="cable">'
U1, U2 = '<actuator name="u1">', '<actuator name="u2">'
SPRING_BEND = '<gazebo reference="bend"><springStiffness>'
SPRING_SPIN = '<gazebo reference="spin"><springStiffness>'
REST_BEND = '<gazebo reference="bend"><springReference>'
COEF = '<joint name="twist" coef="-0.5"/>'
SITES = """\
      <site link="base" xyz="0 0 0.02"/>
      <site link="finger" xyz="0.05 0 0.02"/>
      <site link="pad" xyz="0 0 0.01"/>
"""
TERMS = """\
      <joint name="bend" coef="1"/>
      <joint name="twist" coef="-0.5"/>
"""
BODY = 'ixx="1e-5" ixy="0" ixz="0" iyy="9e-5" iyz="0" izz="9e-5"'
FINGER = f'<link name="finger">{INERTIAL}</link>'
SPIN = '<joint name="spin" type="continuous"><parent link="slider"/><child link="wheel"/></joint>'
CHAIN = "".join(f'<link name="x{i}"/>' for i in range(1030))
STAR = "".join(
    f'<link name="x{i}">{INERTIAL}</link><joint name="y{i}" type="continuous">'
    f'<parent link="base"/><child link="x{i}"/></joint>'
    for i in range(253)
)

FILE = [
    Misuse("empty file", "", "file", "well-formed XML", "Document is empty"),
    Misuse("truncated XML", ARM[:-9], "file", "well-formed XML", "Premature end of data"),
    Misuse("truncated tag", ARM[:200], "file", "well-formed XML", "", row=False),
    Misuse("no XML at all", "robot: arm\n", "file", "well-formed XML", "", row=False),
    Misuse("null character", b"<robot name='a\0'/>", "file", "well-formed XML", "", row=False),
    Misuse("attribute twice", ('link name="base"', 'link name="a" name="base"'), "file",
           "well-formed XML", "Attribute name redefined"),
    Misuse("two documents", ARM + ARM, "file", "well-formed XML", "Extra content", row=False),
    Misuse("unknown encoding", '<?xml version="1.0" encoding="klingon"?>' + ARM, "file",
           "well-formed XML", "Unsupported encoding", row=False),
    Misuse("text in another encoding than declared", ARM.replace("base", "bäse").encode("latin-1"),
           "file", "well-formed XML", "", row=False),
    Misuse("nested beyond 256 levels", beside("<a>" * 300 + "</a>" * 300), "file",
           "well-formed XML", "Excessive depth", row=False),
    Misuse("DTD", "<!DOCTYPE robot>\n" + ARM, "<!DOCTYPE>", "no DTD and no entities",
           "a document type declaration"),
    Misuse("entity", '<!DOCTYPE robot [<!ENTITY e "1">]>' + ARM.replace('"0.1"', '"&e;"'),
           "<!DOCTYPE>", "no DTD and no entities", "a document type declaration", row=False),
    Misuse("entity of another file",
           '<!DOCTYPE robot [<!ENTITY e SYSTEM "file:///etc/hostname">]>'
           + ARM.replace("</robot>", "&e;</robot>"),
           "<!DOCTYPE>", "no DTD and no entities", "a document type declaration", row=False),
    Misuse("undefined entity", beside("&e;"), "file", "well-formed XML", "", row=False),
    Misuse("more than 16 MiB", ARM + " " * 2**24, "file", "at most 16777216 bytes", "more"),
    Misuse("another root element", "<sdf/>", "<sdf>", "the root element <robot>", "<sdf>"),
    Misuse("an MJCF", "<mujoco/>", "<mujoco>", "the root element <robot>",
           "<mujoco>, an MJCF: `softdyn export` writes it as a URDF", row=False),
    Misuse("root in a namespace", ARM.replace("<robot", '<robot xmlns="u"'), "<{u}robot>",
           "the root element <robot>", "<{u}robot>", row=False),
    Misuse("robot without a name", (' name="arm"', ""), "<robot>", 'attribute name="…"', "none"),
]  # fmt: skip
TREE = [
    Misuse("no link", '<robot name="a"/>', "<robot>", "1 to 1024 links", "0"),
    Misuse("too many links", beside(CHAIN), "<robot>", "1 to 1024 links", "1037"),
    Misuse("too many degrees of freedom", beside(STAR), "<robot>",
           "at most 256 degrees of freedom", "257"),
    Misuse("link without a name", ('<link name="base"/>', "<link/>"), "<link>",
           'attribute name="…"', "none", row=False),
    Misuse("blank name", ('<link name="base"/>', '<link name=" "/>'), '<link name=" ">',
           'attribute name="…"', "nothing", row=False),
    Misuse("duplicate link", ('<link name="base"/>', '<link name="base"/><link name="base"/>'),
           '<link name="base">', "a unique link name", "a second 'base'"),
    Misuse("duplicate joint", ('joint name="glue"', 'joint name="bend"'), '<joint name="bend">',
           "a unique joint name", "a second 'bend'"),
    Misuse("joint without a type", (' type="prismatic"', ""), '<joint name="slide">',
           'attribute type="…"', "none", row=False),
    Misuse("unsupported joint type", ('type="prismatic"', 'type="floating"'),
           '<joint name="slide">', "type revolute, continuous, prismatic or fixed", "'floating'"),
    Misuse("planar joint", ('type="prismatic"', 'type="planar"'), '<joint name="slide">',
           "type revolute, continuous, prismatic or fixed", "'planar'", row=False),
    Misuse("mimic of an unknown joint", mimic('<mimic joint="thumb"/>'),
           '<joint name="slide">', "in <mimic> the name of a joint that moves", "'thumb'"),
    Misuse("mimic of a fixed joint", mimic('<mimic joint="glue"/>'),
           '<joint name="slide">', "in <mimic> the name of a joint that moves",
           "fixed joint 'glue'"),
    Misuse("mimic of itself", mimic('<mimic joint="slide"/>'), '<joint name="slide">',
           "in <mimic> a leader that does not follow its own follower",
           "a cycle: slide follows slide", row=False),
    Misuse("mimics in a cycle", ARM.replace(*mimic('<mimic joint="spin"/>')).replace(
           SPIN, SPIN.replace("</joint>", '<mimic joint="slide"/></joint>')),
           '<joint name="slide">', "in <mimic> a leader that does not follow its own follower",
           "a cycle: slide follows spin follows slide"),
    Misuse("mimic of an ambiguous position", mimic('<mimic joint="spin" multiplier="2"/>'),
           '<joint name="slide">', "a follower of continuous joint 'spin', whose angle is",
           "a prismatic one with multiplier 2"),
    Misuse("mimic of half an angle", ARM.replace('type="prismatic"', 'type="continuous"').replace(
           *mimic('<mimic joint="spin" multiplier="0.5"/>')), '<joint name="slide">',
           "turns only, that is continuous with a whole multiplier; or a leader of type",
           "a continuous one with multiplier 0.5", row=False),
    Misuse("mimic beyond all numbers", ARM.replace(
           *mimic('<mimic joint="spin" multiplier="1e40"/>')).replace(
           SPIN, SPIN.replace("</joint>", '<mimic joint="bend" multiplier="1e20"/></joint>')),
           '<joint name="slide">', "a multiplier and an offset within ±1e+06",
           "1e+60 and 0 along slide, spin, bend", row=False),
    Misuse("mimic that squares to overflow", mimic('<mimic joint="bend" multiplier="1e40"/>'),
           '<joint name="slide">', "in <mimic> a multiplier and an offset within ±1e+06",
           "1e+40 and 0 along slide, bend"),
    Misuse("mimic with an offset beyond all places", mimic('<mimic joint="bend" offset="-1e7"/>'),
           '<joint name="slide">', "in <mimic> a multiplier and an offset within ±1e+06",
           "1 and -1e+07 along slide, bend", row=False),
    Misuse("visual with a colour of three numbers", ('<link name="base"/>', '<link name="base">'
           '<visual><geometry><sphere radius="1"/></geometry><material name="red">'
           '<color rgba="1 0 0"/></material></visual></link>'),
           '<link name="base"><visual><material name="red"><color>', "four numbers as rgba",
           "1 0 0"),
    Misuse("collision with a negative radius", ('<link name="base"/>', '<link name="base">'
           '<collision><geometry><sphere radius="-1"/></geometry></collision></link>'),
           '<link name="base"><collision><geometry><sphere>', "radius >= 0", "-1", row=False),
    Misuse("unknown attribute of a mimic", mimic('<mimic joint="bend" ratio="2"/>'),
           '<joint name="slide"><mimic>', "no attribute but joint, multiplier, offset", "ratio"),
    Misuse("a multiplier that is no number", mimic('<mimic joint="bend" multiplier="x"/>'),
           '<joint name="slide"><mimic>', "a finite number as multiplier", "'x'", row=False),
    Misuse("a joint with Pinocchio's own name", ('joint name="glue"', 'joint name="universe"'),
           '<joint name="universe">', "another name", "'universe'"),
    Misuse("joint without a child", ('<child link="knuckle"/>', ""), '<joint name="bend">',
           "<child>", "none"),
    Misuse("joint without a parent", ('<parent link="knuckle"/>', ""), '<joint name="twist">',
           "<parent>", "none", row=False),
    Misuse("joint to an unknown link", ('<child link="knuckle"/>', '<child link="nail"/>'),
           '<joint name="bend"><child>', "the name of a link", "'nail'"),
    Misuse("two parents", ('<child link="pad"/>', '<child link="knuckle"/>'),
           '<joint name="glue">', "one parent of link 'knuckle'", "joints 'bend' and 'glue'"),
    Misuse("two roots", ('<link name="base"/>', '<link name="base"/><link name="stray"/>'),
           "<robot>", "one root link, every other one joined to it", "2: world, stray"),
    Misuse("cycle of all links",
           '<robot name="a"><link name="a"/><link name="b"/>'
           '<joint name="i" type="fixed"><parent link="a"/><child link="b"/></joint>'
           '<joint name="j" type="fixed"><parent link="b"/><child link="a"/></joint></robot>',
           "<robot>", "one root link, every other one joined to it", "a cycle", row=False),
    Misuse("cycle", ('<parent link="base"/>', '<parent link="wheel"/>'), "<robot>", "a tree",
           "a cycle: 5 links out of the root's reach"),
    Misuse("a link jointed to itself", ('<parent link="slider"/>', '<parent link="wheel"/>'),
           "<robot>", "a tree", "a cycle", row=False),
    Misuse("missing limit", (f'<axis xyz="0 0 2"/>{LIMIT}', '<axis xyz="0 0 2"/>'),
           '<joint name="slide">', "<limit lower=", "none"),
    Misuse("limit without effort", ('upper="1.5" effort="9"', 'upper="1.5"'),
           '<joint name="bend"><limit>', 'attribute effort="…"', "none", row=False),
    Misuse("limit without velocity", ('upper="1.5" effort="9" velocity="9"',
                                      'upper="1.5" effort="9"'),
           '<joint name="bend"><limit>', 'attribute velocity="…"', "none", row=False),
    Misuse("joint limits, lower > upper", ('lower="-1.5"', 'lower="2"'),
           '<joint name="bend"><limit>', "lower <= upper", "lower=2.0 upper=1.5"),
    Misuse("zero axis", ('xyz="0 1 0"', 'xyz="0 0 0"'), '<joint name="bend"><axis>',
           "a non-zero vector", "'0 0 0'"),
    Misuse("axis without xyz", ('<axis xyz="0 1 0"/>', "<axis/>"), '<joint name="bend"><axis>',
           'attribute xyz="…"', "none", row=False),
    Misuse("element twice", ('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><axis xyz="1 0 0"/>'),
           '<joint name="bend"><axis>', "one <axis>", "2 of them"),
    Misuse("origin twice", ('<origin xyz="0.02 0 0"/>',
                            '<origin xyz="0.02 0 0"/><origin xyz="0 0 0"/>'),
           '<joint name="slide"><origin>', "one <origin>", "2 of them", row=False),
    Misuse("limit twice", (f'<axis xyz="0 0 2"/>{LIMIT}', f'<axis xyz="0 0 2"/>{LIMIT}{LIMIT}'),
           '<joint name="slide"><limit>', "one <limit>", "2 of them", row=False),
    Misuse("dynamics twice", ('<dynamics damping="0.02" friction="0.001"/>',
                              '<dynamics damping="0.02"/><dynamics damping="0.03"/>'),
           '<joint name="bend"><dynamics>', "one <dynamics>", "2 of them", row=False),
    Misuse("inertial twice", (FINGER, FINGER.replace("</link>", f"{INERTIAL}</link>")),
           '<link name="finger"><inertial>', "one <inertial>", "2 of them", row=False),
    Misuse("mass twice", ('<mass value="0.01"/>', '<mass value="0.01"/><mass value="1"/>'),
           '<link name="pad"><inertial><mass>', "one <mass>", "2 of them", row=False),
    Misuse("unknown attribute of an origin", ('rpy="0 0 0.3"', 'quat="0 0 0 1"'),
           '<joint name="glue"><origin>', "no attribute but xyz, rpy, quat_xyzw", "quat"),
    Misuse("quaternion before URDF 1.1", ('rpy="0 0 0.3"', 'quat_xyzw="0 0 0.6 0.8"'),
           '<joint name="glue"><origin>', 'rpy="0 0 1.287002217586569", or <robot version="1.1">',
           "quat_xyzw in a file of URDF 1.0"),
    Misuse("quaternion beside rpy", ARM.replace('rpy="0 0 0.3"', 'rpy="0 0 0" quat_xyzw="0 0 0 1"')
           .replace('<robot ', '<robot version="1.1" '),
           '<joint name="glue"><origin>', "rpy or quat_xyzw", "both"),
    Misuse("quaternion of another length", ('rpy="0 0 0.3"', 'quat_xyzw="0 0 1 1"'),
           '<joint name="glue"><origin>', "a quaternion of length 1 as quat_xyzw",
           "length 1.41421"),
    Misuse("quaternion of three numbers", ('rpy="0 0 0.3"', 'quat_xyzw="0 0 1"'),
           '<joint name="glue"><origin>', "four numbers as quat_xyzw", "'0 0 1'", row=False),
    Misuse("quaternion of a shape", ('<link name="base"/>', '<link name="base"><visual>'
           '<origin quat_xyzw="0 0 0 1"/></visual></link>'), '<link name="base"><visual><origin>',
           'rpy="0 0 0", or <robot version="1.1">', "quat_xyzw in a file of URDF 1.0", row=False),
    Misuse("unknown version", ('<robot ', '<robot version="2.0" '), "<robot>",
           "a URDF of version 1.0, 1.1, 1.2", 'version="2.0"'),
    Misuse("negative limit of the jerk", ('<limit lower="-1.5"', '<limit jerk="-1" lower="-1.5"'),
           '<joint name="bend"><limit>', "jerk >= 0", "-1.0", row=False),
    Misuse("missing bound in URDF 1.2", ARM.replace('<robot ', '<robot version="1.2" ').replace(
           'lower="-1.5" ', ""), '<joint name="bend"><limit>', 'attribute lower="…"', "none",
           row=False),
    Misuse("rotation as a quaternion", ('rpy="0 0 0.3"', 'quat="1 0 0 0"'),
           '<joint name="glue"><origin>', "no attribute but xyz, rpy", "quat", row=False),
]  # fmt: skip
NUMBERS = [
    Misuse("not a number", number("heavy"), '<joint name="bend"><dynamics>',
           "a finite number as damping", "'heavy'"),
    Misuse("number that is not finite", number("nan"), '<joint name="bend"><dynamics>',
           "a finite number as damping", "'nan'"),
    *(Misuse(f"number {text!r}", number(text), '<joint name="bend"><dynamics>',
             "a finite number as damping", repr(text), row=False)
      for text in ("inf", "-inf", "Infinity", "NaN", "1e999", "0,1", "1_0", "0x10", "1e", "--1",
                   "1 2", "1.0.0", "٣", "１", "1f", "$(x)", "0.02 ", " 0.02", "+", ".", "true")),
    Misuse("number beyond ±1e50", number("1e300"), '<joint name="bend"><dynamics>',
           "a number within ±1e+50 as damping", "1e300"),
    Misuse("empty number", number(""), '<joint name="bend"><dynamics>', 'attribute damping="…"',
           "nothing"),
    Misuse("blank behind a mass", ('value="0.01"', 'value="0.01 "'),
           '<link name="pad"><inertial><mass>', "a finite number as value", "'0.01 '", row=False),
    Misuse("mass that is not a number", ('value="0.01"', 'value="0,01"'),
           '<link name="pad"><inertial><mass>', "a finite number as value", "'0,01'", row=False),
    Misuse("vector of another length", ('xyz="0 1 0"', 'xyz="0 1"'), '<joint name="bend"><axis>',
           "three numbers as xyz", "'0 1'"),
    Misuse("vector with commas", ('xyz="0 1 0"', 'xyz="0,1,0"'), '<joint name="bend"><axis>',
           "three numbers as xyz", "'0,1,0'", row=False),
    Misuse("vector with nan", ('xyz="0.1 0 0"', 'xyz="nan 0 0"'), '<joint name="glue"><origin>',
           "a finite number as xyz", "'nan'", row=False),
    Misuse("vector with a line feed", ('xyz="0.1 0 0"', 'xyz="0.1 0&#10;0"'),
           '<joint name="glue"><origin>', "three numbers as xyz", r"'0.1 0\n0'", row=False),
    Misuse("empty vector", ('xyz="0.1 0 0"', 'xyz=""'), '<joint name="glue"><origin>',
           'attribute xyz="…"', "nothing", row=False),
    Misuse("spring that is not finite", (">0.5<", ">inf<"),
           SPRING_BEND, "a finite number as springStiffness", "'inf'", row=False),
    Misuse("spring without a number", (">0.5<", "><"),
           SPRING_BEND, "a finite number as springStiffness", "''", row=False),
    Misuse("rest that is not a number", (">0.1<", ">straight<"), REST_BEND,
           "a finite number as springReference", "'straight'", row=False),
]  # fmt: skip
INERTIA = [
    Misuse("inertial without a mass", ('<mass value="0.01"/>', ""), '<link name="pad"><inertial>',
           "<mass> and <inertia>", "no <mass>"),
    Misuse("inertial without an inertia",
           ('<inertia ixx="1e-6" ixy="0" ixz="0" iyy="1e-6" iyz="0" izz="1e-6"/>', ""),
           '<link name="pad"><inertial>', "<mass> and <inertia>", "no <inertia>", row=False),
    Misuse("inertia without one of its six numbers", ('ixx="1e-6" ixy="0"', 'ixx="1e-6"'),
           '<link name="pad"><inertial><inertia>', 'attribute ixy="…"', "none"),
    Misuse("negative mass", ('value="0.01"', 'value="-0.01"'),
           '<link name="pad"><inertial><mass>', "value >= 0", "-0.01"),
    Misuse("moments that are not positive", (FINGER, FINGER.replace('ixx="1e-5"', 'ixx="-1e-3"')),
           '<link name="finger">', "a physical inertia, with its fixed links", "not positive"),
    Misuse("moments that break the triangle inequality",
           (FINGER, FINGER.replace('izz="9e-5"', 'izz="9e-3"')),
           '<link name="finger">', "a physical inertia, with its fixed links", " < "),
    Misuse("moments without mass", ('<link name="knuckle"/>',
                                    f'<link name="knuckle"><inertial><mass value="0"/><inertia '
                                    f"{BODY}/></inertial></link>"),
           '<link name="knuckle">', "a physical inertia, with its fixed links", "without mass"),
    Misuse("massless moving leaf", ('<child link="wheel"/></joint>', '<child link="wheel"/></joint>'
                                    '<link name="nail"/><joint name="tap" type="continuous">'
                                    '<parent link="wheel"/><child link="nail"/></joint>'),
           '<link name="nail">', "a positive mass that the joint moves",
           "none on or beyond joint 'tap'"),
]  # fmt: skip
SPRINGS = [
    Misuse("negative damping", number("-0.02"), '<joint name="bend"><dynamics>', "damping >= 0",
           "-0.02"),
    Misuse("negative friction", ('friction="0.001"', 'friction="-1"'),
           '<joint name="bend"><dynamics>', "friction >= 0", "-1", row=False),
    Misuse("negative joint stiffness", (">0.5<", ">-0.5<"), SPRING_BEND,
           "springStiffness >= 0", "-0.5"),
    Misuse("negative stiffness alias", ('stiffness="0.2"', 'stiffness="-0.2"'),
           '<joint name="twist"><dynamics>', "stiffness >= 0", "-0.2"),
    Misuse("conflicting spring sources", ('friction="0.001"', 'stiffness="0.7"'),
           SPRING_BEND, "one stiffness of joint 'bend'", "0.7 and 0.5"),
    Misuse("conflicting aliases", ('stiffness="0.2"', 'stiffness="0.2" spring_stiffness="0.3"'),
           '<joint name="twist"><dynamics>', "one stiffness of joint 'twist'", "0.2 and 0.3",
           row=False),
    Misuse("conflicting rest positions", beside(
           '<gazebo reference="bend"><springReference>0</springReference></gazebo>'),
           REST_BEND, "one rest of joint 'bend'", "0.1 and 0.0"),
    Misuse("spring of an unknown joint", beside(
           '<gazebo reference="thumb"><springStiffness>1</springStiffness></gazebo>'),
           '<gazebo reference="thumb">', "reference to a joint", "'thumb'"),
    Misuse("spring of a link", beside(
           '<gazebo reference="finger"><springStiffness>1</springStiffness></gazebo>'),
           '<gazebo reference="finger">', "reference to a joint", "'finger'", row=False),
    Misuse("spring without a joint", beside(
           "<gazebo><springStiffness>1</springStiffness></gazebo>"),
           "<gazebo>", 'attribute reference="…"', "none", row=False),
    Misuse("spring on a continuous joint", beside(
           '<gazebo reference="spin"><springStiffness>1</springStiffness></gazebo>'),
           SPRING_SPIN, "a spring on a revolute or prismatic joint",
           "continuous joint 'spin'"),
    Misuse("spring on a fixed joint",
           ('rpy="0 0 0.3"/>', 'rpy="0 0 0.3"/><dynamics stiffness="1"/>'),
           '<joint name="glue"><dynamics>', "a spring on a revolute or prismatic joint",
           "fixed joint 'glue'"),
]  # fmt: skip
BLOCK = [
    Misuse("second block", beside('<softdyn version="1"/>'), "<softdyn>", "one <softdyn>",
           "2 of them"),
    Misuse("missing version", ('<softdyn version="1">', "<softdyn>"), "<softdyn>",
           'attribute version="…"', "none"),
    Misuse("unsupported version", ('<softdyn version="1">', '<softdyn version="2">'), "<softdyn>",
           'version="1"', "'2'"),
    Misuse("gravity of two numbers", (
           '<softdyn version="1">', '<softdyn version="1" gravity="0 -9.81">'), "<softdyn>",
           "three numbers as gravity", "'0 -9.81'"),
    Misuse("two gravities", (
           '<softdyn version="1">', '<mujoco><option gravity="0 0 -9.81"/></mujoco>'
           '<softdyn version="1" gravity="0 0 -1.6">'), "<softdyn>",
           "one gravity", "(0.0, 0.0, -1.6), and 0 0 -9.81 for another tool"),
    Misuse("version 1.0", ('<softdyn version="1">', '<softdyn version="1.0">'), "<softdyn>",
           'version="1"', "'1.0'", row=False),
    Misuse("unknown element in the block", inside('<spring name="bend"/>'),
           '<softdyn><spring name="bend">',
           "<joint> or <tendon> or <actuator> or <sensor> or <task>", "<spring>"),
    Misuse("foreign element in the block", inside('<x:a xmlns:x="u"/>'), "<softdyn><x:a>",
           "<joint> or <tendon> or <actuator> or <sensor> or <task>", "<{u}a>", row=False),
    Misuse("unknown element in a tendon", (COEF, f"{COEF}<pulley/>"),
           f"<softdyn>{FLEXOR}<pulley>", "<joint> or <site> or <cylinder> or <sphere>", "<pulley>",
           row=False),
    Misuse("unknown element in an actuator", (
           'lower="0" upper="5"/>', 'lower="0" upper="5"><gear/></actuator>'),
           f"<softdyn>{U2}<gear>", "no element inside", "<gear>", row=False),
    Misuse("unknown element in a site", ('xyz="0 0 0.01"/>', 'xyz="0 0 0.01"><mass/></site>'),
           f"<softdyn>{CABLE}<site><mass>", "no element inside", "<mass>", row=False),
    Misuse("unknown attribute of the block", ('softdyn version="1"', 'softdyn version="1" a=""'),
           "<softdyn>", "no attribute but version", "a", row=False),
    Misuse("unknown attribute in the block", ('armature="0.005"', 'armor="0.005"'),
           '<softdyn><joint name="bend">', "no attribute but name, armature", "armor"),
    Misuse("unknown attribute of a tendon", ('rest="0.2"', 'rest_length="0.2"'),
           f"<softdyn>{FLEXOR}", "no attribute but name, stiffness, damping, rest", "rest_length",
           row=False),
    Misuse("unknown attribute of an actuator", ('gear="-1"', 'gain="-1"'), f"<softdyn>{U2}",
           "no attribute but name, tendon, gear, lower, upper", "gain", row=False),
    Misuse("unknown attribute of a site", ('xyz="0 0 0.01"', 'pos="0 0 0.01"'),
           f"<softdyn>{CABLE}<site>", "no attribute but link, xyz", "pos", row=False),
    Misuse("unknown attribute of a term", ('coef="-0.5"', 'coeff="-0.5"'),
           f'<softdyn>{FLEXOR}<joint name="twist">', "no attribute but name, coef", "coeff",
           row=False),
    Misuse("unknown attribute of the task", ('<task frame="wheel"/>', '<task link="wheel"/>'),
           "<softdyn><task>", "no attribute but frame", "link", row=False),
    Misuse("negative armature", ('armature="0.005"', 'armature="-1"'),
           '<softdyn><joint name="bend">', "armature >= 0", "-1"),
    Misuse("fluid of a density below zero", inside('<fluid density="-1"/>'), "<softdyn><fluid>",
           "density >= 0", "-1"),
    Misuse("buoyancy of a link without mass", inside('<link name="base" gravcomp="0.5"/>'),
           '<softdyn><link name="base">', "a link with mass", "'base' without any"),
    Misuse("buoyancy of an unknown link", inside('<link name="fingr" gravcomp="0.5"/>'),
           '<softdyn><link name="fingr">', "a link", "finger", row=False),
    Misuse("buoyancy of a part of a body", inside('<link name="finger" gravcomp="0.5"/>'),
           "<softdyn>", "one gravcomp for all links with mass that are fixed to 'finger'",
           "0.5 and 0"),
    Misuse("fluid with an unknown attribute", inside('<fluid wind="1"/>'), "<softdyn><fluid>",
           "no attribute but density, viscosity", "wind", row=False),
    Misuse("ball of two hinges", inside('<ball name="b" joints="bend twist"/>'),
           '<softdyn><ball name="b">', "three joints", "'bend twist'"),
    Misuse("ball of hinges with a spring", inside('<ball name="b" joints="bend twist glue"/>'),
           '<softdyn><ball name="b">', "hinges without stiffness", "that of 'bend'", row=False),
    Misuse("three numbers of a polynomial", ('armature="0.005"', 'stiffness_poly="1 2 3"'),
           '<softdyn><joint name="bend">', "two numbers as stiffness_poly", "'1 2 3'"),
    Misuse("damper below zero", ('armature="0.005"', 'damping_poly="0 -1"'),
           '<softdyn><joint name="bend">', "numbers >= 0 as damping_poly", "0 -1"),
    Misuse("branch without a time", ('armature="0.005"', 'relaxation="0.1 2 0.3"'),
           '<softdyn><joint name="bend">', A_BRANCH,
           "'0.1 2 0.3'"),
    Misuse("time of a branch that is zero", ('armature="0.005"', 'relaxation="0.1 0"'),
           '<softdyn><joint name="bend">', A_BRANCH,
           "'0.1 0'"),
    Misuse("four branches", ('armature="0.005"', 'relaxation="1 1 1 2 1 3 1 4"'),
           '<softdyn><joint name="bend">', "at most 6 numbers as relaxation", "8"),
    Misuse("armature of an unknown joint", ('name="bend" armature', 'name="thumb" armature'),
           '<softdyn><joint name="thumb">', "the name of a joint", "'thumb'"),
    Misuse("armature of a fixed joint", ('name="bend" armature', 'name="glue" armature'),
           '<softdyn><joint name="glue">', "a joint that moves", "fixed joint 'glue'"),
    Misuse("two armatures of a joint", inside('<joint name="bend" armature="1"/>'),
           '<softdyn><joint name="bend">', "a unique joint name", "a second 'bend'", row=False),
]  # fmt: skip
TENDONS = [
    Misuse("tendon without a name", ('<tendon name="drive">', "<tendon>"), "<softdyn><tendon>",
           'attribute name="…"', "none", row=False),
    Misuse("duplicate tendon", ('tendon name="drive"', 'tendon name="cable"'),
           f"<softdyn>{CABLE}", "a unique tendon name", "a second 'cable'"),
    Misuse("both kinds of path in a tendon", (COEF, COEF + '<site link="base" xyz="0 0 0"/>'),
           f"<softdyn>{FLEXOR}", "a path of <joint> or of <site> elements", "both"),
    Misuse("empty tendon", (TERMS, ""), f"<softdyn>{FLEXOR}",
           "at least one <joint> or two <site> elements", "an empty tendon"),
    Misuse("spatial tendon with one site", (SITES, '<site link="base" xyz="0 0 0.02"/>\n'),
           f"<softdyn>{CABLE}", "at least two <site> elements", "one"),
    Misuse("unknown joint in a tendon", (COEF, COEF.replace("twist", "thumb")),
           f'<softdyn>{FLEXOR}<joint name="thumb">', "the name of a joint", "'thumb'"),
    Misuse("fixed joint in a tendon", (COEF, COEF.replace("twist", "glue")),
           f'<softdyn>{FLEXOR}<joint name="glue">', "a joint that moves", "fixed joint 'glue'"),
    Misuse("joint twice in a tendon", (COEF, COEF.replace("twist", "bend")),
           f'<softdyn>{FLEXOR}<joint name="bend">', "a unique joint name", "a second 'bend'"),
    Misuse("missing coefficient", (' coef="-0.5"', ""),
           f'<softdyn>{FLEXOR}<joint name="twist">', 'attribute coef="…"', "none", row=False),
    Misuse("coefficient that is not finite", ('coef="-0.5"', 'coef="inf"'),
           f'<softdyn>{FLEXOR}<joint name="twist">', "a finite number as coef", "'inf'", row=False),
    Misuse("unknown link of a site", ('<site link="pad"', '<site link="nail"'),
           f"<softdyn>{CABLE}<site>", "the name of a link", "'nail'"),
    Misuse("site without a link", ('<site link="pad" ', "<site "), f"<softdyn>{CABLE}<site>",
           'attribute link="…"', "none", row=False),
    Misuse("site without a place", (' xyz="0 0 0.01"', ""), f"<softdyn>{CABLE}<site>",
           'attribute xyz="…"', "none", row=False),
    Misuse("sites of different links at one point", (
           'link="pad" xyz="0 0 0.01"',
           'link="pad" xyz="-0.0477668244562803 0.01477601033306698 0.02"'),
           f"<softdyn>{CABLE}", "consecutive sites on different links apart at q = 0",
           "sites of 'finger' and 'pad' at the same point"),
    Misuse("negative tendon stiffness", ('stiffness="3"', 'stiffness="-3"'), f"<softdyn>{FLEXOR}",
           "stiffness >= 0", "-3"),
    Misuse("negative tendon damping", ('damping="0.1"', 'damping="-0.1"'), f"<softdyn>{FLEXOR}",
           "damping >= 0", "-0.1", row=False),
    Misuse("negative rest length of a path", (CABLE, '<tendon name="cable" rest="-0.1">'),
           f"<softdyn>{CABLE}", "rest >= 0, the length of a path", "-0.1"),
    Misuse("elastic tendon over a continuous joint", (
           '<tendon name="drive">', '<tendon name="drive" stiffness="1">'),
           '<softdyn><tendon name="drive">', "a spring on a revolute or prismatic joint",
           "continuous joint 'spin'"),
]  # fmt: skip
AFTER = '<site link="base" xyz="0 0 0.02"/>\n'  # the first site of the cable


def wrap(words: str, tag: str = "cylinder") -> tuple[str, str]:
    """Insert a round body of the base behind the first site of the cable."""
    return AFTER, f'{AFTER}<{tag} link="base" {words}/>'


ROUND, PIN = 'xyz="0.02 0 0"', 'axis="0 1 0" radius="0.01"'
ON_PIN = f"<softdyn>{CABLE}<cylinder>"
WRAPS = [
    Misuse("cylinder without an axis", wrap(f'{ROUND} radius="0.01"'), ON_PIN,
           'attribute axis="…"', "none"),
    Misuse("axis of a sphere", wrap(f"{ROUND} {PIN}", "sphere"), f"<softdyn>{CABLE}<sphere>",
           "no attribute but link, xyz, radius, side, friction", "axis"),
    Misuse("axis of length zero", wrap(f'{ROUND} axis="0 0 0" radius="0.01"'), ON_PIN,
           "an axis that is not zero", "0 0 0"),
    Misuse("round body without a radius", wrap(f'{ROUND} axis="0 1 0"'), ON_PIN,
           'attribute radius="…"', "none"),
    Misuse("radius that is not positive", wrap(f'{ROUND} axis="0 1 0" radius="0"'), ON_PIN,
           "radius > 0", "0.0"),
    Misuse("length that is not positive", wrap(f'{ROUND} {PIN} length="-1"'), ON_PIN,
           "length > 0", "-1.0", row=False),
    Misuse("friction of a round body below zero", wrap(f'{ROUND} {PIN} friction="-0.1"'), ON_PIN,
           "friction from 0 to 10", "-0.1"),
    Misuse("unknown link of a round body", (
           AFTER, f'{AFTER}<cylinder link="palm" {ROUND} {PIN}/>'), ON_PIN,
           "the name of a link", "'palm'", row=False),
    Misuse("round body at the begin of a path", (
           AFTER, f'<cylinder link="base" {ROUND} {PIN}/>{AFTER}'), ON_PIN,
           "a <site> before and behind it", "none before it"),
    Misuse("round body at the end of a path", (
           f"{SITES}    </tendon>", f'{SITES}<cylinder link="pad" {ROUND} {PIN}/></tendon>'),
           ON_PIN, "a <site> before and behind it", "none behind it", row=False),
    Misuse("two round bodies without a site between them", (
           AFTER, f'{AFTER}<cylinder link="base" {ROUND} {PIN}/>'
           '<sphere link="base" xyz="0.03 0 0" radius="0.01"/>'), f"<softdyn>{CABLE}<sphere>",
           "a <site> before and behind it", "<cylinder> before it"),
    Misuse("round body among joints", (COEF, f'{COEF}<cylinder link="base" {ROUND} {PIN}/>'),
           f"<softdyn>{FLEXOR}<cylinder>", "a <site> before and behind it", "none before it",
           row=False),
    Misuse("site inside a round body", wrap('xyz="0 0 0.015" axis="0 1 0" radius="0.01"'), ON_PIN,
           "sites at least 0.01 m from it at q = 0", "the site of 'base' at 0.005 m"),
    Misuse("sites and axis in one line, no side", wrap('xyz="0.025 0 0.02" axis="0 1 0" '
           'radius="0.01"'), ON_PIN, 'side="…"', "two sites and its axis in one line, and no side"),
    Misuse("sites and centre in one line, no side", wrap('xyz="0.025 0 0.02" radius="0.01"',
           "sphere"), f"<softdyn>{CABLE}<sphere>", 'side="…"',
           "two sites and its centre in one line, and no side", row=False),
    Misuse("side on the line of the sites", wrap('xyz="0.025 0 0.02" radius="0.01" '
           'side="0.04 0 0.02"', "sphere"), f"<softdyn>{CABLE}<sphere>",
           "a side beside the line of the sites through its centre", "one on it"),
    Misuse("armature of a tendon around a round body", inside(
           '<tendon name="t" armature="1"><site link="base" xyz="0 0 0.02"/><cylinder link="base"'
           f' {ROUND} {PIN}/><site link="pad" xyz="0 0 0.01"/></tendon>'),
           '<softdyn><tendon name="t">', "no armature of a tendon around a round body", "1"),
]  # fmt: skip
INPUTS = [
    Misuse("actuator without a name", ('<actuator name="u1" ', "<actuator "),
           "<softdyn><actuator>", 'attribute name="…"', "none", row=False),
    Misuse("duplicate actuator", ('actuator name="u2"', 'actuator name="u1"'), f"<softdyn>{U1}",
           "a unique actuator name", "a second 'u1'"),
    Misuse("actuator without a tendon", (' tendon="cable"', ""), f"<softdyn>{U2}",
           'attribute tendon="…"', "none", row=False),
    Misuse("unknown tendon", ('tendon="cable"', 'tendon="cord"'), f"<softdyn>{U2}",
           "the name of a tendon", "'cord'"),
    Misuse("missing lower bound", ('lower="0" upper="5"', 'upper="5"'), f"<softdyn>{U2}",
           'attribute lower="…"', "none"),
    Misuse("missing upper bound", ('lower="0" upper="5"', 'lower="0"'), f"<softdyn>{U2}",
           'attribute upper="…"', "none"),
    Misuse("input bounds, lower > upper", ('lower="0" upper="5"', 'lower="6" upper="5"'),
           f"<softdyn>{U2}", "lower <= upper", "lower=6.0 upper=5.0"),
    Misuse("bound that is not finite", ('lower="0" upper="5"', 'lower="0" upper="inf"'),
           f"<softdyn>{U2}", "a finite number as upper", "'inf'", row=False),
    Misuse("gear that is not a number", ('gear="-1"', 'gear="1:50"'), f"<softdyn>{U2}",
           "a finite number as gear", "'1:50'", row=False),
    Misuse("task frame that is not a link", ('<task frame="wheel"/>', '<task frame="tip"/>'),
           "<softdyn><task>", "the name of a link", "'tip'"),
    Misuse("task frame that is a joint", ('<task frame="wheel"/>', '<task frame="spin"/>'),
           "<softdyn><task>", "the name of a link", "'spin'", row=False),
    Misuse("task without a frame", ('<task frame="wheel"/>', "<task/>"), "<softdyn><task>",
           'attribute frame="…"', "none", row=False),
    Misuse("task of a link fixed to the base", ('<task frame="wheel"/>', '<task frame="base"/>'),
           "<softdyn><task>", "a link that a joint moves", "'base'"),
    Misuse("second task of one name", inside('<task frame="wheel"/>'), "<softdyn><task>",
           "a unique task name", "a second 'wheel'"),
    Misuse("unknown kind of task", inside('<task frame="pad" kind="twist"/>'), "<softdyn><task>",
           "kind position, orientation, pose or axis", "'twist'"),
    Misuse("row that the kind lacks", inside('<task frame="pad" axes="x rz"/>'), "<softdyn><task>",
           "axes of x, y, z, each once", "'rz'"),
    Misuse("row twice", inside('<task frame="pad" kind="pose" axes="rx rx"/>'), "<softdyn><task>",
           "axes of x, y, z, rx, ry, rz, each once", "'rx'", row=False),
    Misuse("axis without a direction", inside('<task frame="pad" kind="axis"/>'),
           "<softdyn><task>", 'direction="…" of kind="axis" only', 'kind="axis"'),
    Misuse("direction of a point", inside('<task frame="pad" direction="1 0 0"/>'),
           "<softdyn><task>", 'direction="…" of kind="axis" only', 'kind="position"', row=False),
    Misuse("direction of length zero", inside('<task frame="pad" kind="axis" direction="0 0 0"/>'),
           "<softdyn><task>", "a direction that is not zero", "0 0 0", row=False),
    Misuse("weight of a task, not positive", inside('<task frame="pad" weight="0"/>'),
           "<softdyn><task>", "weight > 0", "0.0"),
    Misuse("stiffness of a task, not positive", inside('<task frame="pad" Kp="-1"/>'),
           "<softdyn><task>", "Kp > 0", "-1.0", row=False),
    Misuse("level that is no whole number", inside('<task frame="pad" level="0.5"/>'),
           "<softdyn><task>", "a whole level from 0 to 99", "0.5"),
]  # fmt: skip
SLACK = ('<tendon name="flexor" ', '<tendon name="flexor" slack="true" ')
FREE_LENGTH = 'command="length" stiffness="900"'


CHAMBER = 'gear="2e-4" lower="0" upper="5e4"'


def u2(words: str, bounds: str = 'gear="-1" lower="0" upper="5"') -> tuple[str, str]:
    """Give the input of the cable more words, or other bounds."""
    return 'gear="-1" lower="0" upper="5"', f"{bounds} {words}"


def sensor(words: str) -> tuple[str, str]:
    """Insert a sensor into the block."""
    return inside(f'<sensor name="s" {words}/>')


RUBS = '<tendon name="cable" friction="0.1">'
FRICTION = [
    Misuse("negative friction of a cable", (CABLE, RUBS.replace("0.1", "-0.1")),
           f"<softdyn>{CABLE}", "friction >= 0", "-0.1"),
    Misuse("friction that leaves no pull", (CABLE, RUBS.replace("0.1", "11")),
           f"<softdyn>{CABLE}", "friction <= 10", "11.0"),
    Misuse("friction over a continuous joint", (
           '<tendon name="drive">', '<tendon name="drive" friction="0.1">'),
           '<softdyn><tendon name="drive">',
           "friction of a cable on a revolute or prismatic joint", "continuous joint 'spin'"),
    Misuse("driven end without friction", (CABLE, '<tendon name="cable" driven="last">'),
           f"<softdyn>{CABLE}", "friction > 0 beside driven", "0.0"),
    Misuse("unknown end of a path", (CABLE, '<tendon name="cable" friction="0.1" driven="end">'),
           f"<softdyn>{CABLE}", "driven first or last", "'end'"),
    Misuse("sites of one link at one point, with friction", (
           CABLE, f'{RUBS}<site link="base" xyz="0 0 0.02"/>'), f"<softdyn>{CABLE}",
           "consecutive sites with friction apart at q = 0",
           "sites of 'base' and 'base' at the same point"),
]  # fmt: skip
RIG = [
    Misuse("slack that is neither true nor false", (SLACK[0], SLACK[1].replace("true", "1")),
           f"<softdyn>{FLEXOR}", 'slack="true" or "false"', "'1'"),
    Misuse("slack tendon without a spring", (CABLE, '<tendon name="cable" slack="true">'),
           f"<softdyn>{CABLE}", "stiffness > 0 of a slack tendon", "0.0"),
    Misuse("two-sided input on a slack tendon", SLACK, f"<softdyn>{U1}",
           "gear * u <= 0 from lower to upper, as an input on slack tendon 'flexor' only pulls",
           "gear=0.1 lower=-1.0 upper=1.0"),
    Misuse("unknown command", u2('command="lenght"'), f"<softdyn>{U2}",
           "command force, length or velocity", "'lenght'; did you mean 'length'?"),
    Misuse("empty command", u2('command=""'), f"<softdyn>{U2}", 'attribute command="…"', "nothing",
           row=False),
    Misuse("winch without a stiffness", u2('command="length"'), f"<softdyn>{U2}",
           'attribute stiffness="…"', "none"),
    Misuse("winch without elasticity", u2('command="velocity" stiffness="0"'),
           f"<softdyn>{U2}", "stiffness > 0 of a winch's cable", "0.0"),
    Misuse("negative damping of a winch", u2(f'{FREE_LENGTH} damping="-1"'), f"<softdyn>{U2}",
           "damping >= 0", "-1.0"),
    Misuse("two-sided winch", u2(FREE_LENGTH, 'gear="-1" lower="-1" upper="5"'), f"<softdyn>{U2}",
           "gear * u <= 0 from lower to upper, as a winch only pulls",
           "gear=-1.0 lower=-1.0 upper=5.0"),
    Misuse("winch that pushes", u2(FREE_LENGTH, 'lower="0" upper="5"'), f"<softdyn>{U2}",
           "gear * u <= 0 from lower to upper, as a winch only pulls",
           "gear=1.0 lower=0.0 upper=5.0"),
    Misuse("winch without a gear", u2(FREE_LENGTH, 'gear="0" lower="0" upper="5"'),
           f"<softdyn>{U2}", "a gear other than 0 of a winch", "0.0"),
    Misuse("armature of a winch's tendon", inside(
           '<tendon name="t" armature="1"><joint name="bend" coef="1"/></tendon>'
           '<actuator name="w" tendon="t" gear="-1" lower="0" upper="1" command="length"'
           ' stiffness="9"/>'), '<softdyn><actuator name="w">',
           "no armature of tendon 't' beside a winch", "1"),
    Misuse("winch's cable on a force", u2('stiffness="900"'), f"<softdyn>{U2}",
           'command="length" or "velocity" beside stiffness', 'command="force"'),
    Misuse("free length's bound on a force", u2('command="force" length_upper="1"'),
           f"<softdyn>{U2}", 'command="length" or "velocity" beside length_upper',
           'command="force"'),
    Misuse("bounds of the free length, lower > upper", u2(
           f'{FREE_LENGTH} length_lower="0.2" length_upper="0.1"'), f"<softdyn>{U2}",
           "length_lower <= length_upper", "length_lower=0.2 length_upper=0.1"),
    Misuse("negative free length of a path", u2(f'{FREE_LENGTH} length_lower="-0.1"'),
           f"<softdyn>{U2}", "length_lower >= 0, the length of a path", "-0.1"),
    Misuse("offset of a force", u2('offset="0.01"'), f"<softdyn>{U2}",
           'command="length" beside offset', 'command="force"'),
    Misuse("offset of a velocity", u2('command="velocity" stiffness="900" offset="0.01"'),
           f"<softdyn>{U2}", 'command="length" beside offset', 'command="velocity"', row=False),
    Misuse("offset that is not finite", u2(f'{FREE_LENGTH} offset="nan"'), f"<softdyn>{U2}",
           "a finite number as offset", "'nan'", row=False),
    Misuse("offset without a number", u2(f'{FREE_LENGTH} offset="-20 mm"'), f"<softdyn>{U2}",
           "a finite number as offset", "'-20 mm'", row=False),
    Misuse("winch over a continuous joint", inside(
           f'<actuator name="u3" tendon="drive" {u2(FREE_LENGTH)[1]}/>'),
           '<softdyn><actuator name="u3">', "a winch on a revolute or prismatic joint",
           "continuous joint 'spin'"),
    Misuse("negative lag", u2('lag="-0.02"'), f"<softdyn>{U2}", "lag >= 0", "-0.02"),
    Misuse("negative delay", u2('delay="-0.02"'), f"<softdyn>{U2}", "delay >= 0", "-0.02"),
    Misuse("delay in milliseconds", u2('delay="20"'), f"<softdyn>{U2}", "delay <= 10 s", "20.0"),
    Misuse("rate of zero", u2('rate="0"'), f"<softdyn>{U2}", "rate > 0", "0.0"),
    Misuse("pressure in another unit", u2('unit="kPa"', CHAMBER), f"<softdyn>{U2}", 'unit="Pa"',
           "'kPa'; did you mean 'Pa'?"),
    Misuse("chamber without an area", u2('unit="Pa"', CHAMBER.replace("2e-4", "0")),
           f"<softdyn>{U2}", "gear > 0, the area (m²) of a chamber", "0.0"),
    Misuse("chamber of a negative area", u2('unit="Pa"'), f"<softdyn>{U2}",
           "gear > 0, the area (m²) of a chamber", "-1.0"),
    Misuse("chamber on a winch", u2(f'{FREE_LENGTH} unit="Pa"', CHAMBER.replace("5e4", "0")),
           f"<softdyn>{U2}", 'command="force" beside unit="Pa"', "length"),
    Misuse("area that changes, of a force", u2('area_growth="1" area_length="0.1"'),
           f"<softdyn>{U2}", 'unit="Pa" beside area_growth', "none"),
    Misuse("area that changes, without its length", u2('unit="Pa" area_growth="1"', CHAMBER),
           f"<softdyn>{U2}", "area_growth and an area_length > 0, both or neither",
           "an area_length of 0 m"),
    Misuse("more coefficients of an area than four", u2(
           'unit="Pa" area_growth="1 1 1 1 1" area_length="0.1"', CHAMBER),
           f"<softdyn>{U2}", "at most 4 numbers as area_growth", "5"),
    Misuse("rate that is not finite", u2('rate="inf"'), f"<softdyn>{U2}",
           "a finite number as rate", "'inf'", row=False),
]  # fmt: skip
SENSOR = '<softdyn><sensor name="s">'
SENSORS = [
    Misuse("sensor without a name", inside('<sensor type="joint" joint="bend"/>'),
           "<softdyn><sensor>", 'attribute name="…"', "none", row=False),
    Misuse("duplicate sensor", inside(
           2 * '<sensor name="s" type="joint" joint="bend"/>\n'), SENSOR,
           "a unique sensor name", "a second 's'"),
    Misuse("sensor without a type", sensor('joint="bend"'), SENSOR, 'attribute type="…"', "none"),
    Misuse("unknown type", sensor('type="angle" joint="bend"'), SENSOR,
           "type length, tension, position, pose, gyro, accelerometer, joint, bend or pressure",
           "'angle'"),
    Misuse("bend of one link", sensor('type="bend" link="pad" to="pad"'), SENSOR,
           "to another link than 'pad'", "'pad'"),
    Misuse("bend without its second link", sensor('type="bend" link="pad"'), SENSOR,
           'attribute to="…"', "none"),
    Misuse("sensor without its member", sensor('type="length"'), SENSOR, 'attribute tendon="…"',
           "none"),
    Misuse("another type's member", sensor('type="length" tendon="cable" link="pad"'), SENSOR,
           "no attribute but name, type, tendon, noise, bias, rate, latency, resolution, lower, "
           "upper", "link"),
    Misuse("frame of a point", sensor('type="position" link="pad" rpy="0 0 1"'), SENSOR,
           "no attribute but name, type, link, xyz, noise, bias, rate, latency, resolution, lower, "
           "upper",
           "rpy"),
    Misuse("sensor on an unknown tendon", sensor('type="tension" tendon="cabel"'), SENSOR,
           "the name of a tendon", "'cabel'; did you mean 'cable'?"),
    Misuse("sensor on an unknown link", sensor('type="gyro" link="tip"'), SENSOR,
           "the name of a link", "'tip'"),
    Misuse("sensor on an unknown joint", sensor('type="joint" joint="thumb"'), SENSOR,
           "the name of a joint", "'thumb'"),
    Misuse("sensor on a fixed joint", sensor('type="joint" joint="glue"'), SENSOR,
           "a joint that moves", "fixed joint 'glue'"),
    Misuse("sensor on a continuous joint", sensor('type="joint" joint="spin"'), SENSOR,
           "a sensor on a revolute or prismatic joint", "continuous joint 'spin'"),
    Misuse("length over a continuous joint", sensor('type="length" tendon="drive"'), SENSOR,
           "a length sensor on a revolute or prismatic joint", "continuous joint 'spin'"),
    Misuse("pressure of a cable", sensor('type="pressure" tendon="cable"'), SENSOR,
           "a tendon with one chamber", "'cable' without"),
    Misuse("tension that is always zero", sensor('type="tension" tendon="drive"'), SENSOR,
           "a tendon with an actuator, a spring or a damper", "'drive' without"),
    Misuse("place of a sensor", sensor('type="pose" link="pad" xyz="0 0"'), SENSOR,
           "three numbers as xyz", "'0 0'"),
    Misuse("noise of another size", sensor('type="position" link="pad" noise="0.1 0.1"'), SENSOR,
           "one number or 3 as noise", "'0.1 0.1'"),
    Misuse("two biases of one number", sensor('type="joint" joint="bend" bias="0.1 0.1"'), SENSOR,
           "one number as bias", "'0.1 0.1'"),
    Misuse("negative noise", sensor('type="gyro" link="pad" noise="0 -1 0"'), SENSOR, "noise >= 0",
           "-1.0"),
    Misuse("negative resolution", sensor('type="joint" joint="bend" resolution="-1"'), SENSOR,
           "resolution >= 0", "-1.0"),
    Misuse("limits of a reading", sensor('type="joint" joint="bend" lower="1" upper="1"'), SENSOR,
           "lower < upper", 'lower="1" upper="1"'),
    Misuse("limits of another size", sensor('type="gyro" link="pad" upper="1 2"'), SENSOR,
           "one number or 3 as upper", "'1 2'"),
    Misuse("negative readings per second", sensor('type="joint" joint="bend" rate="-1"'), SENSOR,
           "rate >= 0", "-1.0"),
    Misuse("negative latency", sensor('type="joint" joint="bend" latency="-1"'), SENSOR,
           "latency >= 0", "-1.0"),
    Misuse("latency in milliseconds", sensor('type="joint" joint="bend" latency="30"'), SENSOR,
           "latency <= 10 s", "30.0"),
    Misuse("noise that is not a number", sensor('type="joint" joint="bend" noise="low"'), SENSOR,
           "a finite number as noise", "'low'", row=False),
    Misuse("unknown element in a sensor", inside(
           '<sensor name="s" type="joint" joint="bend"><noise/></sensor>'), f"{SENSOR}<noise>",
           "no element inside", "<noise>", row=False),
]  # fmt: skip
STRAYS = [
    Misuse("misspelt element", ('<dynamics damping="0.02"', '<dynamic damping="0.02"'),
           '<joint name="bend"><dynamic>', "<dynamics>", "<dynamic> (misspelt?)"),
    Misuse("misspelt attribute", ('lower="-1.5"', 'lowr="-1.5"'), '<joint name="bend"><limit>',
           'attribute lower="…"', "lowr (misspelt?)"),
    Misuse("number as an element", ('<dynamics damping="0.02" friction="0.001"/>',
           "<dynamics><damping>0.02</damping></dynamics>"),
           '<joint name="bend"><dynamics><damping>', 'attribute damping="…" of <dynamics>',
           "an element <damping>, which is SDF's way"),
    Misuse("limit as an element", ('<limit lower="-1.5" upper="1.5" effort="9" velocity="9"/>',
           '<limit effort="9" velocity="9"><lower>-1.5</lower></limit>'),
           '<joint name="bend"><limit><lower>', 'attribute lower="…" of <limit>',
           "an element <lower>, which is SDF's way", row=False),
    Misuse("misspelt spring", (
           "<springStiffness>0.5</springStiffness>", "<springstiffness>0.5</springstiffness>"),
           '<gazebo reference="bend"><springstiffness>', "<springStiffness>",
           "<springstiffness> (misspelt?)", row=False),
    Misuse("two letters swapped", (FINGER, FINGER.replace("inertial>", "inertail>")),
           '<link name="finger"><inertail>', "<inertial>", "<inertail> (misspelt?)", row=False),
    Misuse("element in the wrong place", ('<link name="base"/>',
           '<link name="base"><mass value="1"/></link>'),
           '<link name="base"><mass>', "another place", "<mass> right inside <link>"),
    Misuse("actuator outside the block", beside('<actuator name="u3" tendon="cable"/>'),
           '<actuator name="u3">', "another place", "<actuator> right inside <robot>"),
    Misuse("sensor outside the block", beside('<sensor name="s" type="joint" joint="bend"/>'),
           '<sensor name="s">', "another place", "<sensor> right inside <robot>"),
    Misuse("joint inside a joint", ('<axis xyz="0 0 2"/>', '<joint name="x"/><axis xyz="0 0 2"/>'),
           '<joint name="slide"><joint name="x">', "another place",
           "<joint> right inside <joint>", row=False),
    Misuse("block in the wrong place", beside('<gazebo><softdyn version="1"/></gazebo>'),
           "<softdyn>", "<softdyn> right inside <robot>", "inside <gazebo>"),
]  # fmt: skip
DRAKE = 'xmlns:drake="http://drake.mit.edu"'
A_TREE = "a tree of <joint>s, some of which may follow others by <mimic>"
A_SPRING, A_DAMPER = "springs as <springStiffness>", 'dampers as <dynamics damping="…">'
WEIGHT, A_MASS = "gravity of 9.81 m/s² along -z on every link", "masses in <inertial>"
A_FORCE, A_PART = "forces as <tendon> and <actuator>", "all links and joints right inside <robot>"
ROTOR = f"""\
  <transmission {DRAKE} name="t"><joint name="bend"/><actuator name="m">
    <drake:gear_ratio value="10"/>
    <drake:rotor_inertia value="0.001"/></actuator></transmission>"""
PAD = '<gazebo reference="pad">'


def gazebo(inside: str, reference: str = ' reference="pad"') -> tuple[str, str]:
    """Insert an element for Gazebo."""
    return beside(f"<gazebo{reference}>{inside}</gazebo>")


OTHERS = [
    Misuse("constraint between two links", beside(
           '<constraint name="c"><parent link="base"/><child link="pad"/></constraint>'),
           '<constraint name="c">', A_TREE, "<constraint>: write it so, or remove it"),
    Misuse("loop", beside('<loop_joint name="l" type="ball"/>'), '<loop_joint name="l">', A_TREE,
           "<loop_joint>"),
    Misuse("element between two parts, of any name", beside('<four_bar a="base" b="pad"/>'),
           "<four_bar>", A_TREE, "<four_bar>"),
    Misuse("element that holds a joint", beside('<arm><virtual_joint name="v"/></arm>'), "<arm>",
           A_TREE, "<arm> with 'virtual_joint'", row=False),
    Misuse("joint of Gazebo", gazebo('<joint name="x" type="revolute"/>', ""),
           '<gazebo><joint name="x">', A_TREE, "<joint>"),
    Misuse("link of Gazebo", gazebo('<link name="x"/>', ""), '<gazebo><link name="x">', A_PART,
           "<link>", row=False),
    Misuse("included model", gazebo("<include><uri>model://x</uri></include>", ""),
           "<gazebo><include>", A_PART, "<include>", row=False),
    Misuse("joint of Drake", beside(f'<drake:joint {DRAKE} name="x" type="ball"/>'),
           '<drake:joint name="x">', A_TREE, "<drake:joint>"),
    Misuse("bushing of Drake", beside(f"<drake:linear_bushing_rpy {DRAKE}/>"),
           "<drake:linear_bushing_rpy>", A_SPRING, "<drake:linear_bushing_rpy>", row=False),
    Misuse("spring by another name", beside('<spring joint="bend" k="3"/>'), "<spring>", A_SPRING,
           "<spring>"),
    Misuse("spring of a joint of Gazebo", gazebo(
           "<axis><dynamics><spring_stiffness>3</spring_stiffness></dynamics></axis>"),
           f"{PAD}<axis>", A_SPRING, "<axis> with 'spring_stiffness'", row=False),
    Misuse("spring as an attribute", number('0.02" spring_constant="3'),
           '<joint name="bend"><dynamics>', A_SPRING, 'spring_constant="3"'),
    Misuse("spring as one letter", number('0.02" K="3'), '<joint name="bend"><dynamics>', A_SPRING,
           'K="3"', row=False),
    Misuse("damping by another name", number('0.02" viscous="3'),
           '<joint name="bend"><dynamics>', A_DAMPER, 'viscous="3"'),
    Misuse("damping of a link", gazebo("<dampingFactor>0.1</dampingFactor>"),
           f"{PAD}<dampingFactor>", A_DAMPER, "<dampingFactor> '0.1'"),
    Misuse("decay of a link's velocity", gazebo(
           "<velocity_decay><linear>0.1</linear></velocity_decay>"), f"{PAD}<velocity_decay>",
           A_DAMPER, "<velocity_decay>", row=False),
    Misuse("link without gravity", gazebo("<gravity>0</gravity>"), f"{PAD}<gravity>", WEIGHT,
           "<gravity> '0'"),
    Misuse("gravity turned off", gazebo('<turnGravityOff value="true"/>'),
           f"{PAD}<turnGravityOff>", WEIGHT, "<turnGravityOff> 'true'"),
    Misuse("another gravity", beside('<mujoco><option gravity="0 0 -1.6"/></mujoco>'),
           "<mujoco><option>", WEIGHT, 'gravity="0 0 -1.6"'),
    Misuse("gravity that MuJoCo turns off", beside(
           '<mujoco><option><flag gravity="disable"/></option></mujoco>'),
           "<mujoco><option><flag>", WEIGHT, 'gravity="disable"', row=False),
    Misuse("link that cannot move", gazebo("<kinematic>true</kinematic>"), f"{PAD}<kinematic>",
           "links that move as their joints let them", "<kinematic> 'true'"),
    Misuse("robot that Gazebo turns", gazebo("<pose>0 0 1 0 1.5 0</pose>", ""), "<gazebo><pose>",
           A_PART, "<pose> '0 0 1 0 1.5 0'", row=False),
    Misuse("mass of Gazebo", gazebo("<inertial><mass>3</mass></inertial>"), f"{PAD}<inertial>",
           A_MASS, "<inertial>"),
    Misuse("scaled inertia", ('<link name="base"/>', '<link name="base"><contact>'
           '<inertia_scaling value="3"/></contact></link>'), '<link name="base"><contact>', A_MASS,
           "<contact>", row=False),
    Misuse("least mass of MuJoCo", beside('<mujoco><compiler boundmass="0.1"/></mujoco>'),
           "<mujoco><compiler>", A_MASS, 'boundmass="0.1"'),
    Misuse("equality of MuJoCo", beside("<mujoco><equality/></mujoco>"), "<mujoco><equality>",
           A_TREE, "<equality> in <mujoco>"),
    Misuse("actuator of MuJoCo", beside("<mujoco><actuator/></mujoco>"), "<mujoco><actuator>",
           A_FORCE, "<actuator> in <mujoco>"),
    Misuse("bodies of MuJoCo", beside("<mujoco><worldbody/></mujoco>"), "<mujoco><worldbody>",
           A_PART, "<worldbody> in <mujoco>", row=False),
    Misuse("rotor in ros2_control", beside(
           '<ros2_control name="c"><joint name="bend"><param name="rotor_inertia">1e-5</param>'
           "</joint></ros2_control>"), '<ros2_control name="c">',
           '<joint name="bend" armature="…"/> in <softdyn>: the inertia there',
           "rotor_inertia '1e-5': write it so, or remove it"),
    Misuse("rotor behind two gears", beside(ROTOR.replace("</actuator>",
           '</actuator><mechanicalReduction>3</mechanicalReduction>')),
           '<transmission name="t"><actuator name="m"><drake:rotor_inertia>',
           'one gear, or <joint name="…" armature="…"/> in <softdyn>',
           "2 of them: write it so, or remove it"),
    Misuse("rotor of an unknown joint", beside(ROTOR.replace('"bend"', '"bent"')),
           '<transmission name="t"><joint name="bent">', "the name of a joint",
           "'bent'; did you mean 'bend'?"),
    Misuse("negative inertia of a rotor", beside(ROTOR.replace('value="0.001"', 'value="-1"')),
           '<transmission name="t"><actuator name="m"><drake:rotor_inertia>',
           "an inertia >= 0", "-1.0", row=False),
    Misuse("two values of friction", ('<axis xyz="0 1 0"/>',
           '<axis xyz="0 1 0"/><joint_properties friction="0.3"/>'),
           '<joint name="bend"><joint_properties>', "one friction of joint 'bend'",
           "0.001 and 0.3"),
    Misuse("spring among a joint's properties", ('<axis xyz="0 1 0"/>',
           '<axis xyz="0 1 0"/><joint_properties stiffness="3"/>'),
           '<joint name="bend"><joint_properties>', A_SPRING, 'stiffness="3"', row=False),
    Misuse("joint that Drake ignores", (
           '<joint name="glue" ', '<joint name="glue" drake_ignore="true" '),
           '<joint name="glue">', A_PART, 'drake_ignore="true"', row=False),
    Misuse("xacro that was not expanded", beside(
           '<xacro:include xmlns:xacro="http://www.ros.org/wiki/xacro" filename="x"/>'),
           "<xacro:include>", "a URDF that xacro has expanded", "<xacro:include>"),
]  # fmt: skip
GROUPS = {
    "File": FILE,
    "Misspelt and misplaced": STRAYS,
    "Other tools": OTHERS,
    "Tree": TREE,
    "Numbers": NUMBERS,
    "Inertia": INERTIA,
    "Joint springs and dampers": SPRINGS,
    "The block": BLOCK,
    "Tendons": TENDONS,
    "Round bodies": WRAPS,
    "Actuators and task": INPUTS,
    "Friction of cables": FRICTION,
    "Slack tendons, motors and winches": RIG,
    "Sensors": SENSORS,
}
START = "<!-- misuses: written by tests/support/misuses.py -->"
END = "<!-- end of misuses -->"
FORMAT = ROOT / "docs" / "format.md"
MISUSES = [misuse for group in GROUPS.values() for misuse in group]


def tables(folder: Path) -> str:
    """The tables of ``docs/format.md``, with the parser's messages for all misuses."""
    parts = []
    for group, misuses in GROUPS.items():
        rows = [f"### {group}", "", "| misuse | element | expected | got |", "|---|---|---|---|"]
        for misuse in misuses:
            if misuse.row:
                error = misuse.error(folder)
                # the XML parser's own words depend on its version
                got = misuse.got if error.expected == "well-formed XML" else error.got
                cells = (f"`{text}`" for text in (error.element, error.expected, got))
                rows.append(" | ".join((f"| {misuse.title}", *cells)) + " |")
        parts.append("\n".join(rows))
    return "\n\n".join(parts)


def documented() -> str:
    """The tables in the document."""
    return FORMAT.read_text().partition(START)[2].partition(END)[0].strip()


def main() -> None:
    """Update the document."""
    with tempfile.TemporaryDirectory() as folder:
        found = tables(Path(folder))
    before, _, rest = FORMAT.read_text().partition(START)
    FORMAT.write_text(f"{before}{START}\n\n{found}\n\n{END}{rest.partition(END)[2]}")


if __name__ == "__main__":
    main()
