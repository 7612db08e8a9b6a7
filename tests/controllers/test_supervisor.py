"""The phases of predictive control, each transition by itself."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from softdyn import Reference, SetPoint, SoftModel
from softdyn.controllers import Mpc
from softdyn.controllers.predictive import plan as planning
from softdyn.controllers.predictive import supervisor as rules
from softdyn.controllers.predictive.aim import ErrorAhead, TipAim
from softdyn.controllers.predictive.plan import make_plan
from softdyn.controllers.predictive.prediction import Present
from softdyn.controllers.predictive.rest_target import RestTarget
from softdyn.controllers.predictive.supervisor import Followed, Phase, Supervisor
from softdyn.validation import Log, simulate
from tests.support import cart

T = 0.125  # s; a sum of periods is exact
GOAL = SetPoint([cart.LENGTH + 0.1, 0.0, 0.0])
PATH = Reference(GOAL.y, ydot=[0.1, 0.0, 0.0])
ZERO = np.zeros(1)
REST = RestTarget(np.array([0.1]), np.array([cart.STIFFNESS * 0.1]), True, 0.0)
LEAST = np.array([0.02])


@pytest.fixture
def slide(monkeypatch) -> SoftModel:
    """A cart on a spring, with plans of 0.3 s."""
    monkeypatch.setattr(planning, "STEPS", 30)
    monkeypatch.setattr(planning, "USEFUL", np.inf)  # the way is short, and so is the time
    return cart.cart(-1.0, 1.5)


class Rests:
    """Rests that are known after a number of calls."""

    searching = False

    def __init__(self, *found: RestTarget, calls: int = 0) -> None:
        self.found, self.calls, self.asked = found, calls, 0

    def find(self, *_given: Any, waits: bool) -> tuple[RestTarget, ...] | None:
        self.asked += 1
        return self.found if waits or self.asked > self.calls else None


def present(model: SoftModel, q: float) -> Present:
    """The cart at rest under the input 0.2."""
    state, u = model.state([q], [0.0]), np.array([0.2])
    linear = state.M, np.eye(1), np.eye(1), state.B
    return Present(state, linear, ZERO, (ZERO, ZERO), u, ZERO, ZERO, u)


def follow(
    supervisor: Supervisor, model: SoftModel, q: float, far: float,
    reference: Reference = GOAL, waits: bool = True,
) -> Followed:  # fmt: skip
    """One step of a cart at q whose tip is `far` (m) from the reference."""
    error = ErrorAhead(np.ones((1, 1)), np.array([far]), ZERO, ZERO, ZERO)
    return supervisor(reference, TipAim(), reference is PATH, error, present(model, q), waits=waits)


@pytest.fixture
def make(slide) -> Iterator[Any]:
    """Make a supervisor of the cart with some rests; its period is T."""

    def made(*rests: RestTarget, calls: int = 0, least: Any = None) -> tuple[Supervisor, Any]:
        found = Supervisor(slide, Rests(*rests, calls=calls), least)  # type: ignore[arg-type]
        found.reset(T, 0.0)
        return found, partial(follow, found, slide)

    return made


def phases(step: Any, count: int, *given: Any, **options: Any) -> list[Phase]:
    return [step(*given, **options).phase for _ in range(count)]


def test_a_search_begins_when_the_tip_is_stuck_and_its_rest_acts_half_a_second_later(make):
    _, step = make(REST)
    assert phases(step, 5, 0.05, 0.001) == [Phase.GIVEN] * 5  # near
    found = phases(step, 17, 0.05, 0.05)
    assert found == [Phase.GIVEN] * 8 + [Phase.SEARCH] * 4 + [Phase.REST] * 5
    assert step(0.05, 0.05).rest is REST
    assert step(0.05, 0.05, reference=SetPoint(GOAL.y + 0.1)).phase is Phase.GIVEN


def test_a_late_answer_acts_late_and_a_rest_that_is_no_nearer_never(make):
    _, step = make(REST, calls=20)
    assert phases(step, 29, 0.05, 0.05, waits=False)[-2:] == [Phase.SEARCH, Phase.REST]
    for rests in ((), (RestTarget(REST.q, REST.u, True, 0.049),)):
        _, step = make(*rests)
        assert phases(step, 60, 0.05, 0.05)[8:] == [Phase.SEARCH] * 52


def test_a_bent_robot_waits_for_a_plan_follows_it_and_tries_three_times(make, slide):
    _, step = make(REST)
    phases(step, 12, -0.4, 0.5)
    found = [step(-0.4, 0.5) for _ in range(70)]
    assert [one.phase for one in found[:8]] == [Phase.HOLD] * 4 + [Phase.PLAN] * 3 + [Phase.REST]
    plan = make_plan(slide, np.array([-0.4]), ZERO, np.array([0.2]), [REST], GOAL.y, wait=0.5)
    assert plan is not None
    np.testing.assert_array_equal([one.command for one in found[:4]], [[0.2]] * 4)
    np.testing.assert_allclose(found[4].command, plan.command(0.0, np.array([-0.4]), ZERO, ZERO))
    assert found[7].command is None
    assert found[7].rest is REST
    begun = sum(
        one.phase is Phase.HOLD and before.phase is not Phase.HOLD
        for before, one in pairwise(found)
    )
    assert begun == rules.PLANS - 1  # the first began before
    assert {one.phase for one in found[-20:]} == {Phase.REST}


def test_without_a_plan_the_rest_acts(make, monkeypatch):
    monkeypatch.setattr(planning, "USEFUL", 0.0)
    _, step = make(REST)
    found = phases(step, 60, -0.4, 0.5)[12:]
    assert found == [Phase.HOLD] * 4 + [Phase.REST] * 44


def test_a_loop_that_does_not_wait_holds_its_input_until_the_plan_is_there(make):
    supervisor, step = make(REST)
    ask = partial(step, -0.4, 0.5, waits=False)
    phases(ask, 13)
    job = supervisor._job
    assert supervisor.phase is Phase.HOLD
    assert job is not None
    assert job.result(300.0) is not None
    assert not supervisor.planning
    rests = round(rules.RESTS / T)
    assert phases(ask, rests + 1)[-3:] == [Phase.HOLD, Phase.PLAN, Phase.PLAN]
    supervisor.reset(T, 0.0)
    phases(ask, 13)
    job = supervisor._job
    step(-0.4, 0.5, reference=SetPoint(GOAL.y + 0.1), waits=False)
    assert job is not None
    with pytest.raises(RuntimeError):  # another set point has ended it
        job.result(300.0)


def test_a_pull_starts_far_from_a_path_and_lasts_a_stated_time(make) -> None:
    supervisor, step = make(least=LEAST)
    lasts, again = (math.ceil(s / T) for s in (rules.LASTS, rules.AGAIN))
    far, near = 2 * rules.FAR, 0.5 * rules.FAR

    def pulls(distances: list[float]) -> list[int]:
        supervisor.reset(T, 0.0)
        steps = [step(0.0, d, reference=PATH) for d in distances]
        for one in steps:
            assert one.rest is not None
            times = rules.TIMES if one.phase is Phase.PULL else rules.KEEPS
            np.testing.assert_allclose(one.rest.u, times * LEAST)
        return [k for k, one in enumerate(steps) if one.phase is Phase.PULL]

    assert pulls([near] * 50) == []
    assert pulls([far] + [near] * 50) == list(range(lasts))
    assert pulls([near] * 10 + [far] + [near] * 20) == list(range(10, 10 + lasts))
    # and not again before a stated time
    pulled = pulls([far] * (2 * lasts + again + 3))
    assert pulled[lasts] - pulled[0] >= lasts + again
    # a set point ends the path, and another path begins anew
    assert step(0.0, far).phase is Phase.GIVEN
    assert step(0.0, far, reference=PATH).phase is Phase.PULL


def test_paths_of_a_robot_that_does_not_buckle_and_controllers_without_rests_have_one_phase(
    make, slide
):
    _, step = make(REST)
    assert set(phases(step, 30, 0.0, 0.5, reference=PATH)) == {Phase.GIVEN}
    alone = Supervisor(slide, None, None)
    alone.reset(T, 0.0)
    assert {follow(alone, slide, 0.0, 0.5).phase for _ in range(30)} == {Phase.GIVEN}


def test_a_log_has_the_phase_of_each_step_and_so_has_its_csv(slide, tmp_path) -> None:
    law = Mpc(slide, targets=Rests(REST))  # type: ignore[arg-type]
    goal = SetPoint([cart.LENGTH + 0.7, 0.0, 0.0])  # out of reach of the input
    log = simulate(slide, law, goal, period=T, duration=2.0)
    assert not log.failed, log.reason
    assert log["phase"].tolist() == ["given"] * 8 + ["search"] * 4 + ["rest"] * 4
    log.to_csv(tmp_path / "log.csv")
    assert Log.from_csv(tmp_path / "log.csv")["phase"].tolist() == log["phase"].tolist()
