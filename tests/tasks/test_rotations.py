"""Errors of angles, at any angle, against SciPy's exponentials and Pinocchio's Jacobian of log₆."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import softdyn
from softdyn.tasks import AxisTask, LinkKinematics, OrientationTask, PoseTask, Target
from tests.support.oracles import relative

FINGER = softdyn.load("finger")
STATE = FINGER.state([0.3, -0.2, 0.1, 0.4], [1.0, -2.0, 0.5, 3.0])
AT = LinkKinematics.of(FINGER)(STATE, "tip")
POINT = np.array([0.01, 0.02, -0.03])

near = st.floats(-14, 0).map(lambda x: 10**x)
angles = (
    near | near.map(lambda x: math.pi - x) | st.floats(0, math.pi) | st.sampled_from([0, 1e-16])
)
part = st.floats(-1, 1)
vectors = st.tuples(part, part, part).map(np.array)
units = vectors.filter(lambda v: v @ v > 1e-3).map(lambda v: v / math.sqrt(v @ v))
anywhere = settings(max_examples=100, deadline=None, derandomize=True)


def turned(turn: np.ndarray) -> np.ndarray:
    return Rotation.from_rotvec(turn).as_matrix()


def skew(a: np.ndarray) -> np.ndarray:
    return np.cross(np.eye(3), a)


@given(angles, units)
@anywhere
def test_the_error_of_an_orientation_is_the_rotation_vector(angle, axis):
    target = turned(angle * axis).T @ AT.rotation
    error = OrientationTask("tip").evaluate(STATE, Target(target)).error
    if math.pi - angle > 2e-9:  # nearer the branch is that of a stated axis
        assert error == pytest.approx(angle * axis, abs=1e-14)
    theirs = Rotation.from_matrix(AT.rotation @ target.T).as_rotvec()
    assert np.abs(error) == pytest.approx(np.abs(theirs), abs=1e-14)


@given(angles, units, vectors, vectors, vectors)
@anywhere
def test_a_pose_s_error_and_jacobian_are_pinocchio_s(angle, axis, place, velocity, spin):
    goal = np.eye(4)
    goal[:3, :3], goal[:3, 3] = turned(angle * axis).T @ AT.rotation, place
    rate = np.concatenate((velocity, spin))
    at = LinkKinematics.of(FINGER)(STATE, "tip", tuple(POINT))
    found = PoseTask("tip", POINT).evaluate(STATE, Target(goal, rate))
    # exp of the error moves the target to the frame, about the target's origin
    twist = np.zeros((4, 4))
    twist[:3, :3], twist[:3, 3] = skew(found.error[3:]), found.error[:3]
    E, d = at.rotation @ goal[:3, :3].T, at.position - place
    motion = np.vstack((np.column_stack((E, d)), [0, 0, 0, 1]))
    near_branch = math.pi - angle < 2e-9
    assert expm(twist) == pytest.approx(motion, abs=1e-8 if near_branch else 1e-13)
    # the motion's velocity in its own axes, from that of frame and target
    spun = at.velocity[3:] - E @ spin
    own = np.concatenate((E.T @ (at.velocity[:3] - velocity), E.T @ spun))
    columns = np.vstack((E.T @ at.jacobian[:3], E.T @ at.jacobian[3:]))
    J = pin.Jlog6(pin.SE3(E, d))
    if 1e-2 < angle < math.pi - 1e-3:  # where Pinocchio's own has its digits
        assert relative(found.rate, J @ own, 1.0) < 1e-9
        assert relative(found.jacobian, J @ columns, 1.0) < 1e-9


@given(angles.filter(lambda x: x < math.pi - 1e-4), units, units)
@anywhere
def test_the_error_of_a_direction_is_the_shortest_turn(angle, axis, aside):
    across = np.cross(AT.rotation @ axis, aside)
    if across @ across < 1e-6:
        return
    n = across / math.sqrt(across @ across)
    goal = turned(-angle * n) @ AT.rotation @ axis
    error = AxisTask("tip", axis).evaluate(STATE, Target(goal)).error
    slack = 1e-14 * (1 + 1 / (math.pi - angle))  # near the antipode rounding turns the axis
    assert error == pytest.approx(angle * n, abs=slack)
    assert turned(error) @ goal == pytest.approx(AT.rotation @ axis, abs=slack)
