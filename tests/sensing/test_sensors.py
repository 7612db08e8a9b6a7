"""Sensors against closed forms, Pinocchio's kinematics of the links, and central differences."""

from __future__ import annotations

import math
import pickle
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import softdyn
from softdyn import SoftModel
from softdyn.actuation import Winches
from softdyn.description.rig import Sensor, SensorKind
from softdyn.dynamics.projection import underlying_tree
from softdyn.sensing import Sensors
from tests.support.arms import PROJECTIONS
from tests.support.cart import cart
from tests.support.named_models import named_model
from tests.support.oracles import relative, slopes
from tests.support.refused import refused
from tests.support.rigs import measured, wound
from tests.support.robots import WALKER, write

BAR = 1e-7
SEEDS = (1, 12, 16, 19, 23)
KIND = SensorKind


@pytest.fixture(params=[*SEEDS, "helix", "walker", "walking gripper", *PROJECTIONS], ids=str)
def model(request, tmp_path) -> SoftModel:
    return measured(named_model(request.param, tmp_path))


def case(model: SoftModel, seed: int = 3):
    """A state away from the edge between taut and slack tendons, and an input."""
    rng = np.random.default_rng(seed)
    low, high = np.maximum(model.lower, -0.8), np.minimum(model.upper, 0.8)
    while True:
        q, v = model.configuration(rng.uniform(low, high)), 0.5 * rng.normal(size=model.nv)
        state = model.state(q, v)
        force = model.tendon_stiffness * (state.lengths - model.tendon_rest)
        force += model.tendon_damping * (state.moment_arms @ v)
        if np.abs(force).min(initial=1.0) > 0.005:
            return q, v, rng.uniform(np.maximum(model.u_min, -5), np.minimum(model.u_max, 5))


