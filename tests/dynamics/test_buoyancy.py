"""Buoyancy of links against MuJoCo's compensation of weights and against a smaller gravity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn import design, statics
from softdyn.description.urdf import parse_text
from softdyn.description.urdf_writer import write
from softdyn.dynamics import Fluid
from softdyn.dynamics.balance import ForceBalance
from softdyn.dynamics.mimic import build
from softdyn.validation import compare, crosscheck
from softdyn.validation.twin.plant_errors import PlantErrors, altered_robot
from tests.support import robots
from tests.support.command import command

STEP = 1e-6


def lifted(robot: softdyn.Robot, seed: int = 1) -> softdyn.SoftModel:
    """The robot with another share for each moving body."""
    carrier = softdyn.description.robot.moving_link_of(robot)
    rng = np.random.default_rng(seed)
    shares = {name: float(rng.uniform(0, 1.5)) for name in dict.fromkeys(carrier.values())}
    links = tuple(
        replace(one, gravcomp=shares[carrier[one.name]]) if one.mass else one for one in robot.links
    )
    return build(replace(robot, links=links))


@pytest.fixture(scope="module")
def model(tree) -> softdyn.SoftModel:
    return lifted(tree)


def test_every_term_is_mujoco_s(model) -> None:
    found = crosscheck(model, samples=5, trajectories=model.name == "finger")
    assert found.passed, str(found)
    (check,) = [check for check in found.checks if check.quantity == "F"]
    assert check.tolerance <= 1e-10
    assert np.abs(model.state(model.q0, np.ones(model.nv)).F).max() > 0


def test_its_derivative_and_its_energy_are_those_of_the_force(model) -> None:
    rng = np.random.default_rng(4)
    q = model.integrate(model.q0, rng.uniform(-0.3, 0.3, model.nv))
    v, zero = rng.normal(size=model.nv), np.zeros(model.nv)
    by_q, by_v = model.force_derivatives(q, v)
    assert not by_v.any()
    moves = STEP * np.eye(model.nv)
    ahead, behind = (
        np.array([model.forces_at(model.integrate(q, s * dq), v) for dq in moves]) for s in (1, -1)
    )
    expected = (ahead - behind).T / (2 * STEP)
    assert by_q == pytest.approx(expected, abs=1e-6 * max(1e-3, np.abs(expected).max()))
    ends = [[model.forces_energy(model.integrate(q, s * dq)) for dq in moves] for s in (1, -1)]
    slope = (np.array(ends[0]) - ends[1]) / (2 * STEP)
    F = model.forces_at(q, zero)
    assert -slope == pytest.approx(F, abs=1e-6 * np.abs(F).max())


def test_the_balance_and_the_step_have_it() -> None:
    """With a fluid beside it, the residual and its derivatives are those of the State."""
    robot = replace(lifted(softdyn.load("finger").robot).robot, fluid=Fluid(1000.0, 0.3))
    model = build(robot)
    rng = np.random.default_rng(2)
    q, v, a = 0.2 * rng.normal(size=(3, model.nv))
    u, state = 0.1 * model.u_max, model.state(q, v)
    found = ForceBalance(model, motors=())(q, v, a, u)
    expected = state.M @ a + state.h - state.B @ u
    assert found.residual == pytest.approx(expected, abs=1e-12 * np.abs(expected).max())
    assert found.by_v == pytest.approx(
        ForceBalance(build(robot.dry), motors=())(q, v, a, u).by_v
        - model.force_derivatives(q, v)[1]
    )


def test_an_arm_of_one_material_rests_as_under_a_smaller_gravity(tmp_path) -> None:
    section = {"length_m": 0.2, "radius_m": [0.02, 0.01], "segments": 3}
    table = {
        "section": [section], "material": {"youngs_modulus_MPa": 0.1, "density_kg_m3": 1070},
        "mount": {"direction": [1, 0, 0]},
        "cable": [{"count": 3, "offset_mm": 8, "routing": "channel", "max_tension_N": 5}],
    }  # fmt: skip
    water = {**table, "fluid": {"density_kg_m3": 1000, "viscosity_Pa_s": 0.001}}
    light = {**table, "mount": {**table["mount"], "gravity_m_s2": [0, 0, -9.81 * 70 / 1070]}}
    path = robots.write(tmp_path, design.read(water).text, "arm.urdf")
    wet = softdyn.load(path)
    dry, less = (build(parse_text(design.read(one).text, path="a.urdf")) for one in (table, light))
    u = 0.1 * dry.u_max * [1, 0, 0]
    there = statics.settle(wet, u)
    assert there.stable
    assert there.q == pytest.approx(statics.settle(less, u).q, abs=1e-9)
    assert np.linalg.norm(there.y - statics.settle(dry, u).y) > 0.005
    shares = np.array([link.gravcomp for link in wet.robot.links if link.mass])
    assert shares == pytest.approx(1000 / 1070)
    heavier = altered_robot(PlantErrors(mass=1.25), wet.robot)  # it displaces no more water
    assert [one.gravcomp for one in heavier.buoyant] == pytest.approx(shares / 1.25)


def test_a_file_and_mjcf_state_it_and_one_alone_differs(tmp_path) -> None:
    urdf, mjcf, back, dry = (tmp_path / n for n in ("a.urdf", "a.xml", "back.urdf", "dry.urdf"))
    robot = lifted(softdyn.load("finger").robot).robot
    urdf.write_text(write(robot))
    dry.write_text(write(robot.dry))
    assert softdyn.load(urdf).robot.links == robot.links
    assert command("export", urdf, "--mjcf", mjcf).code == 0
    assert command("export", mjcf, "--urdf", back).code == 0
    assert compare(urdf, mjcf).passed
    assert compare(urdf, back).passed
    assert {cause.kind for cause in compare(urdf, dry).causes} == {"gravity"}
    assert robot.digest != robot.dry.digest == softdyn.load(dry).robot.digest


def test_own_forces_and_water_act_once_in_the_twin() -> None:
    class Push:
        name = "push"

        def __call__(self, model, q, v):
            return 0.01 + 0 * v

    robot = replace(lifted(softdyn.load("finger").robot).robot, fluid=Fluid(1000.0, 0.3))
    model = build(robot).with_forces(Push())
    assert crosscheck(model, samples=2, trajectories=False).passed
