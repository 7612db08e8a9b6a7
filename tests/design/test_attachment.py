"""`softdyn attach`: the joined robot against its parts, which Pinocchio appends to each other."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import softdyn
from softdyn import InputError, design
from softdyn.description.robot import Robot
from softdyn.description.stated_task import StatedTask, TaskKind
from softdyn.description.visuals import visuals
from softdyn.loading import load_text
from softdyn.validation import crosscheck
from softdyn.validation.mjcf import export
from tests.support import ROOT, robots
from tests.support.arms import THREE_SECTIONS
from tests.support.command import command
from tests.support.oracles import relative
from tests.support.refused import refused

SOFT_UR5 = ROOT / "docs/examples/soft_ur5.xml"
MASSIVE = robots.inertial(0.3, "0.01 0 0.03", "4e-4 1e-5 0 3e-4 0 2e-4")
PALM = f"""<robot name="palm">
  <material name="skin"><color rgba="1 0.8 0.7 1"/></material>
  <link name="ground"/>
  <link name="palm">{MASSIVE}<visual><geometry><box size="0.08 0.08 0.02"/></geometry>
    <material name="skin"/></visual></link>
  <joint name="wrist" type="revolute"><origin xyz="0 0 0.2" rpy="0.1 0 0"/>
    <parent link="ground"/><child link="palm"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="9" velocity="9"/><dynamics damping="0.1"/></joint>
  <gazebo reference="wrist"><springStiffness>4</springStiffness></gazebo>
  <softdyn version="1"><joint name="wrist" armature="0.002"/>
    <tendon name="drive"><joint name="wrist" coef="0.02"/></tendon>
    <actuator name="motor" tendon="drive" gear="-1" lower="0" upper="50"/>
    <sensor name="angle" type="joint" joint="wrist"/>
  </softdyn></robot>"""
THUMB = f"""<robot name="thumb">
  <material name="skin"><color rgba="1 0.8 0.7 1"/></material>
  <material name="nail"><color rgba="1 1 1 1"/></material>
  <link name="root">{MASSIVE}</link><link name="bone">{MASSIVE}<visual><geometry>
    <sphere radius="0.01"/></geometry><material name="nail"/></visual></link><link name="end"/>
  <joint name="bend" type="revolute"><origin xyz="0.02 0 0"/><parent link="root"/>
    <child link="bone"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="9"/>
    <dynamics damping="0.02"/></joint>
  <joint name="weld" type="fixed"><origin xyz="0.05 0 0"/><parent link="bone"/><child link="end"/>
  </joint>
  <gazebo reference="bend"><springStiffness>0.5</springStiffness></gazebo>
  <transmission name="gearbox"><joint name="bend"/></transmission>
  <softdyn version="1">
    <tendon name="cable"><site link="root" xyz="0 0 0.01"/>
      <cylinder link="bone" xyz="0 0 0" axis="0 1 0" radius="0.004" side="0 0 0.005"/>
      <site link="bone" xyz="0.03 0 0.006"/></tendon>
    <actuator name="pull" tendon="cable" gear="-1" lower="0" upper="20"/>
    <sensor name="flex" type="bend" link="root" to="bone"/>
    <task frame="end"/>
  </softdyn></robot>"""
AT = (0.01, -0.02, 0.03, 0.4, -1.1, 2.5)


@pytest.fixture
def palm(tmp_path: Path) -> Path:
    path = robots.write(tmp_path, PALM, "palm.urdf")
    return path


@pytest.fixture
def thumb(tmp_path: Path) -> Path:
    path = robots.write(tmp_path, THUMB, "thumb.urdf")
    return path


# -- the dynamics of the joined robot --------------------------------------------------------------


def alone(robot: Robot, prefix: str = "") -> pin.Model:
    """Pinocchio's own model of one part, each of its names with a prefix."""
    return pin.buildModelFromXML(re.sub(r'\b(name|link)="', rf'\1="{prefix}', robot.xml))


def appended(base: Robot, arms: list[tuple[Robot, str, str, tuple[float, ...]]]) -> pin.Model:
    """The parts as Pinocchio appends them; it drops armatures, so they are set afterwards."""
    model = alone(base)
    for arm, prefix, link, at in arms:
        place = pin.SE3(pin.rpy.rpyToMatrix(np.array(at[3:])), np.array(at[:3]))
        model = pin.appendModel(model, alone(arm, prefix), model.getFrameId(link), place)
    for robot, prefix in [(base, ""), *((arm, prefix) for arm, prefix, *_ in arms)]:
        for joint in robot.moving_joints:
            k = model.joints[model.getJointId(prefix + joint.name)].idx_v
            model.armature[k] = joint.armature
    return model


