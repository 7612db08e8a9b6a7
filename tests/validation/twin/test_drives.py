"""Slack tendons, winches, lag, delay and sensors in the twin: closed forms, and the model."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import softdyn
from softdyn.actuation import Winches
from softdyn.description.rig import CommandKind, Sensor, SensorKind
from softdyn.validation import Rig, Twin, simulate
from softdyn.validation.crosschecks.mujoco_terms import MujocoTerms
from softdyn.validation.loop.log import Log
from softdyn.validation.twin.readings import Readings
from softdyn.validation.twin.state_map import StateMap
from tests.support.refused import refused
from tests.support.robots import build, slide


def robot(cable: dict[str, object] | None = None, **motor: object) -> softdyn.SoftModel:
    """A mass of 2 kg on a slide with a spring of 30 N/m, and a cable against its motion."""
    return build(slide(
        2, limit=(-9, 9), stiffness=30, pull=(0, 40), gear=-2, tendon=cable, drive=motor
    ))  # fmt: skip


@pytest.mark.parametrize("delay", [0.0, 0.004, 0.0041])
def test_a_lag_answers_a_step_as_its_closed_form(delay: float) -> None:
    """The acting input is 1 - e^(-t/λ); MuJoCo rounds the delay up to whole steps of 1 ms."""
    model = robot(lag=0.02, delay=delay)
    twin = Twin(model, rig=True, timestep=1e-3)
    twin.hold(np.zeros(1), np.zeros(1))
    for _ in range(60):
        twin.advance(np.ones(1))
        mujoco.mj_forward(twin.model, twin.data)
        since = max(twin.data.time - math.ceil(delay / 1e-3 - 1e-9) * 1e-3, 0.0)
        assert twin.data.actuator_force[0] == pytest.approx(1 - math.exp(-since / 0.02), abs=1e-12)


def test_a_slack_cable_catches_the_mass_with_its_energy() -> None:
    """The cable acts beyond 0.1 m only: ½ m v² = ½ 30 x² + ½ 800 (x - 0.1)² at the turn."""
    model = robot({"stiffness": 800, "rest": 0.1, "slack": "true"})
    twin = Twin(model, timestep=1e-4, integrator="rk4")
    twin.set_state(np.zeros(1), np.array([3.0]))
    farthest = 0.0
    for _ in range(4000):
        twin.advance(np.zeros(1))
        farthest = max(farthest, float(twin.data.qpos[0]))
    stretch = farthest - 0.1
    energy = 0.5 * 30 * farthest**2 + 0.5 * 800 * stretch**2
    assert energy == pytest.approx(0.5 * 2 * 9.0, rel=1e-5)


def test_a_winch_holds_its_static_tension() -> None:
    """k (x - c) balances the spring: x = k c / (k + 30), tension 30 |x|; u = T / 2."""
    twin = Twin(robot(command="length", stiffness=500, damping=40), rig=True)
    for _ in range(40):
        twin.advance(np.array([-0.2]), 400)
    x = 500 * -0.2 / 530
    assert twin.data.qpos[0] == pytest.approx(x, abs=1e-9)
    assert twin.data.actuator_force[0] == pytest.approx(30 * abs(x) / 2, abs=1e-7)


@pytest.mark.parametrize("damping", [0.0, 7.0])
def test_the_model_and_the_twin_have_the_same_tensions(damping: float) -> None:
    """Of a winch and a slack tendon, at random states: u, q̈, K, D, B and all sensors' values."""
    base = softdyn.load("spirob")
    tendons = tuple(
        replace(t, stiffness=300.0, damping=damping, slack=True) for t in base.robot.tendons
    )
    actuators = tuple(
        replace(a, command=CommandKind.LENGTH, stiffness=900.0, damping=damping)
        for a in base.robot.actuators
    )
    model = softdyn.build(replace(base.robot, tendons=tendons, actuators=actuators))
    twin, plain = Twin(model.robot, rig=True), Twin(model.robot)
    states, terms = StateMap(model, twin), MujocoTerms(plain, StateMap(model, plain))
    winches, rng = Winches(model), np.random.default_rng(3)
    slack = 0
    for _ in range(20):
        state = model.state(*rng.uniform(-0.1, 0.1, (2, model.nv)))
        commands = state.lengths[: model.nu] + rng.uniform(-0.02, 0.02, model.nu)
        twin.set_state(*states.to_twin(state.q, state.v))
        twin.data.ctrl[: model.nu] = commands
        mujoco.mj_forward(twin.model, twin.data)
        u = winches.tensions(state, commands)
        assert twin.data.actuator_force[: model.nu] == pytest.approx(u, abs=1e-10)
        slack += int((u == 0).sum())
        terms.set_state(state.q, state.v)
        for name in ("K", "D", "B"):
            assert getattr(terms, name)() == pytest.approx(getattr(state, name), abs=1e-9)
        expected = model.forward_dynamics(state.q, state.v, u)
        assert terms.qdd(u) == pytest.approx(expected, abs=1e-8, rel=1e-9)
    assert 0 < slack < 20 * model.nu


