"""The balance of forces against the State, central differences, and files with its loads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn import SoftModel
from softdyn.actuation import Winches
from softdyn.description.rig import CommandKind
from softdyn.description.robot import Joint, Link
from softdyn.description.urdf_writer import write as urdf
from softdyn.dynamics.balance import BalanceTerms, Disturbance, ForceBalance
from softdyn.dynamics.projection import Projection
from softdyn.loading import load_text
from tests.support import cart
from tests.support.arms import PROJECTIONS
from tests.support.named_models import BALANCED, case, named_model
from tests.support.oracles import relative, slopes
from tests.support.refused import refused

BAR = 1e-7
ALL = tuple(Disturbance)
# of the random robots: continuous and prismatic joints, elastic, damped, branching tendons
SOURCES = (
    *BALANCED, "helix", *range(8), "wound 12", "wound 23", "slack 16", "walker",
    "walking gripper", *(name for name in PROJECTIONS if name not in BALANCED),
)  # fmt: skip


@pytest.fixture(params=SOURCES, ids=str)
def everything(request, tmp_path) -> SoftModel:
    return named_model(request.param, tmp_path)


@pytest.fixture(params=BALANCED, ids=str)
def model(request, tmp_path) -> SoftModel:
    return named_model(request.param, tmp_path)


def test_terms(everything):
    """r and M of the State, u of the winches."""
    model = everything
    q, v, a, commands, d = case(model, ALL)
    state, found = model.state(q, v), ForceBalance(model, ALL)(q, v, a, commands, 0 * d)
    u = Winches(model).tensions(state, commands)
    scale = np.abs(state.M @ a).max() + np.abs(state.h).max()
    assert relative(found.residual, state.M @ a + state.h - state.B @ u, scale) < 1e-12
    assert relative(found.by_a, state.M) < 1e-12
    assert np.allclose(found.inputs, u, atol=1e-12)
    forces = ForceBalance(model, motors=())(q, v, a, u)
    assert relative(forces.residual, found.residual, scale) < 1e-12
    assert relative(forces.by_commands, -state.B) < 1e-12
    assert forces.by_d.shape == (model.nv, 0)
    np.testing.assert_array_equal(forces.inputs, u)


@pytest.mark.parametrize("motors", [None, ()], ids=["commands", "forces"])
def test_jacobians(everything, motors):
    """Central differences, extrapolated (Richardson), with all disturbances."""
    model = everything
    q, v, a, commands, d = case(model, ALL)
    balance = ForceBalance(model, ALL, motors)
    if motors == ():
        commands = Winches(model).tensions(model.state(q, v), commands)
    found = balance(q, v, a, commands, d)
    n, h = model.nv, 2e-5

    def residual(dq, dv, da, dc, dd):
        return balance(model.integrate(q, dq), v + dv, a + da, commands + dc, d + dd).residual

    zero = [np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(model.nu), np.zeros(len(d))]
    for k, name in enumerate(("by_q", "by_v", "by_a", "by_commands", "by_d")):
        block = getattr(found, name)
        moved = lambda x, k=k: residual(*zero[:k], x, *zero[k + 1 :])  # noqa: E731
        if block.size:
            assert relative(slopes(moved, block.shape[1], h), block, 1e-3) < BAR, name


def test_results_are_new(model):
    """The next call leaves them alone, and so does another robot of the same model."""
    q, v, a, commands, d = case(model, ALL)
    balance = ForceBalance(model, ALL)
    found = balance(q, v, a, commands, d)
    kept = BalanceTerms(*(part.copy() for part in found))
    ForceBalance(model)(q, 0 * v, 0 * a, commands)
    balance(q, -v, -a, commands, -d)
    for name in BalanceTerms._fields:
        np.testing.assert_array_equal(getattr(found, name), getattr(kept, name), err_msg=name)


@pytest.mark.parametrize(
    "wrong", [("q", [0.0] * 3), ("v", [np.nan] * 4), ("a", "x"), ("commands", [0.0]), ("d", [1.0])]
)
def test_wrong_arguments(wrong):
    given = {"q": np.zeros(4), "v": np.zeros(4), "a": np.zeros(4), "commands": np.zeros(2)}
    name, value = wrong
    with refused(name):
        ForceBalance(softdyn.load("finger"))(**(given | {name: value}))


def test_disturbances_are_forces(model):
    """A tip force is Jᵀ f, a payload a link of the file, the springs' terms the file's springs."""
    q, v, a, commands, _ = case(model, ALL)
    state, none = model.state(q, v), ForceBalance(model)(q, v, a, commands, np.zeros(0))
    without = none.residual.copy()
    force, mass = np.array([0.3, -0.2, 0.5]), 0.04
    found = ForceBalance(model, ALL[:1])(q, v, a, commands, force)
    assert np.allclose(without - found.residual, state.J.T @ force)
    found = ForceBalance(model, ALL[1:2])(q, v, a, commands, np.array([-mass]))
    assert np.allclose(without - found.residual, state.J[2] * 9.81 * mass)
    if isinstance(model, Projection):
        return
    robot = model.robot
    links = (*robot.links, Link("payload", mass=mass))
    fixed = Joint("held", "fixed", robot.task, "payload")
    text = urdf(replace(robot, links=links, joints=(*robot.joints, fixed)))
    loaded = load_text(text, path=robot.path)
    found = ForceBalance(model, ALL[1:2])(q, v, a, commands, np.array([mass]))
    expected = ForceBalance(loaded)(q, v, a, commands, np.zeros(0))
    for name in ("residual", "by_q", "by_v", "by_a"):
        assert np.allclose(getattr(found, name), getattr(expected, name), atol=1e-12), name
    joints = tuple(
        replace(joint, stiffness=1.3 * joint.stiffness, rest=joint.rest + 0.1)
        if joint.kind in ("revolute", "prismatic") else joint for joint in model.robot.joints
    )  # fmt: skip
    changed = softdyn.build(replace(model.robot, joints=joints))
    d = np.array([0.3, *np.full(model.nv, 0.1)])
    found = ForceBalance(model, ALL[2:])(q, v, a, commands, d)
    assert np.allclose(
        found.residual, ForceBalance(changed)(q, v, a, commands, np.zeros(0)).residual
    )


def test_a_winch_and_a_spring_in_series():
    """-s x = k (x - c): the tension is s k |c| / (s + k) at the free length c."""
    s, k, c = 8.0, 40.0, -0.3
    robot = cart.cart(0, 30, damping=1.0, stiffness=s).robot
    (motor,) = robot.actuators
    motor = replace(motor, gear=-0.5, command=CommandKind.LENGTH, stiffness=k, damping=3.0)
    model = softdyn.build(replace(robot, actuators=(motor,)))
    found = ForceBalance(model)(model.q0, [0.0], [0.0], [c])
    assert found.by_q[0, 0] == pytest.approx(s + k, rel=1e-12)
    assert found.by_v[0, 0] == pytest.approx(1.0 + 3.0, rel=1e-12)
    assert found.by_commands[0, 0] == pytest.approx(-k, rel=1e-12)
    x = -found.residual / found.by_q[0, 0]  # the equations are linear
    tension = s * k * 0.3 / (s + k)
    assert x == pytest.approx([-tension / s], rel=1e-12)
    there = ForceBalance(model)(x, [0.0], [0.0], [c])
    assert there.residual == pytest.approx([0.0], abs=1e-12)
    assert 0.5 * there.inputs == pytest.approx([tension], rel=1e-12)
    slack = ForceBalance(model)(model.q0, [0.0], [0.0], [0.1])
    assert slack.inputs == 0
    assert not slack.by_commands.any()
    assert slack.by_q[0, 0] == pytest.approx(s, rel=1e-12)
