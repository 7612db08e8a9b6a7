"""Reduced models: Gauss's principle, PCC kinematics, controllers on them, bad bases.

The identities of a State are tested in test_model.py, with those of all other models.
"""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest

import softdyn
from softdyn import InputError, SetPoint, design, statics
from softdyn.controllers import Gains, SoftIdClfQp, Status
from softdyn.design.quadrature import RULES
from tests.support.arms import RUBBER, loaded
from tests.support.refused import refused

CABLES = tuple(
    design.Cable(k * math.pi / 2 + math.pi / 4 * end, 0.008, False, 10.0, 0, end, name=f"c{end}{k}")
    for end in (0, 1)
    for k in range(4)
)


def two_sections(segments: int) -> design.Arm:
    parts = [design.Section(0.1, 0.01, RUBBER, segments, name=name) for name in ("low", "high")]
    return design.Arm(tuple(parts), design.Damping(ratio=0.3), CABLES, name="pcc")


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    return loaded(two_sections(5), tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def pcc(full):
    return softdyn.reduce(full, design.strain_basis(two_sections(5)))


def arcs(curvatures: np.ndarray) -> np.ndarray:
    """Tip (3,) of arcs of 0.1 m in a row that hang down; curvatures (sections, 2) about y, z."""
    R, tip = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), np.zeros(3)
    for about_y, about_z in curvatures:
        kappa = math.hypot(about_y, about_z)
        axis = np.array([0, about_y, about_z]) / kappa
        angle, W = 0.1 * kappa, np.cross(np.eye(3), axis).T
        turn = np.eye(3) + math.sin(angle) * W.T + (1 - math.cos(angle)) * W @ W
        tip = tip + R @ (
            np.array([math.sin(angle), 0, 0]) / kappa
            + (1 - math.cos(angle)) / kappa * np.cross(axis, [1, 0, 0])
        )
        R = R @ turn.T.T
    return tip


def test_piecewise_constant_curvature_is_that_of_arcs(tmp_path):
    xi = np.array([6.0, -9.0, -4.0, 7.0])
    errors = []
    for n in (4, 8, 16):
        arm = two_sections(n)
        model = softdyn.reduce(loaded(arm, tmp_path), design.strain_basis(arm))
        assert model.joint_names == ("bend_y_low", "bend_z_low", "bend_y_high", "bend_z_high")
        tip = model.state(xi, np.zeros(4)).y
        errors.append(np.linalg.norm(tip - arcs(xi.reshape(2, 2))) / 0.2)
    assert errors[1] < 2e-3
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx([2, 2], abs=0.2)


def test_the_motion_is_the_free_one_s_nearest_by_gauss(full, pcc):
    rng = np.random.default_rng(0)
    xi, rate, u = rng.normal(size=4), rng.normal(size=4), rng.uniform(0, 3, full.nu)
    q, v = pcc.expand(xi), pcc.S @ rate
    free, M = full.forward_dynamics(q, v, u), full.state(q, v).M
    root = np.linalg.cholesky(M).T
    nearest = np.linalg.lstsq(root @ pcc.S, root @ free, rcond=None)[0]
    np.testing.assert_allclose(pcc.forward_dynamics(xi, rate, u), nearest, rtol=1e-8)


def test_what_it_projects_on_comes_back(pcc):
    xi, rate = np.arange(4.0), np.arange(4.0)[::-1]
    q, v = pcc.project(pcc.expand(xi), pcc.S @ rate)
    np.testing.assert_allclose([q, v], [xi, rate], atol=1e-12)
    # of a rod bent unevenly, the mean curvature
    uneven = pcc.S[:, 0] * np.linspace(0, 2, len(pcc.S))
    angle = uneven.sum()
    assert pcc.project(uneven, 0 * uneven)[0][0] * 0.1 == pytest.approx(angle)


