"""A controller behind a delay: the state and the reference that it gets, and absurd delays."""

from __future__ import annotations

import numpy as np
import pytest

from softdyn import Reference
from softdyn.controllers import Compensated, Mpc
from softdyn.controllers.predictive.actuation import MOST_WAITING, Actuation
from tests.support.control_cases import robot
from tests.support.refused import refused

DELAY = 0.1


class Recorder:
    """A controller that keeps what it is given."""

    def __call__(self, state, reference):
        self.state, self.reference = state, reference
        return np.zeros(2)


def test_the_reference_is_moved_by_the_delay():
    """Along a path of degree two it is that of the time at which the command begins to act."""
    model, inner = robot("finger"), Recorder()
    law = Compensated(inner, model, delay=DELAY, lag=0.0)
    law.reset(0.005)
    y, ydot, yddot = np.random.default_rng(0).normal(size=(3, 3))

    def path(t):
        return Reference(y + t * ydot + t**2 / 2 * yddot, ydot + t * yddot, yddot)

    law(model.state(model.q0, np.zeros(4)), path(0.3))
    for name in ("y", "ydot", "yddot"):
        expected = getattr(path(0.3 + DELAY), name)
        np.testing.assert_allclose(getattr(inner.reference, name), expected, rtol=1e-12)


@pytest.mark.parametrize("make", [Compensated, Mpc])
def test_a_period_too_short_for_a_delay_is_one_line(make):
    """There is no list of 5e9 commands on their way."""
    model = robot("finger")
    law = make(model, delay=5.0) if make is Mpc else make(Recorder(), model, delay=5.0)
    for period in (1e-9, 5e-324, 0.0, -1.0, np.nan, "1"):
        with refused("period"):
            law.reset(period)
    law.reset(0.05)
    command = law(model.state(model.q0, np.zeros(4)), Reference([0.1, 0, 0.1]))
    assert np.isfinite(command.u).all()


@pytest.mark.parametrize("delay", [10.1, 1e300, np.inf, -1.0, np.nan])
def test_a_delay_is_at_most_that_of_the_format(delay):
    with refused("delay"):
        Compensated(Recorder(), robot("finger"), delay=delay)


def test_a_prediction_over_the_delay_has_few_steps():
    path = Actuation(10.0)
    path.reset(10.0 / MOST_WAITING, np.zeros(2))
    means, _ = path.over_delay(1e-12)
    assert len(means) == 1000
