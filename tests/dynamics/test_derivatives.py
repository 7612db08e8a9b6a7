"""Derivatives of the dynamics against central differences, and the contracted tendon Hessians."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn import InputError, SoftModel
from softdyn.dynamics import discrete_step
from softdyn.dynamics.derivatives import (
    acceleration_derivatives,
    gravity_stiffness,
    stiffness,
    tangent_dynamics,
    tendon_curvature,
)
from softdyn.identification import DesignFile, apply_values, choose_unknowns
from tests.support.arms import PROJECTIONS, THREE_SECTIONS
from tests.support.named_models import named_model
from tests.support.oracles import gradient, relative

BAR = 1e-7
# of the random robots: continuous and prismatic joints, elastic, damped, branching tendons
SOURCES = ("finger", "helix", "spirob", *range(8), *PROJECTIONS)


@pytest.fixture(params=SOURCES, ids=str)
def model(request, tmp_path) -> SoftModel:
    return named_model(request.param, tmp_path)


def random_case(model: SoftModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    low, high = np.maximum(model.lower, -0.8), np.minimum(model.upper, 0.8)
    u = rng.uniform(np.maximum(model.u_min, -5.0), np.minimum(model.u_max, 5.0))
    return model.configuration(rng.uniform(low, high)), rng.normal(size=model.nv), u


def step_of(model: SoftModel) -> float:
    return 1e-3 if np.all(model.upper - model.lower > 0.05) else 2e-4


def by_velocity(f, v: np.ndarray, step: float = 1e-3) -> np.ndarray:
    """Central differences, extrapolated (Richardson)."""

    def central(h: float) -> np.ndarray:
        axes = np.eye(len(v))
        return np.stack([(f(v + h * e) - f(v - h * e)) / (2 * h) for e in axes], axis=-1)

    return (4 * central(step) - central(2 * step)) / 3


def test_acceleration(model):
    q, v, u = random_case(model)
    found = acceleration_derivatives(model, q, v, u)
    assert relative(found.value, model.forward_dynamics(q, v, u)) < 1e-12
    step = step_of(model)
    by_q = gradient(model, lambda x: model.forward_dynamics(x, v, u), q, step)
    assert relative(by_q, found.q) <= BAR
    by_v = by_velocity(lambda x: model.forward_dynamics(q, x, u), v)
    assert relative(by_v, found.v) <= BAR
    state = model.state(q, v)
    assert relative(np.linalg.solve(state.M, state.B), found.u, 1e-6) < 1e-9


def test_tangent_dynamics(model):
    """The Jacobians of the State's h - B u at q̈ = 0."""
    q, v, u = random_case(model)

    def force(x: np.ndarray) -> np.ndarray:
        s = model.state(x, v)
        return s.h - s.B @ u

    K, D = tangent_dynamics(model, q, v, u)
    assert relative(gradient(model, force, q, step_of(model)), K) <= BAR
    assert relative(by_velocity(lambda x: model.state(q, x).h, v), D) <= BAR


def test_stiffness(model):
    q, _, u = random_case(model)

    def residual(x: np.ndarray) -> np.ndarray:
        s = model.state(x, np.zeros(model.nv))
        return s.K + s.g - s.B @ u

    found = stiffness(model, q, u)
    expected = gradient(model, residual, q, step_of(model))
    assert relative(expected, found) <= BAR
    assert relative(found, found.T) < 1e-12
    by_q = gradient(model, model.gravity, q)
    assert relative(by_q, gravity_stiffness(model, q)) <= BAR


def test_contracted_tendon_hessians(model):
    """The kernel over incident joints against the dense Hessians of all joints."""
    q, v, _ = random_case(model)
    dense = model.tendon_hessians(q)
    force = np.random.default_rng(4).normal(size=len(dense))
    total, rates = tendon_curvature(model, q, force, v)
    assert relative(np.tensordot(force, dense, 1), total) < 1e-11
    assert relative(dense @ v, rates) < 1e-11


