"""The processes of disturbances: their long run, and steps of any length."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov

import softdyn
from softdyn.estimation import Disturbance
from softdyn.estimation.drift import DisturbanceDrift

SIGMA, TAU = 0.3, 0.7
STEPS = (1e-3, 0.05, 0.7, 5.0)


def over(step: float, disturbance: Disturbance):
    model = softdyn.load("finger")
    variances = np.full(disturbance.size(model), SIGMA**2)
    return DisturbanceDrift(model, (disturbance,), variances, TAU).over(step)


@pytest.mark.parametrize("step", STEPS)
def test_the_first_order_keeps_its_variance_in_the_long_run(step):
    """ḋ = -d / τ + w decays by e^(-T/τ), and what it gains keeps σ²."""
    found = over(step, Disturbance.PAYLOAD)
    assert found.decay[0] == pytest.approx(np.exp(-step / TAU), rel=1e-12)
    left = found.decay[0] ** 2 * SIGMA**2 + found.added[0]
    assert left == pytest.approx(SIGMA**2, rel=1e-12)


@pytest.mark.parametrize("step", STEPS)
def test_the_second_order_is_that_of_its_equation(step):
    """The transition by a matrix exponential, the long run by a Lyapunov equation."""
    A = np.array([[0.0, 1.0], [-1 / TAU**2, -2 / TAU]])
    W = np.diag([0.0, 4 * SIGMA**2 / TAU**3])
    stationary = solve_continuous_lyapunov(A, -W)
    assert np.allclose(stationary, np.diag([SIGMA**2, (SIGMA / TAU) ** 2]), rtol=1e-9, atol=1e-12)
    found = over(step, Disturbance.TIP_FORCE)
    assert np.allclose(found.turn, expm(A * step), rtol=1e-9, atol=1e-12)
    decay = found.turn @ stationary @ found.turn.T + found.noise
    assert np.allclose(decay, stationary, rtol=1e-9, atol=1e-12)
