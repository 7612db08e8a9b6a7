"""Least squares where each run has its own unknowns, compared with SciPy on the whole problem."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize

from softdyn.identification.blocks import ResidualBlock, least_squares, reduced

RUNS, TIMES = 3, np.linspace(0, 1, 9)
TRUE = np.array([2.0, 0.7])  # decay and a common offset; each run has its own amplitude
OWN = [np.array([1.0]), np.array([-2.0]), np.array([0.5])]


def model(theta, own):
    """Blocks of y = a e^(-θ₀ t) + θ₁, with reproducible noise."""
    rng = np.random.default_rng(5)
    found = []
    for amplitude, true in zip(own, OWN, strict=True):
        seen = true * np.exp(-TRUE[0] * TIMES) + TRUE[1] + 0.1 * rng.standard_normal(len(TIMES))
        decay = np.exp(-theta[0] * TIMES)
        by_theta = np.column_stack((-TIMES * amplitude * decay, np.ones(len(TIMES))))
        found.append(ResidualBlock(amplitude * decay + theta[1] - seen, by_theta, decay[:, None]))
    return found


@pytest.mark.parametrize("lower", [(0.0, -np.inf), (3.0, -np.inf)])
def test_the_least_of_the_whole_problem(lower):
    """The second bound is active: the unbounded minimum is at θ₀ = 2."""
    start = np.array([5.0, 0.0])
    theta, own = least_squares(model, start, [np.ones(1)] * RUNS, np.array(lower))

    def residual(z):
        return np.concatenate([one.residual for one in model(z[:2], z[2:, None])])

    whole = scipy.optimize.least_squares(
        residual, [*start, 1, 1, 1], bounds=([*lower, *[-np.inf] * RUNS], np.inf), xtol=1e-12
    )
    assert np.allclose([*theta, *np.ravel(own)], whole.x, atol=2e-4)
    assert (theta[0] == pytest.approx(lower[0], abs=1e-6)) == (lower[0] == 3)


def test_what_is_left_of_the_normal_equations():
    blocks = model(TRUE + 0.3, OWN)
    J = np.zeros((RUNS * len(TIMES), 2 + RUNS))
    J[:, :2] = np.vstack([one.shared for one in blocks])
    for k, one in enumerate(blocks):
        J[k * len(TIMES) : (k + 1) * len(TIMES), 2 + k] = one.own[:, 0]
    f = np.concatenate([one.residual for one in blocks])
    found = reduced(blocks)
    inverse = np.linalg.inv(J.T @ J)
    assert np.allclose(np.linalg.inv(found.R.T @ found.R), inverse[:2, :2])
    step = -inverse @ J.T @ f
    delta = -np.linalg.solve(found.R, found.d)
    assert np.allclose([*delta, *np.ravel(found.own(delta))], step)
    assert found.cost - found.gain - found.d @ found.d == pytest.approx(((f + J @ step) ** 2).sum())


def test_steps_to_where_there_is_nothing_are_shortened():
    """From a distant start, the first Gauss-Newton step exceeds θ₀ = 12, where the model fails."""
    asked = []

    def partly(theta, own):
        asked.append(theta[0])
        return model(theta, own) if 0.5 < theta[0] < 12 else None

    theta, _ = least_squares(partly, np.array([8.0, 0.0]), [np.ones(1)] * RUNS, np.full(2, -np.inf))
    assert not all(0.5 < one < 12 for one in asked)
    everywhere, _ = least_squares(model, TRUE, OWN, np.full(2, -np.inf))
    assert theta == pytest.approx(everywhere, abs=1e-3)