def bent(model: SoftModel) -> tuple[Sensor, ...]:
    """Lengths, points of a link and of the tip, and joints."""
    robot = model.robot
    chosen = [Sensor(one.name, KIND.LENGTH, tendon=one.name) for one in robot.tendons]
    links = (robot.links[len(robot.links) // 2].name, robot.task)
    chosen += [Sensor(link, KIND.POSITION, link=link, xyz=(0.01, 0.02, 0.03)) for link in links]
    moving = [joint for joint in robot.moving_joints if joint.mimic is None]
    chosen += [Sensor(one.name, KIND.JOINT, joint=one.name) for one in moving[:2]]
    return tuple(chosen)


def test_predictions_are_the_measurements(model):
    """Without a State, to the bit of a sum's order."""
    q, v, u = case(model)
    for sensors in (Sensors(model), Sensors(model, bent(model))):
        expected = sensors.measure(model.state(q, v), u)
        values, jacobian = sensors.predict(q, v, u)
        np.testing.assert_allclose(values, expected.values, rtol=1e-12, atol=1e-13)
        assert relative(jacobian, expected.jacobian) < 1e-12


def test_second_derivatives(model):
    """Central differences of the Jacobian, and second differences along one direction."""
    q, v, u = case(model)
    n, sensors = model.nv, Sensors(model, bent(model))

    def by_q(dq):
        return sensors.predict(model.integrate(q, dq), v, u)[1][:, :n]

    found = sensors.hessians(q, v, u)
    expected = slopes(by_q, n, 1e-4)
    expected = 0.5 * (expected + expected.transpose(0, 2, 1))
    assert relative(found, expected) < BAR
    x = 1e-3 * np.random.default_rng(4).normal(size=n)
    pose = Sensors(model, (Sensor("pose", KIND.POSE, link=model.robot.task),))
    for one in (sensors, pose):
        here, errors = one.predict(q, v, u)[0], one.components.errors
        ends = [errors(here, one.predict(model.integrate(q, s * x), v, u)[0]) for s in (1, -1)]
        assert relative(one.hessians(q, v, u) @ x @ x, np.sum(ends, axis=0), x @ x) < 1e-4


def test_jacobians(model):
    q, v, u = case(model)
    here = model.measure(model.state(q, v), u)
    n = model.nv
    assert here.jacobian.shape == (len(here), 2 * n)
    assert here.jacobian_u.shape == (len(here), model.nu)

    def by_q(dq):
        return here.errors_of(model.measure(model.state(model.integrate(q, dq), v), u).values)

    def by_v(dv):
        return here.errors_of(model.measure(model.state(q, v + dv), u).values)

    def by_u(du):
        return here.errors_of(model.measure(model.state(q, v), u + du).values)

    found = slopes(by_q, n, 5e-5), slopes(by_v, n, 5e-5)
    inputs = slopes(by_u, model.nu, 1e-2) if model.nu else here.jacobian_u
    first = 0
    for sensor in model.robot.sensors:
        rows = slice(first, first + sensor.kind.size)
        first = rows.stop
        # an accelerometer's derivatives may be 1000 times its readings, so they count too
        scale = max(np.abs(here.values[rows]).max(), np.abs(here.jacobian[rows]).max(), 0.1)
        for numbers, exact in (
            (found[0][rows], here.jacobian[rows, :n]),
            (found[1][rows], here.jacobian[rows, n:]),
            (inputs[rows], here.jacobian_u[rows]),
        ):
            assert relative(numbers, exact, scale) <= BAR, sensor
    assert first == len(here)


def test_readings(model):
    """Kinematics of the links, and a point's acceleration by differences of its velocity."""
    q, v, u = case(model, 4)
    state = model.state(q, v)
    here = model.measure(state, u)
    qdd, h = model.forward_dynamics(q, v, u), 1e-4
    joints = underlying_tree(model)[0]
    expanded = q if model is joints else model.expand(q)
    readings, first = {}, 0
    for sensor in model.robot.sensors:
        readings[sensor.name] = here.values[first : first + sensor.kind.size]
        first += sensor.kind.size

    def frame(sensor, time):
        """Its position and orientation along the motion, to the second order in time."""
        q_then = model.integrate(q, time * v + time**2 / 2 * qdd)
        pose = model.link_poses(q_then)[sensor.link]
        origin = sensor.origin
        return (pose[:3, :3] @ origin.translation + pose[:3, 3], pose[:3, :3] @ origin.rotation)

    for sensor in model.robot.sensors:
        got = readings[sensor.name]
        if sensor.kind is KIND.LENGTH:
            assert got == state.lengths[model.tendons.names.index(sensor.tendon)]
        elif sensor.kind is KIND.JOINT:
            at = joints.joint_names.index(sensor.joint)
            assert got == joints.coordinates(expanded)[at]
        elif sensor.kind is KIND.BEND:
            poses, own = model.link_poses(q), sensor.origin.rotation
            begin, end = (poses[link][:3, :3] @ own for link in (sensor.link, sensor.to))
            across, along = end[:, 0] @ begin[:, 1], end[:, 0] @ begin[:, 0]
            assert got == pytest.approx(math.atan2(across, along), abs=1e-12)
        elif sensor.kind is not KIND.TENSION:
            p, R = frame(sensor, 0.0)
            (before, R0), (after, R1) = frame(sensor, -h), frame(sensor, h)
            scale = 1 + np.abs(qdd).max()
            if sensor.kind in (KIND.POSITION, KIND.POSE):
                np.testing.assert_allclose(got[:3], p, atol=1e-12)
            if sensor.kind is KIND.POSE:
                np.testing.assert_allclose(pin.exp3(got[3:]), R, atol=1e-12)
            if sensor.kind is KIND.GYRO:
                np.testing.assert_allclose(got, pin.log3(R0.T @ R1) / (2 * h), atol=1e-5 * scale)
            if sensor.kind is KIND.ACCELEROMETER:
                second = (after - 2 * p + before) / h**2
                expected = R.T @ (second + np.array([0, 0, 9.81]))
                np.testing.assert_allclose(got, expected, atol=1e-4 * scale)


def test_tensions_are_generalised_forces(model):
    """Σ -aᵀ T of all tendons is B u and the tendons' part of -(K + D q̇)."""
    q, v, u = case(model, 5)
    state = model.state(q, v)
    values, names = model.measure(state, u).values, model.measure(state, u).names
    tensions = np.array([values[names.index(f"tension {n}")] for n in model.tendons.names])
    tree, S = underlying_tree(model)
    bare = replace(tree.robot, tendons=tuple(
        replace(t, stiffness=0.0, damping=0.0, slack=False) for t in model.robot.tendons
    ))  # fmt: skip
    expanded = q if S is None else model.expand(q)
    free = softdyn.build(bare).state(expanded, v if S is None else S @ v)
    rest = free.D @ free.v + free.K
    rest = rest if S is None else S.T @ rest
    expected = state.B @ u - state.D @ v - state.K + rest
    scale = max(np.abs(state.K).max(), np.abs(rest).max(), 1.0)
    assert relative(-state.moment_arms.T @ tensions, expected, scale) < 1e-11


def test_errors_and_readings(model):
    q, v, u = case(model, 6)
    here = model.measure(model.state(q, v), u)
    disturbed = here.components.disturbed
    errors = np.random.default_rng(0).uniform(-1.5, 1.5, len(here))
    np.testing.assert_allclose(here.errors_of(disturbed(here.values, errors)), errors, atol=1e-12)
    np.testing.assert_allclose(disturbed(here.values, 0 * errors), here.values, atol=1e-12)
    np.testing.assert_array_equal(np.asarray(here), here.values)
    assert not here.jacobian.flags.writeable


def test_copies(model):
    here = model.measure(model.state(*case(model)[:2]), np.zeros(model.nu))
    for other in (deepcopy(here), pickle.loads(pickle.dumps(here))):
        np.testing.assert_array_equal(other.jacobian, here.jacobian)
        assert not other.values.flags.writeable
        assert other.names == here.names


def test_an_angle_s_error_is_the_short_way(tmp_path):
    model = measured(softdyn.load(write(tmp_path, WALKER), floating=True))
    names = model.joint_names
    turned = np.zeros(model.nv)
    turned[names.index("jz")] = 3.1
    here = model.measure(model.state(model.integrate(model.q0, turned), 0 * turned), [0.0])
    turned[names.index("jz")] = -3.1
    there = model.measure(model.state(model.integrate(model.q0, turned), 0 * turned), [0.0])
    k = here.names.index("encoder jz")
    assert here.errors_of(there.values)[k] == pytest.approx(2 * math.pi - 6.2)
    again = here.components.disturbed(here.values, here.errors_of(there.values))
    assert again[k] == pytest.approx(-3.1)


def test_a_cart_by_hand():
    """m ẍ = u - k x - d ẋ; an accelerometer on its side reads ẍ and +g upwards."""
    robot = cart().robot
    sensors = (
        Sensor("imu", KIND.ACCELEROMETER, link="body", rpy=(math.pi / 2, 0.0, 0.0)),
        Sensor("gyro", KIND.GYRO, link="body"),
        Sensor("camera", KIND.POSITION, link="tip", xyz=(0.0, 0.1, 0.2)),
        Sensor("cable", KIND.TENSION, tendon="cable"),
        Sensor("encoder", KIND.JOINT, joint="x"),
    )
    model = softdyn.build(replace(robot, sensors=sensors))
    x, v, u = 0.2, -0.5, 3.0
    here = model.measure(model.state([x], [v]), [u])
    a = (u - 8.0 * x - 0.3 * v) / 0.5
    assert here.names == (
        "imu.x", "imu.y", "imu.z", "gyro.x", "gyro.y", "gyro.z",
        "camera.x", "camera.y", "camera.z", "cable", "encoder",
    )  # fmt: skip
    expected = [a, 9.81, 0, 0, 0, 0, x + 0.4, 0.1, 0.2, -u, x]
    np.testing.assert_allclose(here.values, expected, atol=1e-12)
    np.testing.assert_allclose(here.jacobian[0], [-16.0, -0.6], rtol=1e-12)
    np.testing.assert_allclose(here.jacobian_u[:, 0], [2, *[0] * 8, -1, 0], atol=1e-12)


def test_a_robot_without_sensors():
    model = softdyn.load("finger")
    here = model.measure(model.state(model.q0, np.zeros(4)), [0.0, 0.0])
    assert here.values.shape == (0,)
    assert here.jacobian.shape == (0, 8)
    assert here.jacobian_u.shape == (0, 2)
    assert here.names == ()


@pytest.mark.parametrize(("sensor", "got"), [
    (Sensor("s", KIND.LENGTH, tendon="tendon_9"), "'tendon_9'; did you mean 'tendon_b'?"),
    (Sensor("s", KIND.POSITION, link="nowhere"), "'nowhere'"),
    (Sensor("s", KIND.JOINT, joint="tip"), "'tip'"),
])  # fmt: skip
def test_sensors_of_nothing_are_refused(sensor, got):
    model = softdyn.build(replace(softdyn.load("finger").robot, sensors=(sensor,)))
    with refused("sensor 's'", got):
        model.measure(model.state(model.q0, np.zeros(4)), [0.0, 0.0])


def test_wrong_arguments():
    model, other = softdyn.load("finger"), softdyn.load("helix")
    state = model.state(model.q0, np.zeros(4))
    with refused("u"):
        model.measure(state, [0.0])
    with refused("state"):
        model.measure(other.state(other.q0, np.zeros(36)), [0.0, 0.0])
    with refused("state"):
        model.measure(model.q0, [0.0, 0.0])


@pytest.mark.parametrize("which", [1, 12, 23, *PROJECTIONS], ids=str)
def test_under_winches_tensions_and_accelerations_change_with_the_state(which, tmp_path):
    """At constant commands, against central differences; at the winches' inputs the same values."""
    model = wound(measured(named_model(which, tmp_path)))
    q, v, u = case(model)
    sensors, winches, n = Sensors(model), Winches(model), model.nv
    state = model.state(q, v)
    commands = winches.commands(state, 0.5 * (model.u_min + model.u_max))
    values, jacobian = sensors.predict(q, v, commands, winches)
    u = winches.tensions(state, commands)
    alone = sensors.predict(q, v, u)
    np.testing.assert_allclose(values, alone[0], rtol=1e-12, atol=1e-13)
    assert relative(jacobian, alone[1]) > 1e-3  # the winches matter
    errors, h = sensors.components.errors, 1e-5

    def change(dq, dv):
        return errors(values, sensors.predict(model.integrate(q, dq), v + dv, commands, winches)[0])

    changes = slopes(lambda x: change(x[:n], x[n:]), 2 * n, h)
    for k in range(2 * n):
        assert relative(changes[:, k], jacobian[:, k]) <= 1e-5