@pytest.mark.parametrize("name", ["finger", "spirob", "winched"])
def test_acceleration_by_parameters(name, tmp_path):
    """Against central differences of robots with other values."""
    model = named_model(name, tmp_path)
    q, v, u = random_case(model)
    kinds = ["stiffness", "damping", "mass", "rest", "gear", "free_length"]
    kinds += ["armature"] * bool(model.armature.any())
    kinds += ["tendon_stiffness", "tendon_damping"] * bool(model.tendon_stiffness.any())
    unknowns = choose_unknowns(model, kinds)
    found = acceleration_derivatives(model, q, v, u, unknowns)
    theta, expected = np.array([one.nominal for one in unknowns]), []
    for k, one in enumerate(unknowns):
        h = 1e-4 * one.scale * np.eye(len(theta))[k]
        ends = [apply_values(model, unknowns, theta + s * h).forward_dynamics(q, v, u)
                for s in (1, -1)]  # fmt: skip
        expected.append((ends[0] - ends[1]) / (2 * h[k]))
    scale = np.array([one.scale for one in unknowns])
    assert relative(np.array(expected).T * scale, found.parameters * scale) <= BAR


def test_acceleration_by_a_bending_stiffness_and_an_offset(tmp_path):
    """They are those of an arm's design, where the identification has differences."""
    (tmp_path / "arm.toml").write_text(THREE_SECTIONS, "utf-8")
    design = DesignFile(tmp_path / "arm.toml")
    unknowns = design.unknowns(["youngs_modulus", "offset"])
    model = design.model
    rng = np.random.default_rng(1)
    q, v = 0.05 * rng.normal(size=model.nv), rng.normal(size=model.nv)
    u = rng.uniform(model.u_min, model.u_max)
    found = acceleration_derivatives(model, q, v, u, unknowns)
    theta = np.array([one.nominal for one in unknowns])
    for k, one in enumerate(unknowns):
        h = 1e-3 * abs(one.nominal) * np.eye(len(theta))[k]
        near = [apply_values(model, unknowns, theta + s * h).forward_dynamics(q, v, u)
                for s in (1, -1, 2, -2)]  # fmt: skip
        slope = (8 * (near[0] - near[1]) - near[2] + near[3]) / (12 * h[k])
        assert relative(slope, found.parameters[:, k]) <= 10 * BAR, one.label


@pytest.mark.parametrize("name", ["finger", "spirob"])
@pytest.mark.parametrize("at_stop", [False, True])
def test_a_step_by_parameters(name, at_stop, tmp_path):
    """Against central differences of robots with other values; a joint may end at its stop."""
    model = named_model(name, tmp_path)
    q, v, u = random_case(model)
    if at_stop:
        q = model.configuration(np.where(np.arange(model.nv) == 1, model.upper, q))
        v[1] = 30.0
    unknowns = choose_unknowns(model, ["stiffness", "damping", "mass", "rest"])
    unknowns = unknowns[:: max(1, len(unknowns) // 12)]
    found = discrete_step(model, q, v, u, 0.01, parameters=unknowns)
    assert found.held.any() or not at_stop
    theta, expected = np.array([one.nominal for one in unknowns]), []
    scale = np.array([one.scale for one in unknowns])
    for h in np.diag(1e-4 * scale):
        near = [discrete_step(apply_values(model, unknowns, theta + s * h), q, v, u, 0.01)
                for s in (1, -1)]  # fmt: skip
        assert all((one.held == found.held).all() for one in near)
        ends = [np.concatenate((one.q, one.v)) for one in near]
        expected.append((ends[0] - ends[1]) / (2 * h.sum()))
    assert relative(np.array(expected).T * scale, found.parameters * scale) <= 1e-6


def test_parameters_of_another_kind_are_refused(tmp_path):
    model = softdyn.load("finger")
    still = np.zeros(4), np.zeros(2)
    with pytest.raises(InputError):
        acceleration_derivatives(model, model.q0, *still, ["stiffness"])
    rubbing = softdyn.build(replace(model.robot, joints=tuple(
        replace(one, friction=0.1) for one in model.robot.joints
    )))  # fmt: skip
    with pytest.raises(InputError):
        acceleration_derivatives(rubbing, model.q0, *still, choose_unknowns(rubbing, ["friction"]))
    gripper = PROJECTIONS["mimic"](tmp_path)
    with pytest.raises(InputError):
        acceleration_derivatives(
            gripper, gripper.q0, np.zeros(gripper.nv), np.zeros(gripper.nu),
            choose_unknowns(model, ["stiffness"]),
        )  # fmt: skip


@pytest.mark.parametrize(
    "arguments",
    [([0] * 3, [0] * 4, [0] * 2), ([0] * 4, [np.nan] * 4, [0] * 2), ([0] * 4, [0] * 4, [0, "a"])],
)
def test_bad_arguments_are_refused(arguments):
    with pytest.raises(InputError):
        acceleration_derivatives(softdyn.load("finger"), *arguments)
