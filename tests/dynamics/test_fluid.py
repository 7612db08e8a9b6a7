"""The drag of a fluid against MuJoCo's own model, and its derivatives against differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn import InputError, design, statics
from softdyn.description.urdf import parse_text
from softdyn.description.urdf_writer import write
from softdyn.dynamics import Fluid, Wrench
from softdyn.dynamics.mimic import build
from softdyn.validation import compare, crosscheck
from softdyn.validation.twin.twin import Twin
from tests.support.command import command

WATER = Fluid(1000.0, 0.3)  # thicker than water, so that both parts count
STEP = 1e-6


def wet(robot: softdyn.Robot) -> softdyn.SoftModel:
    return build(replace(robot, fluid=WATER))


@pytest.fixture(scope="module")
def model(tree) -> softdyn.SoftModel:
    return wet(tree)


def test_every_term_and_trajectory_is_mujoco_s(model) -> None:
    found = crosscheck(model, samples=5)
    assert found.passed, str(found)
    (check,) = [check for check in found.checks if check.quantity == "F"]
    assert check.tolerance <= 1e-10
    moving = model.state(model.q0, np.ones(model.nv))
    assert np.abs(moving.F).max() > 0


class Push:
    """A constant force of one's own."""

    name = "push"

    def __call__(self, model, q, v):
        return 0.1 * np.ones(model.nv)


def test_a_force_of_one_s_own_beside_it_leaves_one_fluid() -> None:
    found = crosscheck(
        wet(softdyn.load("finger").robot).with_forces(Push()), samples=3, trajectories=False
    )
    assert found.passed, str(found)


def test_its_derivatives_are_those_of_the_force(model) -> None:
    rng = np.random.default_rng(4)
    q = model.integrate(model.q0, rng.uniform(-0.3, 0.3, model.nv))
    v = rng.normal(size=model.nv)
    by_q, by_v = model.force_derivatives(q, v)
    moves = STEP * np.eye(model.nv)
    found_q = [model.forces_at(model.integrate(q, s * dq), v) for s in (1, -1) for dq in moves]
    found_v = [model.forces_at(q, v + s * dv) for s in (1, -1) for dv in moves]
    for found, exact in ((found_q, by_q), (found_v, by_v)):
        ahead, behind = np.array(found).reshape(2, model.nv, model.nv)
        expected = (ahead - behind).T / (2 * STEP)
        assert exact == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


def test_it_brakes_and_moves_no_equilibrium() -> None:
    dry, water = softdyn.load("finger"), wet(softdyn.load("finger").robot)
    v = np.array([1.0, -2.0, 0.5, 3.0])
    assert v @ water.state(water.q0, v).F < 0
    u = 0.2 * dry.u_max
    assert statics.settle(water, u).q == pytest.approx(statics.settle(dry, u).q, abs=1e-9)
    assert (water.robot.digest, water.robot.fluid) != (dry.robot.digest, dry.robot.fluid)


def test_the_twin_counts_it_once_beside_forces_of_one_s_own() -> None:
    water, speed = wet(softdyn.load("finger").robot), np.array([1.0, -2.0, 0.5, 3.0])
    wrench = Wrench(water.robot.task, force=(0.0, 0.0, 0.0))
    ends = []
    for model in (water, water.with_forces(wrench)):
        twin = Twin(model)
        twin.set_state(np.zeros(water.nv), speed)
        twin.advance(np.zeros(water.nu), 20)
        ends.append(twin.qvel)
    np.testing.assert_allclose(*ends, rtol=1e-9)


def test_a_file_a_table_and_mjcf_state_it(tmp_path) -> None:
    section = design.Section(0.2, 0.01, design.Material(0.25e6), 3)
    arm = design.Arm((section,), fluid=WATER)
    urdf, mjcf, back = (tmp_path / name for name in ("a.urdf", "a.xml", "back.urdf"))
    urdf.write_text(design.urdf(arm))
    assert softdyn.load(urdf).robot.fluid == WATER
    assert command("export", urdf, "--mjcf", mjcf).code == 0
    assert command("export", mjcf, "--urdf", back).code == 0
    assert compare(urdf, back).passed
    assert softdyn.load(back).robot.fluid == WATER
    table = {"section": [{"length_m": 0.2, "radius_m": 0.01, "segments": 3}],
             "material": {"youngs_modulus_MPa": 0.25},
             "fluid": {"density_kg_m3": 1000, "viscosity_Pa_s": 0.3}}  # fmt: skip
    assert parse_text(design.read(table).text, path="arm.urdf").fluid == WATER
    for wrong in ({"density_kg_m3": -1}, {"wind_m_s": 1}):
        with pytest.raises(InputError):
            design.read({**table, "fluid": wrong})


def test_one_file_alone_with_a_fluid_differs(tmp_path) -> None:
    wetted, dry = tmp_path / "wet.urdf", tmp_path / "dry.urdf"
    robot = softdyn.load("finger").robot
    dry.write_text(write(robot))
    wetted.write_text(write(replace(robot, fluid=WATER)))
    causes = compare(wetted, dry).causes
    assert {cause.kind for cause in causes} == {"fluid"}
