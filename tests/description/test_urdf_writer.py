"""`write` is the inverse of `parse`: what is written is read back as an equal robot.

Robots are compared by `==` of their dataclasses, exact to the last bit (-0 equals 0).
`NOT_COMPARED` lists the exceptions: the robot's path, the texts of its files, a user's own forces.
"""

from __future__ import annotations

import tomllib
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lxml import etree

import softdyn
from softdyn import design
from softdyn.description.library import find
from softdyn.description.robot import Joint, Link, Mimic, Origin, Robot, Site, Tendon
from softdyn.description.urdf import parse, parse_text
from softdyn.description.urdf_writer import write
from softdyn.description.visuals import visuals
from softdyn.design import finger, log_spiral
from softdyn.validation import crosscheck
from tests.support import ROOT, robots
from tests.support.arms import EVERYTHING, THREE_SECTIONS
from tests.support.long_chains import chain_urdf
from tests.support.misuses import ARM
from tests.support.random_robots import random_urdf

NOT_COMPARED = {
    "adopted",
    "root_folder",
    "forces",
    "ignored",
    "comment",
    "path",
    "overlay",
    "xml",
    "text",
    "annotations",
    "mended",
    "warnings",
}
QUANTITIES = ("M", "bias", "K", "D", "B", "y", "J", "lengths")
LOOKS = """\
<robot name="looks">
  <material name="red"><color rgba="1 0 0 1"/></material>
  <material name="cloth"><texture filename="cloth.png"/></material>
  <link name="base">
    <!-- a comment -->
    <visual name="a &amp; b"><geometry><box size="1 2 3"/></geometry><material name="red"/></visual>
    <collision><origin xyz="0 0 1"/><geometry><sphere radius="0.5"/></geometry></collision>
    <visual>
      <origin xyz="0.1 0 0" rpy="0 0 0.5"/>
      <geometry><cylinder radius="0.1" length="0.4"/></geometry><!-- inside -->
    </visual>
  </link>
  <link name="arm"><visual><geometry><sphere radius="0.2"/></geometry></visual>
    <inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
  </link>
  <joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/>
    <limit lower="-1" upper="1" effort="3" velocity="4"/></joint>
  <transmission name="t"><joint name="hinge"><x:y xmlns:x="z"/></joint></transmission>
  <gazebo reference="hinge">
    <springStiffness>2</springStiffness>
    <plugin><springReference>7</springReference></plugin>
    <springReference>0.5</springReference>
  </gazebo>
  <gazebo><static>false</static></gazebo>
  <gazebo reference="arm"/>
</robot>
"""


def again(robot: Robot) -> Robot:
    """Write a robot and read it again, as if from the same file."""
    return parse_text(write(robot), path=robot.path, floating=robot.floating)


WRAPPED = """\
<robot name="wrapped"><link name="base"/>
  <link name="arm"><inertial><mass value="1"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="hinge" type="continuous"><parent link="base"/><child link="arm"/></joint>
  <softdyn version="1"><tendon name="cable" friction="0.1" driven="last">
    <site link="base" xyz="-1 0 0.3"/>
    <cylinder link="arm" xyz="0 0 0" axis="0 2 1" radius="0.25" side="0 0 1" friction="0"/>
    <site link="arm" xyz="0.5 0 0.4"/><site link="arm" xyz="1 0 0"/>
    <sphere link="base" xyz="1.5 0 0.1" radius="0.2"/><site link="base" xyz="2 0 0"/>
  </tendon></softdyn>
</robot>
"""


def test_cables_around_round_bodies_are_written() -> None:
    robot = of_text(WRAPPED)
    cylinder, sphere = robot.tendons[0].wraps
    assert (cylinder.after, sphere.after, sphere.axis, cylinder.friction) == (0, 2, None, 0.0)
    assert again(robot) == robot
    other = replace(robot.tendons[0], wraps=(cylinder,))
    assert replace(robot, tendons=(other,)).digest != robot.digest


def of_text(text: str, **options: Any) -> Robot:
    return parse_text(text, path=Path("robot.urdf"), **options)


def test_what_makes_robots_equal() -> None:
    assert {field.name for field in fields(Robot) if not field.compare} == NOT_COMPARED
    for part in (Link, Origin, Joint, Mimic, Tendon, Site):
        assert all(field.compare for field in fields(part)), part


@pytest.mark.parametrize("name", softdyn.bundled_names())
def test_bundled_files_are_what_the_writer_writes(name: str) -> None:
    text = find(name).read_text(encoding="utf-8")
    robot = parse(find(name))
    assert write(robot) == text
    assert again(robot) == robot


