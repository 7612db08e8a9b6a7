"""Targets that a robot can reach: equilibria that hold in the twin, and inclined paths."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import softdyn
from softdyn import statics
from softdyn.statics.reachable import APART, AXIS, LONGEST, ROOM, SHORTEST
from softdyn.validation import StateMap, Twin
from tests.statics.test_statics import STIFFNESS, G, pendulum
from tests.support.command import command
from tests.support.refused import refused


@pytest.fixture(scope="module")
def rests():
    model = softdyn.load("finger")
    return model, statics.spread_rests(model, 6, seed=3)


def test_spread_rests_are_rests_in_the_twin_and_far_apart(rests):
    model, found = rests
    twin = Twin(model.robot)
    states = StateMap(model, twin)
    start = statics.rest(model).y
    tips = [start, *(one.y for one in found)]
    gaps = [np.linalg.norm(a - b) for i, a in enumerate(tips) for b in tips[:i]]
    assert min(gaps) > APART * model.robot.length
    for one in found:
        assert (np.abs(one.u) <= ROOM * model.u_max).all()
        twin.set_state(*states.to_twin(one.q, np.zeros(model.nv)))
        twin.advance(one.u, 400)
        q, _ = states.from_twin(twin.qpos, twin.qvel)
        np.testing.assert_allclose(q, one.q, atol=1e-6)
    again = statics.spread_rests(model, 6, seed=3)
    np.testing.assert_array_equal([one.y for one in again], [one.y for one in found])


def test_a_path_is_followed_by_rests_and_knows_its_slope(rests):
    model, found = rests
    loop = statics.loop_around(found[-1])
    h = 1e-5
    for t in (0.0, 0.3 * loop.period):
        here, before, after = loop(t), loop(t - h), loop(t + h)
        np.testing.assert_allclose(here.ydot, (after.y - before.y) / (2 * h), atol=1e-9)
        np.testing.assert_allclose(here.yddot, (after.ydot - before.ydot) / (2 * h), atol=1e-8)
        search = statics.inputs_for_tip(model, here.y, [found[-1]], shapes=0, seconds=math.inf)
        near = search.nearest
        assert np.linalg.norm(near.y - here.y) < 0.01 * model.robot.length
    np.testing.assert_allclose(loop(loop.period).y, loop(0.0).y, atol=1e-12)
    # the longer axis is a share of the robot's length, halved until rests follow
    halvings = -np.log2(np.linalg.norm(loop.a) / (AXIS * model.robot.length))
    assert halvings == pytest.approx(round(halvings), abs=1e-9)
    assert 0 <= round(halvings) < 4
    assert np.linalg.norm(loop.b) <= np.linalg.norm(loop.a) * (1 + 1e-12)
    assert abs(loop.a @ loop.b) < 1e-12


def test_a_path_turns_at_half_the_rate_of_the_slowest_pole():
    """A pendulum's poles by hand: M s² + d s + k = 0 about the angle where it rests."""
    slow = {f'i{axis}{axis}="0.001"': f'i{axis}{axis}="0.08"' for axis in "xyz"}
    slow |= {'damping="0.05"': 'damping="0.8"'}  # so much that the two poles differ
    model, angle = pendulum(changes=slow), 0.2
    u = STIFFNESS * angle + 0.1 * G * math.sin(angle)
    loop = statics.loop_around(statics.settle(model, [u]))
    poles = np.roots([0.08 + 0.1**2, 0.8, STIFFNESS + 0.1 * G * math.cos(angle)])
    assert 2 * math.pi / LONGEST < np.abs(poles).min() / 2 < 2 * math.pi / SHORTEST
    assert loop.omega == pytest.approx(np.abs(poles).min() / 2, rel=1e-6)


def test_a_robot_that_cannot_be_moved_is_told(tmp_path):
    text = softdyn.load("finger").robot.path.read_text()
    weak = text.replace('lower="-1" upper="1"', 'lower="-1e-6" upper="1e-6"')
    assert weak != text
    (tmp_path / "weak.urdf").write_text(weak)
    with refused("robot", "fewer"):
        statics.spread_rests(softdyn.load(tmp_path / "weak.urdf"), 4)


def test_cells_hold_the_directions_of_their_rests():
    finger = softdyn.load("finger")
    rests = list(statics.sample_rests(finger, 4, 0))
    cells = statics.reach_by_direction(rests, [2, 0, 0], 0.03)
    assert sorted(id(one) for cell in cells for one in cell.rests) == sorted(map(id, rests))
    assert len(cells) > 3
    assert [cell.cone for cell in cells] == sorted((cell.cone for cell in cells), reverse=True)
    for cell in cells:
        ahead = np.array([finger.link_poses(one.q)["tip"][:3, 0] for one in cell.rests])
        assert all(np.abs(one.y - cell.centre).max() <= 0.015 for one in cell.rests)
        np.testing.assert_allclose(np.cross(cell.direction, ahead.mean(axis=0)), 0, atol=1e-12)
        angles = [math.atan2(np.linalg.norm(np.cross(a, cell.direction)), a @ cell.direction)
                  for a in ahead]  # fmt: skip
        assert cell.cone == pytest.approx(max(angles), abs=1e-7)
    with refused("axis"):
        statics.reach_by_direction(rests, [0, 0, 0], 0.03)


def test_the_command_maps_directions(tmp_path):
    done = command("statics", "finger", "--axis", 1, 0, 0, "--cell", 0.05, "--rays", 4,
                   "--spread", 3, "--map", tmp_path / "map.png", "--json", "-")  # fmt: skip
    assert done.code == 0, done.err
    assert (tmp_path / "map.png").stat().st_size > 1000
    report = json.loads(done.out)
    assert report["cell_m"] == 0.05
    assert sum(cell["rests"] for cell in report["cells"]) > 20
    assert 0 < report["cells"][0]["cone_deg"] <= 180
    assert command("statics", "finger", "--cell", 0.1).code == 2
