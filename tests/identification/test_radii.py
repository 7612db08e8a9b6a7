"""Radii of pulleys, identified from the motion of MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest

import softdyn
from softdyn import identification
from softdyn.identification.parameters import apply_values
from softdyn.loading import load_text
from softdyn.validation.identification.trials import Excitation, trial

# a lever on a hinge, raised by a cable over a pulley, and stretched by one below a pin
LEVER = """\
<robot name="lever"><link name="base"/>
  <link name="arm"><inertial><origin xyz="0.05 0 0"/><mass value="0.1"/>
    <inertia ixx="1e-5" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tip"/>
  <joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <dynamics damping="0.01"/><limit lower="-1" upper="1" effort="9" velocity="9"/></joint>
  <joint name="end" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0.1 0 0"/>
  </joint>
  <gazebo reference="hinge"><springStiffness>0.2</springStiffness></gazebo>
  <softdyn version="1">
    <tendon name="over"><site link="base" xyz="-0.06 0 0"/>
      <cylinder link="base" xyz="0 0 0" axis="0 1 0" radius="0.01" side="0 0 0.012"/>
      <site link="arm" xyz="0.06 0 0"/></tendon>
    <tendon name="below" stiffness="300"><site link="base" xyz="-0.06 0 0"/>
      <cylinder link="base" xyz="0 0 0" axis="0 1 0" radius="0.008" side="0 0 -0.02"/>
      <site link="arm" xyz="0.06 0 0"/></tendon>
    <actuator name="pull" tendon="over" gear="-1" lower="0" upper="20"/>
  </softdyn>
</robot>"""


@pytest.fixture(scope="module")
def lever(tmp_path_factory) -> softdyn.SoftModel:
    path = tmp_path_factory.mktemp("lever") / "lever.urdf"
    path.write_text(LEVER)
    return softdyn.load(path)


def test_a_pulley_s_radius_is_found_within_its_interval(lever):
    several = identification.parameters(lever, "wrap_radius")
    assert [one.label for one in several] == ["wrap_radius over.1", "wrap_radius below.1"]
    outputs = ["q.hinge", "length.over"]
    one = trial(lever, several, outputs, Excitation(0.25, timestep=5e-4), 1.0, 2)
    assert np.abs(one.scores).max() < 3
    assert np.abs(one.relative).max() < 0.02


def test_a_side_point_stays_on_its_side_and_the_file_is_written(lever):
    """A radius beyond the stated side point leaves the cable outside."""
    several = identification.parameters(lever, "wrap_radius")
    model = apply_values(lever, several, np.array([0.02, 0.004]))
    over, below = (tendon.wraps[0] for tendon in model.robot.tendons)
    assert (over.radius, below.radius) == (0.02, 0.004)
    assert not over.inside
    assert not below.inside
    text = identification.rewrite_urdf(
        lever.robot, {"wrap_radius": {"over.1": 0.02, "below.1": 0.004}}
    )
    again = load_text(text, path=lever.robot.path)
    q = np.array([-0.2])
    np.testing.assert_allclose(again.tendon_moment_arms(q), model.tendon_moment_arms(q))
    np.testing.assert_allclose(np.abs(again.tendon_moment_arms(q)[:, 0]), [0.02, 0.004], rtol=1e-9)
