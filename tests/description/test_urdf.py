"""The annotated URDF: every misuse is refused, and both engines read valid files alike."""

from __future__ import annotations

import re
import subprocess
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lxml import etree

import softdyn
from softdyn import SoftdynError, UrdfError
from softdyn.commands import crosscheck
from softdyn.description.library import BUNDLED
from softdyn.description.robot import Robot, moving_bodies, poses
from softdyn.description.urdf import MAX_DOF, MAX_LINKS, parse
from softdyn.validation import Twin
from softdyn.validation.twin.bodies import read_bodies
from softdyn.validation.twin.build import body_name
from tests.support.forked import forked
from tests.support.misuses import (
    ARM,
    FORMAT,
    INERTIAL,
    LIMIT,
    MISUSES,
    Misuse,
    beside,
    documented,
    tables,
)
from tests.support.refused import refused


def write(folder: Path, data: str | bytes) -> Path:
    path = folder / "arm.urdf"
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


def changed(folder: Path, *changes: tuple[str, str]) -> Robot:
    text = ARM
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return parse(write(folder, text))


def joint(robot: Robot, name: str):
    return next(joint for joint in robot.joints if joint.name == name)


def chain(count: int, kind: str = "fixed") -> str:
    """`count` links in a row; the first joint is revolute, the others are of one kind."""
    links = "".join(f'<link name="l{i}">{INERTIAL}</link>' for i in range(count))
    joints = "".join(
        f'<joint name="j{i}" type="{kind if i else "revolute"}"><parent link="l{i - 1}"/>'
        f'<child link="l{i}"/><origin xyz="0 0 0.1"/>{LIMIT}</joint>'
        for i in range(count)
    )
    return f'<robot name="c"><link name="l-1"/>{links}{joints}</robot>'


# -- misuses -----------------------------------------------------------------------------------


@pytest.mark.parametrize("misuse", MISUSES, ids=lambda misuse: misuse.title)
def test_every_misuse_is_named_on_one_line(misuse: Misuse, tmp_path: Path) -> None:
    error = misuse.error(tmp_path)
    assert error.element == misuse.element
    assert misuse.expected in error.expected
    assert misuse.got in error.got
    path = tmp_path / "arm.urdf"
    place = f"{path}:{error.line}" if error.line else f"{path}"
    assert str(error) == f"{place}: {error.element}: expected {error.expected}, got {error.got}"
    assert len(str(error).splitlines()) == 1
    assert len(str(error)) < len(str(path)) + 600


PLACED = [m for m in MISUSES if not m.element.startswith(("file", "<!"))]


@pytest.mark.parametrize("misuse", PLACED, ids=lambda misuse: misuse.title)
def test_the_line_is_that_of_the_element(misuse: Misuse, tmp_path: Path) -> None:
    error = misuse.error(tmp_path)
    line = misuse.data.decode().splitlines()[(error.line or 0) - 1]
    tag = re.findall(r"<([^ >]+)", error.element)[-1]
    assert f"<{tag.rpartition('}')[2]}" in line or f":{tag.rpartition('}')[2]}" in line


def test_misuses_have_titles_of_their_own() -> None:
    assert len({misuse.title for misuse in MISUSES}) == len(MISUSES)


@pytest.mark.parametrize("misuse", MISUSES, ids=lambda misuse: misuse.title)
def test_a_command_exits_with_code_2_and_one_line(
    misuse: Misuse, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch
) -> None:
    error = misuse.error(tmp_path)
    path = str(tmp_path / "arm.urdf")
    monkeypatch.setattr(warnings, "formatwarning", warnings.formatwarning)
    assert crosscheck.main([path]) == 2
    out, err = capfd.readouterr()
    assert (out, err) == ("", f"error: {error}\n")


