"""Tasks as the cost of the predictive controller."""

from __future__ import annotations

import math

import numpy as np
import pytest

from softdyn import Ellipse, Reference, SetPoint, SoftModel, statics
from softdyn.controllers import Compensated, Mpc, SoftIdClfQp, best
from softdyn.controllers.controller import KnownRig
from softdyn.controllers.predictive.aim import aim_of
from softdyn.tasks import (
    AxisTask,
    LinkKinematics,
    OrientationTask,
    PointTask,
    Poses,
    PoseTask,
    References,
    Target,
    Turns,
    Waypoints,
    compute_errors,
)
from softdyn.tasks.targets import exp3
from softdyn.validation import simulate
from tests.support.control_cases import drawn, robot
from tests.support.refused import refused

ELLIPSE = Ellipse(0.08, 0.03, 0.3, omega=0.4)
SPLIT = [PointTask("tip", name="x", axes=(0,)), PointTask("tip", name="rest", axes=(1, 2))]


@pytest.mark.parametrize("goal", [SetPoint([0.13, 0, -0.13]), ELLIPSE(0.3)], ids=["rest", "path"])
def test_the_tips_position_in_two_tasks_costs_as_much_as_in_one(goal: Reference) -> None:
    model = robot("finger")
    both = References({"x": lambda t: goal, "rest": lambda t: goal})(0.0)
    one, other = Mpc(model), Mpc(model, tasks=SPLIT)
    for state, _ in drawn("finger", 10):
        command, split = one(state, goal), other(state, both)
        np.testing.assert_allclose(split.u, command.u, atol=1e-7)
        np.testing.assert_allclose(split.V, command.V, rtol=1e-9, atol=1e-12)


def test_a_weight_of_all_tasks_changes_no_input() -> None:
    """Speeds and inputs count in units of what it costs to move the tasks' weighted errors."""
    model, pose = robot("finger"), np.eye(4)
    pose[:3, :3], pose[:3, 3] = exp3(np.array([0.0, 0.5, 0.0])), [0.13, 0.0, -0.13]
    goal = References({"tip.pose": lambda t: Target(pose)})(0.0)
    laws = [Mpc(model, tasks=[PoseTask("tip", weight=weight)]) for weight in (1.0, 4.0)]
    for lag in (0.0, 0.02):  # a lag of the plant weighs anew
        for law in laws:
            law.reset(law.period, KnownRig(lag=lag))
        for state, _ in drawn("finger", 4):
            one, other = (law(state, goal) for law in laws)
            assert np.abs(one.u).max() > 0
            np.testing.assert_allclose(other.u, one.u, atol=1e-7)
            np.testing.assert_allclose(other.V, 4 * one.V, rtol=1e-9, atol=1e-12)


def test_the_tip_alone_is_the_controller_without_tasks() -> None:
    model, goal = robot("finger"), ELLIPSE(0.1)
    one, listed = Mpc(model), Mpc(model, tasks=[PointTask("tip")])
    for state, _ in drawn("finger", 5):
        np.testing.assert_array_equal(listed(state, References({"tip": lambda t: goal})(0.0)).u,
                                      one(state, goal).u)  # fmt: skip


def test_errors_ahead_are_those_of_the_targets_motion() -> None:
    """At a fixed configuration they differ from the tasks' errors later on by O(t³)."""
    model, times = robot("finger"), [0.0, 1.0, 2.0]
    state, _ = drawn("finger", 1)[0]
    at = LinkKinematics.of(model)(state, "tip")
    turned = [
        exp3(np.array(turn)) @ at.rotation for turn in ([0.2, 0, 0], [0, 0.5, 0.1], [0, 0, 1])
    ]
    points = Waypoints(times, at.position + np.diag([0.02, 0.03, -0.05]))
    tasks = [
        PointTask("tip", weight=2.0), OrientationTask("tip", weight=0.3),
        PoseTask("tip", axes=(0, 4)), AxisTask("tip", [1, 0, 0]),
    ]  # fmt: skip
    turns = Turns(times, turned)
    motion = References({
        "tip": points, "tip.orientation": turns, "tip.pose": Poses(points, turns),
        "tip.axis": Waypoints(times, [R[:, 0] for R in turned], unit=True),
    })  # fmt: skip
    aim = aim_of(model, tasks)
    now = aim(state, motion(0.4), True)
    left = []
    for t in (0.02, 0.01):
        later = aim(state, motion(0.4 + t), True)
        predicted = now.now - (now.y + t * now.ydot + t * t / 2 * now.yddot)
        left.append(np.abs(predicted - later.now).max())
    assert left[1] < 1e-4
    assert left[0] / left[1] == pytest.approx(8.0, rel=0.2)
    assert aim(state, motion(0.4), False).rows.shape == (11, model.nv)


def errors_at_end(model: SoftModel, controller, tasks, goal: References) -> dict[str, float]:
    log = simulate(model, controller, goal, duration=4.0)
    return {name: error[-1] for name, error in compute_errors(model, tasks, log, goal).items()}


def test_weights_trade_and_a_reachable_pair_is_reached() -> None:
    model = robot("finger")
    tip, mid = "tip", model.robot.chain("tip")[2].child
    bent = statics.settle(model, u=[-0.2, -0.1])
    place = LinkKinematics.of(model)(bent.state, mid).position
    both = References({tip: SetPoint(bent.y), mid: SetPoint(place)})
    tasks = [PointTask(tip), PointTask(mid, weight=0.5)]
    assert max(errors_at_end(model, best(model, tasks=tasks), tasks, both).values()) < 1e-3
    apart, found = References({tip: SetPoint(bent.y), mid: SetPoint(bent.y)}), []
    for weight in (100.0, 0.01):
        tasks = [PointTask(tip, weight=weight), PointTask(mid)]
        found.append(errors_at_end(model, Mpc(model, tasks=tasks), tasks, apart))
    heavy, light = found
    assert heavy[tip] < light[tip]
    assert light[mid] < heavy[mid]


def test_a_pair_out_of_reach_ends_at_the_nearest_rest() -> None:
    model = robot("finger")
    tasks = [PointTask("tip"), AxisTask("tip", [1, 0, 0], weight=0.01)]
    goal = References({"tip": SetPoint([0.13, 0, -0.13]), "tip.axis": Target([0, 0.6, 0.8])})
    search = statics.inputs_for_tasks(model, tasks, goal(0.0), seconds=math.inf)
    assert search.nearest_stable is not None
    nearest = search.errors(search.nearest_stable)
    assert nearest["tip.axis"] > 0.5
    end = errors_at_end(model, best(model, tasks=tasks), tasks, goal)
    assert abs(end["tip"] - nearest["tip"]) < 0.01
    assert abs(end["tip.axis"] - nearest["tip.axis"]) < np.radians(1)


def test_what_it_refuses_is_one_line() -> None:
    model = robot("finger")
    levels = [PointTask("tip"), AxisTask("tip", [1, 0, 0], level=2)]
    for make in (Mpc, best):
        with refused("tasks", "levels 0, 2"):
            make(model, tasks=levels)
        with refused("tasks", "none"):
            make(model, tasks=[])
    pair = SoftIdClfQp(model, tasks=SPLIT)
    assert Compensated(pair, model, lag=0.01).tasks == pair.tasks
    with refused("controller", pair):
        Compensated(pair, model, delay=0.01)
    with refused("reference", "those of y"):
        Mpc(model, tasks=SPLIT)(model.state(model.q0, np.zeros(4)), References({"y": ELLIPSE})(0.0))
