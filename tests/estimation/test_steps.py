"""The balance of forces and the implicit step against the model's own terms and differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import softdyn
from softdyn.actuation import Winches
from softdyn.description.rig import Sensor, SensorKind
from softdyn.description.robot import Joint, Link
from softdyn.description.urdf_writer import write as urdf
from softdyn.dynamics.derivatives import residual_derivatives
from softdyn.dynamics.projection import Projection
from softdyn.estimation import Disturbance
from softdyn.estimation.balance import ForceBalance
from softdyn.estimation.implicit_step import ImplicitStep, ImplicitStepResult
from softdyn.estimation.readings import Reader
from softdyn.estimation.second_order import second_order, sharp
from softdyn.loading import load_text
from softdyn.sensing import Sensors
from tests.support.arms import PROJECTIONS
from tests.support.micro import write
from tests.support.oracles import relative
from tests.support.rigged import slackened
from tests.support.winched import ARM

ALL = tuple(Disturbance)
ROBOTS = ("finger", "spirob", "slack", "winched", "mimic")


@pytest.fixture(params=ROBOTS)
def model(request, tmp_path):
    if request.param == "mimic":
        return PROJECTIONS["mimic"](tmp_path)
    if request.param == "winched":
        return softdyn.load(write(tmp_path, ARM))
    return slackened(softdyn.load("spirob")) if request.param == "slack" else softdyn.load(
        request.param
    )  # fmt: skip


def case(model, seed=1):
    rng = np.random.default_rng(seed)
    q = model.configuration(
        rng.uniform(np.maximum(model.lower, -0.4), np.minimum(model.upper, 0.4))
    )
    v, a = rng.normal(size=(2, model.nv))
    u = rng.uniform(np.maximum(model.u_min, -3), np.minimum(model.u_max, 3))
    d = 0.1 * rng.normal(size=sum(one.size(model) for one in ALL))
    return q, v, a, Winches(model).commands(model.state(q, v), u), d


def test_balance(model):
    q, v, a, commands, d = case(model)
    balance, state = ForceBalance(model, ALL), model.state(q, v)
    terms = [np.array(part) for part in balance(q, v, a, commands, 0 * d)]
    u = Winches(model).tensions(state, commands)
    scale = np.abs(state.M @ a).max() + np.abs(state.h).max()
    assert relative(terms[0], state.M @ a + state.h - state.B @ u, scale) < 1e-12
    assert relative(terms[3], state.M) < 1e-12
    assert np.allclose(terms[6], u, atol=1e-12)
    if not Winches(model).winds.any():
        by_q, by_v = residual_derivatives(model, q, v, a, u)
        assert relative(terms[1], by_q) < 1e-10
        assert relative(terms[2], by_v) < 1e-10
    terms = [np.array(part) for part in balance(q, v, a, commands, d)]
    n, h = model.nv, 1e-5

    def residual(dq, dv, dd, dc):
        point = model.integrate(q, dq), v + dv, a, commands + dc, d + dd
        return np.array(balance(*point).residual)

    for k, block in enumerate((terms[1], terms[2], terms[4], terms[5])):
        zero = [np.zeros(n), np.zeros(n), np.zeros(len(d)), np.zeros(model.nu)]
        columns = []
        for axis in np.eye(block.shape[1]):
            ends = [residual(*(*zero[:k], s * h * axis, *zero[k + 1 :])) for s in (1, -1)]
            columns.append((ends[0] - ends[1]) / (2 * h))
        assert relative(np.array(columns).T, block) < 1e-7, k


def test_disturbances_are_forces(model):
    """A tip force is Jᵀ f, a payload a link of the file, the springs' terms the file's springs."""
    q, v, a, commands, _ = case(model)
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


def chosen_sensors(model, point):
    robot = model.robot
    chosen = [Sensor(one.name, SensorKind.LENGTH, tendon=one.name) for one in robot.tendons]
    chosen += [
        Sensor(link, SensorKind.POSITION, link=link, xyz=point)
        for link in (robot.links[len(robot.links) // 2].name, robot.task)
    ]
    chosen += [Sensor(name, SensorKind.JOINT, joint=name) for name in model.joint_names[:2]]
    return tuple(chosen)


def test_readings(model):
    """The kernel's readings are those of `Sensors`, with their Jacobians."""
    q, v, *_ = case(model)
    u = np.clip(0.3, model.u_min, model.u_max)
    chosen = chosen_sensors(model, (0.01, 0.02, 0.03))
    found = Reader(model, chosen)(q, v, u)
    expected = Sensors(model, chosen).measure(model.state(q, v), u)
    assert np.allclose(found.values, expected.values, atol=1e-14)
    assert np.allclose(found.jacobian, expected.jacobian, atol=1e-14)


@settings(
    max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.integers(0, 10**6), st.tuples(*[st.floats(-0.1, 0.1)] * 3))
