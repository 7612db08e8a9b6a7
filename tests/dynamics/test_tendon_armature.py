"""The inertia of rotors felt along cables, against MuJoCo, differences and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn import design, statics
from softdyn.description.rig import CommandKind
from softdyn.description.robot import Robot
from softdyn.description.urdf import parse_text
from softdyn.description.urdf_writer import write
from softdyn.dynamics import tree
from softdyn.dynamics.derivatives import acceleration_derivatives
from softdyn.dynamics.mimic import build
from softdyn.dynamics.model import SoftModel
from softdyn.validation import Twin, compare, crosscheck
from softdyn.validation.crosschecks.engines import side_by_side
from softdyn.validation.twin.rig import Rig
from tests.support.command import command
from tests.support.oracles import slopes
from tests.support.random_robots import random_urdf
from tests.support.refused import refused
from tests.support.robots import GRIPPER
from tests.support.wrapped_robots import wrapped_robot

STEP = 1e-4  # rotors make M stiff, and a shorter step loses digits
TWO = """<mujoco model="differential"><worldbody>
  <body name="u"><joint name="bend" axis="0 1 0" range="-57 57" damping="0.02"/>
    <inertial pos="0 0 -0.05" mass="0.1" diaginertia="1e-4 1e-4 1e-5"/>
    <body name="v" pos="0 0 -0.1"><joint name="twist" axis="1 0 0" range="-57 57" damping="0.02"/>
      <inertial pos="0 0 -0.05" mass="0.1" diaginertia="1e-4 1e-4 1e-5"/></body></body></worldbody>
  <tendon><fixed name="plus" armature="0.004"><joint joint="bend" coef="1"/>
      <joint joint="twist" coef="1"/></fixed>
    <fixed name="minus" armature="0.004"><joint joint="bend" coef="1"/>
      <joint joint="twist" coef="-1"/></fixed></tendon>
  <actuator><motor name="m1" tendon="plus" ctrlrange="-1 1"/>
    <motor name="m2" tendon="minus" ctrlrange="-1 1"/></actuator></mujoco>"""


def turning(robot: Robot, seed: int, floating: bool = False) -> Robot:
    """A robot all of whose cables have rotors."""
    rng = np.random.default_rng(seed)
    tendons = tuple(
        tendon if tendon.wraps else replace(tendon, armature=10.0 ** rng.uniform(-3, 0))
        for tendon in robot.tendons
    )
    text = write(replace(robot, tendons=tendons))
    return parse_text(text, path=robot.path, floating=floating)


MODELS = {
    "finger": lambda: build(turning(softdyn.load("finger").robot, 1)),
    "spirob": lambda: build(turning(softdyn.load("spirob").robot, 2)),
    "mimic": lambda: build(turning(parse_text(GRIPPER, path="r.urdf"), 3)),
    "reduced": lambda: softdyn.reduce(
        build(turning(softdyn.load("finger").robot, 4)), np.eye(4)[:, :2] + 0.3
    ),
    "branches": lambda: build(turning(parse_text(random_urdf(19), path="r.urdf"), 5)),
    "floating": lambda: build(
        turning(parse_text(random_urdf(17), path="r.urdf", floating=True), 6, floating=True)
    ),
}


@pytest.fixture(scope="module", params=list(MODELS))
def model(request: pytest.FixtureRequest) -> SoftModel:
    return MODELS[request.param]()


def state_of(model: SoftModel, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A random (q, v, u)."""
    rng = np.random.default_rng(seed)
    q = model.integrate(model.q0, rng.uniform(-0.5, 0.5, model.nv))
    return q, rng.normal(size=model.nv), rng.uniform(0, 0.5, model.nu)


