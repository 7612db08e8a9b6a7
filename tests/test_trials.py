"""Trials away from the paper's grid: plants that differ, delays, noise, tuning."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from control_cases import robot

from controllers import Command
from softdyn import Reference, SetPoint
from validation import Twin, beyond, paper, tuning
from validation.trials import Degraded, Plant, Trial, run


def test_a_plant_of_other_numbers() -> None:
    plain, heavy = Twin("finger"), Plant(mass=1.2, stiffness=0.9, damping=1.1).twin("finger")
    weight = [twin.model.body_mass.sum() for twin in (plain, heavy)]
    assert weight[1] == pytest.approx(1.2 * weight[0])
    np.testing.assert_allclose(heavy.model.jnt_stiffness, 0.9 * plain.model.jnt_stiffness)
    np.testing.assert_allclose(heavy.model.dof_damping, 1.1 * plain.model.dof_damping)
    # and it acts: the arm falls alike at first, whatever its mass, but bends otherwise
    for twin in (plain, heavy):
        twin.advance(np.zeros(2), 400)
    assert np.abs(plain.qpos - heavy.qpos).max() > 1e-3


class Counting:
    period = 0.1

    def __init__(self) -> None:
        self.calls = 0
        self.seen: list[np.ndarray] = []

    def __call__(self, state: Any, reference: Reference) -> Command:
        self.calls += 1
        self.seen.append(state.y)
        return Command(np.full(2, float(self.calls)))


def test_delay_and_noise() -> None:
    model, inner = robot("finger"), Counting()
    state = model.state(model.q0, np.zeros(model.nv))
    late = Degraded(inner, Plant(delay=0.01, noise=0.001), 0.005, seed=1)
    late.period = 0.005
    assert inner.period == 0.005
    answers = [late(state, SetPoint(state.y)).u[0] for _ in range(200)]
    assert answers == [1.0, 1.0, *range(1, 199)]
    seen = np.array(inner.seen) - state.y
    assert np.std(seen) == pytest.approx(0.001, rel=0.15)


def test_a_trial_is_what_simulate_says() -> None:
    result = run(Trial("finger", "best", "set_point", 0.25, duration=0.5, shrink=0.7))
    assert not result["failed"]
    assert 0 <= result["final_error_cm"] < 3
    assert result["second_cycle_cm2"] is None


def test_cells_cover_the_grid() -> None:
    trials = beyond.cells(("finger", "spirob"), "best")
    assert len(trials) == (3 + 2) * 4 + 2 * 5
    assert max(t.period or 0 for t in trials if t.robot == "spirob") == 0.002
    row = {
        "robot": "finger", "kind": "set_point", "period": 0.005, "mean": 1.0, "failed": 1,
        "cells": [{"final_error_cm": x, "failed": x > 2} for x in (0.5, 1.0, math.nan, 3.0)],
    }  # fmt: skip
    text = beyond.markdown([row])
    assert "| finger | 5 ms | 0.50 | 1.00 | – | 3.00 failed | 1.00 | 1 |" in text


def test_the_cost_of_a_run() -> None:
    trial = Trial("finger", "best", "set_point", 0.25)
    length = 100 * paper.setup("finger").length
    exact = {"failed": False, "mse_cm2": (0.01 * length) ** 2, "final_error_cm": 0.0}
    wanted = 0.5 * (math.log10(0.011) + math.log10(0.001))
    assert tuning.cost(trial, exact) == pytest.approx(wanted)
    assert tuning.cost(trial, {"failed": True}) > tuning.cost(trial, exact)
    trained = tuning.cases(("finger",), "best", 1.0)
    assert not {t.value for t in trained if t.kind == "set_point"} & set(paper.THETAS)
    assert not {t.value for t in trained if t.kind == "tracking"} & set(paper.OMEGAS)


def test_the_same_seed_gives_the_same_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cma")

    def bowl(trials: Any, jobs: int) -> list[dict[str, Any]]:  # best at a = 0.1, b = 10
        far = [math.log10(t.gains["a"]) + 1 for t in trials]
        wide = [math.log10(t.gains["b"]) - 1 for t in trials]
        return [
            {"failed": False, "mse_cm2": 0.0, "final_error_cm": x * x + y * y}
            for x, y in zip(far, wide, strict=True)
        ]

    monkeypatch.setattr(tuning, "run_all", bowl)
    trial = Trial("finger", "best", "set_point", 0.25)
    kept: list[dict[str, Any]] = []
    traces = [
        tuning.tune(
            [trial], {"a": 1.0, "b": 1.0}, generations=25, population=8, seed=3, each=kept.append
        )
        for _ in range(2)
    ]
    assert traces[0] == traces[1]
    assert kept == traces[0] + traces[1]
    assert traces[0][0]["a"] == 1.0  # the start comes first
    best = min(traces[0], key=lambda entry: entry["cost"])
    assert math.log10(best["a"]) == pytest.approx(-1, abs=0.3)
    assert math.log10(best["b"]) == pytest.approx(1, abs=0.3)


def test_the_report_groups_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    def made_up(trials: list[Trial], jobs: int) -> list[dict[str, Any]]:
        return [
            {
                "final_error_cm": t.value, "mse_cm2": 10 * t.value, "second_cycle_cm2": t.value,
                "failed": t.value == 1.5, "step_us": {"median": 100.0},
            }
            for t in trials
        ]  # fmt: skip

    monkeypatch.setattr(beyond, "run_all", made_up)
    rows = beyond.report(("spirob",), "best")
    assert [(row["kind"], row["period"]) for row in rows] == [
        ("set_point", 0.001), ("set_point", 0.002), ("tracking", 0.002),
    ]  # fmt: skip
    assert rows[0]["mean"] == pytest.approx(0.75)
    assert rows[0]["failed"] == 1
    assert rows[2]["mean"] == pytest.approx(3.0)
    assert rows[2]["second_cycle_mean"] == pytest.approx(0.3)
    text = beyond.markdown(rows)
    assert "1.50 failed" in text
    assert "3.00 (0.30)" in text