def test_a_rig_is_in_the_log_and_the_ideal_loop_is_unchanged(tmp_path: Any) -> None:
    """Rig() of an ideal file gives the ideal run; sensors, commands and seen states are logged."""
    model = softdyn.load("finger")
    reference = softdyn.SetPoint([0.1, 0.0, -0.1])

    def law(state: Any, reference: Any) -> Any:
        return 0.3 * np.sin(40 * state.v[:2])

    plain, same = (simulate(model, law, reference, duration=0.2, rig=rig) for rig in (None, "file"))
    np.testing.assert_array_equal(plain.q, same.q)
    np.testing.assert_array_equal(same.q_seen, same.q[:-1])
    sensors = (
        Sensor("cable", SensorKind.LENGTH, tendon=model.robot.tendons[0].name),
        Sensor("camera", SensorKind.POSITION, link=model.robot.task, rate=50.0, latency=0.01),
    )
    rig = Rig(lag=0.02, delay=0.004, sensors=sensors, noise=1e-3, latency=0.01, seed=3)
    log, again = (simulate(model, law, reference, duration=0.2, rig=rig) for _ in range(2))
    np.testing.assert_array_equal(log.measured, again.measured)
    assert log.sensor_names == ("cable", "camera.x", "camera.y", "camera.z")
    assert np.abs(log.acting[:3]).max() == 0 < np.abs(log.acting).max()  # the delay
    late = np.abs(log.q_seen[5:] - log.q[:-6]).max()
    assert 0 < late < 0.2
    lengths = [model.state(q, v).lengths[0] for q, v in zip(log.q, log.v, strict=True)]
    assert log.measured[:, 0] == pytest.approx(lengths, abs=1e-12)
    tips = log.y[::10]  # 50 Hz; the reading is 10 ms old, and holds for 20 ms
    assert log.measured[15, 1:] == pytest.approx(tips[1], abs=1e-12)
    path = tmp_path / "run.npz"
    log.save(path)
    read = Log.load(path)
    np.testing.assert_array_equal(read.acting, log.acting)
    assert read.sensor_names == log.sensor_names


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Rig(lag=-1.0), ("lag", -1.0)),
        (lambda: Rig(sensors="file"), ("sensors", "'file'")),
        (lambda: Rig(plant={"payload": 0.1}), ("plant", "{'payload': 0.1}")),
        (lambda: Rig(noise=math.nan), ("noise", "nan")),
        (lambda: Rig(command="torque"), ("command", "'torque'")),
        (
            lambda: Rig(command="length").robot(softdyn.load("spirob").robot),
            ("command", "<CommandKind.LENGTH: 'length'>"),
        ),
    ],
)
def test_a_rig_refuses(make: Any, message: str) -> None:
    with refused(*message):
        make()


def test_a_rig_needs_the_twin() -> None:
    model = softdyn.load("finger")
    with refused("rig"):
        simulate(model, lambda s, r: np.zeros(2), softdyn.SetPoint([0, 0, 0]), rig="mine")


def test_the_error_of_a_pose_is_in_the_sensors_frame() -> None:
    """A bias turns the reading about the sensor's own axes: R exp(bias), by Pinocchio."""
    model = softdyn.load("finger")
    bias = (0.0, 0.0, 0.0, 0.1, -0.2, 0.3)
    sensor = Sensor("mark", SensorKind.POSE, link=model.robot.task, rpy=(0.3, 0.2, 0.1), bias=bias)
    twin = Twin(replace(model.robot, sensors=(sensor,)), rig=True)
    twin.advance(np.full(2, 0.5), 200)
    mujoco.mj_forward(twin.model, twin.data)
    measured, true = Readings(twin, 0)()
    expected = pin.exp3(true[3:]) @ pin.exp3(np.array(bias[3:]))
    assert pin.exp3(measured[3:]) == pytest.approx(expected, abs=1e-12)
    assert measured[:3] == pytest.approx(true[:3], abs=1e-15)
