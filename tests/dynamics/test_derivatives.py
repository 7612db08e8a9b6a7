"""Derivatives of the dynamics against central differences, and the contracted tendon Hessians."""

from __future__ import annotations

import numpy as np
import pytest

import softdyn
from softdyn import InputError, SoftModel
from softdyn.dynamics.derivatives import (
    acceleration_derivatives,
    gravity_stiffness,
    stiffness,
    tangent_dynamics,
    tendon_curvature,
)
from tests.proof.crosschecks.random_robots import write_robot
from tests.support.arms import PROJECTIONS
from tests.support.oracles import gradient, relative

BAR = 1e-7
# of the random robots: continuous and prismatic joints, elastic, damped, branching tendons
SOURCES = ("finger", "helix", "spirob", *range(8), *PROJECTIONS)


@pytest.fixture(params=SOURCES, ids=str)
def model(request, tmp_path) -> SoftModel:
    source = request.param
    if source in PROJECTIONS:
        return PROJECTIONS[source](tmp_path)
    return softdyn.load(source if isinstance(source, str) else write_robot(source, tmp_path))


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


@pytest.mark.parametrize(
    "arguments",
    [([0] * 3, [0] * 4, [0] * 2), ([0] * 4, [np.nan] * 4, [0] * 2), ([0] * 4, [0] * 4, [0, "a"])],
)
def test_bad_arguments_are_refused(arguments):
    with pytest.raises(InputError):
        acceleration_derivatives(softdyn.load("finger"), *arguments)
