"""The safety filter: barriers for `best` and for a user's controller."""

from __future__ import annotations

import numpy as np
import pytest

import softdyn
from softdyn import SetPoint
from softdyn.controllers import SafetyFilter, best
from softdyn.controllers.qps.horizon import Horizon
from softdyn.safety import HalfSpace, Surroundings
from softdyn.validation import simulate
from tests.support.refused import refused

GOAL = SetPoint([0.127, 0, -0.127])
FLOOR = Surroundings([HalfSpace([0, 0, 1], -0.1, links="all", name="floor", contact=False)])


class Push:
    """A user's controller that knows no obstacle."""

    def __init__(self, u):
        self.u = np.array(u, float)

    def __call__(self, state, reference):
        return self.u


@pytest.mark.parametrize("name", ["best", "own"])
def test_a_controller_without_barriers_keeps_clear(name):
    model = softdyn.load("finger")
    made = best(model) if name == "best" else Push([0.0, 0.0])
    least, laws = [], (made, SafetyFilter(made, model, FLOOR.barriers))
    for law in laws:
        log = simulate(model, law, GOAL, duration=1.0, period=0.005, surroundings=FLOOR)
        least.append(log.least_reserve["floor"])
    assert least[0] < -0.02
    assert least[1] > -1e-4
    assert laws[1].barrier_rows.relaxed == 0
    assert 0 < laws[1].changed <= log.steps
    if name == "best":  # 5.96 cm off, and 0.39 mm clear, if it takes a changed input for a force
        assert log.final_error_cm < 3
        assert least[1] > 1e-3


def test_a_stop_that_is_met_within_a_period():
    # a joint meets its stop at 2 rad/s and pushes the others: 2.4 mm deep while rows ignored it
    model = softdyn.load("finger")
    pushing = best(model)  # it is not told which input acts
    pushing.reset(0.005)
    pushing.waits = True  # a simulation sets it only on its own controller
    law = SafetyFilter(
        lambda state, reference: pushing(state, reference), model, FLOOR.barriers, horizon=0.1
    )
    log = simulate(model, law, GOAL, duration=2.0, period=0.005, surroundings=FLOOR)
    assert np.abs(log.q).max() > 1.57
    assert log.least_reserve["floor"] > -1e-4
    assert law.barrier_rows.relaxed == 0


def test_an_input_that_is_safe_passes_unchanged():
    model = softdyn.load("finger")
    state = model.state(model.q0, np.zeros(4))
    law = SafetyFilter(Push([0.01, -0.02]), model, FLOOR.barriers)
    law.reset(0.005)
    np.testing.assert_array_equal(law(state, GOAL).u, [0.01, -0.02])
    assert law.changed == 0


def test_a_joint_may_leap_if_it_is_as_fast_already():
    """Beside rows, no joint moves by more than 0.1 rad in a period, or than at its velocity."""
    model, rng, period = softdyn.load("finger"), np.random.default_rng(1), 0.005
    far = [HalfSpace([0, 0, 1], -9.0)]
    fast = within = 0
    for _ in range(14):
        q, v = rng.uniform(-0.3, 0.3, 4), rng.normal(size=4) * rng.uniform(5, 60)
        state, u = model.state(q, v), rng.uniform(model.u_min, model.u_max)
        M, h = Horizon(model, period)(state)
        moved = period * np.abs(v + period * np.linalg.solve(M, state.B @ u - h))
        allowed = (moved <= np.maximum(0.1, period * np.abs(v))).all()
        fast, within = fast + (moved.max() > 0.1), within + allowed
        law = SafetyFilter(Push(u), model, far, horizon=0.0)
        law.reset(period)
        assert (law(state, GOAL).u == u).all() == allowed
        assert law.changed == (not allowed)
    assert fast > 4
    assert within < 14


def test_bad_arguments_are_named():
    model = softdyn.load("finger")
    with refused("barriers", "none"):
        SafetyFilter(best(model), model, [])
    with refused("controller", "<class 'test_safety_filter.Push'>"):
        SafetyFilter(Push, model, FLOOR.barriers)
    with refused("horizon"):
        SafetyFilter(best(model), model, FLOOR.barriers, horizon=-1.0)
