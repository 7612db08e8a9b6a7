"""The step over a period: A and B against differences, its equation, stops, sub-steps, errors."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn import InputError, SoftModel
from softdyn.actuation import CommandKind, Winches
from softdyn.actuation.drives import Drives
from softdyn.dynamics import ForceBalance, StepError, discrete_step
from tests.support.arms import PROJECTIONS
from tests.support.named_models import case, named_model
from tests.support.robots import GRIPPER, WALKER, write
from tests.support.step_differences import differences

MODELS = ("finger", "spirob", "slack", "winched", *PROJECTIONS, "walker", "wrapped")


@pytest.fixture(params=MODELS, ids=str)
def model(request, tmp_path) -> SoftModel:
    return named_model(request.param, tmp_path)


def check(model, q, v, u, period, found, **settings):
    """Compare; the number of columns whose neighbours all hold the same joints."""
    n = model.nv
    expected = differences(model, q, v, u, period, found, **settings)
    right, kept = np.hstack((found.A, found.B)), np.isfinite(expected).all(0)
    for rows in (slice(0, n), slice(n, None)):
        for columns in (slice(0, n), slice(n, 2 * n), slice(2 * n, None)):
            block, use = right[rows, columns], kept[columns]
            error = np.abs(block - expected[rows, columns])[:, use].max(initial=0.0)
            assert error <= 1e-7 * max(np.abs(block).max(initial=0.0), 1e-3), (rows, columns, error)
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
    model = named_model("winched", tmp_path)
    q, v, _, commands, _ = case(model, ())
    found = discrete_step(model, q, v, commands, 0.005, winches=True)
    assert found.B.any()
    assert check(model, q, v, commands, 0.005, found, winches=True) == 2 * model.nv + model.nu


def with_motors(folder, **fields) -> SoftModel:
    """An arm with a winch and a force motor, with these fields of both."""
    robot = named_model("winched", folder).robot
    changed = tuple(
        replace(one, **{name: values[k] for name, values in fields.items()})
        for k, one in enumerate(robot.actuators)
    )
    return softdyn.build(replace(robot, actuators=changed))


MOTORS = {
    "lags": {},
    "none": {"lag": (0.0, 0.0)},
    "bounded rates": {"rate": (0.5, 40.0), "lag": (0.0, 0.01)},
    "far from their rates": {"rate": (1e4, 1e6)},
    "speed": {"command": (CommandKind.VELOCITY, CommandKind.FORCE), "lag": (0.0, 0.01)},
    "late speed": {"command": (CommandKind.VELOCITY, CommandKind.FORCE), "rate": (3.0, np.inf)},
}


@pytest.mark.parametrize("fields", MOTORS.values(), ids=MOTORS)
def test_states_of_motors(fields, tmp_path):
    """A and B of (q, v, acting) against differences, and the values against the drives' law."""
    model = with_motors(tmp_path, **fields)
    q, v, _, commands, _ = case(model, ())
    begin = discrete_step(model, q, v, commands, 1e-4, motors=True).acting
    target = commands + np.array([-0.003, 2.0])
    if model.robot.speeds[0]:
        target[0] = -0.2
    found = discrete_step(model, q, v, target, 0.005, motors=True, acting=begin)
    size = 2 * model.nv + len(begin)
    assert found.A.shape == (size, size)
    assert found.B.shape == (size, model.nu)

    drives = Drives([one.lag for one in model.robot.actuators], [0, 0],
                    [one.rate for one in model.robot.actuators], Winches(model),
                    model.robot.speeds)  # fmt: skip
    drives.reset(model.state(q, v), model.relaxed, 0.0)
    drives.begin(commands, 0.0)
    drives.over(0.0, 1e-4)
    drives.send(1e-4, target)
    mean = drives.over(1e-4, 0.0051)
    plain = discrete_step(model, q, v, mean, 0.005, winches=True)
    np.testing.assert_allclose(found.q, plain.q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.acting[: model.nu], drives.commands, rtol=1e-12)

    expected = differences(model, q, v, target, 0.005, found, begin)
    right = np.hstack((found.A, found.B))
    assert np.isfinite(expected).all()
    assert np.abs(expected - right).max() < 1e-7 * np.abs(right).max()


def test_motors_are_followed_through_divided_steps():
    """A helix whose motors lag: the motors' states do not depend on how often a step is divided."""
    robot = softdyn.load("helix").robot
    lagging = tuple(replace(one, lag=0.02) for one in robot.actuators)
    model = softdyn.build(replace(robot, actuators=lagging))
    rng, divided = np.random.default_rng(5), 0
    n, size = model.nv, model.upper - model.lower
    for _ in range(20):
        q, v = (
            model.configuration(model.lower + rng.random(n) * size),
            10 * size * rng.normal(size=n),
        )
        u = np.where(rng.random(model.nu) < 0.5, model.u_min, model.u_max)
        found = discrete_step(model, q, v, u, 0.01, motors=True, acting=np.zeros(model.nu))
        divided += found.substeps > 1
        np.testing.assert_allclose(found.acting, u * -np.expm1(-0.5), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(found.B[2 * n :], -np.expm1(-0.5) * np.eye(model.nu), atol=1e-12)
    assert divided


def test_a_turning_base_has_jacobians_of_its_own(tmp_path):
    """With its speed of 20 rad/s over 30 ms the slopes of ⊕ are far from the identity."""
    for text in (WALKER, GRIPPER):
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
    """A helix has full inputs and violent states, where one step has no solution."""
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
        ("model", {"model": "finger"}), ("motors", {"motors": 1}), ("winches", {"winches": "yes"}),
        ("acting", {"acting": [0.0, 0.0]}), ("acting", {"motors": True, "acting": [0.0]}),
        ("parameters", {"motors": True, "parameters": ["stiffness"]}),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(name, given):
    model = softdyn.load("finger")
    right = {"model": model, "q": model.q0, "v": np.zeros(4), "u": np.zeros(2), "period": 0.01}
    with pytest.raises(InputError) as caught:
        discrete_step(**(right | given))
    assert caught.value.name == name
    assert "\n" not in str(caught.value)
