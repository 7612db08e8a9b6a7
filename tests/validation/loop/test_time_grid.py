"""The division of a run into control periods and plant steps."""

import math

import numpy as np
import pytest

from softdyn import InputError
from softdyn.validation import simulate
from softdyn.validation.loop.time_grid import MAX_STEPS, TimeGrid
from tests.support.cart import TARGET, steer
from tests.support.refused import refused

NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("period", "substeps"),
    [(0.005, 10), (0.0075, 15), (0.002, 4), (0.0005, 1), (0.0001, 1), (0.0007, 2), (0.01, 20)],
)
def test_the_plant_step_divides_the_period(period, substeps):
    plan = TimeGrid.plan(1.0, period)
    assert plan.substeps == substeps
    assert plan.timestep == pytest.approx(period / substeps, rel=1e-15)
    assert plan.timestep <= 5e-4 * (1 + 1e-9)


@pytest.mark.parametrize("duration", [10.0, 40 / 3, 0.0075, 0.001, 4.0, 8.0])
@pytest.mark.parametrize("period", [0.005, 0.0075, 0.002])
def test_runs_end_within_half_a_plant_step(duration, period):
    plan = TimeGrid.plan(duration, period)
    t = plan.times()
    assert len(t) == plan.steps + 1
    assert abs(t[-1] - duration) <= plan.timestep / 2 + 1e-12
    assert 1 <= plan.last <= plan.substeps
    assert (np.diff(t) > 0).all()


@pytest.mark.parametrize("name", ["duration", "period", "timestep"])
@pytest.mark.parametrize("value", [NAN, INF, -INF, 0.0, -1.0, "1", [1.0], 1j, True, 1e300, 5e-324])
def test_hostile_times_are_refused(cart, name, value):
    if (name, value) == ("timestep", INF):  # one step per period
        assert TimeGrid.plan(0.01, 0.002, INF).substeps == 1
        return
    with pytest.raises(InputError):
        simulate(cart, steer, TARGET, **{"duration": 0.01, "period": 0.002, name: value})


def test_steps_that_do_not_fit_are_refused():
    with refused("timestep", 0.0003):
        TimeGrid.plan(1.0, 0.005, 0.0003)
    with refused("timestep", 0.01):
        TimeGrid.plan(1.0, 0.005, 0.01)
    with refused("duration", "4000 s"):
        TimeGrid.plan((MAX_STEPS + 1) * 0.002, 0.002)
