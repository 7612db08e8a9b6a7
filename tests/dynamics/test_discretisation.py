"""The step over a period: A and B against differences, its equation, stops, sub-steps, errors."""

from __future__ import annotations

import pickle

import numpy as np
import pinocchio as pin
import pytest

import softdyn
from softdyn import InputError, SoftModel
from softdyn.dynamics import ForceBalance, StepError, discrete_step
from tests.proof.crosschecks.wrapped_robots import wrapped_robot
from tests.support.arms import PROJECTIONS
from tests.support.balanced import balanced, case
from tests.support.micro import FLOATING, GRIPPER, write

MODELS = ("finger", "spirob", "slack", "winched", *PROJECTIONS, "walker", "wrapped")


@pytest.fixture(params=MODELS)
def model(request, tmp_path):
    name = request.param
    if name in PROJECTIONS:
        return PROJECTIONS[name](tmp_path)
    if name == "wrapped":
        return softdyn.build(wrapped_robot(3, bodies=2))
    if name == "walker":
        return softdyn.load(write(tmp_path, FLOATING), floating=True)
    return balanced(name, tmp_path)


def moved(model: SoftModel, q: np.ndarray, there: np.ndarray) -> np.ndarray:
    """dq (n,) with q ⊕ dq = there."""
    step = model.coordinates(there) - model.coordinates(q)
    step = np.where(np.abs(step) > np.pi, step - 2 * np.pi * np.sign(step), step)
    if model.robot.floating:
        step[:6] = pin.liegroups.SE3().difference(q[:7], there[:7])
    return step


def differences(model, q, v, u, period, found, **settings):
    """∂(q, v)⁺ by (q, v, u), of fourth order; NaN where a neighbour holds other joints."""
    n, h, columns = model.nv, 2e-5, []
    for axis in np.eye(2 * n + model.nu):
        ends = []
        for k in (1, -1, 2, -2):
            x = k * h * axis
            near = discrete_step(
                model, model.integrate(q, x[:n]), v + x[n : 2 * n], u + x[2 * n :], period,
                **settings,
            )  # fmt: skip
            same = near.substeps == found.substeps and (near.held == found.held).all()
            end = np.concatenate((moved(model, found.q, near.q), near.v - found.v))
            ends.append(end if same else np.full(2 * n, np.nan))
        columns.append((8 * (ends[0] - ends[1]) - ends[2] + ends[3]) / (12 * h))
    return np.array(columns).T


def check(model, q, v, u, period, found, **settings):
    """Compare; the number of columns whose neighbours all hold the same joints."""
    n = model.nv
    expected = differences(model, q, v, u, period, found, **settings)
    right, kept = np.hstack((found.A, found.B)), np.isfinite(expected).all(0)
    for rows in (slice(0, n), slice(n, None)):
        for columns in (slice(0, n), slice(n, 2 * n), slice(2 * n, None)):
            block, use = right[rows, columns], kept[columns]
            error = np.abs(block - expected[rows, columns])[:, use].max(initial=0.0)
            assert error <= 2e-7 * max(np.abs(block).max(initial=0.0), 1e-3), (rows, columns, error)
    return int(kept.sum())


@pytest.mark.parametrize("period", [0.002, 0.03])
def test_jacobians_are_those_of_differences(model, period):
    q, v, _, _, _ = case(model, ())
    u = np.random.default_rng(2).uniform(
        np.maximum(model.u_min, -3), np.minimum(model.u_max, 3)
    )  # fmt: skip
    found = discrete_step(model, q, v, u, period)
    assert check(model, q, v, u, period, found) > model.nv


def test_commands_of_winches(tmp_path):
    model = balanced("winched", tmp_path)
    q, v, _, commands, _ = case(model, ())
    found = discrete_step(model, q, v, commands, 0.005, winches=True)
    assert found.B.any()
    assert check(model, q, v, commands, 0.005, found, winches=True) == 2 * model.nv + model.nu


def test_a_turning_base_has_jacobians_of_its_own(tmp_path):
    """With its speed of 20 rad/s over 30 ms the slopes of ⊕ are far from the identity."""
    for text in (FLOATING, GRIPPER):
        model = softdyn.load(write(tmp_path, text), floating=True)
        rng = np.random.default_rng(0)
        q, v = model.integrate(model.q0, rng.normal(size=model.nv)), rng.normal(size=model.nv)
        v[3:6] = 20 * rng.normal(size=3)
        u = np.zeros(model.nu)
        found = discrete_step(model, q, v, u, 0.03, stops=False)
        check(model, q, v, u, 0.03, found, stops=False)
        turn = found.A[3:6, 3:6] - np.eye(3)
        assert np.abs(turn).max() > 0.1