@pytest.mark.parametrize("script", ["crosscheck", "run"])
def test_a_command_of_its_own_process_says_one_line(script: str, tmp_path: Path) -> None:
    path = write(tmp_path, ARM[:300])
    rest = [] if script == "crosscheck" else ["soft-id-clf-qp", "--target", "0", "0", "0"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = forked(script, path, *rest, "--json", "-", **pipes)
    out, err = process.communicate()
    assert (process.returncode, out) == (2, "")
    assert err.startswith(f"error: {path}:")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        ("absent", ("file", "No such file or directory")),
        (".", ("file", "Is a directory")),
        ("a\0b", ("file", "embedded null byte")),
        ("x" * 5000, ("file", "File name too long")),
    ],
)
def test_a_file_that_cannot_be_read(path: str, reason: str, tmp_path: Path) -> None:
    with refused(*reason, by=UrdfError):
        parse(f"{tmp_path}/{path}")


def test_an_endless_file_is_not_read_to_its_end() -> None:
    with refused("file", "more", by=UrdfError):
        parse("/dev/zero")


@pytest.mark.parametrize("digits", ["1" * 10**6 + "x", "1" * 10**6, "0." + "1" * 10**6 + "e"])
def test_a_number_of_a_million_digits_is_refused_at_once(digits: str, tmp_path: Path) -> None:
    with refused('<joint name="bend"><dynamics>', by=UrdfError) as caught:
        changed(tmp_path, ('damping="0.02"', f'damping="{digits}"'))
    assert len(str(caught.value)) < 500


def test_entities_that_explode_are_refused(tmp_path: Path) -> None:
    levels = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 10))
    dtd = f'<!DOCTYPE robot [<!ENTITY e0 "lol">{levels}]>'
    for text in (ARM.replace('"arm"', '"&e9;"'), ARM.replace("</robot>", "&e9;</robot>")):
        with pytest.raises(UrdfError):
            parse(write(tmp_path, dtd + text))


def test_names_with_line_breaks_stay_on_one_line(tmp_path: Path) -> None:
    text = ARM.replace('"pad"', '"p&#10;a&#13;d"').replace('value="0.01"', 'value="x"')
    with pytest.raises(UrdfError) as caught:
        parse(write(tmp_path, text))
    assert len(str(caught.value).splitlines()) == 1


# -- what is read ------------------------------------------------------------------------------


def test_the_whole_format_is_read(tmp_path: Path) -> None:
    robot = parse(write(tmp_path, ARM))
    assert (robot.name, robot.task, robot.warnings) == ("arm", "wheel", ())
    bend, twist = joint(robot, "bend"), joint(robot, "twist")
    assert [j.name for j in robot.moving_joints] == ["bend", "twist", "slide", "spin"]
    assert (bend.kind, bend.parent, bend.child) == ("revolute", "base", "knuckle")
    assert (bend.lower, bend.upper, bend.damping, bend.friction) == (-1.5, 1.5, 0.02, 0.001)
    assert (bend.stiffness, bend.rest, bend.armature) == (0.5, 0.1, 0.005)
    assert (twist.stiffness, twist.rest, twist.armature) == (0.2, 0.0, 0.0)
    assert (joint(robot, "spin").lower, joint(robot, "spin").upper) == (-np.inf, np.inf)
    np.testing.assert_array_equal(joint(robot, "slide").axis, [0, 0, 1])
    np.testing.assert_array_equal(joint(robot, "spin").axis, [1, 0, 0])
    flexor, cable, drive = robot.tendons
    assert [(t.joint, t.coef) for t in flexor.terms] == [("bend", 1.0), ("twist", -0.5)]
    assert (flexor.stiffness, flexor.damping, flexor.rest) == (3.0, 0.1, 0.2)
    assert (cable.terms, [s.link for s in cable.sites]) == ((), ["base", "finger", "pad"])
    np.testing.assert_array_equal(cable.sites[1].xyz, [0.05, 0, 0.02])
    assert (drive.stiffness, drive.damping, drive.rest) == (0.0, 0.0, None)
    u1, u2 = robot.actuators
    assert (u1.tendon, u1.gear, u1.lower, u1.upper) == ("flexor", 0.1, -1.0, 1.0)
    assert (u2.name, u2.gear) == ("u2", -1.0)
    assert robot.length == pytest.approx(0.12)
    assert [j.name for j in robot.chain("pad")] == ["mount", "bend", "twist", "glue"]


