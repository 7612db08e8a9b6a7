"""Effects of tendons, springs and dampers on B, on the tip at rest and on q̈, in closed form."""

import numpy as np
import pytest
from scipy.optimize import brentq

import softdyn
from softdyn import statics
from softdyn.validation import compare
from softdyn.validation.mjcf.comparison.dynamics import random_states
from softdyn.validation.mjcf.comparison.resting import resting_points, tip_points
from softdyn.validation.mjcf.comparison.side import Side

MASS, LENGTH, ARM, STIFFNESS, DAMPING, PULL = 0.2, 0.1, 0.02, 0.3, 0.01, 40.0
WEIGHT = MASS * 9.81 * LENGTH
ROBOT = f"""<robot name="lever">
  <link name="base"/>
  <link name="lever"><inertial><origin xyz="{LENGTH} 0 0"/><mass value="{MASS}"/>
    <inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><parent link="base"/><child link="lever"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="9" velocity="9"/>
    <dynamics damping="{DAMPING}"/></joint>
  <gazebo reference="hinge"><springStiffness>{STIFFNESS}</springStiffness></gazebo>
  <link name="tip"/>
  <joint name="end" type="fixed"><parent link="lever"/><child link="tip"/>
    <origin xyz="{LENGTH} 0 0"/></joint>
  <softdyn version="1">
    <tendon name="cable" stiffness="{PULL}">
      <joint name="hinge" coef="{ARM}"/></tendon>
    <actuator name="motor" tendon="cable" gear="2" lower="0" upper="5"/>
    <task frame="tip"/>
  </softdyn>
</robot>
"""


def effects(tmp_path, old, new):
    """The first cause of two levers, one of which has `new` for `old`, and their states."""
    files = []
    for name, text in (("a", ROBOT), ("b", ROBOT.replace(old, new))):
        files.append(tmp_path / f"{name}.urdf")
        files[-1].write_text(text)
    found = compare(*files)
    # a URDF's effort, the only other cause, follows from the gear and the arm
    assert {cause.kind for cause in found.causes[1:]} <= {"effort"}
    return found.causes[0].effect, random_states(Side.of(files[0]).neutral, 8, 0), str(found)


def rest(stiffness):
    """The tip (x, z) where the moment of the weight is that of the springs."""
    q = brentq(lambda q: stiffness * q - WEIGHT * np.cos(q), -3, 3, xtol=1e-14)
    return LENGTH * np.array([np.cos(q), -np.sin(q)])


def test_a_spring_moves_the_tip_at_rest(tmp_path):
    held = STIFFNESS + PULL * ARM**2
    for old, new, change in (
        (f"<springStiffness>{STIFFNESS}", "<springStiffness>0.36", 0.06),
        (f'stiffness="{PULL}"', 'stiffness="90"', 50 * ARM**2),
    ):
        found, states, _ = effects(tmp_path, old, new)
        moved = np.linalg.norm(rest(held) - rest(held + change)) / LENGTH
        assert found["rest"] == pytest.approx(moved, rel=1e-6)
        q = states.q[0][:, 0]
        fall = np.abs(WEIGHT * np.cos(q)).max()
        assert found["forces"] == pytest.approx(np.abs(change * q).max() / fall, rel=1e-9)
        assert found["B"] == 0


def test_a_damper_has_a_force_and_no_rest(tmp_path):
    found, states, text = effects(tmp_path, f'damping="{DAMPING}"', 'damping="0.015"')
    fall = np.abs(WEIGHT * np.cos(states.q[0][:, 0])).max()
    assert found["forces"] == pytest.approx(0.005 * np.abs(states.v).max() / fall, rel=1e-9)
    assert (found["rest"], found["B"]) == (0, 0)
    (titles,) = [line.split() for line in text.splitlines() if line.split()[:2] == ["M", "g"]]
    assert titles[:5] == ["M", "g", "tip", "forces", "kind"]


def test_a_lever_arm_and_a_gear_change_the_actuation(tmp_path):
    found, _, _ = effects(tmp_path, f'coef="{ARM}"', 'coef="0.025"')
    assert found["B"] == pytest.approx(0.25, rel=1e-9)
    moved = np.linalg.norm(rest(STIFFNESS + PULL * ARM**2) - rest(STIFFNESS + PULL * 0.025**2))
    assert found["rest"] == pytest.approx(moved / LENGTH, rel=1e-6)
    found, _, _ = effects(tmp_path, 'gear="2"', 'gear="3"')
    assert found["B"] == pytest.approx(0.5, rel=1e-9)
    assert found["rest"] == 0


@pytest.mark.parametrize("robot", ["finger", "spirob"])
def test_the_rest_is_that_of_the_model(robot):
    """The rest by MuJoCo's terms is that by Pinocchio's, in `statics`."""
    neutral = Side.of(robot).neutral
    found = resting_points(neutral, tip_points(neutral))
    right = statics.rest(softdyn.load(robot)).y
    assert np.linalg.norm(found - right, axis=1).min() < 1e-8
