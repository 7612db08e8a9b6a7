"""The dynamics over a horizon τ: the published ones at τ = 0, else backward Euler's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import softdyn
from softdyn.compiled import COMPILES
from softdyn.controllers import SoftIdClfQp
from softdyn.controllers.qps import horizon, linear_algebra, soft_inverse_dynamics
from softdyn.controllers.qps.horizon import Horizon
from tests.support.control_cases import BUNDLED, GAINS, drawn, gains_of, robot
from tests.support.exact_qps import printed, solve_quadprog
from tests.support.oracles import gradient, relative
from tests.support.random_robots import write_robot
from tests.support.refused import refused

ROBOTS = ("finger", "spirob", "n < 3 + m", "sliding and turning")


def controller_of(name: str, **options: object) -> SoftIdClfQp:
    gains = gains_of(name) if name in BUNDLED else GAINS
    return SoftIdClfQp(robot(name), gains, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ROBOTS)
def test_no_horizon_is_the_published_law(name: str) -> None:
    published, held = controller_of(name), controller_of(name, horizon=0.0)
    for state, reference in drawn(name):
        M, h = Horizon(robot(name), 0.0)(state)
        assert (M is state.M, h is state.h) == (True, True)
        np.testing.assert_array_equal(published(state, reference).u, held(state, reference).u)


@pytest.mark.parametrize("name", ROBOTS)
def test_springs_and_dampers_at_the_end_of_the_horizon(name: str) -> None:
    # the equation solved for q̈ is the original one with K and D's force at (q, v) after τ
    model, tau, rng = robot(name), 0.03, np.random.default_rng(1)
    for state, _ in drawn(name)[:6]:
        u = rng.uniform(model.u_min, model.u_max)
        M, h = Horizon(model, tau)(state)
        qdd = np.linalg.solve(M, state.B @ u - h)
        v = state.v + tau * qdd
        # springs of the bundled and micro robots are linear: so is K, in joint coordinates
        moved = model.coordinates(state.q) + tau * v
        K = model.stiffness * (moved - model.rest)
        residual = state.M @ qdd + state.bias + state.D @ v + K - state.B @ u
        assert np.abs(residual).max() < 1e-10 * max(1.0, np.abs(M @ qdd).max())


@pytest.mark.parametrize("seed", [*range(4), "finger", "sliding and turning"])
def test_the_stiffness_is_the_gradient_of_the_springs(seed: int | str, tmp_path: Path) -> None:
    # random robots have elastic tendons, whose stiffness depends on q
    model = robot(seed) if isinstance(seed, str) else softdyn.load(write_robot(seed, tmp_path))
    rng = np.random.default_rng(2)
    low, high = np.maximum(model.lower, -0.8), np.minimum(model.upper, 0.8)
    q = model.configuration(rng.uniform(low, high))
    numeric = gradient(model, lambda q: model.state(q, np.zeros(model.nv)).K, q, 2e-4)
    assert relative(model.tangent_stiffness(q), numeric) < 1e-7
    state, tau = model.state(q, rng.normal(size=model.nv)), 0.3
    M, h = Horizon(model, tau)(state)
    assert relative(M, state.M + tau * state.D + tau**2 * numeric) < 1e-7
    assert relative(h, state.h + tau * numeric @ state.v) < 1e-7


@pytest.mark.parametrize("tau", [0.002, 0.05])
@pytest.mark.parametrize("name", ROBOTS)
def test_inputs_are_those_of_the_textbook_form_with_the_other_dynamics(
    name: str, tau: float
) -> None:
    model = robot(name)
    controller = controller_of(name, horizon=tau)
    for state, reference in drawn(name)[::2]:
        M = state.M + tau * state.D + tau**2 * np.diag(model.stiffness)
        h = state.h + tau * model.stiffness * state.v
        exact = solve_quadprog(printed(replace(state, M=M, h=h), reference, controller.gains))
        assert exact.residual < 1e-9
        spread = (model.u_max - model.u_min).max()
        np.testing.assert_allclose(
            controller(state, reference).u, exact["u"], rtol=0, atol=1e-6 * max(spread, 1e-9)
        )
    assert controller.guard.fallbacks == 0


@pytest.mark.skipif(not COMPILES, reason="nothing is compiled")
@pytest.mark.parametrize("name", ["finger", "spirob"])
def test_warming_up_compiles_all_that_the_steps_need(name: str) -> None:
    kernels = horizon._over, soft_inverse_dynamics._condense, linear_algebra.row_space
    law = controller_of(name, horizon=0.03)
    before = [len(kernel.signatures) for kernel in kernels]
    for state, reference in drawn(name):
        law(state, reference)
    assert [len(kernel.signatures) for kernel in kernels] == before


def test_the_horizon_matters_and_must_make_sense() -> None:
    state, reference = drawn("finger")[4]
    one, two = (controller_of("finger", horizon=tau)(state, reference).u for tau in (0.0, 0.03))
    assert np.abs(one - two).max() > 1e-4
    for wrong in (-1e-3, float("nan"), "long"):
        with refused("horizon"):
            controller_of("finger", horizon=wrong)
