"""URDF 1.1 and 1.2: quaternions, capsules, further limits, in all readers alike."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import softdyn
from softdyn import UrdfError
from softdyn.description.origins import read_origin
from softdyn.description.robot import Robot
from softdyn.description.strict_xml import read_bytes
from softdyn.description.urdf import parse
from softdyn.description.urdf_writer import write
from softdyn.description.visuals import CylinderShape, SphereShape, triangles, visuals
from softdyn.loading import load_text
from softdyn.validation import Twin, crosscheck
from softdyn.validation.mjcf.to_mjcf import to_mjcf
from tests.support.refused import refused

TURN = Rotation.from_rotvec([np.pi / 6, 0, 0])
QUATERNION = 'quat_xyzw="0.25881904510252074 0 0 0.9659258262890683"'
CAPSULE = '<geometry><capsule radius="0.02" length="0.2"/></geometry>'
LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'


def pendulum(folder: Path, version: str, origin: str, shape: str = "", limit: str = LIMIT) -> Path:
    """A body on a hinge about y; its inertia is turned by 30° about x."""
    path = folder / "pendulum.urdf"
    path.write_text(f"""\
<robot name="pendulum"{version}>
  <link name="base"/>
  <link name="a">{shape}
    <inertial><origin xyz="0 0 -0.1" {origin}/><mass value="0.6"/>
      <inertia ixx="0.003" ixy="0" ixz="0" iyy="0.0025" iyz="0" izz="0.0006"/></inertial>
  </link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/>
    {limit}</joint>
</robot>
""")
    return path


@pytest.mark.parametrize(
    ("version", "origin", "shape"),
    [
        ("", 'rpy="0.5235987755982988 0 0"', ""),
        (' version="1.1"', QUATERNION, ""),
        (' version="1.2"', QUATERNION, f"<visual>{CAPSULE}</visual>"),
        ("", 'rpy="0.5235987755982988 0 0"', f"<collision>{CAPSULE}</collision>"),
    ],
)  # fmt: skip
def test_all_readers_agree(version: str, origin: str, shape: str, tmp_path: Path) -> None:
    """M = 0.0025 cos² 30° + 0.0006 sin² 30° + 0.6 · 0.1²."""
    path = pendulum(tmp_path, version, origin, shape)
    model = softdyn.load(path)
    assert model.state([0.0], [0.0]).M[0, 0] == pytest.approx(0.008025, rel=1e-12)
    assert crosscheck(model, samples=3).passed
    exported = mujoco.MjModel.from_xml_string(to_mjcf(model.robot))
    M = np.empty((1, 1))
    data = mujoco.MjData(exported)
    mujoco.mj_forward(exported, data)
    mujoco.mj_fullM(exported, data, M)
    assert M[0, 0] == pytest.approx(0.008025, rel=1e-12)
    written = tmp_path / "written.urdf"
    written.write_text(write(model.robot))
    assert parse(written) == model.robot


@settings(max_examples=50, deadline=None, derandomize=True)
@given(
    numbers=st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda x: np.linalg.norm(x) > 0.1),
    pitch=st.sampled_from([None, np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9]),
    yaw=st.floats(-3, 3),
)
def test_angles_are_exact_to_rounding(numbers, pitch, yaw) -> None:
    turn = Rotation.from_quat(numbers)
    if pitch is not None:  # roll and yaw turn about one axis
        turn = Rotation.from_euler("xyz", [numbers[0], pitch, yaw])
    text = " ".join(map(repr, turn.as_quat().tolist()))
    file = f'<robot version="1.1"><joint><origin quat_xyzw="{text}"/></joint></robot>'
    (joint,) = read_bytes(Path("r.urdf"), file.encode()).children("joint")
    np.testing.assert_allclose(read_origin(joint).rotation, turn.as_matrix(), atol=2e-15)


def moved(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    (joint,) = robot.joints
    return joint.origin.rotation, joint.origin.translation


def test_a_joint_and_its_shapes_turn_in_all_readers(tmp_path: Path) -> None:
    shape = f'<visual><origin xyz="0.1 0 0" {QUATERNION}/>{CAPSULE}</visual>'
    shape += f'<collision><origin xyz="0.2 0 0" {QUATERNION}/>{CAPSULE}</collision>'
    path = pendulum(tmp_path, ' version="1.1"', 'rpy="0 0 0"', shape)
    axis = '<axis xyz="0 1 0"/>'
    text = path.read_text().replace(axis, f'{axis}<origin xyz="0 0 1" {QUATERNION}/>')
    path.write_text(text)
    model = softdyn.load(path)
    rotation, translation = moved(model.robot)
    np.testing.assert_allclose(rotation, TURN.as_matrix(), atol=1e-15)
    assert translation.tolist() == [0, 0, 1]
    assert crosscheck(model, samples=3).passed
    (rod, low, high), problems = visuals(model.robot)
    assert problems == ()
    assert (rod.shape, low.shape) == (CylinderShape(0.02, 0.2), SphereShape(0.02))
    ends = np.add(TURN.apply([[0, 0, -0.1], [0, 0, 0.1]]), (0.1, 0, 0))
    np.testing.assert_allclose([low.pose[:3, 3], high.pose[:3, 3]], ends, atol=1e-15)
    corners = np.concatenate([triangles(part).reshape(-1, 3) for part in (rod, low, high)])
    far = np.abs((corners - [0.1, 0, 0]) @ TURN.as_matrix()).max(axis=0)
    np.testing.assert_allclose(far, [0.02, 0.02, 0.12], rtol=0.02)
    twin = Twin(model, contacts=True)
    assert twin.model.geom_pos.tolist() == [[0.2, 0.0, 0.0]]
    np.testing.assert_allclose(twin.model.geom_quat[0], TURN.as_quat()[[3, 0, 1, 2]], atol=1e-15)
    written = tmp_path / "written.urdf"
    written.write_text(write(model.robot))
    assert "quat_xyzw" not in written.read_text()
    assert parse(written) == model.robot
    assert [part.pose.tolist() for part in visuals(parse(written))[0]] == [
        part.pose.tolist() for part in visuals(model.robot)[0]
    ]


def test_a_log_reads_a_robot_s_text_again(tmp_path: Path) -> None:
    model = softdyn.load(pendulum(tmp_path, ' version="1.1"', QUATERNION))
    again = load_text(model.robot.text, path=tmp_path / "elsewhere.urdf")
    assert again.robot.digest == model.robot.digest
    assert Twin(again).model.body_inertia.tolist() == Twin(model).model.body_inertia.tolist()


def test_limits_of_urdf_1_2(tmp_path: Path) -> None:
    limit = '<limit lower="-1" upper="1" acceleration="9" deceleration="8" jerk="7"/>'
    path = pendulum(tmp_path, ' version="1.2"', 'rpy="0 0 0"', limit=limit)
    model = softdyn.load(path)
    (joint,) = model.robot.joints
    assert (joint.lower, joint.upper, joint.effort, joint.velocity) == (-1, 1, np.inf, np.inf)
    assert model.robot.ignored == ()
    assert crosscheck(model, samples=2).passed
    path.write_text(write(model.robot))
    assert parse(path) == model.robot
    with refused('<joint name="turn"><limit>', "none", by=UrdfError):
        parse(pendulum(tmp_path, "", 'rpy="0 0 0"', limit=limit))
    stated = limit.replace('upper="1"', 'upper="1" effort="1" velocity="1"')
    parse(pendulum(tmp_path, "", 'rpy="0 0 0"', limit=stated))
