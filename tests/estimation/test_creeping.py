"""Torques of Maxwell branches that a filter estimates, against those of the twin."""

from __future__ import annotations

import numpy as np
import pytest

import softdyn
from softdyn import InputError
from softdyn.description.rig import Sensor, SensorKind
from softdyn.dynamics.balance import Disturbance, ForceBalance
from softdyn.dynamics.mimic import build
from softdyn.estimation import Ekf
from softdyn.estimation.creeping import CreepingBalance
from softdyn.validation import Twin
from tests.dynamics.test_relaxation import creeping
from tests.support.oracles import slopes

STEP = 1e-6
SENSORS = tuple(
    Sensor(f"at_{k}", SensorKind.JOINT, joint=f"joint{k}", noise=(2e-3,), rate=200.0)
    for k in (1, 4)
)


def test_the_balance_at_the_step_s_end_has_the_slopes_of_differences() -> None:
    model = build(creeping(softdyn.load("finger").robot))
    plain = ForceBalance(model, (Disturbance.RELAXATION,))
    creeps = CreepingBalance(model, plain, slice(0, 4))
    creeps.hold(0.01)
    rng = np.random.default_rng(0)
    (q, v, a, d), u = 0.3 * rng.normal(size=(4, 4)), np.array([0.3, 0.1])
    found = creeps.trusted(q, v, a, u, d)
    by_v = slopes(lambda x: creeps.trusted(q, v + x, a, u, d).residual, 4, STEP)
    by_d = slopes(lambda x: creeps.trusted(q, v, a, u, d + x).residual, 4, STEP)
    assert found.by_v == pytest.approx(by_v, abs=1e-8)
    assert found.by_d == pytest.approx(by_d, abs=1e-8)


def test_the_torques_and_the_shape_are_found() -> None:
    model = build(creeping(softdyn.load("finger").robot, 1.0, 0.6))
    twin, rng = Twin(model), np.random.default_rng(3)
    seeing, blind = Ekf(model, SENSORS, ("relaxation",)), Ekf(model, SENSORS)
    u, errors, inside = np.zeros(2), np.zeros((2, 0)), []
    for k in range(400):
        t = 0.005 * k
        y = twin.qpos[[0, 3]] + 2e-3 * rng.normal(size=2)
        states = [one.step(t, y, u) for one in (seeing, blind)]
        errors = np.column_stack((errors, [np.abs(s.q - twin.qpos).max() for s in states]))
        z, sigma = (getattr(states[0], n)["relaxation"] for n in ("disturbances", "deviations"))
        inside.append(np.abs(z - twin.memory.torque) < 2 * sigma)
        u = np.array([0.4, 0.0]) if t < 1.0 else np.array([0.1, 0.3])
        twin.advance(u, 10)
    assert np.mean(inside) > 0.9
    assert errors[0, 20:].max() < 0.02
    assert errors[0, 20:].mean() < 0.5 * errors[1, 20:].mean()


def test_springs_that_do_not_creep_have_no_torques_to_estimate() -> None:
    with pytest.raises(InputError):
        Ekf(softdyn.load("finger"), SENSORS, ("relaxation",))
