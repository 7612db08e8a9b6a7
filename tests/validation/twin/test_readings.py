"""Sensors and winches of the model and of the twin, on random robots."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import softdyn
from softdyn.actuation import Winches
from softdyn.description.rig import Sensor, SensorKind
from softdyn.validation import Rig, Twin, rollout
from softdyn.validation.twin.readings import Readings
from softdyn.validation.twin.state_map import StateMap
from tests.support import cart, robots
from tests.support.random_robots import write_robot
from tests.support.rigs import measured, wound
from tests.support.robots import WALKER, write


@pytest.mark.parametrize("source", [*range(1, 16), 16, 19, 23, "floating"], ids=str)
def test_the_model_and_the_twin_read_the_same(source, tmp_path) -> None:
    if source == "floating":
        base = softdyn.load(write(tmp_path, WALKER), floating=True)
    else:
        base = softdyn.load(write_robot(source, tmp_path))
    model = measured(wound(base))
    twin = Twin(model.robot, rig=True, limits=False)
    states, readings, winches = StateMap(model, twin), Readings(twin, 0), Winches(model)
    speeds = model.robot.speeds
    rng = np.random.default_rng(5)
    low, high = np.maximum(model.lower, -0.8), np.minimum(model.upper, 0.8)
    for _ in range(3):
        q, v = model.configuration(rng.uniform(low, high)), 0.5 * rng.normal(size=model.nv)
        state = model.state(q, v)
        asked = rng.uniform(model.u_min, model.u_max)
        commands = winches.commands(state, asked) + 0.1 * winches.winds * rng.normal(size=model.nu)
        twin.set_state(*states.to_twin(q, v))
        twin.hold(np.where(speeds, 0.0, commands), commands)
        mujoco.mj_forward(twin.model, twin.data)
        u = winches.tensions(state, commands)
        assert twin.data.actuator_force[: model.nu] == pytest.approx(u, rel=1e-10, abs=1e-10)
        here = model.measure(state, u)
        assert readings.names == here.names
        errors, first = np.abs(here.errors_of(readings.ideal())), 0
        qdd = np.abs(model.forward_dynamics(q, v, u)).max()
        for sensor in model.robot.sensors:
            rows = slice(first, first + sensor.kind.size)
            first = rows.stop
            scale = max(np.abs(here.values[rows]).max(), 1.0)
            if sensor.kind is SensorKind.ACCELEROMETER:
                scale = max(scale, qdd)
            assert errors[rows].max() <= 1e-10 * scale, sensor


def test_a_late_camera_begins_with_the_start_and_reads_at_its_rate() -> None:
    """In a plane, one coordinate is constant; its noise is new in each reading all the same."""
    camera = """<sensor name="camera" type="position" link="tip" noise="1e-3" rate="50"
        latency="0.03"/>"""
    model = cart.cart(-1, 1, block=camera)
    rig = Rig(seed=1)
    log = rollout(model, np.ones(1), 2.0, period=0.002, timestep=5e-4, q0=np.array([0.3]), rig=rig)
    seen = log.measured
    assert seen[0] == pytest.approx([0.7, 0, 0], abs=5e-3)
    rows = np.flatnonzero((np.diff(seen, axis=0) != 0).all(1)) + 1
    np.testing.assert_allclose(
        log.t[rows][1:], 0.03 + 0.02 * np.arange(2, len(rows) + 1), atol=1e-9
    )
    true = np.interp(log.t[rows] - 0.03, log.t, log.y[:, 0])
    assert np.abs(seen[rows, 0] - true)[1:].max() < 5e-3


def test_errors_of_a_pose_turn_about_the_sensors_own_axes(tmp_path) -> None:
    model = robots.load(tmp_path, robots.WINCHED)
    camera = Sensor("camera", SensorKind.POSE, link="tip", noise=(0, 0, 0, 0.1, 0, 0),
                    bias=(0, 0, 0, 0, 0, 0.3))  # fmt: skip
    twin = Twin(Rig(sensors=(camera,)).robot(model.robot), rig=True)
    q, v = np.array([0.7, 0.5]), np.zeros(2)  # about y, by 1.2 rad
    twin.set_state(*StateMap(model, twin).to_twin(q, v))
    mujoco.mj_forward(twin.model, twin.data)
    readings = Readings(twin, 3)
    turns = []
    for _ in range(5):
        measured, true = readings()
        turned = pin.exp3(true[3:]).T @ pin.exp3(measured[3:])
        turns.append(pin.log3(turned))
    assert np.linalg.norm(true[3:]) == pytest.approx(1.2)
    np.testing.assert_allclose(np.array(turns)[:, 1:], [[0, 0.3]] * 5, atol=1e-12)
    assert np.std(np.array(turns)[:, 0]) > 0.02