def hand(palm: Path, finger: str) -> tuple[softdyn.SoftModel, list]:
    """Five fingers on one palm, attached one after the other."""
    made, arms = palm, []
    arm = softdyn.load(finger).robot
    for k in range(5):
        at = (0.03, 0.016 * (k - 2), 0.01, 0.0, -0.2 * k, 0.1 * (k - 2))
        made = design.attach(arm, made, "palm", at, prefix=f"f{k}_", name="hand")
        arms.append((arm, f"f{k}_", "palm", at))
    assert list(made.meshes) == ["meshes/finger/phalanx.stl"]
    return load_text(made.text, path="hand.urdf"), arms


def joined(which: str, palm: Path, thumb: Path) -> tuple[softdyn.SoftModel, Robot, list]:
    """A joined robot, its base, and its arms with prefix, link and pose."""
    if which == "hand":
        return (found := hand(palm, "finger"))[0], softdyn.parse(palm), found[1]
    if which == "thumb":
        base, arm, link, prefix = softdyn.parse(palm), softdyn.parse(thumb), "palm", ""
    else:
        base = softdyn.load("ur5", annotations=SOFT_UR5).robot
        made = design.read(tomllib.loads(THREE_SECTIONS))
        arm, link, prefix = load_text(made.text, path="arm.urdf").robot, "tool0", "soft_"
    made = design.attach(arm, base, link, AT, prefix=prefix)
    return load_text(made.text, path="both.urdf"), base, [(arm, prefix, link, AT)]


@pytest.mark.parametrize("which", ["soft arm on ur5", "thumb", "hand"])
def test_the_joined_robot_is_the_sum_of_its_parts(which, palm, thumb):
    model, base, arms = joined(which, palm, thumb)
    reference = appended(base, arms)
    data = reference.createData()
    order = [reference.joints[reference.getJointId(n)].idx_v for n in model.joint_names]
    rng = np.random.default_rng(0)
    for _ in range(3):
        q, v = rng.uniform(-0.7, 0.7, model.nv), rng.uniform(-2, 2, model.nv)
        there, speed = np.zeros(model.nv), np.zeros(model.nv)
        there[order], speed[order] = q, v
        state = model.state(q, v)
        pin.computeAllTerms(reference, data, there, speed)
        pin.updateFramePlacements(reference, data)
        frame = reference.getFrameId(model.robot.task)
        J = pin.getFrameJacobian(reference, data, frame, pin.LOCAL_WORLD_ALIGNED)[:3, order]
        M = pin.crba(reference, data, there)
        M = np.triu(M) + np.triu(M, 1).T
        pairs = (
            (state.M, M[np.ix_(order, order)]),
            (state.bias, data.nle[order]),
            (state.g, pin.computeGeneralizedGravity(reference, data, there)[order]),
            (state.J, J),
            (state.y, data.oMf[frame].translation),
        )
        for ours, theirs in pairs:
            assert relative(ours, theirs) < 1e-12


@pytest.mark.parametrize("which", ["soft arm on ur5", "thumb", "hand"])
def test_springs_dampers_inputs_and_lengths_of_each_part_are_unchanged(which, palm, thumb):
    model, base, arms = joined(which, palm, thumb)
    rng = np.random.default_rng(1)
    q, v = rng.uniform(-0.5, 0.5, model.nv), rng.uniform(-1, 1, model.nv)
    state = model.state(q, v)
    seen_rows, seen_inputs = [], []
    lengths = dict(zip((t.name for t in model.robot.tendons), state.lengths, strict=True))
    names = [a.name for a in model.robot.actuators]
    for robot, prefix in [(base, ""), *((arm, prefix) for arm, prefix, *_ in arms)]:
        part = softdyn.build(robot)
        rows = [model.joint_names.index(prefix + name) for name in part.joint_names]
        own = part.state(q[rows], v[rows])
        inputs = [names.index(prefix + actuator.name) for actuator in robot.actuators]
        np.testing.assert_allclose(state.K[rows], own.K, rtol=1e-13)
        np.testing.assert_allclose(state.D[np.ix_(rows, rows)], own.D, rtol=1e-13)
        np.testing.assert_allclose(state.B[np.ix_(rows, inputs)], own.B, rtol=1e-12, atol=1e-15)
        others = [k for k in range(model.nv) if k not in rows]
        assert not state.B[np.ix_(others, inputs)].any()
        assert not state.D[np.ix_(others, rows)].any()
        for tendon, length in zip(robot.tendons, own.lengths, strict=True):
            assert lengths[prefix + tendon.name] == pytest.approx(length, rel=1e-13)
        seen_rows += rows
        seen_inputs += inputs
    assert sorted(seen_rows) == list(range(model.nv))
    assert seen_inputs == list(range(model.nu))  # the base's first, then those of the arms