@pytest.mark.parametrize(
    "text",
    [
        design.urdf(EVERYTHING),
        design.read(tomllib.loads(THREE_SECTIONS)).text,
        log_spiral.urdf(design.LogSpiral(0.3, 0.12, 4, 0.82, 0.02, 0.05, 0.005, 0.0005)),
        finger.urdf(
            design.Finger(
                (0.045, 0.03), (0.009, 0.007), 1100.0, 0.05, 0.002,
                (design.FingerTendon((1, 2), (0.007, 0.006), 20.0, pair=True),),
            )
        ),
        chain_urdf(5),
    ],
    ids=("everything", "arm", "log_spiral", "finger", "chain"),
)  # fmt: skip
def test_designed_files_are_what_the_writer_writes(text: str) -> None:
    robot = of_text(text)
    assert write(robot) == text
    assert again(robot) == robot


@pytest.mark.parametrize("text", [ARM, robots.GRIPPER, robots.WALKER, LOOKS])
@pytest.mark.parametrize("floating", [False, True])
def test_every_feature(text: str, floating: bool) -> None:
    """Welds, mimic joints, elastic tendons, aliases of springs, foreign elements, visuals."""
    robot = of_text(text, floating=floating)
    assert robot.floating == floating
    assert again(robot) == robot


@pytest.mark.parametrize("seed", range(200))
def test_random_robots(seed: int) -> None:
    robot = of_text(random_urdf(seed), floating=seed % 5 == 0)
    written = again(robot)
    assert written == robot
    assert write(written) == write(robot)


@pytest.mark.parametrize("seed", range(6))
def test_engines_see_no_difference(seed: int) -> None:
    """Pinocchio's quantities are equal bit by bit; MuJoCo's within the engines' agreement."""
    robot = of_text(random_urdf(seed))
    one, other = softdyn.build(robot), softdyn.build(again(robot))
    rng = np.random.default_rng(seed)
    state = one.configuration(rng.uniform(-1, 1, one.nv)), rng.normal(size=one.nv)
    for name in QUANTITIES:
        a, b = (getattr(model.state(*state), name) for model in (one, other))
        np.testing.assert_array_equal(a, b, name)


def test_what_is_written_passes_the_cross_check(tmp_path: Path) -> None:
    path = robots.write(tmp_path, write(of_text(robots.GRIPPER)))
    assert crosscheck(softdyn.load(path), samples=2, trajectories=False).passed


@pytest.mark.parametrize("example", ["soft_ur5", "soft_panda", "soft_allegro"])
def test_an_overlay_ends_up_in_the_file(example: str) -> None:
    name = {"soft_ur5": "ur5", "soft_panda": "panda", "soft_allegro": "allegro_right_hand"}[example]
    robot = parse(find(name), annotations=ROOT / "docs" / "examples" / f"{example}.xml")
    assert robot.overlay is not None
    written = again(robot)
    assert written == robot
    assert written.overlay is None
    assert written.annotations == ""


def test_repaired_inertias_are_written(tmp_path: Path) -> None:
    path = robots.write(tmp_path, ARM.replace('izz="1e-6"', 'izz="3e-6"'))
    robot = parse(path, repair_inertia=True)
    assert again(robot) == robot
    path.write_text(ARM.replace('iyy="1e-6"', 'iyy="5e-3"').replace('ixx="1e-6"', 'ixx="1e-3"'))
    robot = parse(path, repair_inertia=True)
    assert robot.mended
    assert again(robot) == robot


def test_looks_are_spelled_as_they_were() -> None:
    robot = of_text(LOOKS)
    base, arm = robot.links
    assert len(base.looks) == 3
    assert base.looks[2].count("\n") == 3
    assert "<!-- inside -->" in base.looks[2]
    assert len(arm.looks) == 1
    before, after = visuals(robot)[0], visuals(again(robot))[0]
    assert [v.shape for v in after] == [v.shape for v in before]
    for one, other in zip(before, after, strict=True):
        np.testing.assert_array_equal(one.pose, other.pose)
        assert (one.link, one.rgba) == (other.link, other.rgba)
    assert len(before) == 3


def test_what_other_tools_read_stays() -> None:
    """All of it except springs, which belong to the robot, and empty elements."""
    robot = of_text(LOOKS)
    written = again(robot)
    assert written.others == robot.others
    kept = [etree.fromstring(text) for text in written.others]
    assert [node.tag for node in kept] == ["material"] * 2 + ["transmission"] + ["gazebo"] * 2
    assert [child.tag for child in kept[3]] == ["plugin"]
    assert (written.joints[0].stiffness, written.joints[0].rest) == (2.0, 0.5)


