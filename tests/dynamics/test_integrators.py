"""Integrators against closed-form motion and against their own order."""

from __future__ import annotations

import numpy as np
import pytest

import softdyn
from softdyn.dynamics.integrators import step_implicit, step_rk4
from tests.support.robots import build, slide

# A sliding mass on a spring and damper, pulled by one cable: m x'' + d x' + k x = f
MASS, DAMPING, STIFFNESS, FORCE = 2.0, 0.6, 50.0, 3.0


@pytest.fixture
def slider() -> softdyn.SoftModel:
    text = slide(MASS, limit=(-9, 9), damping=DAMPING, stiffness=STIFFNESS, pull=(-9, 9), gear=2)
    return build(text)


def exact(t: float, x0: float, v0: float) -> float:
    """Underdamped response to a constant force."""
    rest, decay = FORCE / STIFFNESS, DAMPING / (2 * MASS)
    omega = np.sqrt(STIFFNESS / MASS - decay**2)
    a, b = x0 - rest, (v0 + decay * (x0 - rest)) / omega
    return rest + np.exp(-decay * t) * (a * np.cos(omega * t) + b * np.sin(omega * t))


def error(model, step, h: float) -> float:
    q, v, u = np.array([0.2]), np.array([-0.5]), np.array([FORCE / 2])
    for _ in range(round(1.0 / h)):
        q, v = step(model, q, v, u, h)
    return abs(q[0] - exact(1.0, 0.2, -0.5))


@pytest.mark.parametrize(
    ("step", "order", "h", "bar"), [(step_rk4, 4, 0.02, 1e-4), (step_implicit, 1, 0.005, 5e-3)]
)
def test_order_against_the_closed_form(slider, step, order, h, bar):
    coarse, fine = error(slider, step, h), error(slider, step, h / 2)
    assert fine < coarse < bar
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.15)


def test_implicit_damping_is_stable_where_explicit_is_not():
    """λmax(M⁻¹D) of the finger is about 1e4: a 5 ms step is far outside any explicit scheme."""
    model = softdyn.load("finger")
    q, v, u = np.full(4, 0.3), np.zeros(4), np.zeros(2)
    s = model.state(q, v)
    assert np.linalg.eigvals(np.linalg.solve(s.M, s.D)).real.max() * 5e-3 > 10
    for _ in range(2000):
        q, v = step_implicit(model, q, v, u, 5e-3)
    # only a slow creep remains, in which damping, springs and gravity balance
    assert np.abs(model.state(q, v).h).max() < 1e-6 * np.abs(s.h).max()
    assert np.abs(v).max() < 1e-3
