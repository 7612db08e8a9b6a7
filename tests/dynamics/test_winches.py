"""Winches against closed forms and central differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn import SoftModel
from softdyn.actuation import Winches
from softdyn.description.rig import CommandKind
from softdyn.dynamics.integrators import step_implicit
from tests.support.arms import PROJECTIONS
from tests.support.cart import cart as on_a_spring
from tests.support.named_models import named_model
from tests.support.oracles import relative, slopes
from tests.support.refused import refused
from tests.support.rigs import wound

BAR = 1e-7
SEEDS = (1, 12, 16, 19, 23)  # with inputs on fixed and spatial tendons


@pytest.fixture(params=[*SEEDS, "spirob", *PROJECTIONS], ids=str)
def model(request, tmp_path) -> SoftModel:
    return wound(named_model(request.param, tmp_path))


def cases(model: SoftModel, count: int = 3):
    """States and commands: winches that pull with about 0.3 to 5 N, forces within bounds."""
    rng, winches = np.random.default_rng(1), Winches(model)
    low, high = np.maximum(model.lower, -0.8), np.minimum(model.upper, 0.8)
    for _ in range(count):
        q, v = model.configuration(rng.uniform(low, high)), 0.3 * rng.normal(size=model.nv)
        middle = 0.5 * (model.u_min + model.u_max)
        u = middle + rng.uniform(-0.4, 0.4, model.nu) * (model.u_max - model.u_min)
        yield q, v, u, winches.commands(model.state(q, v), u)


def test_the_inverse(model):
    winches = Winches(model)
    for q, v, u, commands in cases(model):
        state = model.state(q, v)
        np.testing.assert_allclose(winches.tensions(state, commands), u, atol=1e-11)
        tendons = [model.tendons.names.index(a.tendon) for a in model.robot.actuators]
        taut = state.lengths[tendons] - commands
        taut = winches.stiffness * taut + winches.damping * (state.moment_arms[tendons] @ v)
        gears = np.array([a.gear for a in model.robot.actuators])
        np.testing.assert_allclose(taut, np.where(winches.winds, -gears * u, 0.0), atol=1e-11)
        np.testing.assert_array_equal(commands[~winches.winds], u[~winches.winds])


def test_derivatives(model):
    winches = Winches(model)
    for q, v, u, c in cases(model, 2):
        state = model.state(q, v)
        at, rates = state.lengths, state.moment_arms @ v
        found = winches.inputs(at, rates, c)
        np.testing.assert_allclose(found.u, u, atol=1e-11)
        chosen = np.eye(len(at))[winches.tendon]
        given = at, rates, c
        for k, by in enumerate((found.by_length, found.by_rate, found.by_command)):

            def f(x, k=k, given=given):
                return winches.inputs(*given[:k], given[k] + x, *given[k + 1 :]).u

            columns = by[:, None] * (np.eye(model.nu) if k == 2 else chosen)
            assert relative(slopes(f, len(given[k]), 1e-5), columns) <= BAR


SPRING = 8.0


def cart(**winch: float) -> SoftModel:
    """A cart on a spring, with a winch that pulls it towards -x."""
    robot = on_a_spring(0, 30, damping=1.0, stiffness=SPRING).robot
    (motor,) = robot.actuators
    defaults = {"gear": -0.5, "command": CommandKind.LENGTH, "stiffness": 40.0}
    return softdyn.build(replace(robot, actuators=(replace(motor, **{**defaults, **winch}),)))


def test_static_tension_is_that_of_two_springs_in_series():
    """-s x = k (x - c): the tension is s k |c| / (s + k) at the free length c."""
    model, c = cart(damping=3.0), -0.3
    winches, tension = Winches(model), SPRING * 40.0 * 0.3 / (SPRING + 40.0)
    x = np.array([-tension / SPRING])
    u = winches.tensions(model.state(x, [0.0]), [c])
    assert 0.5 * u == pytest.approx([tension], rel=1e-12)
    assert model.forward_dynamics(x, [0.0], u) == pytest.approx([0.0], abs=1e-12)
    q, v = model.q0, np.zeros(1)
    for _ in range(1600):
        q, v = step_implicit(model, q, v, winches.tensions(model.state(q, v), [c]), 5e-3)
    assert q == pytest.approx(x, rel=1e-9)


def test_bounds():
    """A slack cable and a saturated input do not change with q, q̇ and the command."""
    model = cart(damping=3.0, length_lower=-0.1, length_upper=0.4)
    winches = Winches(model)
    state = model.state([0.2], [0.1])
    for command, u in ((0.3, 0.0), (-2.0, 30.0)):  # tensions -3.7 and 88.3 N
        found = winches.inputs(state.lengths, state.moment_arms @ state.v, [command])
        assert found.u == winches.tensions(state, [command]) == u
        assert not np.any([found.by_length, found.by_rate, found.by_command])
    just_slack = winches.commands(state, [0.0])
    assert just_slack == pytest.approx([0.2 + 3.0 * 0.1 / 40])
    assert winches.tensions(state, just_slack) == pytest.approx([0.0], abs=1e-14)
    assert winches.tensions(state, just_slack + 1e-9) == 0
    assert winches.commands(state, [30.0]) == -0.1  # 0.2 m + (0.3 - 15) N / (40 N/m) is shorter
    assert winches.commands(model.state([0.9], [0.0]), [0.0]) == 0.4
    np.testing.assert_array_equal(winches.lower, [-0.1])
    np.testing.assert_array_equal(winches.upper, [0.4])


def test_an_offset_is_added_to_a_command_of_length():
    """T = k (ℓ - c - z): 40 N/m times 0.2 + 0.1 - 0.02 m; the bounds are of c + z."""
    bounds = {"length_lower": -0.3, "length_upper": 0.4}
    model = cart(offset=0.02, **bounds)
    winches, state = Winches(model), model.state([0.2], [0.0])
    assert winches.tensions(state, [-0.1]) == pytest.approx([40.0 * 0.28 / 0.5], rel=1e-12)
    assert winches.commands(state, [40.0 * 0.28 / 0.5]) == pytest.approx([-0.1], rel=1e-12)
    np.testing.assert_array_equal(winches.lower, [-0.3 - 0.02])
    assert winches.commands(model.state([0.9], [0.0]), [0.0]) == 0.4 - 0.02
    speed = cart(offset=0.02, command=CommandKind.VELOCITY, **bounds)
    np.testing.assert_array_equal(Winches(speed).offset, [0.0])


def test_a_robot_without_winches_has_its_commands_as_inputs():
    model = softdyn.load("helix")
    winches, state = Winches(model), model.state(model.q0, np.zeros(model.nv))
    u = np.linspace(0, 1, model.nu)
    for found in (winches.tensions(state, u), winches.commands(state, u)):
        np.testing.assert_array_equal(found, u)
    found = winches.inputs(state.lengths, 0 * state.lengths, u)
    np.testing.assert_array_equal(found.by_command, np.ones(model.nu))
    assert not found.by_length.any()
    np.testing.assert_array_equal(winches.lower, model.u_min)


def test_wrong_arguments():
    model = softdyn.load("finger")
    winches, state = Winches(model), model.state(model.q0, np.zeros(4))
    with refused("commands"):
        winches.tensions(state, [1.0])
    with refused("commands"):
        winches.tensions(state, [1.0, np.nan])
    with refused("state"):
        winches.commands(model.q0, [0.0, 0.0])
    with refused("model"):
        Winches("finger")


def test_a_state_of_another_robot_is_refused():
    """Also of one with the same sizes; a copy of the same description is no other robot."""
    model, spirob = softdyn.load("finger"), softdyn.load("spirob")
    winches = Winches(model)
    tendons = tuple(replace(tendon, stiffness=5.0) for tendon in model.robot.tendons)
    for other in (spirob, softdyn.build(replace(model.robot, tendons=tendons))):
        state = other.state(other.q0, np.zeros(other.nv))
        for use in (winches.tensions, winches.commands):
            with refused("state"):
                use(state, np.zeros(2))
    again = softdyn.load("finger")
    assert not winches.tensions(again.state(again.q0, np.zeros(4)), np.zeros(2)).any()
