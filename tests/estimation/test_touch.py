"""Which link is touched: the rate of false alarms, and touches that are found."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, kstest

import softdyn
from softdyn import InputError
from softdyn.estimation import Ekf, EkfParameters, find_touch
from softdyn.sensing import Sensors
from tests.support.sensed import sensors

PERIOD = 0.005
GIVEN = EkfParameters(spread=0.01, process=0.05)


def recorded(model, rng, steps, link="link1", force=(0.0, 0.0, 0.0), begin=0.0):
    """Readings of a plant with the filter's own noise, and a force at a link's centre of mass."""
    ekf, n, u = Ekf(model, sensors(model), parameters=GIVEN), model.nv, np.array([0.3, -0.2])
    start = rng.normal(size=2 * n) * np.sqrt(ekf._first)
    q, v, held = model.integrate(model.q0, start[:n]), start[n:], np.zeros(n, int)
    robot, rows, none = model.robot, [], np.zeros(0)
    truth = Sensors(model, sensors(model))
    origin = {one.name: one.origin.translation for one in robot.links}
    for k in range(steps):
        if k:
            push = rng.normal(size=n) * np.sqrt(ekf._force_noise / PERIOD)
            if k * PERIOD > begin:
                push += jacobian(model, q, link, origin[link]).T @ np.array(force)
            found = ekf._step(q, v, u, none, PERIOD, held)
            kick = found.by_force @ push
            q, v, held = model.integrate(found.q, PERIOD * kick), found.v + kick, found.held
        ideal = truth.measure(model.state(q, v), u).values
        noise = np.concatenate([np.sqrt(c.variance) for c in ekf._channels])
        rows.append(ideal + noise * rng.normal(size=len(ideal)))
    return PERIOD * np.arange(steps), np.array(rows), np.tile(u, (steps, 1))


def jacobian(model, q, link, point):
    """The Jacobian of a link's point, by central differences of its pose."""
    columns = []
    for axis in 1e-6 * np.eye(model.nv):
        ahead, behind = (model.link_poses(model.integrate(q, s * axis))[link] for s in (1, -1))
        columns.append((ahead - behind) @ [*point, 1.0] / 2e-6)
    return np.array(columns)[:, :3].T


def test_rate_of_false_alarms():
    """Without a force the chances are uniform, and alarms as rare as said."""
    model, rate, runs = softdyn.load("finger"), 0.2, 50
    chances, alarms = [], 0
    for seed in range(runs):
        data = recorded(model, np.random.default_rng(seed), 40)
        found = find_touch(model, *data, sensors(model), parameters=GIVEN, false_alarms=rate)
        chances.append(found.chances)
        alarms += found.touched is not None
        assert found.links == ("link1", "link2", "link3", "link4")
        assert found.ranks[1:].tolist() == [2, 2, 2]  # the finger is planar
    assert alarms <= binom.ppf(0.999, runs, rate)
    assert alarms >= binom.ppf(0.001, runs, rate / 4)  # links with one force share their alarms
    for column in np.transpose(chances):
        assert kstest(column, "uniform").pvalue > 1e-3


@pytest.mark.parametrize("link", ["link2", "link4"])
def test_a_touch_is_found_on_its_link(link):
    model, force = softdyn.load("finger"), np.array([0.1, 0.0, -0.1])
    for seed in range(2):
        data = recorded(model, np.random.default_rng(seed), 200, link, force, begin=0.5)
        found = find_touch(model, *data, sensors(model), parameters=GIVEN, begin=0.5)
        assert found.touched == link
    where = found.links.index(link)
    assert np.linalg.norm(found.forces[where] - force) < 0.3 * np.linalg.norm(force)


def test_refused_arguments():
    model = softdyn.load("finger")
    t, rows, u = recorded(model, np.random.default_rng(0), 3)
    for bad in (
        lambda: find_touch(model, t, rows, u[:2], sensors(model)),
        lambda: find_touch(model, t, rows, u, sensors(model), begin=1.0),
        lambda: find_touch(model, t, rows, u, sensors(model), false_alarms=1.0),
        lambda: find_touch(model, t, rows[0], u, sensors(model)),
        lambda: find_touch(model, t, rows, u),
    ):
        with pytest.raises(InputError):
            bad()