def test_each_jacobian_is_the_derivative_of_the_acceleration(model: SoftModel) -> None:
    q, v, u = state_of(model, 1)
    at = acceleration_derivatives(model, q, v, u)
    by_q = slopes(lambda dq: model.forward_dynamics(model.integrate(q, dq), v, u), model.nv, STEP)
    by_v = slopes(lambda dv: model.forward_dynamics(q, v + dv, u), model.nv, STEP)
    for found, expected in ((at.q, by_q), (at.v, by_v)):
        assert found == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def test_mass_coriolis_and_energy_belong_together(model: SoftModel) -> None:
    """Ṁ - 2C is skew, C q̇ + g is the bias, and the rotors' energy is ½ m ℓ̇²."""
    q, v, _ = state_of(model, 2)
    state = model.state(q, v)
    ahead, behind = (model.state(model.integrate(q, sign * STEP * v), v).M for sign in (1, -1))
    skew = (ahead - behind) / (2 * STEP) - 2 * state.C
    size = np.abs(state.C).max()
    assert np.abs(skew + skew.T).max() < 1e-6 * size
    assert state.C @ v + state.g == pytest.approx(state.bias, abs=1e-12 * max(size, 1.0))
    assert model.kinetic_energy(q, v) == pytest.approx(v @ state.M @ v / 2, rel=1e-12)


def test_numpy_and_the_kernel_agree(model: SoftModel, monkeypatch: pytest.MonkeyPatch) -> None:
    q, v, _ = state_of(model, 3)
    ours = model.state(q, v)
    monkeypatch.setattr(tree, "COMPILES", False)
    plain = model.with_forces().state(q, v)
    for name in ("M", "bias", "h"):
        expected = getattr(plain, name)
        assert getattr(ours, name) == pytest.approx(expected, abs=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["spirob", "mimic", "branches", "floating"])
def test_every_term_and_trajectory_is_mujoco_s(name: str) -> None:
    found = crosscheck(MODELS[name](), samples=3, trajectories=name in ("spirob", "branches"))
    assert found.passed, str(found)


def test_equilibria_do_not_know_the_rotors() -> None:
    heavy, light = MODELS["finger"](), softdyn.load("finger")
    u = 0.5 * light.u_max
    assert statics.settle(heavy, u).q == pytest.approx(statics.settle(light, u).q, abs=1e-9)


def test_two_files_of_a_differential_have_its_coupled_inertia(tmp_path) -> None:
    """google-deepmind/mujoco#928: two rotors drive the sum and the difference of two joints."""
    two, urdf, mjcf = (tmp_path / name for name in ("two.xml", "two.urdf", "back.xml"))
    two.write_text(TWO)
    assert command("export", two, "--urdf", urdf).code == 0
    model = softdyn.load(urdf)
    expected = np.diag([0.0027, 0.00035]) + 0.008 * np.eye(2)
    assert pytest.approx(expected, rel=1e-12) == model.state(model.q0, [0.0, 0.0]).M
    assert "armatures of tendons: plus 0.004 kg, minus 0.004 kg" in str(model)
    assert command("export", urdf, "--mjcf", mjcf).code == 0
    for one in (urdf, mjcf):
        assert {cause.kind for cause in compare(one, two).causes} <= {"limit"}  # soft stops
    two.write_text(TWO.replace('"plus" armature="0.004"', '"plus"'))
    (cause,) = compare(urdf, two).causes
    assert (cause.kind, cause.where, cause.alone) == ("armature", "plus", True)
    assert side_by_side(urdf, two).passed  # with the URDF's armature in both


def test_what_cannot_be_is_refused_by_name() -> None:
    with refused("armature"):
        design.CableMotor(("a",), CommandKind.LENGTH, stiffness=900.0, armature=0.1)
    with refused("command", "<CommandKind.LENGTH: 'length'>"):
        Rig(command="length", stiffness=900.0).robot(MODELS["spirob"]().robot)
    robot = wrapped_robot(7)
    tendons = tuple(replace(tendon, armature=0.1) for tendon in robot.tendons)
    with refused("armature", 0.1):
        build(replace(robot, tendons=tendons))
    apart = Twin(MODELS["branches"]())
    with refused("tendon 't9_0'"):
        apart.advance(np.zeros(apart.nu))