def test_what_is_read_cannot_be_written_to(tmp_path: Path) -> None:
    robot = parse(write(tmp_path, ARM))
    with pytest.raises(AttributeError):
        robot.name = "leg"  # type: ignore[misc]
    with pytest.raises(TypeError, match="item assignment"):
        robot.tendons[1].sites[0].xyz[0] = 1.0  # type: ignore[index]
    place = robot.joints[1].origin
    for array in (place.translation, place.rotation, robot.joints[1].axis):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_without_a_block_a_plain_urdf_remains(tmp_path: Path) -> None:
    text = re.sub(r"<softdyn.*</softdyn>", "", ARM, flags=re.DOTALL)
    robot = parse(write(tmp_path, text))
    assert (robot.tendons, robot.actuators, robot.task) == ((), (), "wheel")
    assert joint(robot, "bend").stiffness == 0.5
    assert softdyn.load(robot.path).nu == 0


def test_an_empty_block_is_a_block(tmp_path: Path) -> None:
    text = re.sub(r"<softdyn.*</softdyn>", '<softdyn version="1"/>', ARM, flags=re.DOTALL)
    assert parse(write(tmp_path, text)).actuators == ()


def test_without_a_task_the_deepest_leaf_is_it(tmp_path: Path) -> None:
    assert changed(tmp_path, ('<task frame="wheel"/>', "")).task == "wheel"
    twins = "".join(
        f'<link name="{name}"/><joint name="to_{name}" type="fixed"><parent link="wheel"/>'
        f'<child link="{name}"/></joint>'
        for name in ("zeta", "alpha")
    )
    robot = changed(tmp_path, ('<task frame="wheel"/>', ""), beside(twins))
    assert robot.task == "zeta"  # the first in the file among equals


def test_defaults(tmp_path: Path) -> None:
    robot = changed(
        tmp_path,
        ('gear="-1" ', ""),
        (' rest="0.2"', ""),
        ('lower="-1.5" upper="1.5" ', ""),
        ('<dynamics damping="0.02" friction="0.001"/>', ""),
    )
    bend = joint(robot, "bend")
    assert robot.actuators[1].gear == 1.0
    assert (bend.lower, bend.upper, bend.damping, bend.friction) == (0.0, 0.0, 0.0, 0.0)
    assert robot.tendons[0].rest is None
    model = softdyn.build(robot)
    np.testing.assert_allclose(model.tendon_rest[0], 0.0)
    np.testing.assert_allclose(model.tendon_rest[1], model.tendon_lengths(model.q0)[1])


def test_limits_of_a_continuous_joint_are_no_limits(tmp_path: Path) -> None:
    robot = changed(
        tmp_path, ('<child link="wheel"/>', f'<child link="wheel"/>{LIMIT.replace("1", "2")}')
    )
    assert joint(robot, "spin").upper == np.inf


def test_a_tendon_may_damp_a_continuous_joint(tmp_path: Path) -> None:
    robot = changed(tmp_path, ('<tendon name="drive">', '<tendon name="drive" damping="1">'))
    assert robot.tendons[2].damping == 1.0


@pytest.mark.parametrize(
    ("where", "attribute"), [("stiffness", "0.50"), ("spring_stiffness", "5e-1")]
)
def test_sources_of_a_spring_may_agree(where: str, attribute: str, tmp_path: Path) -> None:
    robot = changed(tmp_path, ('friction="0.001"', f'{where}="{attribute}"'))
    assert joint(robot, "bend").stiffness == 0.5
    assert joint(robot, "bend").rest == 0.1


def test_a_spring_of_stiffness_zero_may_stand_anywhere(tmp_path: Path) -> None:
    zero = '<gazebo reference="{}"><springStiffness>0</springStiffness></gazebo>'
    robot = changed(tmp_path, beside(zero.format("spin") + zero.format("glue")))
    assert joint(robot, "spin").stiffness == 0.0


