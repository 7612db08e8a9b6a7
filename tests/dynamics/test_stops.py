"""Joint limits: what they allow, which joints they hold, and against which forces."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from softdyn import load, statics
from softdyn.dynamics.stops import Stops

STOPS = Stops(np.array([-1.0, 0.5, -np.inf, 0.3]), np.array([2.0, 0.6, np.inf, 0.3]))
NUMBERS = arrays(float, 4, elements=st.integers(-50, 50).map(lambda k: k / 10))


@given(NUMBERS, NUMBERS, NUMBERS)
def test_steps_end_within_and_held_joints_are_pressed(at, step, r) -> None:
    at = STOPS.within(at)
    after = at + STOPS.clip(at, step)
    assert (after <= STOPS.upper + 1e-15).all()
    assert (after >= STOPS.lower - 1e-15).all()
    inside = (after > STOPS.lower + 1e-9) & (after < STOPS.upper - 1e-9)
    np.testing.assert_allclose(after[inside], (at + step)[inside], atol=1e-15)
    held = STOPS.held(after, r)
    assert not held[2]  # without limits
    assert held[3]  # locked
    low, high = after - STOPS.lower <= 1e-9, STOPS.upper - after <= 1e-9
    pressed = low & (r > 0) | high & (r < 0)
    assert (held[:2] == pressed[:2]).all()


def test_both_limits_are_hit_up_to_a_margin() -> None:
    lower, upper = STOPS.hit(np.array([-0.99, 0.6, 1e9, 0.3]), margin=0.02)
    np.testing.assert_array_equal(lower, [True, False, False, True])
    np.testing.assert_array_equal(upper, [False, True, False, True])
    np.testing.assert_array_equal(STOPS.locked, [False, False, False, True])


def test_the_stops_of_a_robot_hold_it_at_rest() -> None:
    model = load("finger")
    rest = statics.settle(model, [1.0, 1.0])
    assert rest.held.any()
    unbalanced = rest.limit_forces
    np.testing.assert_array_equal(
        Stops.of(model).held(model.coordinates(rest.q), unbalanced), rest.held
    )
