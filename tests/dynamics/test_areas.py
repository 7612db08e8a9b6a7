"""Chambers whose area changes: an own volume, differences, MuJoCo, the table, identification."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import pytest

import softdyn
from softdyn import InputError, SoftModel, UrdfError, design, identification, statics
from softdyn.description.robot import Mimic, Tendon
from softdyn.description.urdf import parse_text
from softdyn.description.urdf_writer import write
from softdyn.dynamics.balance import ForceBalance
from softdyn.dynamics.mimic import build
from softdyn.identification import Acquisition, Measurements
from softdyn.statics.equilibrium import potential, residual
from softdyn.validation import compare, crosscheck
from softdyn.validation.mjcf import export
from softdyn.validation.twin.twin import Twin
from tests.support.arms import loaded
from tests.support.command import command

LENGTH, AREA, GROWTH, STEP = 0.1, 4e-5, (1.5, -2.0, 3.0), 1e-6
PRESSURES = np.array([8e4, 5e4])


def arm(straight: bool = False, growth: tuple[float, ...] = GROWTH) -> design.Arm:
    """Two chambers beside the axis, the second of a constant area."""
    section = design.Section(
        LENGTH, 0.0125, design.Material(2e5), 3, ("bend_y", "bend_z", "extension"),
        bending_stiffness=2e-3, axial_stiffness=40.0, mass=0.05, discs=3,
    )  # fmt: skip
    words = {"offset": 0.008, "max_pressure": 1e5, "area": AREA, "straight": straight}
    one = design.Chamber(0.4, growth=growth, name="one", **words)  # type: ignore[arg-type]
    two = design.Chamber(2.5, name="two", **words)  # type: ignore[arg-type]
    return design.Arm((section,), design.Damping(ratio=0.2), chambers=(one, two))


@pytest.fixture(params=[False, True], ids=["in the body", "from disc to disc"])
def model(request: pytest.FixtureRequest, tmp_path: Path) -> SoftModel:
    return loaded(arm(request.param), tmp_path)


def drawn(model: SoftModel, seed: int) -> np.ndarray:
    """A configuration with stretches of some 10 %."""
    sizes = np.where(["extension" in name for name in model.joint_names], 0.004, 0.2)
    return np.random.default_rng(seed).normal(size=model.nv) * sizes


def own_length(model: SoftModel, tendon: Tendon, q: np.ndarray) -> float:
    """The chamber's length from the links' poses, or from its arms and its length when straight."""
    if not tendon.sites:
        order = {name: k for k, name in enumerate(model.joint_names)}
        return LENGTH + sum(term.coef * q[order[term.joint]] for term in tendon.terms)
    poses = model.link_poses(q)
    points = [poses[s.link][:3, :3] @ s.xyz + poses[s.link][:3, 3] for s in tendon.sites]
    return float(sum(np.linalg.norm(b - a) for a, b in pairwise(points)))


def own_area(stretch: np.ndarray | float) -> np.ndarray:
    """A(λ) in powers of λ - 1."""
    return AREA * (1 + sum(g * (stretch - 1) ** k for k, g in enumerate(GROWTH, 1)))


def test_the_work_of_the_pressure_is_p_times_the_change_of_the_volume(model: SoftModel) -> None:
    nodes, weights = np.polynomial.legendre.leggauss(24)
    first, last = drawn(model, 1), drawn(model, 2)
    work = 0.0
    for node, weight in zip(nodes, weights, strict=True):
        q = first + (1 + node) / 2 * (last - first)
        force = model.state(q, np.zeros(model.nv)).B @ [PRESSURES[0], 0.0]
        work += weight / 2 * float(force @ (last - first))
    a, b = (own_length(model, model.robot.tendons[0], q) for q in (first, last))
    at = a + (1 + nodes) / 2 * (b - a)
    volume = float(weights @ own_area(at / LENGTH)) * (b - a) / 2
    assert abs(b - a) > 0.01 * LENGTH
    assert work == pytest.approx(PRESSURES[0] * volume, rel=1e-9)


def test_the_tangent_is_the_difference_of_the_forces(model: SoftModel, tmp_path: Path) -> None:
    """It holds for the tree, for a reduced model, and for one with a mimic joint."""
    robot = model.robot
    leader, follower = robot.joints[2], robot.joints[5]
    mimic = replace(follower, mimic=Mimic(leader.name, 0.7, 0.1))
    file = tmp_path / "mimic.urdf"
    joints = tuple(mimic if one is follower else one for one in robot.joints)
    file.write_text(write(replace(robot, joints=joints)))
    basis = np.transpose([drawn(model, seed) for seed in range(4)])
    for one in (model, softdyn.reduce(model, basis), softdyn.load(file)):
        q, v = 0.2 * drawn(model, 3)[: one.nv], np.zeros(one.nv)
        terms = ForceBalance(one)(q, v, v, PRESSURES)
        moves = STEP * np.eye(one.nv)
        slopes = [(residual(one, q + d, PRESSURES) - residual(one, q - d, PRESSURES)) / (2 * STEP)
                  for d in moves]  # fmt: skip
        scale = np.abs(terms.by_q).max()
        np.testing.assert_allclose(terms.by_q, np.transpose(slopes), atol=1e-8 * scale)
        works = [(potential(one, q + d, PRESSURES) - potential(one, q - d, PRESSURES)) / (2 * STEP)
                 for d in moves]  # fmt: skip
        np.testing.assert_allclose(works, terms.residual, atol=1e-7 * np.abs(works).max())


def test_numpy_and_the_kernel_agree(model: SoftModel, monkeypatch: pytest.MonkeyPatch) -> None:
    q, v = drawn(model, 4), np.zeros(model.nv)
    state, batch = model.state(q, v), model.states(np.array([q]), np.array([v]))
    monkeypatch.setattr(model, "_assemble", model._in_numpy)  # type: ignore[attr-defined]
    np.testing.assert_allclose(model.state(q, v).B, state.B, rtol=1e-12, atol=1e-18)
    assert (batch[0].B == state.B).all()


def test_the_twin_pushes_with_its_own_area(model: SoftModel) -> None:
    twin = Twin(model)
    qpos = np.random.default_rng(5).normal(size=twin.model.nq) * 0.02
    twin.set_state(qpos, np.zeros(twin.model.nv))
    twin.advance(PRESSURES)
    u, first = PRESSURES, twin.model.tendon("one").id
    # the force of the step is that of its start
    twin.set_state(qpos, np.zeros(twin.model.nv))
    twin.data.ctrl[:] = u
    mujoco.mj_forward(twin.model, twin.data)
    length = twin.data.ten_length[first] + LENGTH * (not model.robot.tendons[0].sites)
    expected = u[0] * own_area(length / LENGTH)
    pushed = twin.model.actuator_gear[0, 0] * twin.data.actuator_force[0]
    assert pushed == pytest.approx(float(expected), rel=1e-12)
    assert abs(length / LENGTH - 1) > 0.005
    assert twin.model.actuator_gear[1, 0] == AREA


def test_mujoco_agrees_in_every_term_and_scheme(model: SoftModel) -> None:
    found = crosscheck(model, samples=1, trajectories=not model.tendons.spatial)
    assert found.passed, str(found)


def test_export_says_that_it_is_lost_and_compare_finds_it(tmp_path: Path) -> None:
    growing, constant = tmp_path / "growing.urdf", tmp_path / "constant.urdf"
    growing.write_text(design.urdf(arm()), encoding="utf-8")
    constant.write_text(design.urdf(arm(growth=())), encoding="utf-8")
    result, lost = export.write_mjcf(growing, tmp_path / "arm.xml", shapes=False)
    assert {one.where for one in result.causes if not one.one_sided} == {"one"}
    assert [line for line in lost if "area" in line] == [
        "actuator 'one': that its area changes with its stretch"
    ]
    assert {one.where for one in compare(growing, constant).causes} == {"one"}
    kept = softdyn.load(growing).robot
    assert kept.actuators[0].area_growth == pytest.approx(GROWTH)
    assert kept.actuators[0].area_length == pytest.approx(LENGTH)
    assert "area_growth" not in constant.read_text()


def test_a_growth_of_zero_is_a_constant_area(tmp_path: Path) -> None:
    zero, plain = (loaded(arm(growth=growth), tmp_path) for growth in ((0.0,), ()))
    q, v = drawn(zero, 6), drawn(zero, 7)
    np.testing.assert_allclose(zero.state(q, v).B, plain.state(q, v).B, rtol=1e-15)
    rest = [statics.settle(one, PRESSURES).q for one in (zero, plain)]
    np.testing.assert_allclose(*rest, atol=1e-12)


def test_area_and_factor_are_found_from_a_bending_test(model: SoftModel) -> None:
    """Tips at rest under 19 pressures, with 0.2 mm of noise, of an arm with other areas."""
    true = {"gear": 1.15 * AREA, "area_growth": (0.9, *GROWTH[1:])}
    first, *others = model.robot.actuators
    other = build(replace(model.robot, actuators=(replace(first, **true), *others)))
    rng = np.random.default_rng(8)
    u = np.column_stack((np.linspace(1e4, 1e5, 19), np.zeros(19)))
    tips = np.array([statics.settle(other, one).y for one in u])
    data = Measurements(np.arange(19.0), u, ("tip.x", "tip.y", "tip.z"),
                        tips + 2e-4 * rng.normal(size=tips.shape))  # fmt: skip
    unknowns = (identification.parameters(model, "gear")[0],
                identification.parameters(model, "area_growth")[0])  # fmt: skip
    found = identification.identify(model, data, unknowns, acquisition=Acquisition(static=True))
    for one, truth in zip(found.estimates, (true["gear"], true["area_growth"][0]), strict=True):
        low, high = one.interval
        assert low < truth < high
    assert found.estimates[0].value == pytest.approx(1.15 * AREA, rel=0.02)


TABLE = """\
[material]
youngs_modulus_kPa = 200
[[section]]
name = "one"
length_mm = 100
radius_mm = 12.5
segments = 3
freedoms = ["bend", "extension"]
bending_stiffness_Nm2 = 2e-3
axial_stiffness_N = 40
[[chamber]]
offset_mm = 8
area_mm2 = [40, 60, -80]
max_pressure_kPa = 100
"""


def growth_of(text: str) -> tuple[float, ...]:
    robot = parse_text(design.read(tomllib.loads(text)).text, path=Path("arm.urdf"))
    (one,) = robot.actuators
    return (1e6 * one.gear, *one.area_growth)


def test_a_table_states_coefficients_or_measured_areas() -> None:
    assert growth_of(TABLE) == pytest.approx((40, 1.5, -2.0))
    at = [1.0, 1.1, 1.2, 1.4]
    rows = [[x, 40 * (1 + 1.5 * (x - 1) - 2 * (x - 1) ** 2)] for x in at]
    measured = TABLE.replace("area_mm2 = [40, 60, -80]", f"areas_mm2 = {rows}")
    assert growth_of(measured) == pytest.approx((40, 1.5, -2.0))


@pytest.mark.parametrize(
    ("new", "expected"),
    [
        ("area_mm2 = [40, -400]", "an area > 0 at stretches"),
        ("area_mm2 = [-40, 60]", "a finite number > 0"),
        ("area_mm2 = [40, 1, 1, 1, 1, 1]", "at most 4 numbers"),
        ("areas_mm2 = [[1.0, 40]]", "areas at two stretches > 0 or more"),
        ("areas_mm2 = [[-1.0, 40], [1.0, 40]]", "areas at two stretches > 0 or more"),
        ("areas_mm2 = [1.0, 40]", "a list of lists of 2 numbers"),
        ("areas_mm2 = [[1.0, 40], [1.1, 44]]\narea_mm2 = 40", "areas or area, not both"),
    ],
)
def test_misuse_of_a_table_is_one_line(new: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        design.read(tomllib.loads(TABLE.replace("area_mm2 = [40, 60, -80]", new)), "arm.toml")
    assert expected in caught.value.expected
    assert "\n" not in str(caught.value)


def test_a_file_with_an_area_below_zero_in_reach_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    text = design.urdf(arm(growth=(0.5,))).replace('area_growth="0.5"', 'area_growth="-30"')
    file.write_text(text, encoding="utf-8")
    with pytest.raises(UrdfError) as caught:
        softdyn.load(file)
    assert 'actuator name="one"' in str(caught.value)
    assert command("check", file).code == 2


def test_a_pressure_in_bar_is_said(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    text = design.urdf(arm()).replace('upper="100000"', 'upper="1"')
    file.write_text(text, encoding="utf-8")
    assert "in kPa or bar?" in command("check", file).out