def test_a_comment_inside_a_spring_is_no_number(tmp_path: Path) -> None:
    robot = changed(tmp_path, (">0.5<", "><!-- N m/rad -->\n 0.5 \n<"))
    assert joint(robot, "bend").stiffness == 0.5


FOREIGN = """
  <!-- a comment -->
  <?pi some instruction?>
  <material name="red"><color rgba="1 0 0 1"/></material>
  <transmission name="t"><type>x</type><joint name="bend"/><actuator name="m"/></transmission>
  <gazebo><plugin name="p" filename="lib.so"><springStiffness>9</springStiffness></plugin></gazebo>
  <gazebo reference="pad"><mu1>0.2</mu1><material>Gazebo/Red</material></gazebo>
  <drake:collision_filter_group xmlns:drake="http://drake.mit.edu" name="x"/>
  <sensor name="camera"><parent link="pad"/></sensor>
  <ros2_control name="r" type="system"><joint name="bend"/></ros2_control>
"""


def test_elements_of_other_tools_are_left_alone(tmp_path: Path) -> None:
    plain, robot = parse(write(tmp_path, ARM)), changed(tmp_path, beside(FOREIGN))
    assert [j.name for j in robot.joints] == [j.name for j in plain.joints]
    assert joint(robot, "bend").stiffness == 0.5
    assert robot.xml == plain.xml
    assert_read_alike(robot)


def test_foreign_attributes_and_children_are_left_alone(tmp_path: Path) -> None:
    robot = changed(
        tmp_path,
        ('<link name="base"/>', '<link name="base" type="x"><self_collide/></link>'),
        ('<joint name="mount" type="fixed">', '<joint name="mount" type="fixed"><axis/><limit/>'),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0" name="y"/><calibration rising="no"/>'),
        ('friction="0.001"', 'friction="0.001" coulomb="high"'),
    )
    assert_read_alike(robot, twin=False)


def test_order_does_not_matter(tmp_path: Path) -> None:
    forward = softdyn.load(write(tmp_path, ARM))
    robot = etree.fromstring(ARM)
    robot[:] = reversed(robot)
    block = robot.find("softdyn")
    assert block is not None
    tasks = list(block)
    block[:] = [tasks[-1], *reversed(tasks[:-1])]
    for element in robot.iter("joint"):
        element[:] = reversed(element)
    backward = softdyn.load(write(tmp_path, etree.tostring(robot)))
    assert backward.robot.task == forward.robot.task
    q, v = forward.q0, np.ones(forward.nv)
    assert backward.joint_names == forward.joint_names
    np.testing.assert_array_equal(backward.state(q, v).h, forward.state(q, v).h)
    np.testing.assert_array_equal(backward.state(q, v).B[:, ::-1], forward.state(q, v).B)


ENCODINGS = {
    "BOM": ARM.encode("utf-8-sig"),
    "declared": f'<?xml version="1.0" encoding="UTF-8"?>\n{ARM}'.encode(),
    "CRLF": ARM.replace("\n", "\r\n").encode(),
    "UTF-16": f'<?xml version="1.0" encoding="UTF-16"?>\n{ARM}'.encode("utf-16"),
    "latin-1": '<?xml version="1.0" encoding="ISO-8859-1"?>\n<!-- Müller -->\n'.encode("latin-1")
    + ARM.encode("latin-1"),
    "line breaks in vectors": ARM.replace('"0.1 0 0"', '"0.1\n\t0\n0"').encode(),
}


@pytest.mark.parametrize("data", ENCODINGS.values(), ids=ENCODINGS)
def test_any_spelling_of_the_same_document_is_the_same_robot(data: bytes, tmp_path: Path) -> None:
    plain = parse(write(tmp_path, ARM))
    robot = parse(write(tmp_path, data))
    assert robot.xml.replace("0.1  0 0", "0.1 0 0") == plain.xml
    assert_read_alike(robot)


def test_names_in_another_encoding_reach_the_engines(tmp_path: Path) -> None:
    text = '<?xml version="1.0" encoding="ISO-8859-1"?>\n' + ARM.replace("pad", "Übung é")
    robot = parse(write(tmp_path, text.encode("latin-1")))
    assert any(link.name == "Übung é" for link in robot.links)
    assert_read_alike(robot)


