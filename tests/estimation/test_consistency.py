"""Consistency of the filter over runs: at a joint stop, and with a force at the tip."""

from __future__ import annotations

import numpy as np

import softdyn
from softdyn.estimation import Ekf, EkfParameters
from softdyn.estimation.consistency import chi_squared_bounds, nees
from softdyn.sensing import Sensors
from tests.support.rigs import sensors

PERIOD, RUNS, STEPS = 0.005, 20, 40
U = np.array([0.3, -0.2])


def last_of(model, seed, stop):
    """The last true state and estimate of a run with the filter's own noise in the plant.

    The start is drawn from the filter's first covariance, and one joint begins near its stop.
    """
    rng, n = np.random.default_rng(seed), model.nv
    begin = model.q0.copy()
    begin[stop] = model.upper[stop] - 0.01
    ekf = Ekf(
        model, sensors(model), start=(begin, np.zeros(n)),
        parameters=EkfParameters(spread=0.03, process=0.05, least_process=0.05),
    )  # fmt: skip
    drawn = rng.normal(size=2 * n) * np.sqrt(ekf._filtered.first)
    q, v = np.clip(begin + drawn[:n], model.lower, model.upper), drawn[n:]
    held, truth = np.zeros(n, int), Sensors(model, sensors(model))
    noise = np.concatenate([np.sqrt(channel.variance) for channel in ekf._channels])
    for k in range(STEPS):
        if k:
            found = ekf._filtered.step(q, v, U, np.zeros(0), PERIOD, held)
            kick = found.by_force @ (
                rng.normal(size=n) * np.sqrt(ekf._filtered.force_noise / PERIOD)
            )
            q = np.clip(found.q + PERIOD * kick, model.lower, model.upper)
            v, held = found.v + kick, found.held
        state = model.state(q, v)
        ideal = truth.measure(state, U).values
        estimate = ekf.step(k * PERIOD, ideal + noise * rng.normal(size=len(ideal)), U)
    return state, estimate


def test_errors_are_chi_squared_over_20_runs_with_joints_at_stops_left_out():
    """NEES of the joints that neither truth nor estimate has at a stop (Bar-Shalom, 5.4)."""
    model = softdyn.load("finger")
    total, freedom, at_stops = 0.0, 0, 0
    for seed in range(RUNS):
        state, estimate = last_of(model, seed, 0)
        near = np.zeros(model.nv, bool)
        for q in (state.q, estimate.q):
            near |= (q >= model.upper - 1e-3) | (q <= model.lower + 1e-3)
        free = np.flatnonzero(~near)
        rows = np.eye(2 * model.nv)[np.concatenate((free, model.nv + free))]
        value, degrees = nees(estimate, state, rows)
        assert degrees == 2 * len(free)
        total, freedom, at_stops = total + value, freedom + degrees, at_stops + near.sum()
    assert at_stops > 0
    low, high = chi_squared_bounds(freedom, 1, 0.999)
    assert low < total < high
