"""Other tools' elements: those that change nothing are ignored and counted.

The others are misuses, see `tests.support.misuses`.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from softdyn import diagnose, load, parse
from softdyn.description.robot import Robot
from tests.support import robots
from tests.support.misuses import ARM

OLD = 'xmlns:joint="http://playerstage.sourceforge.net/gazebo/xmlschema/#slider"'
HINGE = "<gazebo><joint:hinge><body1>base</body1><body2>pad</body2></joint:hinge></gazebo>"
FLOATS = '<gazebo reference="pad"><turnGravityOff>true</turnGravityOff></gazebo>'
DRIVE = '<dynamics damping="0.02" friction="0.001" K="7000" D="1" mu_coulomb="0" mu_viscous="16"/>'
BELT = '<note belt="0" link="pad"/>'
MUJOCO = '<mujoco><compiler meshdir="x" balanceinertia="true" boundmass="0"/><size/></mujoco>'


def read(folder: Path, more: str = "", *changes: tuple[str, str]) -> Robot:
    text = ARM.replace("</robot>", f"{more}</robot>")
    for change in changes:
        assert text.count(change[0]) == 1
        text = text.replace(*change)
    path = robots.write(folder, text, "arm.urdf")
    return parse(path)


@pytest.mark.parametrize(
    ("more", "found"),
    [
        ('<gazebo reference="pad"><gravity>1</gravity></gazebo>', "1 <gazebo><gravity>"),
        ('<gazebo reference="pad"><turnGravityOff>false</turnGravityOff></gazebo>',
         "1 <gazebo><turnGravityOff>"),
        ("<gazebo><static>false</static></gazebo>", "1 <gazebo><static>"),
        ("<gazebo><pose>0 0 1 0 0 0</pose></gazebo>", "1 <gazebo><pose>"),
        (2 * '<gazebo reference="pad"><mu1>1</mu1></gazebo>', "2 <gazebo><mu1> (contacts)"),
        ('<gazebo reference="pad"><dampingFactor>0</dampingFactor></gazebo>',
         "1 <gazebo><dampingFactor>"),
        ('<gazebo><plugin name="p"><joint>bend</joint><force>9</force></plugin></gazebo>',
         "1 <gazebo><plugin> (control)"),
        ('<x:force_torque_sensor xmlns:x="u" links="base pad"/>', "1 <x:force_torque_sensor>"),
        (BELT, "1 <note>"),
        (MUJOCO, "1 <mujoco>"),
    ],
)  # fmt: skip
def test_what_changes_nothing_is_counted(more: str, found: str, tmp_path: Path) -> None:
    robot = read(tmp_path, more)
    assert robot.ignored == (found,)
    assert robot == read(tmp_path, more)
    assert robot.xml == read(tmp_path).xml


def test_attributes_are_counted_too(tmp_path: Path) -> None:
    drive = ('<dynamics damping="0.02" friction="0.001"/>', DRIVE)
    robot = read(tmp_path, "", drive, ('name="glue"', 'name="glue" dont_collapse="true"'))
    shown = [f"1 <dynamics {name}>" for name in ("D", "K", "mu_coulomb", "mu_viscous")]
    assert robot.ignored == (*shown, "1 <joint dont_collapse>")


def test_check_prints_them_in_one_line(tmp_path: Path) -> None:
    read(tmp_path, MUJOCO + 2 * '<gazebo reference="pad"><mu1>1</mu1></gazebo>')
    found = diagnose(load(tmp_path / "arm.urdf"), 1)
    assert "\nignored: 2 <gazebo><mu1> (contacts), 1 <mujoco>\n" in str(found)
    assert found.to_dict()["ignored"] == ["2 <gazebo><mu1> (contacts)", "1 <mujoco>"]


def test_elements_for_old_releases_of_gazebo_are_left_out_with_a_warning(tmp_path: Path) -> None:
    robot = read(tmp_path, HINGE + FLOATS, ('<robot name="arm"', f'<robot name="arm" {OLD}'))
    (warning,) = robot.warnings
    assert warning.endswith("for Gazebo before 1.0 only: 1 <joint:hinge>, 1 <turnGravityOff>")


def test_a_spring_may_be_written_as_gazebo_reads_it(tmp_path: Path) -> None:
    springs = "<springStiffness>0.5</springStiffness>", '<springStiffness value="0.75"/>'
    robot = read(tmp_path, "", springs)
    assert next(j for j in robot.joints if j.name == "bend").stiffness == 0.75
