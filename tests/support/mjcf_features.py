"""Pairs of MJCFs that differ in one feature of MuJoCo which changes the motion."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from lxml import etree

BASE = """\
<mujoco>
  <option/>
  <worldbody>
    <site name="anchor" pos="0.1 0.2 0.4"/>
    <body name="arm" pos="0 0 1">
      <joint name="turn" axis="0 0.8 0.6" stiffness="1" damping="0.1" frictionloss="0.05"
        range="-20 25"/>
      <inertial pos="0.1 0.02 0" mass="0.7" fullinertia="2e-3 3e-3 4e-3 1e-4 -2e-4 3e-4"/>
      <geom name="hull" type="box" size="0.1 0.03 0.02" pos="0.1 0 0.01"/>
      <site name="on_arm" pos="0.12 0.01 0.03" euler="20 10 0"/>
      <body name="fore" pos="0.25 0 0">
        <joint name="push" type="slide" axis="1 0 0" stiffness="20" damping="1"/>
        <inertial pos="0.05 0 0.01" mass="0.3" diaginertia="1e-3 2e-3 2e-3"/>
        <site name="on_fore" pos="0.05 0.02 0" euler="0 30 0"/>
        <body name="hand" pos="0.1 0 0">
          <joint name="wrist" type="ball" stiffness="0.5" damping="0.05"/>
          <inertial pos="0.03 0 0" mass="0.2" diaginertia="3e-4 4e-4 5e-4"/>
          <site name="on_hand" pos="0.04 0.01 0.02"/>
        </body>
      </body>
    </body>
    <body name="block" pos="1 0 1">
      <joint name="float" type="free" damping="0.2"/>
      <inertial pos="0.01 0 0" mass="0.5" diaginertia="1e-3 2e-3 3e-3"/>
      <site name="on_block" pos="0.02 0.01 0"/>
    </body>
  </worldbody>
  <tendon>
    <fixed name="both" stiffness="2" damping="0.1" springlength="0.1">
      <joint joint="turn" coef="1.5"/><joint joint="push" coef="-2"/>
    </fixed>
    <fixed name="other"><joint joint="push" coef="1"/></fixed>
    <spatial name="cable" stiffness="5" springlength="0.2">
      <site site="anchor"/><site site="on_arm"/><pulley divisor="2"/><site site="on_fore"/>
      <site site="on_hand"/>
    </spatial>
  </tendon>
  <actuator>
    <motor name="drive" joint="turn" gear="2" group="1" ctrlrange="-3 3"/>
    <position name="servo" joint="push" kp="30"/>
    <motor name="winch" tendon="both" gear="1.5"/>
    <motor name="jet" site="on_hand" gear="0 0 1 0 0 0"/>
    <motor name="spin" joint="wrist" gear="0 0.1 0 0 0 0"/>
  </actuator>
  <equality/>
