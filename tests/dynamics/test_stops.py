"""Joint limits: what they allow, which joints they hold, and against which forces."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from softdyn import load, statics
from softdyn.dynamics.stops import Stops

STOPS = Stops(np.array([-1.0, 0.5, -np.inf, 0.3]), np.array([2.0, 0.6, np.inf, 0.3]))
NUMBERS = arrays(float, 4, elements=st.integers(-50, 50).map(lambda k: k / 10))


@settings(deadline=None, derandomize=True)
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


def test_clip_and_near_of_joints_with_two_limits_one_and_none() -> None:
    """Written out by hand: a range, one limit on each side, none; then beyond both limits."""
    stops = Stops(np.array([-1.0, 0.0, -np.inf, -np.inf]), np.array([3.0, np.inf, 1.0, np.inf]))
    at = np.array([1.0, 2.0, 0.0, -7.0])
    np.testing.assert_array_equal(
        stops.clip(at, np.array([9.0, 9.0, 9.0, 9.0])), [2.0, 9.0, 1.0, 9.0]
    )
    np.testing.assert_array_equal(
        stops.clip(at, np.array([-9.0, -9.0, -9.0, -9.0])), [-2.0, -2.0, -9.0, -9.0]
    )
    # beyond a limit it may only stay or go back
    at = np.array([4.0, -1.0, 2.0, 0.0])
    np.testing.assert_array_equal(stops.clip(at, np.ones(4)), [0.0, 1.0, 0.0, 1.0])
    np.testing.assert_array_equal(stops.clip(at, -np.ones(4)), [-1.0, 0.0, -1.0, -1.0])
    # an eighth of a range of 4 is 0.5; one limit alone must be reached
    near = np.array([[-0.5, 0.0, 1.0, 0.0], [2.5, 0.01, 0.99, 1e9], [-0.4, -1.0, 2.0, -1e9]])
    np.testing.assert_array_equal(
        stops.near(near, 0.125),
        [[True, True, True, False], [True, False, False, False], [False, True, True, False]],
    )


def problem(rng: np.random.Generator, skew: float) -> tuple[np.ndarray, ...]:
    """A, r, limits, position, step and a guess; A's principal minors are all positive."""
    n = int(rng.integers(3, 37))
    root, turned = rng.normal(size=(2, n, n))
    A = root @ root.T / n + 10 ** rng.uniform(-3, 0) * np.eye(n) + skew * (turned - turned.T)
    upper = rng.uniform(0, 1, n) * (rng.random(n) < 0.9)  # some are locked
    lower = -upper * rng.random(n)
    at = np.where(rng.random(n) < 0.4, lower, rng.uniform(lower, upper))
    lower[rng.random(n) < 0.1], upper[rng.random(n) < 0.1] = -np.inf, np.inf
    held = rng.integers(-1, 2, n)
    held[(held < 0) & np.isinf(lower) | (held > 0) & np.isinf(upper)] = 0
    return A, 10 ** rng.uniform(-1, 2) * rng.normal(size=n), lower, upper, at, held


@pytest.mark.parametrize("skew", [0.0, 1.0])
def test_speeds_balance_all_joints_whatever_the_guess(skew: float) -> None:
    """The conditions of each joint; with a skew part, changing all at once cycles in 4 of 10."""
    rng = np.random.default_rng(5)
    for _ in range(150):
        A, r, lower, upper, at, guess = problem(rng, skew)
        step = 10 ** rng.uniform(-3, 0)
        x, held = Stops(lower, upper).solve(A, r, at, step, guess)
        push, end = A @ x + r, at + step * x
        rounding = 1e-10 * (np.abs(A) @ np.abs(x) + np.abs(r)).max()
        assert (np.abs(push[held == 0]) <= rounding).all()
        assert (push * held <= rounding).all()
        assert (end >= lower - 1e-9).all()
        assert (end <= upper + 1e-9).all()
        np.testing.assert_allclose(end[held > 0], upper[held > 0], atol=1e-9)
        np.testing.assert_allclose(end[held < 0], lower[held < 0], atol=1e-9)


def test_without_speeds_that_balance_there_is_no_answer() -> None:
    """A joint with -x + 2 = p and x ≤ 1: free it would pass its stop, held the stop would pull."""
    stops, zero, free = Stops(np.array([-np.inf]), np.ones(1)), np.zeros(1), np.zeros(1, int)
    for A in (-np.eye(1), np.zeros((1, 1)), np.full((1, 1), np.nan)):
        with pytest.raises(np.linalg.LinAlgError):
            stops.solve(A, np.full(1, 2.0), zero, 1.0, free)
