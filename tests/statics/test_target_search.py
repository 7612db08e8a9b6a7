"""Inputs that hold several tasks, found again from poses of known equilibria."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy.optimize import brentq

import softdyn
from softdyn import InputError, SetPoint, statics
from softdyn.statics import target_search
from softdyn.tasks import AxisTask, OrientationTask, PointTask, PoseTask, StackedReference, Target
from tests.support.command import command
from tests.support.refused import refused
from tests.support.robots import build, hinge

FINGER = softdyn.load("finger")
STANDING = build(hinge(
    1, "0 0 0.1", limit=(-3, 3), damping=0.05, stiffness=0.5, pull=(-2, 2),
    block='<task frame="arm"/>',
))  # fmt: skip
TIP = FINGER.robot.task


def test_many_targets_have_the_results_of_single_calls():
    targets = np.array([[0.127, 0.0, -0.127], [0.15, 0.0, -0.05]])
    settings = {"shapes": 2, "rays": 0, "seconds": math.inf}
    several = statics.inputs_for_tips(FINGER, targets, **settings)
    assert len(several) == 2
    for target, found in zip(targets, several, strict=True):
        alone = statics.inputs_for_tip(FINGER, target, **settings)
        np.testing.assert_array_equal(found.nearest.u, alone.nearest.u)
        np.testing.assert_array_equal(found.target, target)


@pytest.mark.parametrize("targets", [[0.1, 0, 0], [[0.1, 0]], [[np.nan] * 3], 1.0])
def test_many_targets_of_another_form_are_refused(targets):
    with pytest.raises(InputError) as caught:
        statics.inputs_for_tips(FINGER, targets)
    assert caught.value.name == "targets"


@pytest.fixture(scope="module")
def known() -> list[statics.Equilibrium]:
    return [statics.settle(FINGER, u) for u in ([-0.2, -0.1], [0.1, 0.15])]


def pose_of(one: statics.Equilibrium) -> np.ndarray:
    return FINGER.link_poses(one.q)[TIP]


def test_poses_of_stable_equilibria_are_held(known) -> None:
    for one in known:
        goal = StackedReference({"hand": Target(pose_of(one))})
        tasks = [PoseTask(TIP, name="hand")]
        found = statics.inputs_for_tasks(FINGER, tasks, goal, rays=2, seconds=math.inf)
        best = found.nearest_stable
        assert best is not None
        assert found.errors(best)["hand"] < 1e-8
        assert best.residual < 1e-8
        assert ((FINGER.u_min <= best.u) & (best.u <= FINGER.u_max)).all()
        np.testing.assert_allclose(pose_of(best), pose_of(one), atol=1e-8)


def test_a_point_alone_is_the_search_for_the_tip(known) -> None:
    goal = known[0].y
    found = statics.inputs_for_tasks(
        FINGER, [PointTask(TIP)], SetPoint(goal), rays=2, seconds=math.inf
    )
    assert np.linalg.norm(found.nearest.y - goal) < 1e-6
    from_rest = statics.approach(statics.rest(FINGER), goal, stay_stable=True)
    assert any(np.array_equal(one.u, from_rest.u) for one in found.found)


def test_a_pair_out_of_reach_has_residuals_by_task() -> None:
    tasks = [PointTask("tip", weight=100.0), AxisTask("tip", [0, 0, 1])]
    goal = StackedReference({"tip": SetPoint([0, 0, 1.0]), "tip.axis": Target([1, 0, 0])})
    found = statics.inputs_for_tasks(FINGER, tasks, goal, rays=2, seconds=math.inf)
    at = found.nearest
    errors = found.errors(at)
    assert errors["tip"] == pytest.approx(np.linalg.norm(at.y - (0, 0, 1.0)))
    angle = np.arccos(FINGER.link_poses(at.q)["tip"][0, 2])
    assert errors["tip.axis"] == pytest.approx(angle)
    assert found.distance(at) == pytest.approx(np.hypot(10 * errors["tip"], angle))
    assert found.distance(at) <= min(map(found.distance, statics.sample_rests(FINGER, 2)))


def test_the_command_holds_a_pose() -> None:
    one = statics.settle(FINGER, [-0.1, 0.05])
    at = PoseTask("tip", name="p")
    zero = at.evaluate(FINGER.state(one.q, np.zeros(4)), Target(np.eye(4))).error
    turn = OrientationTask("tip").evaluate(FINGER.state(one.q, np.zeros(4)), Target(np.eye(3)))
    pose = [*one.y, *turn.error]
    assert zero[3:] == pytest.approx(turn.error)
    code, out, _ = command(
        "statics", "finger", "--pose", *map(str, pose), "--rays", "2", "--hold", "0.1",
        "--json", "-",
    )  # fmt: skip
    report = json.loads(out)
    assert code == 0
    assert report["closest_stable"]["distance_cm"] < 1e-4
    assert report["closest_stable"]["angle_deg"] < 1e-4


@pytest.mark.parametrize(("tasks", "reference", "expected"), [
    ([], SetPoint([0, 0, 0]), ("tasks", "none")),
    (["tip"], SetPoint([0, 0, 0]), ("tasks[0]", "'tip'")),
    ([PointTask(TIP)], [0, 0, 0], ("reference", "[0, 0, 0]")),
    ([OrientationTask(TIP)], SetPoint([0, 0, 0]), ("reference", "a plain reference")),
    ([PointTask("nose")], SetPoint([0, 0, 0]), ("link", "'nose'")),
])  # fmt: skip
def test_every_misuse_is_one_line(tasks, reference, expected) -> None:
    with refused(*expected):
        statics.inputs_for_tasks(FINGER, tasks, reference)


def test_a_pose_far_from_the_branch_of_rest_is_held() -> None:
    helix = softdyn.load("helix")
    known = statics.settle(helix, [-0.15, 0.31, 0.43, 0.16, 0.64, 0.69, -0.26, -0.1, 0.35])
    tip = helix.robot.task
    tasks = [PointTask(tip), AxisTask(tip, [0, 0, 1], weight=0.02)]
    ahead = helix.link_poses(known.q)[tip][:3, 2]
    goal = StackedReference({tip: SetPoint(known.y), f"{tip}.axis": Target(ahead)})
    alone = statics.inputs_for_tasks(helix, tasks, goal, seconds=0.0)  # from rest alone
    assert alone.timed_out
    assert alone.distance(alone.nearest) > 0.01
    found = statics.inputs_for_tasks(helix, tasks, goal, seconds=math.inf)
    assert not found.timed_out
    best = found.nearest_stable
    assert best is not None
    assert found.distance(best) < 1e-6
    assert best.stable


def test_the_limit_of_time_holds_for_the_samples_too(monkeypatch) -> None:
    model = softdyn.load("finger")  # its own samples
    clock = [0.0]
    monkeypatch.setattr(target_search, "perf_counter", lambda: clock[0])
    sample = target_search.sample_rests
    taken = []

    def slow(*given):
        for one in sample(*given):
            clock[0] += 1.0
            taken.append(one)
            yield one

    monkeypatch.setattr(target_search, "sample_rests", slow)
    tasks, goal = [PointTask(TIP)], SetPoint([0, 0, 1.0])  # out of reach
    found = statics.inputs_for_tasks(model, tasks, goal, seconds=4.5)
    assert len(taken) == 5
    assert found.timed_out
    assert len(found.found) == 1
    # nothing was kept of the first, so that the whole sample is taken, once
    whole = list(sample(model, 32, 0))
    statics.inputs_for_tasks(model, tasks, goal, seconds=math.inf)
    assert len(taken) == 5 + len(whole)
    statics.inputs_for_tasks(model, tasks, goal, seconds=math.inf)
    assert len(taken) == 5 + len(whole)


def test_the_search_for_the_tip_has_a_limit_too(monkeypatch) -> None:
    clock = [0.0]
    monkeypatch.setattr(target_search, "perf_counter", lambda: clock[0])
    explored = target_search.explore_from

    def slow(*given):
        clock[0] += 1.0
        return explored(*given)

    monkeypatch.setattr(target_search, "explore_from", slow)
    search = statics.inputs_for_tip(FINGER, [0.0, 0.0, 1.0], shapes=6, seconds=1.5)
    assert search.timed_out
    assert clock[0] == 2.0
    assert not statics.inputs_for_tip(FINGER, [0.0, 0.0, 1.0], shapes=1).timed_out


def test_of_equilibria_at_the_target_the_one_with_the_least_input_is_first() -> None:
    """Two shapes of the finger hold each of these tips; the first one found needs more, once."""
    rng, several = np.random.default_rng(0), 0
    for _ in range(6):
        goal = statics.settle(FINGER, 0.3 * rng.uniform(FINGER.u_min, FINGER.u_max)).y
        search = statics.inputs_for_tip(FINGER, goal, shapes=6, rays=2, seconds=math.inf)
        norms = [np.linalg.norm(one.u) for one in search.found if search.distance(one) <= 1e-6]
        several += len(norms) > 1
        assert norms == sorted(norms)
        assert np.linalg.norm(search.nearest.u) == min(norms)
    assert several > 1


def test_downhill_of_a_saddle_there_are_both_sides() -> None:
    """A mass on a spring stands upright for k < m g r; it leans where m g r sin q = k q."""
    saddle = statics.balance(STANDING, [0.0], [1e-3])
    assert not saddle.stable
    lean = brentq(lambda q: 0.5 * q - 0.981 * np.sin(q), 0.5, 3, xtol=1e-14)
    sides = sorted(float(one.q[0]) for one in target_search._downhill(saddle))
    assert sides == pytest.approx([-lean, lean], abs=1e-8)