@pytest.mark.parametrize(
    "name",
    ["a b", "a/b", "a:b", "指先", "root_joint", "base", "world", "task", "1", "a" * 10**5, "&lt;'"],
)
def test_names_are_just_names(name: str, tmp_path: Path) -> None:
    """Even a joint may have the name of a link."""
    text = ARM.replace('"bend"', f'"{name}"').replace('"cable"', f'"{name}"')
    robot = parse(write(tmp_path, text))
    assert robot.joints[1].name == robot.tendons[1].name == name.replace("&lt;", "<")
    assert_read_alike(robot)


@pytest.mark.parametrize("order", [("wheel", "slider", "finger"), ("slider", "finger", "wheel")])
def test_links_may_have_the_names_that_mujoco_keeps_for_itself(order, tmp_path: Path) -> None:
    """MuJoCo has a body `world`, so the twin renames such links, and its names stay unique."""
    text, plain = ARM.replace('"world"', '"ground"'), Twin(parse(write(tmp_path, ARM)))
    for old, new in zip(order, ("world", "link:world", "link:link:world"), strict=True):
        text = text.replace(f'"{old}"', f'"{new}"')
    robot = parse(write(tmp_path, text))
    assert_read_alike(robot)
    twin = Twin(robot)
    names = [body_name(robot, link.name) for link in robot.links]
    assert len({*names, "world"}) == len(names) + 1
    for name in ("body_mass", "body_parentid", "body_pos"):
        np.testing.assert_array_equal(getattr(twin.model, name), getattr(plain.model, name))
    assert {twin.model.body(i).name for i in range(1, twin.model.nbody)} <= set(names)


@pytest.mark.parametrize("number", ["0.10", ".1", "1e-1", "+0.1", "1.E-1", "0.1E+00"])
def test_every_spelling_of_a_number_means_the_same(number: str, tmp_path: Path) -> None:
    robot = changed(tmp_path, ('xyz="0.1 0 0"', f'xyz="  {number} 0  -0 "'))
    np.testing.assert_array_equal(joint(robot, "glue").origin.translation, [0.1, 0, 0])
    assert_read_alike(robot)


@pytest.mark.parametrize("number", ["5e-324", "1e-400", "-0", "1e50"])
def test_extreme_numbers_mean_the_same(number: str, tmp_path: Path) -> None:
    robot = changed(tmp_path, ('xyz="0.1 0 0"', f'xyz="{number} 0 0"'))
    assert joint(robot, "glue").origin.translation[0] == float(number)
    assert_read_alike(robot)


def test_a_namespaced_element_reaches_no_engine(tmp_path: Path) -> None:
    """Pinocchio's reader ignores namespaces and would take the first for the link's inertia."""
    alien = INERTIAL.replace("<inertial>", '<inertial xmlns="http://alien">')
    with refused(
        '<link name="base"><{http://alien}inertial>',
        "<inertial>: write it so, or remove it",
        by=UrdfError,
    ):
        changed(tmp_path, ('<link name="base"/>', f'<link name="base">{alien}</link>'))
    note = '<link name="base"><note xmlns="http://alien"/></link>'
    robot = changed(tmp_path, ('<link name="base"/>', note))
    assert "alien" not in robot.xml
    assert_read_alike(robot)


def test_one_link_s_own_defect_is_a_warning(tmp_path: Path) -> None:
    text = ARM.replace(
        'ixx="1e-6" ixy="0" ixz="0" iyy="1e-6" iyz="0" izz="1e-6"',
        'ixx="1e-7" ixy="0" ixz="0" iyy="1e-7" iyz="0" izz="9e-7"',
    )
    robot = parse(write(tmp_path, text))
    (warning,) = robot.warnings
    assert warning.startswith(f'{robot.path}: <link name="pad">: principal moments')
    with pytest.warns(UserWarning, match="pad"):
        softdyn.load(robot.path)


