"""Targets, and paths of each kind with exact rates."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from softdyn import Ellipse, InputError, Reference, SetPoint
from softdyn.tasks import (
    Poses,
    References,
    StackedReference,
    Target,
    Turns,
    Waypoints,
    read_paths,
)
from softdyn.tasks.targets import exp3
from tests.support.refused import refused

TIMES = (0.0, 0.5, 1.2, 2.0)
RNG = np.random.default_rng(5)
POINTS = RNG.normal(size=(4, 3))
ROTATIONS = [exp3(turn) for turn in RNG.normal(size=(4, 3))]
INSIDE = (0.1, 0.49, 0.77, 1.9)


def central(f, t: float, h: float = 1e-4) -> np.ndarray:
    return (4 * (f(t + h) - f(t - h)) / (2 * h) - (f(t + 2 * h) - f(t - 2 * h)) / (4 * h)) / 3


@pytest.mark.parametrize("unit", [False, True])
def test_waypoints_are_passed_with_exact_rates(unit):
    path = Waypoints(TIMES, POINTS, unit=unit)
    for t, point in zip(TIMES, POINTS, strict=True):
        wanted = point / np.linalg.norm(point) if unit else point
        assert path(t).y == pytest.approx(wanted)
    for t in INSIDE:
        found = path(t)
        assert found.ydot == pytest.approx(central(lambda t: path(t).y, t), abs=1e-7)
        assert found.yddot == pytest.approx(central(lambda t: path(t).ydot, t), abs=1e-7)
    for t in (-1.0, 0.0, 2.0, 5.0):
        assert np.abs([path(t).ydot, path(t).yddot]).max() < 1e-9
    assert isinstance(path(0.3), Target if unit else Reference)
    shapes = Waypoints(TIMES, RNG.normal(size=(4, 5, 3)))
    assert shapes(0.3).y.shape == (5, 3)


def test_turns_pass_their_rotations_with_exact_rates():
    path = Turns(TIMES, ROTATIONS)
    for t, rotation in zip(TIMES, ROTATIONS, strict=True):
        assert path(t).y == pytest.approx(rotation, abs=1e-12)
    for t in INSIDE:
        found = path(t)
        spin = central(lambda t: path(t).y, t) @ found.y.T
        omega = np.array((spin[2, 1], spin[0, 2], spin[1, 0]))
        assert found.ydot == pytest.approx(omega, abs=1e-7)
        assert spin == pytest.approx(-spin.T, abs=1e-7)
        assert found.yddot == pytest.approx(central(lambda t: path(t).ydot, t), abs=1e-7)


def test_poses_join_a_path_of_points_and_one_of_rotations():
    points, turns = Ellipse(0.1, 0.05, 0.2, omega=0.3), Turns(TIMES, ROTATIONS)
    pose = Poses(points, turns)(0.7)
    assert np.array_equal(pose.y[:3, 3], points(0.7).y)
    assert pose.y[:3, :3] == pytest.approx(turns(0.7).y, abs=1e-15)
    assert np.array_equal(pose.ydot, np.concatenate((points(0.7).ydot, turns(0.7).ydot)))
    with refused("pose", "shapes (3, 3) and (3, 3)"):
        Poses(turns, turns)(0.0)


def test_a_stack_is_a_reference_of_its_first_position():
    pose = Poses(SetPoint([1, 2, 3]), Target(ROTATIONS[0]))
    stack = References({"axis": Target([1, 0, 0]), "hand": pose, "mid": SetPoint([0, 0, 1])})(0.3)
    assert isinstance(stack, Reference)
    assert stack.y == pytest.approx([1, 2, 3])
    assert stack.targets["mid"].y == pytest.approx([0, 0, 1])
    for copied in (copy.deepcopy(stack), pickle.loads(pickle.dumps(stack))):
        assert not copied.targets["axis"].y.flags.writeable
        assert np.array_equal(copied.y, stack.y)


def test_a_recorded_path_is_read_back(tmp_path):
    file = tmp_path / "path.csv"
    names = "t,tip.x,tip.y,tip.z,hand.rx,hand.ry,hand.rz,tip.axis.dx,tip.axis.dy,tip.axis.dz"
    turns = RNG.normal(size=(4, 3))
    table = np.column_stack((TIMES, POINTS, turns, 2 * POINTS))
    joints = RNG.normal(size=(4, 2))
    table = np.column_stack((table, joints, turns, POINTS))
    names += ",joints.0,joints.1,pose.rx,pose.ry,pose.rz,pose.x,pose.y,pose.z"
    np.savetxt(file, table, "%.17g", ",", header=names, comments="")
    paths = read_paths(file)
    assert set(paths) == {"tip", "hand", "tip.axis", "joints", "pose"}
    np.testing.assert_array_equal(paths["pose"].times, TIMES)
    for t, point, turn, row in zip(TIMES, POINTS, turns, joints, strict=True):
        assert paths["tip"](t).y == pytest.approx(point)
        assert paths["hand"](t).y == pytest.approx(exp3(turn))
        assert paths["tip.axis"](t).y == pytest.approx(point / np.linalg.norm(point))
        assert paths["joints"](t).y == pytest.approx(row)
        assert paths["pose"](t).y[:3, 3] == pytest.approx(point)
        assert paths["pose"](t).y[:3, :3] == pytest.approx(exp3(turn))
    References(paths)(0.4)


@pytest.mark.parametrize("text", [
    "", "t\n0\n1\n", "x,y\n0,1\n", "t,tip.x,tip.y\n0,1,2\n1,2,3\n", "t,a.x,a.y,a.z\n0,1,2,3\n",
    "t,a.x,a.y,a.z\n0,1,2,3\n0,1,2,3\n", "t,a.x,a.y,a.z\n0,1,2,x\n1,1,2,3\n",
    "t,a.x,a.y,a.z\n0,1,2,nan\n1,1,2,3\n", "t,a.x,a.y,a.z\n0,1,2\n1,1,2,3\n",
    "t,t,a.0\n0,1,2\n1,1,2\n", "t,x,y,z\n0,1,2,3\n1,1,2,3\n",
])  # fmt: skip
def test_a_damaged_recording_is_one_line_that_names_the_file(text, tmp_path):
    file = tmp_path / "path.csv"
    file.write_text(text)
    with pytest.raises(InputError) as caught:
        References(read_paths(file) | {"tip": SetPoint([0, 0, 0])})
    assert "path.csv" in str(caught.value)


MISUSES = {
    "shape": lambda: Target(np.zeros((2, 2))),
    "a reflection": lambda: Target(np.diag((1.0, 1.0, -1.0))),
    "no rotation": lambda: Target(2 * np.eye(3)),
    "last row": lambda: Target(np.ones((4, 4))),
    "rates": lambda: Target(np.eye(3), np.eye(3)),
    "text": lambda: Target("tip"),
    "not finite": lambda: Target([0.0, np.nan]),
    "no position": lambda: StackedReference({"axis": Target([1, 0, 0])}),
    "no mapping": lambda: StackedReference([SetPoint([0, 0, 0])]),
    "no target": lambda: StackedReference({"tip": [0, 0, 0]}),
    "no callable": lambda: References({"tip": Reference([0, 0, 0])}),
    "one waypoint": lambda: Waypoints([0.0], [[0, 0, 0]]),
    "times": lambda: Turns([0, 0], ROTATIONS[:2]),
    "through zero": lambda: Waypoints([0, 1], [[1, 0, 0], [-1, 0, 0]], unit=True)(0.5),
    "t": lambda: Waypoints(TIMES, POINTS)(np.nan),
}


@pytest.mark.parametrize("misuse", MISUSES)
def test_every_misuse_is_one_line(misuse):
    with pytest.raises(InputError) as caught:
        MISUSES[misuse]()
    assert "\n" not in str(caught.value)