@pytest.mark.parametrize("which", ["soft arm on ur5", "thumb", "hand"])
def test_both_engines_agree_about_the_joined_robot(which, palm, thumb, tmp_path):
    model, *_ = joined(which, palm, thumb)
    assert crosscheck(model, samples=1, trajectories=False).passed
    path = robots.write(tmp_path, model.robot.text, "both.urdf")
    compared, _ = export.write_mjcf(path, tmp_path / "both.xml", shapes=False)
    assert compared.passed


# -- names -----------------------------------------------------------------------------------------


def test_a_name_of_both_robots_is_refused_with_the_prefix_that_helps(palm):
    other = replace(softdyn.parse(palm), name="other palm")
    with pytest.raises(InputError) as refused:
        design.attach(other, palm, "palm")
    assert refused.value.name == "prefix"
    for name in ("links 'ground', 'palm'", "joints 'wrist'", "tendons 'drive'", "sensors 'angle'"):
        assert name in refused.value.got
    (proposed,) = re.findall(r"'(.*)'", refused.value.expected)
    made = design.attach(other, palm, "palm", prefix=proposed)
    robot = load_text(made.text, path="both.urdf").robot
    assert {"wrist", "other_palm_wrist"} <= {joint.name for joint in robot.joints}


def test_a_material_of_two_colours_is_a_collision_and_one_of_one_colour_is_shared(palm, thumb):
    made = design.attach(thumb, palm, "palm", prefix="t_")
    others = softdyn.description.urdf.parse_text(made.text, path=palm).others
    assert [re.findall(r'name="(\w+)"', one)[0] for one in others] == [
        "skin", "t_nail", "t_gearbox",
    ]  # fmt: skip
    assert '<joint name="t_bend"' in others[2]
    thumb.write_text(THUMB.replace("1 0.8 0.7 1", "0 0 1 1"))
    with refused("prefix", "'': both have materials 'skin'"):
        design.attach(thumb, palm, "palm")


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ({"link": "plam"}, "link"),
        ({"prefix": "a b"}, "prefix"),
        ({"prefix": None}, "prefix"),
        ({"at": (0, 0, 0)}, "at"),
        ({"at": (0, 0, 0, 0, 0, np.nan)}, "at"),
        ({"arm": 3}, "arm"),
        ({"base": "no_such_robot"}, "robot"),
    ],
)
def test_bad_arguments_are_refused_by_name(palm, thumb, words, name):
    with pytest.raises(InputError) as refused:
        design.attach(**{"arm": thumb, "base": palm, "link": "palm"} | words)
    assert refused.value.name == name


def test_two_robots_of_too_many_joints_are_refused(tmp_path):
    links = [robots.tag("link", MASSIVE, name=f"l{k}") for k in range(131)]
    joints = [robots.joint(f"j{k}", f"l{k}", f"l{k + 1}", None, "continuous") for k in range(130)]
    path = robots.write(tmp_path, robots.robot("chain", *links, *joints))
    with refused("<robot>", 260, by=softdyn.UrdfError):
        design.attach(path, path, "l130", prefix="x_")


# -- tasks -----------------------------------------------------------------------------------------


def tasks(base: Robot | Path, arm: Robot | Path, link: str) -> tuple[str, list[str]]:
    made = design.attach(arm, base, link, prefix="x_")
    robot = load_text(made.text, path="both.urdf").robot
    return robot.task, [task.name for task in robot.tasks]


def test_the_tip_is_the_arms_and_a_tip_beside_it_stays(palm, thumb):
    one = load_text(design.attach(thumb, palm, "palm").text, path="one.urdf").robot
    assert (one.task, one.tasks) == ("end", ())  # the palm's own tip carries the arm
    assert tasks(one, thumb, "palm") == ("end", ["end", "x_end"])  # beside the first thumb
    assert tasks(one, thumb, "end") == ("x_end", [])  # on its end