def test_names_may_hold_what_xml_must_escape() -> None:
    odd = "a \"b\" 'c' <d> & e\n\tf é –"
    robot = of_text(ARM)
    links = tuple(replace(link, name=odd) if link.name == "pad" else link for link in robot.links)
    joints = tuple(
        replace(
            joint,
            parent=odd if joint.parent == "pad" else joint.parent,
            child=odd if joint.child == "pad" else joint.child,
            name=f"{odd}{joint.name}",
        )
        for joint in robot.joints
    )
    tendons = tuple(
        replace(
            tendon,
            terms=tuple(replace(t, joint=f"{odd}{t.joint}") for t in tendon.terms),
            sites=tuple(replace(s, link=odd) if s.link == "pad" else s for s in tendon.sites),
        )
        for tendon in robot.tendons
    )
    robot = replace(robot, name=odd, links=links, joints=joints, tendons=tendons)
    assert again(robot) == robot


@pytest.mark.parametrize("comment", ["-", "--", "---", "a -- b-", "\n <x> & y\n", "- - -"])
def test_any_comment(comment: str) -> None:
    robot = replace(of_text(ARM), comment=comment)
    written = again(robot)
    assert written == robot
    assert written.comment.replace(" ", "") == comment.replace(" ", "")
    assert again(written).comment == written.comment


NUMBERS = (5e-324, 1e-300, 1e-12, 0.1 + 0.2, 1 / 3, 123456789.123456789, 1e22, 1e50)


def changes(robot: Robot, x: float) -> dict[str, Robot]:
    """The robot with one number or word changed, by where that is."""
    joint, link, tendon, actuator = (
        robot.joints[2], robot.links[4], robot.tendons[0], robot.actuators[0]
    )  # fmt: skip
    cable = robot.tendons[1]
    y = min(x, 1e3)  # no axis, body or multiplier is as large as other numbers may be

    def within(name: str, old: Any, **change: Any) -> Robot:
        parts = tuple(replace(old, **change) if p is old else p for p in getattr(robot, name))
        return replace(robot, **{name: parts})  # type: ignore[arg-type]

    fields_of_joint = {
        "lower": -x, "upper": x, "effort": x, "velocity": x, "stiffness": x, "rest": -x,
        "damping": x, "armature": x, "friction": x, "origin": Origin((x, -x, 0.0)),
        "direction": (1.0, y, -y), "mimic": Mimic("bend", y, -y),
    }  # fmt: skip
    sites = (cable.sites[0], replace(cable.sites[1], xyz=(x, -x, 0.0)), cable.sites[2])
    found = {name: within("joints", joint, **{name: new}) for name, new in fields_of_joint.items()}
    found["rpy"] = within("joints", joint, origin=Origin(rpy=(0.0, x, -x)))
    found["a weld"] = within("joints", robot.joints[3], origin=Origin((0.0, 0.0, x)))
    found["com"] = within("links", link, origin=Origin((y, y, 0.0)))
    found["axes"] = within("links", link, origin=Origin(rpy=(y, y, y)))
    found["mass"] = within("links", link, mass=y)
    found["tendon's spring"] = within("tendons", tendon, stiffness=x)
    found["tendon's damper"] = within("tendons", tendon, damping=x)
    found["tendon's rest"] = within("tendons", tendon, rest=-x)
    found["term"] = within("tendons", tendon, terms=(replace(tendon.terms[0], coef=x),))
    found["site"] = within("tendons", cable, sites=sites)
    found["gear"] = within("actuators", actuator, gear=-x)
    found["bounds"] = within("actuators", actuator, lower=-x, upper=x)
    return found


@pytest.mark.parametrize("x", NUMBERS)
def test_every_number_counts_and_keeps_its_digits(x: float) -> None:
    robot = of_text(ARM)
    for where, changed in changes(robot, x).items():
        assert changed != robot, where
        assert again(changed) == changed, where


def test_every_word_counts() -> None:
    robot = of_text(ARM)
    *links, last = robot.links
    (first, *_), (tendon, *tendons) = robot.joints, robot.tendons
    for changed in (
        replace(robot, name="leg"),
        replace(robot, task="pad"),
        replace(robot, links=(last, *links)),
        replace(robot, joints=(*robot.joints[1:], first)),
        replace(robot, tendons=(*tendons, tendon)),
        replace(robot, actuators=robot.actuators[::-1]),
        replace(robot, actuators=robot.actuators[1:]),
        replace(robot, others=('<material name="red"/>',)),
        replace(robot, floating=True),
        replace(robot, links=(replace(links[0], looks=("<visual/>",)), *links[1:], last)),
        replace(robot, joints=(replace(first, name="weld"), *robot.joints[1:])),
    ):
        assert changed != robot
        assert again(changed) == changed