</mujoco>
"""
TURN, PUSH, WRIST, FLOAT = (f"joint[@name='{name}']" for name in ("turn", "push", "wrist", "float"))
FIXED, CABLE, DRIVE = "fixed[@name='both']", "spatial[@name='cable']", "motor[@name='drive']"
SERVO, WINCH, JET, SPIN = (
    "position",
    "motor[@name='winch']",
    "motor[@name='jet']",
    "motor[@name='spin']",
)
HULL = "geom[@name='hull']"
Edit = Mapping[str, Mapping[str, str]]


class Pair(NamedTuple):
    """`said` must be in the comparison; `common` turns the base into A, `change` turns A into B.

    A key is the path of an element. A path that ends in + adds the element to its parent.
    """

    said: str
    change: Edit
    common: Edit = MappingProxyType({})


def flag(name: str, value: str = "disable") -> Edit:
    return {"option/flag+": {name: value}}


def joint(**values: str) -> Edit:
    return {TURN: values}


LIMITED = {FIXED: {"range": "-0.1 0.15"}}
RUBBING = {FIXED: {"frictionloss": "0.2"}}
FLUID = {"option": {"density": "1000"}}
LIQUID = FLUID | {HULL: {"fluidshape": "ellipsoid"}}
FILTER = {"dyntype": "filter", "dynprm": "0.05"}
GENERAL = {"actuator/general+": {"name": "more", "joint": "turn", "gainprm": "2"}}
FILTERED = {"actuator/general+": {"name": "more", "joint": "turn", "gainprm": "2", **FILTER}}
MUSCLE = {"actuator/muscle+": {"name": "flesh", "tendon": "both", "lengthrange": "-1 1",
                               "force": "5"}}  # fmt: skip
CRANK = {"actuator/motor+": {"name": "crank", "cranksite": "on_fore", "slidersite": "on_arm",
                             "cranklength": "0.5"}}  # fmt: skip
TIED = {"equality/joint+": {"joint1": "push", "joint2": "turn", "polycoef": "0.01 0.2 0 0 0"}}
HUNG = {"equality/connect+": {"body1": "hand", "body2": "block", "anchor": "0.1 0 0"}}
WELDED = {"equality/weld+": {"body1": "hand", "body2": "block"}}
ROPES = {"equality/tendon+": {"tendon1": "both", "tendon2": "other"}}
ORIENTED = {"actuator/orientation+": {"name": "aim", "joint": "wrist", "kp": "2"}}
PID = {"actuator/pid+": {"name": "held", "joint": "turn", "kp": "3"}}
LATE = {DRIVE: {"delay": "0.01", "nsample": "5"}}

PAIRS = {
    "joint stiffness polynomial": Pair("stiffness", joint(stiffness="1 2 3")),
    "joint damping polynomial": Pair("damping", joint(damping="0.1 0.2 0.3")),
    "ball stiffness polynomial": Pair("stiffness", {WRIST: {"stiffness": "0.5 1 2"}}),
    "ball damping polynomial": Pair("damping", {WRIST: {"damping": "0.05 0.1 0.2"}}),
    "joint springyield": Pair("jnt_springyield", joint(springyield="2")),
    "joint springref": Pair("rest", joint(springref="5")),
    "joint armature": Pair("armature", joint(armature="0.01")),
    "joint frictionloss": Pair("friction", joint(frictionloss="0.2")),
    "joint solreflimit": Pair("jnt_solref", joint(solreflimit="0.05 1")),
    "joint solimplimit": Pair("jnt_solimp", joint(solimplimit="0.5 0.6 0.001")),
    "joint margin": Pair("jnt_margin", joint(margin="10")),
    "joint solreffriction": Pair("dof_solref", joint(solreffriction="0.05 1")),
    "joint solimpfriction": Pair("dof_solimp", joint(solimpfriction="0.3 0.4 0.001")),
    "joint range": Pair("limit", joint(range="-10 12")),
    "joint actuatorfrcrange": Pair("effort", joint(actuatorfrcrange="-1 1")),
    "joint actuatorfrcrange, uneven": Pair(
        "effort", joint(actuatorfrcrange="-0.2 1"), joint(actuatorfrcrange="-1 1")
    ),
    "joint actuatorgravcomp": Pair(
        "jnt_actgravcomp", joint(actuatorgravcomp="true"),
        {TURN: {"actuatorfrcrange": "-0.3 0.3"}, "body[@name='arm']": {"gravcomp": "1"}},
    ),
    "ball range": Pair("limit", {WRIST: {"range": "0 10"}}),
    "ball margin": Pair("jnt_margin", {WRIST: {"margin": "30"}}, {WRIST: {"range": "0 10"}}),
    "free joint damping": Pair("damping", {FLOAT: {"damping": "0.2 1 0"}}),
    "free joint stiffness": Pair("stiffness", {FLOAT: {"stiffness": "3"}}),
    "body gravcomp": Pair("gravity", {"body[@name='fore']": {"gravcomp": "0.5"}}),
    "free body gravcomp": Pair("gravity", {"body[@name='block']": {"gravcomp": "1"}}),
    "tendon stiffness polynomial": Pair("tendon", {FIXED: {"stiffness": "2 3 4"}}),
    "tendon damping polynomial": Pair("tendon", {CABLE: {"damping": "0 2 3"}}),
    "tendon springyield": Pair("tendon_springyield", {FIXED: {"springyield": "0.01"}}),
    "tendon springlength": Pair("tendon", {CABLE: {"springlength": "0.2 0.3"}}),
    "fixed tendon armature": Pair("armature", {FIXED: {"armature": "0.02"}}),
    "spatial tendon armature": Pair("armature", {CABLE: {"armature": "0.5"}}),
    "tendon frictionloss": Pair("tendon_frictionloss", {FIXED: {"frictionloss": "0.3"}}),
    "tendon limits": Pair("tendon_range", LIMITED),
    "tendon margin": Pair("tendon_margin", {FIXED: {"margin": "0.2"}}, LIMITED),
    "tendon solreflimit": Pair("tendon_solref_lim", {FIXED: {"solreflimit": "0.1 1"}}, LIMITED),
    "tendon solimplimit": Pair(
        "tendon_solimp_lim", {FIXED: {"solimplimit": "0.3 0.4 0.001"}}, LIMITED
    ),
    "tendon solreffriction": Pair(
        "tendon_solref_fri", {FIXED: {"solreffriction": "0.1 1"}}, RUBBING
    ),
    "tendon solimpfriction": Pair(
        "tendon_solimp_fri", {FIXED: {"solimpfriction": "0.3 0.4 0.001"}}, RUBBING
    ),
    "tendon actuatorfrcrange": Pair("tendon_actfrcrange", {FIXED: {"actuatorfrcrange": "-1 1"}}),
    "tendon pulley": Pair("tendon", {"pulley": {"divisor": "3"}}),
    "actuator delay": Pair("delay", LATE),
    "actuator delay, interpolated": Pair("history", {DRIVE: {"interp": "linear", "delay": "0.009"}},
                                         {DRIVE: {"delay": "0.009", "nsample": "5"}}),
    "actuator armature": Pair("armature", {DRIVE: {"armature": "0.01"}}),
    "actuator armature on a tendon": Pair("armature", {WINCH: {"armature": "0.01"}}),
    "actuator damping": Pair("damping", {DRIVE: {"damping": "0.2"}}),
    "actuator damping polynomial": Pair("damping", {DRIVE: {"damping": "0 0.2 0.1"}}),
    "actuator damping on a tendon": Pair("tendon", {WINCH: {"damping": "0.3"}}),
    "actuator dynamics": Pair("actuator", {"actuator/general": FILTER}, GENERAL),
    "actuator dynprm": Pair("actuator", {"actuator/general": {"dynprm": "0.1"}}, FILTERED),
    "actuator actearly": Pair("actearly", {"actuator/general": {"actearly": "true"}}, FILTERED),
    "actuator actrange": Pair("actrange", {"actuator/general": {"actrange": "-0.1 0.1"}}, FILTERED),
    "actuator biasprm": Pair(
        "actuator", {"actuator/general": {"biastype": "affine", "biasprm": "0 -1 -0.1"}}, GENERAL
    ),
    "actuator gain": Pair("actuator", {"actuator/general": {"gainprm": "2.1"}}, GENERAL),
    "actuator ctrlrange": Pair("actuator", {DRIVE: {"ctrlrange": "-3 0.2"}}),
    "actuator forcerange": Pair("actuator", {SERVO: {"forcerange": "-1 1"}}),
    "actuator forcerange on a tendon": Pair("actuator", {WINCH: {"forcerange": "-0.2 0.2"}}),
    "servo kp": Pair("actuator", {SERVO: {"kp": "31"}}),
    "servo kv": Pair("actuator", {SERVO: {"kv": "2"}}),
    "servo gear": Pair("actuator", {SERVO: {"gear": "1.1"}}),
    "site motor's gear 4": Pair("actuator", {JET: {"gear": "0 0 1 0.2 0 0"}}),
    "site motor's axes": Pair("actuator", {JET: {"gear": "0 0.6 0.8 0 0 0"}}),
    "site motor's refsite": Pair("actuator", {JET: {"refsite": "on_arm"}}),
    "site motor's site": Pair("actuator", {"site[@name='on_hand']": {"euler": "0 20 0"}}),
    "ball motor's gear": Pair("actuator", {SPIN: {"gear": "0.05 0.1 0 0 0 0"}}),
    "slider-crank": Pair("cranklength", {"motor[@name='crank']": {"cranklength": "0.6"}}, CRANK),
    "muscle range": Pair("actuator", {"muscle": {"range": "0.5 1.3"}}, MUSCLE),
    "muscle force": Pair("actuator", {"muscle": {"force": "6"}}, MUSCLE),
    "muscle timeconst": Pair("actuator", {"muscle": {"timeconst": "0.02 0.08"}}, MUSCLE),
    "muscle lengthrange": Pair("lengthrange", {"muscle": {"lengthrange": "-2 1.5"}}, MUSCLE),
    "orientation servo": Pair("actuator", {"orientation": {"kp": "3"}}, ORIENTED),
    "pid": Pair("actuator", {"actuator/pid": {"ki": "5"}}, PID),
    "actuatorgroupdisable": Pair("disableactuator", {"option": {"actuatorgroupdisable": "1"}}),
    "joint equality of higher powers": Pair(
        "coupling", {"equality/joint": {"polycoef": "0.01 0.2 0.5 0 0"}}, TIED
    ),
    "joint equality's slope": Pair(
        "coupling", {"equality/joint": {"polycoef": "0.01 0.3 0 0 0"}}, TIED
    ),
    "joint equality's solref": Pair("eq_solref", {"equality/joint": {"solref": "0.05 1"}}, TIED),
    "joint equality's solimp": Pair("eq_solimp", {"equality/joint": {"solimp": "0.3 0.5 0.01"}},
                                    TIED),
    "joint equality alone": Pair("coupling", TIED),
    "one joint held": Pair("coupling", {"equality/joint+": {"joint1": "push"}}),
    "connect": Pair("coupling", HUNG),
    "connect's anchor": Pair("coupling", {"connect": {"anchor": "0.1 0.02 0"}}, HUNG),
    "weld": Pair("coupling", WELDED),
    "weld's torquescale": Pair("coupling", {"weld": {"torquescale": "0.2"}}, WELDED),
    "weld's relpose": Pair("coupling", {"weld": {"relpose": "0.5 0 0 1 0 0 0"}}, WELDED),
    "tendon equality": Pair("coupling", ROPES),
    "tendon equality's curve": Pair(
        "coupling", {"equality/tendon": {"polycoef": "0 1 0.5 0 0"}}, ROPES
    ),
    "density": Pair("opt.density", FLUID),
    "viscosity": Pair("opt.viscosity", {"option": {"viscosity": "1"}}),
    "wind": Pair("opt.wind", {"option": {"wind": "1 2 3"}}, FLUID),
    "fluid shape": Pair("geom_fluid", {HULL: {"fluidshape": "ellipsoid"}}, FLUID),
    "fluid coefficients": Pair("geom_fluid", {HULL: {"fluidcoef": "1 0.5 1 1 1"}}, LIQUID),
    "size of a shape in a fluid": Pair("geom", {HULL: {"size": "0.1 0.03 0.03"}}, LIQUID),
    "gravity": Pair("gravity", {"option": {"gravity": "0 0 -3"}}),
    "noslip": Pair("opt.noslip_iterations", {"option": {"noslip_iterations": "5"}}, RUBBING),
    "flag gravity": Pair("gravity", flag("gravity")),
    "flag spring": Pair("mjDSBL_SPRING", flag("spring")),
    "flag damper": Pair("mjDSBL_DAMPER", flag("damper")),
    "flag actuation": Pair("mjDSBL_ACTUATION", flag("actuation")),
    "flag equality": Pair("mjDSBL_EQUALITY", flag("equality"), TIED),
    "flag frictionloss": Pair("mjDSBL_FRICTIONLOSS", flag("frictionloss")),
    "flag limit": Pair("mjDSBL_LIMIT", flag("limit")),
    "flag constraint": Pair("mjDSBL_CONSTRAINT", flag("constraint")),
    "flag clampctrl": Pair("mjDSBL_CLAMPCTRL", flag("clampctrl")),
    "flag refsafe": Pair("mjDSBL_REFSAFE", flag("refsafe"), joint(solreflimit="0.001 1")),
    "flag diagexact": Pair("mjENBL_DIAGEXACT", flag("diagexact", "enable")),
}  # fmt: skip


def edited(text: str, edit: Edit) -> str:
    """The text of an MJCF with some elements' attributes set."""
    root = etree.fromstring(text.encode())
    for path, values in edit.items():
        above, _, name = path.rstrip("+").rpartition("/")
        if path.endswith("+"):
            node = etree.SubElement(root.find(f".//{above}"), name)
        else:
            found = root.findall(f".//{path}")
            assert len(found) == 1, path
            node = found[0]
        for key, value in values.items():
            node.set(key, value)
    return etree.tostring(root, encoding="unicode")


def texts(pair: Pair) -> tuple[str, str]:
    """A and B."""
    a = edited(BASE, pair.common)
    return a, edited(a, pair.change)
