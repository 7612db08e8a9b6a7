"""Springs and dampers that are not linear, against MuJoCo's own law and central differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn import statics
from softdyn.description.robot import Robot
from softdyn.description.urdf import parse_text
from softdyn.description.urdf_writer import write
from softdyn.dynamics.derivatives import acceleration_derivatives, total_damping
from softdyn.dynamics.mimic import build
from softdyn.dynamics.model import SoftModel
from softdyn.statics.suspicious_values import suspicious_values
from softdyn.validation import compare, crosscheck
from tests.support.command import command
from tests.support.oracles import slopes
from tests.support.robots import GRIPPER

STEP = 1e-6


def curved(robot: Robot, seed: int) -> Robot:
    """A robot whose springs and dampers have random coefficients of higher powers."""
    rng = np.random.default_rng(seed)

    def pair(scale: float, lowest: float) -> tuple[float, float]:
        return scale * rng.uniform(lowest, 0.3), scale * rng.uniform(0.1, 0.5)

    joints = tuple(
        replace(
            joint,
            stiffness_poly=pair(max(joint.stiffness, 0.1), -0.3),
            damping_poly=pair(max(joint.damping, 1e-3), 0.0),
        )
        if joint.moves and joint.kind != "continuous"
        else joint
        for joint in robot.joints
    )
    tendons = tuple(
        tendon
        if tendon.slack
        else replace(
            tendon,
            stiffness=20.0,
            damping=0.2,
            stiffness_poly=(50.0, 300.0),
            damping_poly=(0.1, 0.3),
        )
        for tendon in robot.tendons
    )
    return parse_text(write(replace(robot, joints=joints, tendons=tendons)), path=robot.path)


@pytest.fixture(scope="module", params=["finger", "spirob", "mimic", "reduced"])
def model(request) -> SoftModel:
    if request.param == "mimic":
        return build(curved(parse_text(GRIPPER, path="gripper.urdf"), 1))
    if request.param == "reduced":
        return softdyn.reduce(
            build(curved(softdyn.load("finger").robot, 2)), np.eye(4)[:, :2] + 0.3
        )
    return build(curved(softdyn.load(request.param).robot, 3))


def state_of(model: SoftModel, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A random (q, v, u)."""
    rng = np.random.default_rng(seed)
    q = model.integrate(model.q0, rng.uniform(-0.4, 0.4, model.nv))
    return q, rng.normal(size=model.nv), rng.uniform(0, 0.5, model.nu)


@pytest.mark.parametrize("seed", range(3))
def test_each_jacobian_is_the_derivative_of_its_force(model: SoftModel, seed: int) -> None:
    (q, v, u), rest = state_of(model, seed), np.zeros(model.nv)
    at, state = acceleration_derivatives(model, q, v, u), model.state(q, v)
    by_q = slopes(lambda dq: model.forward_dynamics(model.integrate(q, dq), v, u), model.nv, STEP)
    by_v = slopes(lambda dv: model.forward_dynamics(q, v + dv, u), model.nv, STEP)
    K = slopes(lambda dq: model.state(model.integrate(q, dq), rest).K, model.nv, STEP)
    energy = slopes(lambda dq: model.elastic_energy(model.integrate(q, dq)), model.nv, STEP)
    D = slopes(lambda dv: model.state(q, v + dv).D @ (v + dv), model.nv, STEP)
    for found, expected in (
        (at.q, by_q),
        (at.v, by_v),
        (model.tangent_stiffness(q), K),
        (state.K, energy),
        (total_damping(state), D),
    ):
        assert found == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def test_at_rest_the_forces_balance(model: SoftModel) -> None:
    rest = statics.rest(model)
    state = model.state(rest.q, np.zeros(model.nv))
    moved = (model.lower < rest.q) & (rest.q < model.upper) if model.nq == model.nv else slice(None)
    assert np.abs(state.B @ rest.u - state.h)[moved].max() < 1e-6 * max(np.abs(state.K).max(), 1)


@pytest.mark.parametrize("name", ["finger", "spirob", "mimic"])
def test_every_term_and_trajectory_is_mujoco_s(name: str) -> None:
    robot = parse_text(GRIPPER, path="r.urdf") if name == "mimic" else softdyn.load(name).robot
    found = crosscheck(build(curved(robot, 3)), samples=5)
    assert found.passed, str(found)


def test_a_file_states_them_and_mjcf_too(tmp_path) -> None:
    robot = curved(softdyn.load("finger").robot, 4)
    assert parse_text(write(robot), path=robot.path) == robot
    assert robot.digest != softdyn.load("finger").robot.digest
    urdf, mjcf, back = (tmp_path / name for name in ("a.urdf", "a.xml", "back.urdf"))
    urdf.write_text(write(robot))
    assert command("export", urdf, "--mjcf", mjcf).code == 0
    assert command("export", mjcf, "--urdf", back).code == 0
    assert compare(urdf, back).passed
    ours, theirs = softdyn.load(urdf), softdyn.load(back)
    for seed in range(3):
        q, v, _ = state_of(ours, seed)
        assert theirs.state(q, v).h == pytest.approx(ours.state(q, v).h, rel=1e-9, abs=1e-12)


def test_a_spring_that_turns_within_its_limits_is_named() -> None:
    robot = softdyn.load("finger").robot
    (joint, *_) = robot.moving_joints
    bent = replace(joint, stiffness_poly=(0.0, -joint.stiffness))
    joints = tuple(bent if one is joint else one for one in robot.joints)
    warned = suspicious_values(replace(robot, joints=joints))
    assert any(joint.name in line and "turns" in line for line in warned)
