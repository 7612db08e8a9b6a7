"""The map between a model's and a twin's states: order, continuous joints, senses, zeros."""

from __future__ import annotations

import math

import numpy as np

import softdyn
from softdyn.validation.twin.state_map import StateMap
from softdyn.validation.twin.twin import Twin
from tests.support.refused import refused
from tests.validation.twin.test_twin import joint, link, urdf


def test_state_map_orders_by_name_and_unwinds_circles(tmp_path):
    body = link("base") + link("z", 1.0, "1 1 1") + link("a", 1.0, "1 1 1") + link("m", 1.0)
    body += joint("jz", "base", "z", "continuous") + joint("ja", "base", "a", "prismatic")
    body += joint("jm", "a", "m", "continuous", axis="1 0 0", at="0 0.3 0")
    path = urdf(tmp_path, body, '<joint name="jm" armature="1"/>')
    model, twin = softdyn.load(path), Twin(path)
    assert model.joint_names == ("ja", "jm", "jz")
    assert twin.joint_names == ("jz", "ja", "jm")
    states = StateMap(model, twin)
    np.testing.assert_array_equal(states.dofs, [1, 2, 0])
    q = np.array([0.3, math.cos(2.0), math.sin(2.0), math.cos(-3.0), math.sin(-3.0)])
    qpos, qvel = states.to_twin(q, np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(qpos, [-3.0, 0.3, 2.0], rtol=1e-15)
    np.testing.assert_array_equal(qvel, [3.0, 1.0, 2.0])
    back, v = states.from_twin(qpos + 2 * math.pi * np.array([1, 0, -2]), qvel)
    np.testing.assert_allclose(back, q, atol=1e-14)
    np.testing.assert_array_equal(v, [1.0, 2.0, 3.0])


def test_state_map_refuses_another_robot():
    with refused("twin", "('bend1', 'lat1', …"):
        StateMap(softdyn.load("finger"), Twin("helix"))


def test_joints_of_another_hand_turn_the_other_way_or_from_another_zero():
    """q = sense · qpos + zero, v = sense · qvel, joint by joint, in both directions."""
    model, twin = softdyn.load("finger"), Twin("finger")
    first, second, third, _ = model.joint_names
    states = StateMap(model, twin, turns={first: (-1, 0.0), second: (1, 0.3), third: (-1, -0.2)})
    q, v = np.array([0.1, 0.5, -0.4, 0.7]), np.array([1.0, 2.0, 3.0, 4.0])
    qpos, qvel = states.to_twin(q, v)
    np.testing.assert_allclose(qpos, [-0.1, 0.2, 0.2, 0.7], rtol=1e-15)
    np.testing.assert_array_equal(qvel, [-1, 2, -3, 4])
    np.testing.assert_array_equal(states.velocity_map(qpos), np.diag([-1, 1, -1, 1]))
    back, rate = states.from_twin(qpos, qvel)
    np.testing.assert_allclose(back, q, rtol=1e-15)
    np.testing.assert_array_equal(rate, v)
    np.testing.assert_allclose(states.coordinates(qpos), q, rtol=1e-15)