def test_a_fixed_link_may_lend_its_mass_to_a_massless_body(tmp_path: Path) -> None:
    text = ARM.replace(f'<link name="slider">{INERTIAL}</link>', '<link name="slider"/>')
    robot = parse(write(tmp_path, text))
    bodies = moving_bodies(robot)
    assert (bodies["slider"].mass, bodies["knuckle"].mass) == (0.0, 0.0)
    assert bodies["finger"].mass == pytest.approx(0.11)
    assert_read_alike(robot)


def test_the_largest_trees(tmp_path: Path) -> None:
    robot = parse(write(tmp_path, chain(MAX_LINKS - 1)))
    assert len(robot.links) == MAX_LINKS
    assert_read_alike(robot)
    robot = parse(write(tmp_path, chain(MAX_DOF, "revolute")))
    assert len(robot.moving_joints) == MAX_DOF
    assert_read_alike(robot)
    for text in (chain(MAX_LINKS), chain(MAX_DOF + 1, "revolute")):
        with refused("<robot>", by=UrdfError):
            parse(write(tmp_path, text))


# -- both engines read what the parse read --------------------------------------------------------


def assert_read_alike(robot: Robot, twin: bool = True) -> None:
    """Pinocchio and yourdfpy must agree with the parse: tree, poses at q = 0, masses."""
    model = pin.buildModelFromXML(robot.xml)
    assert sorted(model.names[1:]) == sorted(j.name for j in robot.moving_joints)
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    placed, bodies = poses(robot), moving_bodies(robot)
    scale = max(1e-3, *(np.abs(translation).max() for _, translation in placed.values()))
    for name, (rotation, translation) in placed.items():
        frame = data.oMf[model.getFrameId(name, pin.FrameType.BODY)]
        np.testing.assert_allclose(frame.translation, translation, rtol=1e-12, atol=1e-12 * scale)
        np.testing.assert_allclose(frame.rotation, rotation, atol=1e-12)
    columns = pin.computeJointJacobians(model, data, pin.neutral(model)).reshape(6, -1)
    for j in robot.moving_joints:
        column = columns[:, model.joints[model.getJointId(j.name)].idx_v]
        axis = column[:3] if j.kind == "prismatic" else column[3:]
        np.testing.assert_allclose(axis, placed[j.child][0] @ j.axis, atol=1e-9)
        inertia, body = model.inertias[model.getJointId(j.name)], bodies[j.child]
        assert inertia.mass == pytest.approx(body.mass, rel=1e-12)
        size = np.abs(body.com).max() + 1e-9
        if body.mass > 0:
            np.testing.assert_allclose(inertia.lever, body.com, rtol=1e-9, atol=1e-9 * size)
        largest = np.abs(body.tensor).max()
        np.testing.assert_allclose(inertia.inertia, body.tensor, rtol=1e-9, atol=1e-9 * largest)
    if twin:
        tree = read_bodies(robot.path, floating=False)
        mine = {b.joint.name: b for b in tree.bodies if b.joint is not None}
        for j in robot.moving_joints:
            assert mine[j.name].mass == pytest.approx(bodies[j.child].mass, rel=1e-12)
            np.testing.assert_allclose(mine[j.name].joint.axis, j.axis, atol=1e-12)
            np.testing.assert_allclose(mine[j.name].com * mine[j.name].mass,
                                       bodies[j.child].com * bodies[j.child].mass,
                                       rtol=1e-9, atol=1e-12 * scale)  # fmt: skip


@pytest.mark.parametrize("name", softdyn.bundled_names())
def test_bundled_robots_are_read_alike(name: str) -> None:
    assert_read_alike(parse(BUNDLED / f"{name}.urdf"))


# -- random vandalism ------------------------------------------------------------------------------

HOSTILE = (
    "", " ", "nan", "inf", "-inf", "1e999", "1e300", "1e50", "1e-320", "-0", "0", "-1", "0,1",
    "1_0", "0x10", "heavy", "1 2", "0 0 0", "1 2 3", "1 2 3 4", "nan 0 0", "1e300 0 0", "universe",
    "world", "fixed", "continuous", "prismatic", "planar", "link1", "joint1", "٣", "\u00a01",
    "1\n", "a\nb",
)  # fmt: skip
SOURCES = {
    "arm": ARM,
    "finger": (BUNDLED / "finger.urdf").read_text(),
    "helix": (BUNDLED / "helix.urdf").read_text(),
}


