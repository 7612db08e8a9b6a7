"""The implicit step against its equation and differences, and readings of a spread state."""

from __future__ import annotations

import numpy as np
import pytest

import softdyn
from softdyn.description.rig import Sensor, SensorKind
from softdyn.dynamics.balance import ForceBalance
from softdyn.dynamics.implicit_step import ImplicitStep, ImplicitStepResult
from softdyn.estimation import Disturbance
from softdyn.estimation.arrivals import second_order, sharp
from softdyn.sensing import Sensors
from tests.support.named_models import BALANCED, case, named_model
from tests.support.oracles import relative, slopes

ALL = tuple(Disturbance)


@pytest.fixture(params=BALANCED, ids=str)
def model(request, tmp_path):
    return named_model(request.param, tmp_path)


def test_second_order_is_the_mean_and_variance_of_a_spread_state():
    model, rng = softdyn.load("finger"), np.random.default_rng(0)
    q, v, u = np.array([0.4, -0.3, 0.5, 0.6]), np.zeros(4), np.zeros(2)
    sensors = Sensors(model, (Sensor("tip", SensorKind.POSITION, link=model.robot.task),))
    spread = 0.03 * (np.eye(4) + 0.3)
    P, own = np.zeros((8, 8)), np.full(3, 1e-9)
    P[:4, :4] = spread @ spread.T
    here, by_q = sensors.predict(q, v, u)
    assert not sharp(by_q, P, own)
    assert sharp(by_q, 1e-9 * P, own)
    shift, variance = second_order(sensors, (q, v, u), P, own)
    moved = rng.normal(size=(20_000, 4)) @ spread
    rest = np.array([sensors.predict(q + x, v, u)[0] - here - by_q[:, :4] @ x for x in moved])
    assert np.allclose(shift, rest.mean(axis=0), rtol=0.03, atol=1e-6)
    assert np.allclose(variance - own, rest.var(axis=0), rtol=0.06, atol=1e-9)


def test_step(model):
    q, v, _, commands, d = case(model, ALL)
    n, step, h, free = model.nv, 0.002, 2e-5, np.zeros(model.nv, int)
    stepper, balance = ImplicitStep(model, ForceBalance(model, ALL)), ForceBalance(model, ALL)
    found = ImplicitStepResult(*(part.copy() for part in stepper(q, v, commands, d, step, free)))
    left = balance(found.q, found.v, (found.v - v) / step, commands, d).residual
    assert not found.held.any()
    assert np.abs(left).max() < 1e-7 * np.abs(balance(q, v, 0 * v, commands, d).residual).max()
    assert np.allclose(found.q, model.integrate(q, step * found.v))

    def speed(x):
        return stepper(
            model.integrate(q, x[:n]), v + x[n : 2 * n], commands, d + x[2 * n :], step, free
        ).v.copy()

    by_state = slopes(speed, 2 * n + len(d), h)
    assert relative(by_state, found.by_state) < 1e-6
    pushes = found.by_state[:, 2 * n :]
    by_d = ForceBalance(model, ALL)(found.q, found.v, (found.v - v) / step, commands, d).by_d
    assert relative(pushes, -found.by_force @ by_d) < 1e-6


def test_stops_hold_and_release():
    """A joint pressed against its stop stays on it; its stop never pulls."""
    model = softdyn.load("helix")
    stepper, balance = ImplicitStep(model), ForceBalance(model)
    q, v, held = model.q0.copy(), np.zeros(model.nv), np.zeros(model.nv, int)
    u = np.where(np.arange(model.nu) < 3, model.u_max, 0.0)
    met = set()
    for k in range(300):
        if k == 150:
            u = np.zeros(model.nu)
        found = stepper(q, v, u, np.zeros(0), 0.001, held)
        force = balance(found.q, found.v, (found.v - v) / 0.001, u, np.zeros(0)).residual
        free = found.held == 0
        assert np.all(found.q <= model.upper + 1e-9)
        assert np.all(found.q >= model.lower - 1e-9)
        assert np.all(force[~free] * found.held[~free] <= 1e-6)
        assert np.allclose(force[free], 0, atol=1e-5)
        limits = np.where(found.held > 0, model.upper, model.lower)
        assert np.allclose(found.q[~free], limits[~free], atol=1e-9)
        # a held joint's position no longer depends on the state before
        row = found.by_state[:, : model.nv] * 0.001 + np.eye(model.nv)
        assert np.allclose(row[~free], 0, atol=1e-9)
        q, v, held = found.q, found.v, found.held
        met |= {(int(i), int(held[i])) for i in np.flatnonzero(held)}
    assert len(met) >= 3
    assert len({i for i, _ in met} - set(np.flatnonzero(held))) >= 1


def test_derivatives_with_held_joints_are_those_of_differences():
    """Each stop stays as it is under small changes; those of q, v and d act on all joints."""
    model, d, step = softdyn.load("helix"), np.array([0.02, -0.01, 0.03]), 0.001
    forces = (Disturbance.TIP_FORCE,)
    stepper, n = ImplicitStep(model, ForceBalance(model, forces)), model.nv
    q, v, held = model.q0.copy(), np.zeros(n), np.zeros(n, int)
    u = np.where(np.arange(model.nu) < 3, model.u_max, 0.0)
    for _ in range(120):
        q, v, *_, held, _ = stepper(q, v, u, d, step, held)
    before = q.copy(), v.copy()
    found = ImplicitStepResult(*(part.copy() for part in stepper(q, v, u, d, step, held)))
    assert 2 <= np.count_nonzero(found.held) < n
    h = 1e-5

    def speed(x):
        stepper.forget()
        moved = model.integrate(before[0], x[:n]), before[1] + x[n : 2 * n]
        there = stepper(*moved, u, d + x[2 * n :], step, held)
        np.testing.assert_array_equal(there.held, found.held)
        return there.v

    differences = slopes(speed, 2 * n + len(d), h)
    for part in (slice(0, n), slice(n, 2 * n), slice(2 * n, None)):
        assert relative(differences[:, part], found.by_state[:, part]) < 1e-6


@pytest.mark.parametrize("name", ["finger", "helix"])
def test_violent_steps_end_in_balance_or_not_at_all(name):
    """A quarter of the joints begin at stops; speeds up to 100 ranges a second."""
    model, rng, ended = softdyn.load(name), np.random.default_rng(0), 0
    stepper, balance = ImplicitStep(model), ForceBalance(model)
    n, size = model.nv, model.upper - model.lower
    for _ in range(200):
        share, at_stop = rng.random((2, n))
        share = np.where(at_stop < 0.125, 0.0, np.where(at_stop < 0.25, 1.0, share))
        q = model.configuration(model.lower + share * size)
        v, step = 10 ** rng.uniform(-1, 2) * size * rng.normal(size=n), 10 ** rng.uniform(-3, -2)
        u = rng.uniform(model.u_min, model.u_max)
        stepper.forget()
        found = stepper(q, v, u, np.zeros(0), step)
        if found is None:
            continue
        ended += 1
        terms = balance(found.q, found.v, (found.v - v) / step, u, np.zeros(0))
        rounding = 1e-9 * (np.abs(terms.by_a) @ np.abs(found.v - v) / step).max()
        assert np.abs(terms.residual[found.held == 0]).max(initial=0) < rounding
        assert (terms.residual * found.held < rounding).all()
        at = model.coordinates(found.q)
        assert ((model.lower - 1e-9 <= at) & (at <= model.upper + 1e-9)).all()
    assert ended > 50