def test_limits_are_those_of_the_joints_that_one_coordinate_moves(full, pcc):
    reach = math.pi / np.abs(pcc.S).max(axis=0)
    np.testing.assert_allclose([-pcc.lower, pcc.upper], [reach, reach])
    mixed = softdyn.reduce(full, np.ones((full.nv, 2)) + np.eye(full.nv)[:, :2])
    assert not np.isfinite(mixed.upper[:2]).any()


def test_laws_run_on_it_and_tell_its_states_from_the_robot_s(full, pcc):
    target = pcc.state([4.0, 3.0, -6.0, 2.0], np.zeros(4)).y
    law = SoftIdClfQp(pcc, Gains(Kp=200, eps=0.05))
    command = law(pcc.state(*pcc.project(full.q0, np.zeros(full.nv))), SetPoint(target))
    assert command.status is Status.OK
    with refused("state", "one of 'pcc' with 8 inputs, of …"):
        law(full.state(full.q0, np.zeros(full.nv)), SetPoint(target))


def test_it_rests_where_constant_moments_hold_it(full, pcc):
    """Cables in channels bend a weightless rod evenly: q_i = w_i T r / EI; this rod has weight."""
    u = np.array([1.0, 0, 0.5, 0, 0, 0.8, 0, 0])
    whole, reduced = statics.settle(full, u), statics.settle(pcc, u)
    assert reduced.stable
    assert np.linalg.norm(whole.y - reduced.y) < 2e-3
    # under the constraint the energy can only be higher
    assert statics.potential(pcc, reduced.q, u) > statics.potential(full, whole.q, u)


def test_copies_are_the_same_model(pcc):
    again = pickle.loads(pickle.dumps(pcc))
    assert again.robot.digest == pcc.robot.digest != pcc.full.robot.digest
    xi = np.array([1.0, 2, 3, 4])
    np.testing.assert_array_equal(again.state(xi, xi).h, pcc.state(xi, xi).h)


@pytest.mark.parametrize(
    ("basis", "message"),
    [
        (np.ones((3, 1)), ("basis",)),
        (np.ones(20), ("basis",)),
        (np.ones((20, 2)), ("basis",)),
        (
            np.full((20, 1), np.nan),
            ("basis", "array([[nan], …"),
        ),
        (np.empty((20, 0)), ("basis",)),
        (
            softdyn.Basis(np.ones((1, 1)), ("elbow",), ("a",)),
            ("basis", "of others: …"),
        ),
    ],
)
def test_a_bad_basis_is_one_line(full, basis, message):
    with refused(*message):
        softdyn.reduce(full, basis)


def test_the_file_of_an_arm_has_its_strains(tmp_path):
    """The basis of the robot is that of the arm, with any rule, plates and numbers of joints."""
    plate = design.Plate(0.012, 0.003, 0.005)
    parts = [
        design.Section(length, 0.01, RUBBER, count, name=name, plate=plate, freedoms=freedoms)
        for name, length, count, freedoms in (
            ("low.1", 0.0937, 3, ("bend_y", "bend_z")), ("middle", 0.2, 2, ("bend_y", "twist")),
            ("high", 0.05, 4, ("bend_z", "extension")),
        )
    ]  # fmt: skip
    arms = [design.Arm(tuple(parts), rule=rule) for rule in RULES.values()]
    arms += [two_sections(1)]
    for arm in arms:
        least = min(section.segments for section in arm.sections)
        for degree in range(least):
            stated, found = (
                design.strain_basis(one, degree) for one in (arm, loaded(arm, tmp_path).robot)
            )
            assert found.names == stated.names
            rows = [found.joints.index(name) for name in stated.joints]
            assert found.matrix[rows] == pytest.approx(stated.matrix, rel=1e-9, abs=1e-12)
    with pytest.raises(InputError):
        design.strain_basis(softdyn.load("finger").robot)


@pytest.mark.parametrize("degree", [-1, 0.5, 5, math.nan])
def test_a_bad_degree_is_one_line(degree):
    with refused("degree"):
        design.strain_basis(two_sections(5), degree)