def test_it_solves_backward_euler(model):
    q, v, _, _, _ = case(model, ())
    u, h = np.zeros(model.nu), 0.005
    found = discrete_step(model, q, v, u, h, stops=False)
    if found.substeps == 1:
        np.testing.assert_allclose(found.q, model.integrate(q, h * found.v), atol=1e-12)
        state = model.state(found.q, found.v)
        left = state.M @ (found.v - v) / h + state.h - state.B @ u
        scale = np.abs(state.M).max() * np.abs(found.v - v).max() / h + np.abs(state.h).max()
        assert np.abs(left).max() < 1e-7 * scale


@pytest.mark.parametrize("name", ["finger", "helix", "spirob"])
def test_full_inputs_and_violent_states_always_have_a_step(name):
    """A quarter of the joints begin at stops; speeds up to 100 ranges a second."""
    model, rng, divided = softdyn.load(name), np.random.default_rng(0), 0
    n, size = model.nv, model.upper - model.lower
    for _ in range(60):
        share, at_stop = rng.random((2, n))
        share = np.where(at_stop < 0.125, 0.0, np.where(at_stop < 0.25, 1.0, share))
        q = model.configuration(model.lower + share * size)
        v, period = 10 ** rng.uniform(-1, 2) * size * rng.normal(size=n), 10 ** rng.uniform(-3, -2)
        u = np.where(rng.random(model.nu) < 0.5, model.u_min, model.u_max)
        found = discrete_step(model, q, v, u, period)
        divided += found.substeps > 1
        at = model.coordinates(found.q)
        assert ((model.lower - 1e-9 <= at) & (at <= model.upper + 1e-9)).all()
        limits = np.where(found.held > 0, model.upper, model.lower)
        np.testing.assert_allclose(at[found.held != 0], limits[found.held != 0], atol=1e-9)
        assert np.isfinite(found.A).all()
        assert np.isfinite(found.B).all()
        if found.substeps == 1:
            terms = ForceBalance(model, motors=())(found.q, found.v, (found.v - v) / period, u)
            rounding = 1e-9 * (np.abs(terms.by_a) @ np.abs(found.v - v) / period).max()
            assert np.abs(terms.residual[found.held == 0]).max(initial=0) < rounding
            assert (terms.residual * found.held < rounding).all()
    assert divided > 0 or name != "helix"


def test_jacobians_of_divided_steps_follow_the_chain_rule():
    """Of a helix at full inputs from violent states, where one step has no solution."""
    model, rng, compared = softdyn.load("helix"), np.random.default_rng(5), 0
    n, size = model.nv, model.upper - model.lower
    for _ in range(40):
        q = model.configuration(model.lower + rng.random(n) * size)
        v = 10 * size * rng.normal(size=n)
        u = np.where(rng.random(model.nu) < 0.5, model.u_min, model.u_max)
        found = discrete_step(model, q, v, u, 0.01)
        if found.substeps == 1 or found.substeps > 6:
            continue
        h, axis = 1e-6, rng.normal(size=n)
        ends = [discrete_step(model, q, v + s * h * axis, u, 0.01) for s in (1, -1)]
        if any(e.substeps != found.substeps or (e.held != found.held).any() for e in ends):
            continue
        slope = (ends[0].v - ends[1].v) / (2 * h)
        if np.abs(slope - found.A[n:, n:] @ axis).max() <= 1e-5 * np.abs(slope).max():
            compared += 1
    assert compared > 0


def test_without_stops_joints_pass_their_limits():
    model = softdyn.load("finger")
    v, u = np.full(4, 50.0), np.zeros(2)
    q = model.upper - 1e-3
    held = discrete_step(model, q, v, u, 0.01)
    assert held.held.any()
    assert (held.q <= model.upper + 1e-9).all()
    free = discrete_step(model, q, v, u, 0.01, stops=False)
    assert not free.held.any()
    assert (free.q > model.upper).any()


def test_no_motion_is_an_error_that_has_the_state():
    model = softdyn.load("finger")
    v = np.full(4, 1e200)
    with pytest.raises(StepError) as caught:
        discrete_step(model, model.q0, v, np.array([0.1, -0.1]), 0.01, stops=False)
    error = pickle.loads(pickle.dumps(caught.value))
    np.testing.assert_array_equal(error.u, [0.1, -0.1])
    assert error.q.shape == error.v.shape == error.residual.shape == (4,)
    assert "\n" not in str(error)


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("q", {"q": [0.0]}), ("q", {"q": [np.nan] * 4}), ("v", {"v": [0.0] * 5}),
        ("u", {"u": [np.inf, 0]}), ("period", {"period": 0.0}), ("period", {"period": -0.01}),
        ("period", {"period": np.nan}), ("stops", {"stops": "hard"}),
        ("model", {"model": "finger"}),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(name, given):
    model = softdyn.load("finger")
    right = {"model": model, "q": model.q0, "v": np.zeros(4), "u": np.zeros(2), "period": 0.01}
    with pytest.raises(InputError) as caught:
        discrete_step(**(right | given))
    assert caught.value.name == name
    assert "\n" not in str(caught.value)
