"""Sensors and winches of the model and of the twin, on random robots."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import softdyn
from softdyn.actuation import Winches
from softdyn.description.rig import CommandKind, SensorKind
from softdyn.validation import Twin
from softdyn.validation.twin.readings import Readings
from softdyn.validation.twin.state_map import StateMap
from tests.proof.crosschecks.random_robots import write_robot
from tests.support.micro import FLOATING, write
from tests.support.rigged import measured, wound


@pytest.mark.parametrize("source", [*range(1, 16), 16, 19, 23, "floating"], ids=str)
def test_the_model_and_the_twin_read_the_same(source, tmp_path) -> None:
    if source == "floating":
        base = softdyn.load(write(tmp_path, FLOATING), floating=True)
    else:
        base = softdyn.load(write_robot(source, tmp_path))
    model = measured(wound(base))
    twin = Twin(model.robot, rig=True, limits=False)
    states, readings, winches = StateMap(model, twin), Readings(twin, 0), Winches(model)
    speeds = np.array([a.command is CommandKind.VELOCITY for a in model.robot.actuators], bool)
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
