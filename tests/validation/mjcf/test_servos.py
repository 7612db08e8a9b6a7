"""Position and velocity servos of a user's scene, driven by forces."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from lxml import etree

import softdyn
from softdyn.controllers import SoftIdClfQp
from softdyn.validation import crosscheck, paper, simulate
from softdyn.validation.mjcf.scene import Scene
from tests.support import ROOT

SCENE = ROOT / "docs/examples/finger_scene.xml"
POSITION = {"kp": "30", "kv": "2"}
SERVOS = [
    ("position", POSITION),
    ("velocity", {"kv": "5"}),
    ("general", {"gainprm": "-4", "biastype": "affine", "biasprm": "0.3 -20 -1"}),
]
WITH_MEMORY = [
    ("intvelocity", POSITION | {"actrange": "-90 90", "ctrllimited": "false"}),
    ("position", POSITION | {"timeconst": "0.02"}),
    ("position", {"kp": "30", "delay": "0.0009", "nsample": "4"}),
    ("general", {"dyntype": "filter", "dynprm": "0.01", "gainprm": "2"}),
]
Q, V = np.array([0.1, -0.2, 0.3, 0.2]), np.array([1.0, 2.0, -1.0, 0.5])
U = np.array([0.3, -0.6])


@pytest.fixture(scope="module")
def finger() -> softdyn.SoftModel:
    return softdyn.load("finger")


def scene(model: softdyn.SoftModel, folder: Path, tag: str, fields: dict[str, str]) -> Scene:
    """The example's scene without obstacles, with other actuators in place of its motors."""
    root = etree.parse(SCENE).getroot()
    for node in root.xpath("//geom[@name='post'] | //geom[@name='shelf'] | //body[@name='block']"):
        node.getparent().remove(node)
    for node in root.findall("actuator/motor"):
        node.tag = tag
        node.attrib.update({"gear": "0.1"} | fields)
    target = folder / "scene.xml"
    target.write_bytes(etree.tostring(root))
    return Scene(model, target)


@pytest.mark.parametrize(("tag", "fields"), SERVOS)
def test_a_servo_begins_a_period_with_the_force_of_a_motor(finger, tmp_path, tag, fields):
    """MuJoCo's own force and q̈ agree with a motor's; the file begins without a force."""
    motor, servo = (scene(finger, tmp_path, *a) for a in (("motor", {}), (tag, fields)))
    for plant in (motor, servo):
        plant.set_state(*plant.states.to_twin(Q, V))
        assert plant.data.actuator_force == pytest.approx([0, 0], abs=1e-12)
        plant.advance(U)
        assert plant.data.actuator_force == pytest.approx(U, abs=1e-12)
    np.testing.assert_allclose(servo.data.qacc, motor.data.qacc, rtol=1e-9)
    before = servo.data.ctrl.copy()
    servo.advance(U, 20)
    assert np.abs(servo.data.ctrl - before).min() > 0  # anew at each command
    assert np.abs(servo.data.actuator_force - U).min() > 1e-4  # and its own loop in between


@pytest.mark.parametrize(("tag", "fields"), WITH_MEMORY)
def test_a_servo_with_memory_arrives_at_the_force(finger, tmp_path, tag, fields):
    """The held arm's force goes from 0 to u: in one period, with the lag, or after the delay."""
    plant = scene(finger, tmp_path, tag, fields)
    plant.set_state(*plant.states.to_twin(Q, 0 * V))
    times, forces = [], []
    for _ in range(60):
        mujoco.mj_forward(plant.model, plant.data)
        times.append(plant.data.time)
        forces.append(plant.data.actuator_force / U)
        plant.advance(U)
        plant.data.qpos[:], plant.data.qvel[:] = plant.states.to_twin(Q, 0 * V)
    t, lag = np.array(times), float(fields.get("timeconst", "0"))
    expected = 1 - np.exp(-t / lag) if lag else (t > float(fields.get("delay", "0"))) * 1.0
    if "dyntype" in fields:  # which MuJoCo integrates by Euler's method
        expected = 1 - (1 - 0.0005 / 0.01) ** np.arange(60)
    np.testing.assert_allclose(forces, np.column_stack((expected, expected)), atol=1e-9)


def test_the_terms_of_a_scene_with_servos_are_those_of_its_mechanics(finger, tmp_path):
    assert crosscheck(finger, scene(finger, tmp_path, *SERVOS[0]), samples=3).passed


def test_a_controller_reaches_its_target_through_servos(finger, tmp_path):
    """As through motors (`test_mjcf_scene`): 3 mm after 1.5 s."""
    plant = scene(finger, tmp_path, "position", {"kp": "3"})
    plan = paper.set_point("finger", theta=0.5)
    log = simulate(finger, SoftIdClfQp(finger), plan, plant=plant, duration=1.5)
    assert np.linalg.norm(log.error[-1]) < 0.003  # m
