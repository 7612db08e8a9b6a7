"""Trials away from the paper's grid: plants that differ, delays, noise."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from softdyn import Reference, SetPoint
from softdyn.controllers import Command, Status
from softdyn.validation import Twin
from softdyn.validation.loop.signal_path import SignalPath
from softdyn.validation.studies import beyond, robustness
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.distribution import Distribution
from softdyn.validation.studies.engine.executors import run_all
from softdyn.validation.twin.plant_errors import PlantErrors
from tests.support.control_cases import robot


def test_a_plant_of_other_numbers() -> None:
    plain, heavy = Twin("finger"), PlantErrors(mass=1.2, stiffness=0.9, damping=1.1).twin("finger")
    weight = [twin.model.body_mass.sum() for twin in (plain, heavy)]
    assert weight[1] == pytest.approx(1.2 * weight[0])
    np.testing.assert_allclose(heavy.model.jnt_stiffness, 0.9 * plain.model.jnt_stiffness)
    np.testing.assert_allclose(heavy.model.dof_damping, 1.1 * plain.model.dof_damping)
    # and it acts: the arm falls alike at first, whatever its mass, but bends otherwise
    for twin in (plain, heavy):
        twin.advance(np.zeros(2), 400)
    assert np.abs(plain.qpos - heavy.qpos).max() > 1e-3


class Counting:
    def __init__(self) -> None:
        self.calls = 0
        self.seen: list[np.ndarray] = []
        self.period = 0.1

    def reset(self, period: float) -> None:
        self.period = period

    def __call__(self, state: Any, reference: Reference) -> Command:
        self.calls += 1
        self.seen.append(state.y)
        return Command(np.full(2, float(self.calls)))


def test_delay_and_noise() -> None:
    model, inner = robot("finger"), Counting()
    state = model.state(model.q0, np.zeros(model.nv))
    late = SignalPath(delay=0.01, noise=0.001, seed=1).around(inner, 0.005)
    late.reset(0.005)
    assert inner.period == 0.005
    answers = [late(state, SetPoint(state.y)).u[0] for _ in range(200)]
    assert answers == [1.0, 1.0, *range(1, 199)]
    seen = np.array(inner.seen) - state.y
    assert np.std(seen) == pytest.approx(0.001, rel=0.15)


def test_a_trial_is_what_simulate_says() -> None:
    case = Case("finger", "best", "set_point", 0.25, duration=0.5, ellipse_scale=0.7)
    (result,) = run_all([case], 1)
    assert not result["failed"]
    assert 0 <= result["final_error_cm"] < 3
    assert result["second_cycle_mse_cm2"] is None


def test_actuators_lag() -> None:
    model, inner = robot("finger"), Counting()
    state = model.state(model.q0, np.zeros(model.nv))
    late = SignalPath(lag=0.01).around(inner, 0.005)
    late.reset(0.005)
    assert inner.period == 0.005
    acts, dt = 0.0, 1e-6
    for k in range(3):  # what acts follows the command by Euler's fine steps
        inner.calls, mean = 0, 0.0  # each command is (1, 1)
        for _ in range(5000):
            mean += acts / 5000
            acts += dt / 0.01 * (1.0 - acts)
        command = late(state, SetPoint(state.y))
        assert command.u == pytest.approx(mean, abs=2e-4), k
        assert command.status is Status.OK


def test_cables_rub() -> None:
    twin = PlantErrors(cable_friction=0.05).twin("finger", friction=True)
    twin.advance(np.array([1.0, -1.0]), 100)  # both tendons slide
    rubs = twin.data.efc_type == mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON
    largest = 0.05 * 0.1  # N m: gear 0.1, inputs up to 1
    np.testing.assert_allclose(np.abs(twin.data.efc_force[rubs]), [largest] * 2)
    assert (twin.data.efc_force[rubs] * twin.data.ten_velocity < 0).all()


def test_cells_cover_the_grid() -> None:
    cells = beyond.cells(("finger", "spirob"), "best")
    assert len(cells) == (3 + 2) * 4 + 2 * 5
    assert max(c.period or 0 for c in cells.values() if c.robot == "spirob") == 0.002
    made = {label: Distribution(case.value) for label, case in cells.items()}
    first, second = beyond.markdown(made).split("\n\n")
    assert "| spirob | best | 1 ms | 0.00 | 0.50 | 1.00 | 1.50 | 0.75 ± 0.56 |" in first
    assert "| finger | best | 5 ms | 0.10 | 0.20 | 0.30 | 0.40 | 0.50 | 0.30 ± 0.14 |" in second
    trials = robustness.cells(("finger", "spirob"), "best", None)
    assert len(trials) == len(set(trials.values()))
    lost = {label: Distribution(1.0, {}, {"nominal": 1}) for label in trials}
    assert robustness.nearby_failures(lost) == 2 * 3 * (1 + 3 * 2)
    assert "| spirob | best | one plant step a period | 1.00 | 1.00 | 1.00 |" in (
        robustness.markdown(lost)
    )