def test_stated_tasks_of_a_link_that_carries_the_arm_follow_the_arms(palm, thumb):
    up = StatedTask("palm", "up", TaskKind.AXIS, direction=(0.0, 0.0, 1.0))
    base = replace(softdyn.parse(palm), tasks=(StatedTask("palm", "middle"), up))
    assert tasks(base, thumb, "palm") == ("x_end", ["x_end", "middle", "up"])


def test_a_base_without_annotations_states_no_task(thumb):
    assert tasks(softdyn.load("ur5").robot, thumb, "base_link") == ("x_end", [])


# -- meshes and the command ------------------------------------------------------------------------


def test_meshes_are_found_from_the_new_place(tmp_path):
    (tmp_path / "new").mkdir()
    words = ("--to", "ur5", "tool0", "--prefix", "index_", "--out", tmp_path / "new/both.urdf")
    done = command("attach", "finger", *words, "--json", tmp_path / "report.json")
    assert done.code == 0, done.err
    shapes, problems = visuals(softdyn.parse(tmp_path / "new/both.urdf"))
    assert problems == ()
    parts = [visuals(softdyn.load(name).robot)[0] for name in ("ur5", "finger")]
    assert len(shapes) == sum(map(len, parts))
    for ours, theirs in zip(shapes, (*parts[0], *parts[1]), strict=True):
        assert ours.link.removeprefix("index_") == theirs.link
        assert ours.rgba == theirs.rgba
    report = json.loads((tmp_path / "report.json").read_text())
    assert (report["name"], report["degrees_of_freedom"], report["inputs"]) == ("both", 10, 2)


def test_a_mesh_below_the_new_files_folder_is_named_and_not_copied(palm, tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts/bone.stl").write_bytes((ROOT / "urdf/meshes/phalanx.stl").read_bytes())
    mesh = '<mesh filename="bone.stl"/>'
    arm = tmp_path / "parts/thumb.urdf"
    arm.write_text(THUMB.replace('<sphere radius="0.01"/>', mesh))
    done = command("attach", arm, "--to", palm, "palm", "--out", tmp_path / "both.urdf")
    assert done.code == 0, done.err
    assert not (tmp_path / "meshes").exists()
    assert visuals(softdyn.parse(tmp_path / "both.urdf"))[1] == ()
    made = design.attach(arm, palm, "palm")
    assert list(made.meshes) == ["meshes/thumb/bone.stl"]
    (tmp_path / "parts/bone.stl").unlink()
    with pytest.warns(UserWarning, match="bone.stl"):
        design.attach(arm, palm, "palm")


def test_a_table_and_its_mesh_can_be_attached(palm, tmp_path):
    table = tmp_path / "spiral.toml"
    table.write_text(
        'name = "spiral"\n[log_spiral]\nlength_mm = 300\nsegments = 4\nratio = 0.82\n'
        "radius_mm = 20\nmass_g = 120\njoint_stiffness_Nm_rad = 0.05\n"
        "joint_damping_Nms_rad = 0.005\nmax_tension_N = 20\n"
    )
    out = tmp_path / "both.urdf"
    done = command("attach", table, "--to", palm, "palm", "--out", out)
    assert done.code == 0, done.err
    mesh = tmp_path / "meshes/spiral.stl"
    assert mesh.is_file()
    assert visuals(softdyn.parse(out))[1] == ()
    out.unlink()
    mesh.write_bytes(b"another")
    done = command("attach", table, "--to", palm, "palm", "--out", out)
    assert (done.code, out.exists(), mesh.read_bytes()) == (2, False, b"another")


def test_nothing_is_written_for_bad_input(palm, thumb, tmp_path):
    before = sorted(tmp_path.iterdir())
    for words in (("--to", palm, "no"), ("--to", palm, "palm", "--at", 0, 0, 0, 0, 0, "nan")):
        done = command("attach", thumb, *words, "--out", tmp_path / "both.urdf")
        assert (done.code, done.out, done.err.count("\n")) == (2, "", 1)
    done = command("attach", thumb, "--to", palm, "palm", "--out", palm)
    assert done.code == 2
    assert sorted(tmp_path.iterdir()) == before


def test_both_robots_take_annotations_from_files(palm, tmp_path):
    words = ("--annotations", SOFT_UR5, "--arm-annotations", SOFT_UR5, "--prefix", "up_")
    done = command("attach", "ur5", "--to", "ur5", "tool0", *words, "--out", tmp_path / "both.urdf")
    assert done.code == 0, done.err
    robot = softdyn.parse(tmp_path / "both.urdf")
    names = ["pan_motor", "lift_motor", "elbow_motor"]
    assert [a.name for a in robot.actuators] == [*names, *("up_" + name for name in names)]