def test_second_derivatives(model, seed, point):
    """Central differences of the Jacobian, and second differences along one direction."""
    q, v, *_ = case(model, seed)
    u, n, h = np.clip(0.3, model.u_min, model.u_max), model.nv, 1e-5
    read = Reader(model, chosen_sensors(model, point))
    ends = (
        [read(model.integrate(q, x), v, u).jacobian[:, :n].copy() for x in (step, -step)]
        for step in h * np.eye(n)
    )
    expected = np.stack([a - b for a, b in ends], axis=2) / (2 * h)
    assert relative(read.hessians(q, v, u), expected) < 1e-7
    x = 1e-3 * np.random.default_rng(seed).normal(size=n)
    for one in (read, Reader(model, (Sensor("pose", SensorKind.POSE, link=model.robot.task),))):
        here, errors = one(q, v, u).values.copy(), one.components.errors
        ends = [errors(here, one(model.integrate(q, s * x), v, u).values) for s in (1, -1)]
        assert relative(one.hessians(q, v, u) @ x @ x, np.sum(ends, axis=0)) < 1e-4


def test_second_order_is_the_mean_and_variance_of_a_spread_state():
    model, rng = softdyn.load("finger"), np.random.default_rng(0)
    q, v, u = np.array([0.4, -0.3, 0.5, 0.6]), np.zeros(4), np.zeros(2)
    read = Reader(model, (Sensor("tip", SensorKind.POSITION, link=model.robot.task),))
    spread = 0.03 * (np.eye(4) + 0.3)
    P, own = np.zeros((8, 8)), np.full(3, 1e-9)
    P[:4, :4] = spread @ spread.T
    assert not sharp(read(q, v, u).jacobian, P, own)
    assert sharp(read(q, v, u).jacobian, 1e-9 * P, own)
    shift, variance = second_order(read, (q, v, u), P, own)
    here, by_q = (part.copy() for part in read(q, v, u))
    moved = rng.normal(size=(20_000, 4)) @ spread
    rest = np.array([read(q + x, v, u).values - here - by_q[:, :4] @ x for x in moved])
    assert np.allclose(shift, rest.mean(axis=0), rtol=0.03, atol=1e-6)
    assert np.allclose(variance - own, rest.var(axis=0), rtol=0.06, atol=1e-9)


def test_step(model):
    q, v, _, commands, d = case(model)
    n, step, h, free = model.nv, 0.002, 2e-5, np.zeros(model.nv, int)
    stepper, balance = ImplicitStep(model, ALL), ForceBalance(model, ALL)
    found = ImplicitStepResult(*(part.copy() for part in stepper(q, v, commands, d, step, free)))
    left = balance(found.q, found.v, (found.v - v) / step, commands, d).residual
    assert not found.held.any()
    assert np.abs(left).max() < 1e-7 * np.abs(balance(q, v, 0 * v, commands, d).residual).max()
    assert np.allclose(found.q, model.integrate(q, step * found.v))

    def speed(x):
        return stepper(
            model.integrate(q, x[:n]), v + x[n : 2 * n], commands, d + x[2 * n :], step, free
        ).v.copy()

    by_state = np.array([
        (8 * (speed(h * axis) - speed(-h * axis)) - speed(2 * h * axis) + speed(-2 * h * axis))
        / (12 * h) for axis in np.eye(2 * n + len(d))
    ]).T  # fmt: skip
    assert relative(by_state, found.by_state) < 1e-6
    pushes = found.by_state[:, 2 * n :]
    by_d = ForceBalance(model, ALL)(found.q, found.v, (found.v - v) / step, commands, d).by_d
    assert relative(pushes, -found.by_force @ by_d) < 1e-6


def test_stops_hold_and_release():
    """A joint pressed against its stop stays on it; its stop never pulls."""
    model = softdyn.load("helix")
    stepper, balance = ImplicitStep(model), ForceBalance(model)
    q, v, held = model.q0.copy(), np.zeros(model.nv), np.zeros(model.nv, int)
    u = np.where(np.arange(model.nu) < 3, model.u_max, 0.0)
    met = set()
    for k in range(300):
        if k == 150:
            u = np.zeros(model.nu)
        found = stepper(q, v, u, np.zeros(0), 0.001, held)
        force = balance(found.q, found.v, (found.v - v) / 0.001, u, np.zeros(0)).residual
        free = found.held == 0
        assert np.all(found.q <= model.upper + 1e-9)
        assert np.all(found.q >= model.lower - 1e-9)
        assert np.all(force[~free] * found.held[~free] <= 1e-6)
        assert np.allclose(force[free], 0, atol=1e-5)
        limits = np.where(found.held > 0, model.upper, model.lower)
        assert np.allclose(found.q[~free], limits[~free], atol=1e-9)
        # a held joint's position no longer depends on the state before
        row = found.by_state[:, : model.nv] * 0.001 + np.eye(model.nv)
        assert np.allclose(row[~free], 0, atol=1e-9)
        q, v, held = found.q, found.v, found.held
        met |= {(int(i), int(held[i])) for i in np.flatnonzero(held)}
    assert len(met) >= 3
    assert len({i for i, _ in met} - set(np.flatnonzero(held))) >= 1
