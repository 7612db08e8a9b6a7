"""Schedules: their tables, and the stage that acts at each time."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from shutil import copy
from typing import Any

import numpy as np
import pytest

import softdyn
from softdyn import InputError, SetPoint
from softdyn.controllers import (
    Gains,
    Mpc,
    Schedule,
    SoftIdClfQp,
    Stage,
    Staged,
    Status,
    find_controller,
)
from softdyn.controllers.predictive.supervisor import Phase
from softdyn.controllers.schedule import make_schedule, tuned
from softdyn.controllers.staged import best
from softdyn.description import library as catalogue
from softdyn.validation import paper, simulate
from tests.support.control_cases import GAINS, drawn, recorded, robot
from tests.support.refused import refused

SLOW, FAST = Gains(Kp=50.0, eps=0.2), Gains(Kp=900.0, eps=0.02)
SCHEDULE = Schedule(Stage(FAST, 0.02), Stage(SLOW, 0.1), arrive=0.01, leave=0.05, dwell=0.1)


def test_stages_follow_the_distance() -> None:
    model = robot("finger")
    law = Staged(model, SCHEDULE, period=0.03)
    approach = SoftIdClfQp(model, FAST, horizon=0.02)
    stay = SoftIdClfQp(model, SLOW, horizon=0.1)
    state = recorded("finger")[2][0]
    # `stay` begins after `dwell` within `arrive`; `approach` begins at once beyond `leave`
    distances = [0.2, 0.009, 0.009, 0.011, 0.009, 0.009, 0.009, 0.009, 0.04, 0.06, 0.009]
    staying = [False] * 7 + [True, True, False, False]
    for distance, stays in zip(distances, staying, strict=True):
        goal = SetPoint(state.y + np.array([0.0, 0.0, distance]))
        expected = (stay if stays else approach)(state, goal)
        np.testing.assert_allclose(law(state, goal).u, expected.u, rtol=0, atol=1e-8)
        assert law(state, goal).V == expected.V or distance < 0.05
        # the second call was within the same period
        law.supervisor._near -= 0.03 * (law.supervisor._near > 0)
    assert not np.allclose(
        approach(state, SetPoint(state.y + 0.05)).u, stay(state, SetPoint(state.y + 0.05)).u
    )


def test_both_stages_share_a_guard() -> None:
    model = robot("finger")
    law = Staged(model, replace(SCHEDULE, dwell=0.0))
    state = recorded("finger")[2][0]
    good = law(state, SetPoint(state.y + 0.02))
    broken = replace(state, h=np.full(model.nv, np.nan))
    far, near = law(broken, SetPoint(state.y + 0.02)), law(broken, SetPoint(state.y))
    for command in (far, near):
        assert command.status is Status.NON_FINITE
        np.testing.assert_array_equal(command.u, good.u)
    assert law.guard.fallbacks == 2
    law.reset(0.01)
    assert law.guard.fallbacks == 0
    assert law.period == 0.01
    for period in (0.0, -0.01, float("nan"), "0.01", None):
        with refused("period"):
            law.reset(period)


def test_a_tip_that_is_nowhere_changes_no_stage() -> None:
    model = robot("finger")
    law = Staged(model, SCHEDULE)
    state = recorded("finger")[2][0]
    law.supervisor.phase = Phase.STAY
    law(replace(state, y=np.full(3, np.nan)), SetPoint(state.y))
    assert law.supervisor.phase is Phase.STAY


def test_the_tip_leaves_beyond_the_distance_not_at_it() -> None:
    law = Staged(robot("finger"), replace(SCHEDULE, leave=0.5))
    here = replace(recorded("finger")[2][0], y=np.zeros(3))
    law.supervisor.phase = Phase.STAY
    for distance, stays in ((0.5, True), (np.nextafter(0.5, 1.0), False)):
        command = law(here, SetPoint([0.0, 0.0, distance]))
        assert command.values == {"phase": "stay" if stays else "approach"}


def test_the_tuned_schedule() -> None:
    name = "spirob"
    schedule = tuned(robot(name))
    assert schedule is not None
    law = find_controller("best")(robot(name))
    assert isinstance(law.inner, Staged)
    assert law.gains == schedule
    for stage in (schedule.approach, schedule.stay):  # the bound of docs/hold.md
        assert stage.horizon > 0
    for state, reference in drawn(name)[:3]:
        assert law(state, reference).status is Status.OK


def test_other_robots_need_no_gains(tmp_path: Path) -> None:
    best = find_controller("best")
    source = catalogue.BUNDLED / "finger.urdf"
    copy(source, tmp_path / "finger.urdf")
    other = softdyn.load(tmp_path / "finger.urdf")
    assert isinstance(best(other), Mpc)
    assert isinstance(best(other, SCHEDULE), Staged)
    with refused("gains", None):
        Staged(other)
    for wrong in (5.0, 0, "x", GAINS, [], [1], object()):
        with refused("gains"):
            best(robot("finger"), wrong)


def test_tables() -> None:
    table: dict[str, Any] = {
        "approach": {"Kp": 900, "eps": 0.02, "horizon": 0.02}, "stay": {"Kp": 50, "eps": 0.2},
        "arrive": 0.01, "leave": 0.05, "dwell": 0,
    }  # fmt: skip
    schedule = make_schedule(table)
    assert schedule.approach == Stage(FAST, 0.02)
    assert schedule.stay == Stage(SLOW, 0.0)
    wrong: list[dict[str, Any]] = [
        {}, {**table, "other": 1}, {k: v for k, v in table.items() if k != "stay"},
        {**table, "stay": 5}, {**table, "stay": {}}, {**table, "stay": {"Kp": 1, "Kq": 2}},
        {**table, "stay": {"Kp": -1}}, {**table, "leave": 0.01}, {**table, "arrive": 0},
        {**table, "dwell": -1}, {**table, "dwell": math.nan}, {**table, "arrive": "near"},
        {**table, "stay": {"Kp": 1, "horizon": -1}},
        {**table, "stay": {"Kp": 1, "horizon": math.inf}},
    ]  # fmt: skip
    for bad in wrong:
        with pytest.raises(InputError):
            make_schedule(bad)


@pytest.mark.parametrize("period", [0.001, 0.005])
def test_the_finger_gets_there_at_any_period(period: float) -> None:
    goal = paper.set_point("finger", 0.75)
    law = best(robot("finger"))
    log = simulate(robot("finger"), law, goal, period=period, duration=2)
    assert not log.failed
    assert np.linalg.norm(log.error[-1]) < 1e-3
    assert log.fallbacks == 0


def test_best_knows_its_actuators() -> None:
    """A tuned schedule is for actuators that act at once; lag and delay need prediction."""
    model = robot("spirob")
    assert isinstance(best(model).inner, Staged)
    law = best(model, lag=0.02, delay=0.005)
    assert isinstance(law, Mpc)
    assert (law.actuation.lag, law.actuation.delay) == (0.02, 0.005)
    for wrong in (-1.0, math.nan, "x"):
        with refused("lag"):
            best(model, lag=wrong)
    with refused("gains", SCHEDULE):
        best(model, SCHEDULE, lag=0.01)