@st.composite
def vandalised(draw: st.DrawFn) -> bytes:
    """A robot's file with one to three random changes of its elements and attributes."""
    source = draw(st.sampled_from(["arm"] * 6 + ["finger"] * 3 + ["helix"]))
    robot = etree.fromstring(SOURCES[source].encode())
    for _ in range(draw(st.integers(1, 3))):
        elements = [e for e in robot.iter() if isinstance(e.tag, str)]
        inner = elements[1:]
        element = draw(st.sampled_from(elements))
        act = draw(st.sampled_from(["delete", "double", "rename", "move", "text", "attribute"]))
        if act == "attribute" and element.attrib:
            name = draw(st.sampled_from(sorted(element.attrib)))
            values = [element.get(name) for element in elements if element.get(name)]
            what = draw(st.sampled_from(["delete", "rename", "hostile", "swap"]))
            if what == "delete":
                del element.attrib[name]
            elif what == "rename":
                element.set(draw(st.sampled_from(["x", "name", "xyz", "quat", "{u}x"])), "1")
            else:
                pool = HOSTILE if what == "hostile" else tuple(values)
                element.set(name, draw(st.sampled_from(pool)))
        elif act == "text":
            element.text = draw(st.sampled_from(HOSTILE))
        elif act == "rename":
            element.tag = draw(st.sampled_from(sorted({e.tag for e in elements} | {"x", "{u}y"})))
        elif inner:
            element = draw(st.sampled_from(inner))
            parent = element.getparent()
            if act == "delete":
                parent.remove(element)
            elif act == "double":
                parent.append(etree.fromstring(etree.tostring(element)))
            else:
                below = set(element.iter())
                draw(st.sampled_from([e for e in elements if e not in below])).append(element)
    return etree.tostring(robot)


@settings(
    max_examples=100,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(data=vandalised())
def test_a_vandalised_file_is_refused_or_loads(data: bytes, tmp_path: Path) -> None:
    path = write(tmp_path, data)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        warnings.simplefilter("ignore", UserWarning)
        try:
            model = softdyn.load(path)
        except SoftdynError as error:
            refusal = str(error)
        else:
            refusal = ""
    if refusal:
        assert len(refusal.splitlines()) == 1
        return
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        state = model.state(model.q0, np.zeros(model.nv))
    assert np.isfinite(state.M).all()
    assert np.isfinite(state.h).all()
    assert np.isfinite(state.B).all()
    try:
        read_bodies(path, floating=False)
    except UrdfError:  # only the twin would need this shape
        assert_read_alike(model.robot, twin=False)
    else:
        assert_read_alike(model.robot)


# -- the document ------------------------------------------------------------------------------


def examples() -> list[str]:
    return re.findall(r"```xml\n(<(?:\?xml|robot).*?)```", FORMAT.read_text(), re.DOTALL)


def test_the_document_s_example_loads(tmp_path: Path) -> None:
    (example,) = examples()
    model = softdyn.load(write(tmp_path, example))
    assert model.robot.warnings == ()
    assert (model.nv, model.nu) == (3, 2)
    assert_read_alike(model.robot)


def test_the_document_s_table_is_what_the_parser_says(tmp_path: Path) -> None:
    assert documented() == tables(tmp_path), "python -m tests.support.misuses brings it up to date"


def test_the_document_names_every_attribute_of_the_block(tmp_path: Path) -> None:
    refusals = [m.error(tmp_path).expected for m in MISUSES if "no attribute but" in m.expected]
    names = {
        name for text in refusals for name in text.removeprefix("no attribute but ").split(", ")
    }
    assert len(names) >= 14
    assert [name for name in sorted(names) if f"`{name}`" not in FORMAT.read_text()] == []
