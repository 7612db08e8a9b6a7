"""Numbers of other tools' elements that are read: rotors behind gears, onshape's properties.

The right values are computed here by hand, as the tools' own manuals state them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import softdyn
from softdyn import UrdfError, diagnose, parse
from softdyn.description.urdf_writer import write
from softdyn.validation import crosscheck
from tests.support import robots

BOOM = """<robot name="geared" {space}>
  <link name="plate"/>
  <link name="boom"><inertial><origin xyz="0 0 -0.1"/><mass value="0.2"/>
    <inertia ixx="4e-4" ixy="0" ixz="0" iyy="4e-4" iyz="0" izz="2e-5"/></inertial></link>
  <joint name="lift" type="revolute"><parent link="plate"/><child link="boom"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="5" velocity="4"/>{inside}</joint>
  {beside}</robot>"""
LINK = 4e-4 + 0.2 * 0.1**2  # kg m², about the hinge
ROS = (
    '<transmission name="t"><type>SimpleTransmission</type><joint name="lift"/>'
    '<actuator name="m"><mechanicalReduction>{n}</mechanicalReduction>'
    "<motorInertia>{J}</motorInertia></actuator></transmission>"
)
DRAKE = (
    '<transmission type="SimpleTransmission"><joint name="lift"/><actuator name="m">'
    '<drake:gear_ratio value="10"/><drake:rotor_inertia value="1e-4"/></actuator></transmission>'
)


def written(folder: Path, inside: str = "", beside: str = "", space: str = "") -> Path:
    path = robots.write(folder, BOOM.format(inside=inside, beside=beside, space=space))
    return path


@pytest.mark.parametrize(
    ("inside", "beside", "armature"),
    [
        ("", "", 0.0),
        ("", ROS.format(n=50, J="2e-5"), 0.05),
        ("", ROS.format(n=-50, J="2e-5"), 0.05),
        ("", ROS.format(n=50, J=0), 0.0),
        ("", ROS.replace("<mechanicalReduction>{n}</mechanicalReduction>", "").format(J=2), 2.0),
        ("", ROS.format(n=50, J="2e-5") + ROS.format(n=10, J="1e-4").replace('"t"', '"u"'), 0.06),
        ("", DRAKE, 0.01),
        ('<dynamics rotor_inertia="0.05" damping="0.01"/>', "", 0.05),
        ('<dynamics armature="0.05"/>', "", 0.05),
        ('<joint_properties armature="0.05"/>', "", 0.05),
        ('<dynamics rotor_inertia="0.05"/>', ROS.format(n=10, J="1e-4"), 0.06),
    ],
)
@pytest.mark.parametrize("scheme", ["http", "https"])
def test_a_rotor_is_an_armature_of_its_inertia_times_the_gear_squared(
    inside, beside, armature, scheme, tmp_path
):
    path = written(tmp_path, inside, beside, f'xmlns:drake="{scheme}://drake.mit.edu"')
    robot = parse(path)
    model = softdyn.build(robot)
    np.testing.assert_allclose(model.state(model.q0, [0.0]).M, [[LINK + armature]], rtol=1e-12)
    assert bool(robot.adopted) == (armature > 0)
    tools = [name for name in robot.ignored if "type" not in name]
    assert bool(tools) == ("<transmission" in beside and armature == 0)
    path.write_text(write(robot))
    assert parse(path) == robot


def test_both_engines_have_the_rotor_and_check_prints_it(tmp_path):
    model = softdyn.load(written(tmp_path, beside=ROS.format(n=50, J="2e-5")))
    assert crosscheck(model, samples=1, trajectories=False).passed
    found = diagnose(model, 1)
    (line,) = [line for line in str(found).splitlines() if line.startswith("read: ")]
    assert "<motorInertia> 2e-05 at a ratio of 50 as armature 0.05 of 'lift'" in line
    assert found.to_dict()["read"] == list(model.robot.adopted)


def test_an_armature_of_the_block_replaces_a_rotor(tmp_path):
    block = '<softdyn version="1"><joint name="lift" armature="0.03"/></softdyn>'
    robot = parse(written(tmp_path, beside=ROS.format(n=50, J="2e-5") + block))
    assert robot.joints[0].armature == 0.03
    path = written(tmp_path, beside=ROS.format(n=50, J="2e-5"))
    (tmp_path / "block.xml").write_text(block)
    assert parse(path, annotations=tmp_path / "block.xml").joints[0].armature == 0.03


def test_the_properties_of_onshape_are_friction_and_damping(tmp_path):
    words = '<joint_properties friction="0.3" damping="0.2"/><joint_index value="3"/>'
    robot = parse(written(tmp_path, words))
    assert (robot.joints[0].friction, robot.joints[0].damping) == (0.3, 0.2)
    assert robot.ignored == ("1 <joint><joint_index> (names)",)
    zero = parse(written(tmp_path, '<joint_properties friction="0.0"/>'))
    assert zero.joints == parse(written(tmp_path)).joints
    assert zero.ignored == ("1 <joint><joint_properties>",)
    twice = '<dynamics friction="0.3"/><joint_properties friction="0.3"/>'
    assert parse(written(tmp_path, twice)).joints[0].friction == 0.3


@pytest.mark.parametrize(
    "beside",
    [
        ROS.format(n=50, J="2e-5").replace('<joint name="lift"/>', ""),
        ROS.format(n=50, J="2e-5").replace('<joint name="lift"/>', 2 * '<joint name="lift"/>'),
        ROS.format(n="1:50", J="2e-5"),
        ROS.format(n=50, J="heavy"),
        '<ros2_control name="c"><transmission name="t"><joint name="lift"/><actuator name="m">'
        "<motor_inertia>2e-5</motor_inertia></actuator></transmission></ros2_control>",
    ],
)
def test_a_rotor_that_is_not_clear_is_refused(beside, tmp_path):
    with pytest.raises(UrdfError) as refused:
        parse(written(tmp_path, beside=beside))
    assert refused.value.line is not None


def test_a_controller_without_a_rotor_is_ignored(tmp_path):
    plain = '<ros2_control name="c"><joint name="armature"><param name="p">9</param></joint>{}'
    more = '<joint name="lift"><param name="rotor_inertia">0</param></joint></ros2_control>'
    assert parse(written(tmp_path, beside=plain.format(more))).ignored == ("1 <ros2_control>",)


@pytest.mark.parametrize(
    ("old", "new", "attribute"),
    [
        ('<axis xyz="0 1 0"/>', "<axis><xyz>0 1 0</xyz></axis>", "xyz"),
        ('<axis xyz="0 1 0"/>', "<axis/><dynamics><damping>0.8</damping></dynamics>", "damping"),
        ('<axis xyz="0 1 0"/>', "<axis/><dynamics><friction>0.3</friction></dynamics>", "friction"),
        ('lower="-1" upper="1" effort="5" velocity="4"/>',
         'effort="5" velocity="4"><lower>-1</lower><upper>1</upper></limit>', "lower"),
        ('<axis xyz="0 1 0"/>', "<origin><xyz>0 0 0.3</xyz></origin>", "xyz"),
        ('<mass value="0.2"/>', "<mass><value>0.2</value></mass>", "value"),
    ],
)  # fmt: skip
def test_a_number_as_an_element_is_refused_by_the_attribute_that_states_it(
    old, new, attribute, tmp_path
):
    path = written(tmp_path)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(UrdfError) as refused:
        parse(path)
    assert refused.value.expected.startswith(f'attribute {attribute}="…"')
    assert refused.value.line is not None
