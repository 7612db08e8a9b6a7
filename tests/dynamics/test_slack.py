"""Tendons that only pull: max(0, k (ℓ - rest) + d ℓ̇), in every term that depends on them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn import SoftModel
from softdyn.controllers.qps.horizon import Horizon
from softdyn.dynamics.derivatives import (
    acceleration_derivatives,
    tangent_dynamics,
)
from softdyn.dynamics.integrators import step_rk4
from softdyn.identification.unknowns.kinds import KINDS, Around, MotionSample
from softdyn.statics.equilibrium import potential, residual
from tests.support.arms import PROJECTIONS
from tests.support.named_models import named_model
from tests.support.oracles import gradient, relative, slopes
from tests.support.rigs import slackened
from tests.support.robots import build, cable, slide

BAR = 1e-7
SEEDS = (1, 12, 16, 19, 23)  # with fixed and spatial tendons, branches and continuous joints
MARGIN = 0.002  # N; differences do not cross the edge between taut and slack


@pytest.fixture(params=[*SEEDS, "spirob", *PROJECTIONS], ids=str)
def model(request, tmp_path) -> SoftModel:
    return slackened(named_model(request.param, tmp_path))


def tension(model: SoftModel, q, v) -> tuple[np.ndarray, np.ndarray]:
    """Spring and damper force (tendons,) of each tendon; the negative ones do not act."""
    spring = model.tendon_stiffness * (model.tendon_lengths(q) - model.tendon_rest)
    return spring, model.tendon_damping * (model.tendon_moment_arms(q) @ v)


def cases(model: SoftModel, speed: float = 0.3, count: int = 4):
    """States without a tendon on the edge."""
    rng = np.random.default_rng(3)
    low, high = np.maximum(model.lower, -0.8), np.minimum(model.upper, 0.8)
    for _ in range(200):
        q, v = model.configuration(rng.uniform(low, high)), speed * rng.normal(size=model.nv)
        if np.abs(sum(tension(model, q, v))).min() > MARGIN:
            u = rng.uniform(np.maximum(model.u_min, -5.0), np.minimum(model.u_max, 5.0))
            yield q, v, u
            count -= 1
        if count == 0:
            return
    raise AssertionError("no state away from the edge")


def test_the_generated_cases_are_taut_and_slack(tmp_path):
    taut = []
    for seed in SEEDS:
        model = slackened(named_model(seed, tmp_path))
        taut += [sum(tension(model, q, v)) > 0 for q, v, _ in cases(model)]
    assert 0.3 < np.concatenate(taut).mean() < 0.7


def test_every_term_has_the_tension(model):
    for q, v, u in cases(model):
        state = model.state(q, v)
        spring, damper = tension(model, q, v)
        taut, arms = spring + damper > 0, model.tendon_moment_arms(q)
        free = slackened(model, slack=False)
        free = free.state(q, v)  # every tendon acts both ways
        K = free.K - arms.T @ np.where(taut, 0.0, spring)
        D = free.D - arms.T @ (np.where(taut, 0.0, model.tendon_damping)[:, None] * arms)
        h = free.h - arms.T @ np.where(taut, 0.0, spring + damper)
        for found, expected, whole in ((state.K, K, free.K), (state.D, D, free.D),
                                       (state.h, h, free.h)):  # fmt: skip
            assert relative(found, expected, np.abs(whole).max()) < 1e-12
        qdd = model.forward_dynamics(q, v, u)
        scale = np.abs(state.M).max() * np.abs(qdd).max()
        assert relative(state.M @ qdd + state.h, state.B @ u, scale) < 1e-11


def test_energy_and_stiffness(model):
    for q, v, u in cases(model, speed=0.0):
        K = model.state(q, v).K
        assert relative(gradient(model, model.elastic_energy, q, 1e-4), K, 1e-3) <= BAR
        found = gradient(model, lambda x, v=v: model.state(x, 0 * v).K, q, 1e-4)
        assert relative(found, model.tangent_stiffness(q), 1e-3) <= BAR
        Pi = gradient(model, lambda x, u=u: potential(model, x, u), q, 1e-4)
        r = residual(model, q, u)
        assert relative(Pi, r, np.abs(model.state(q, v).bias).max() + 1.0) <= BAR


def test_derivatives(model):
    for q, v, u in cases(model, count=2):
        found = acceleration_derivatives(model, q, v, u)
        assert relative(found.value, model.forward_dynamics(q, v, u)) < 1e-11
        by_q = gradient(model, lambda x, v=v, u=u: model.forward_dynamics(x, v, u), q, 2e-4)
        assert relative(by_q, found.q) <= BAR
        K, D = tangent_dynamics(model, q, v, u)
        h = gradient(
            model, lambda x, v=v, u=u: model.state(x, v).h - model.state(x, v).B @ u, q, 2e-4
        )
        assert relative(h, K) <= BAR
        h = slopes(lambda x, q=q, v=v: model.state(q, v + x).h, model.nv, 1e-4)
        assert relative(h, D) <= BAR


def test_columns_of_parameters(tmp_path):
    """∂r/∂k and ∂r/∂d of r = M a + h - B u, which identification fits: zero for a slack tendon."""
    model = slackened(named_model(16, tmp_path))
    for q, v, _ in cases(model):
        sample = MotionSample(model.state(q, v), v, np.zeros(model.nu), Around(model))
        for kind, field in (("tendon_stiffness", "stiffness"), ("tendon_damping", "damping")):
            columns = KINDS[kind].columns(sample)
            for t, tendon in enumerate(model.robot.tendons):
                tendons = list(model.robot.tendons)
                tendons[t] = replace(tendon, **{field: 1.0001 * getattr(tendon, field)})
                other = softdyn.build(replace(model.robot, tendons=tuple(tendons)))
                change = (other.state(q, v).h - sample.state.h) / (1e-4 * getattr(tendon, field))
                np.testing.assert_allclose(columns[:, t], change, atol=1e-9)


def test_the_kernel_and_numpy_agree(tmp_path):
    for seed in SEEDS:
        model = slackened(named_model(seed, tmp_path))
        for q, v, _ in cases(model, count=2):
            scratch = model._scratch
            model.state(q, v)
            one = model._by_kernel(q, q, v, scratch)
            two = model._in_numpy(q, q, v, scratch)
            for field in ("K", "D", "h"):
                assert relative(getattr(one, field), getattr(two, field)) < 1e-12


def test_a_tendon_that_is_always_taut_is_an_ordinary_one(tmp_path):
    model = named_model(16, tmp_path)
    shorter = tuple(
        replace(tendon, stiffness=3.0, damping=0.1, rest=-50.0 * (not tendon.sites))
        for tendon in model.robot.tendons
    )
    both, pulls = (
        softdyn.build(replace(model.robot, tendons=tuple(replace(t, slack=slack) for t in shorter)))
        for slack in (False, True)
    )
    q, v, u = next(cases(both))
    for field in ("K", "D", "h", "B", "lengths"):
        np.testing.assert_array_equal(
            getattr(both.state(q, v), field), getattr(pulls.state(q, v), field)
        )
    np.testing.assert_array_equal(both.forward_dynamics(q, v, u), pulls.forward_dynamics(q, v, u))
    assert both.elastic_energy(q) == pulls.elastic_energy(q)


def test_the_horizon_keeps_the_taut_tendons_of_its_state(tmp_path):
    """A tendon that its damper slackens has neither a stiffness nor a damping."""
    model = slackened(named_model(16, tmp_path))
    horizon = Horizon(model, 0.05)
    for q, v, _ in cases(model, speed=2.0):
        state = model.state(q, v)
        M, h = horizon(state)
        stiffness = gradient(model, lambda x, v=v: model.state(x, v).K, q, 2e-5)
        assert relative(M, state.M + 0.05 * state.D + 0.05**2 * stiffness) < 1e-6
        assert relative(h, state.h + 0.05 * stiffness @ v) < 1e-6


MASS, K, SPEED, STEPS = 0.5, 800.0, 2.0, 400


def cart(damping: float) -> SoftModel:
    spring = {"stiffness": K, "damping": damping, "rest": 0.3, "slack": "true"}
    return build(slide(MASS, limit=(-9, 9), block=cable("cable", "slide 1", **spring)))


def run(model: SoftModel, x: float, time: float) -> list[tuple[float, float]]:
    q, v = np.array([x]), np.array([SPEED])
    path = [(x, SPEED)]
    for _ in range(STEPS):
        q, v = step_rk4(model, q, v, np.zeros(0), time / STEPS)
        path.append((q[0], v[0]))
    return path


def test_a_slack_cable_catches_a_cart_and_returns_its_energy():
    """The catch is half an oscillation; its stretch is v √(m/k), and the speed comes back."""
    model, rate = cart(0.0), math.sqrt(K / MASS)
    caught = run(model, 0.3, math.pi / rate)
    assert max(x for x, _ in caught) == pytest.approx(0.3 + SPEED / rate, rel=1e-8)
    assert caught[-1] == pytest.approx((0.3, -SPEED), rel=1e-8)
    energies = [model.kinetic_energy([x], [v]) + model.potential_energy([x]) for x, v in caught]
    np.testing.assert_allclose(energies, MASS * SPEED**2 / 2, rtol=1e-8)
    free = run(model, -0.5, 0.4)  # 0.8 m to the catch: no force, no energy
    assert free[-1] == pytest.approx((0.3, SPEED), rel=1e-12)
    assert model.elastic_energy([0.2]) == 0


def test_a_damped_catch_ends_where_the_damper_takes_the_tension():
    """m s̈ + d ṡ + k s = 0 until s̈ = 0, with s still positive; then the cart moves freely."""
    d = 8.0
    model = cart(d)
    decay = d / (2 * MASS)
    rate = math.sqrt(K / MASS - decay**2)
    # s = (v / w) e^(-a t) sin(w t); s̈ = 0 at tan(w t) = 2 a w / (a² - w²)
    end = (math.atan2(2 * decay * rate, decay**2 - rate**2)) / rate
    assert 0 < end < math.pi / rate
    fall = math.exp(-decay * end) * SPEED / rate
    stretch = fall * math.sin(rate * end)
    speed = fall * (rate * math.cos(rate * end) - decay * math.sin(rate * end))
    assert stretch > 0.001
    assert run(model, 0.3, end)[-1] == pytest.approx((0.3 + stretch, speed), rel=1e-8)
    q, v = np.array([0.3 + 0.99 * stretch]), np.array([speed])
    assert model.forward_dynamics(q, v, np.zeros(0)) == 0  # stretched, but without tension
    assert model.state(q, v).D == 0
    assert model.state(q, 0 * v).K > 0
