"""Trials away from the paper's grid: plants that differ, delays, noise, tuning."""

from __future__ import annotations

import json
import math
import tomllib
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import softdyn
from softdyn import Reference, SetPoint
from softdyn.commands import tune
from softdyn.controllers import Command, Status
from softdyn.controllers.schedule import make_schedule, tuned
from softdyn.validation import Twin, paper
from softdyn.validation.loop.signal_path import SignalPath
from softdyn.validation.studies import beyond, robustness, tuning
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.distribution import Distribution
from softdyn.validation.studies.engine.executors import run_all
from softdyn.validation.twin.plant_errors import PlantErrors
from tests.support import ROOT
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


def test_the_costs_of_a_run() -> None:
    at, along = (
        Case("finger", "best", "set_point", 0.25),
        Case("finger", "best", "tracking", 0.25),
    )
    length = 100 * paper.setup("finger").length
    # an error that falls to 1/e in 0.05 s: its square's integral is 0.025 s of the first one's
    decay = 0.025 * (1 - math.exp(-40))
    result = {
        "failed": False, "first_error_cm": 3.0, "mse_cm2": 9 * decay, "final_error_cm": 0.3,
    }  # fmt: skip
    assert tuning.approach_cost(at, result) == pytest.approx(0.25 + 0.1)
    assert tuning.stay_cost(at, {**result, "final_error_cm": 0.01 * length}) == pytest.approx(1)
    assert tuning.stay_cost(along, {**result, "mse_cm2": 0.002 * length**2}) == pytest.approx(1)
    failed = {**result, "failed": True}
    lost = {**result, "mse_cm2": 1e9, "final_error_cm": 1e9}
    for cost in (tuning.approach_cost, tuning.stay_cost):
        assert cost(at, failed) >= cost(at, lost) > cost(at, result)


def test_the_training_set_is_not_the_papers() -> None:
    for cases in (tuning.approach_cases, tuning.stay_cases, tuning.final_cases):
        trials = cases("helix")
        assert {t.kind for t in trials} == {"set_point", "tracking"}
        assert not {t.value for t in trials if t.kind == "set_point"} & set(paper.THETAS)
        assert not {t.value for t in trials if t.kind == "tracking"} & set(paper.OMEGAS)


def test_the_same_seed_gives_the_same_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cma")

    def bowl(trials: Any, jobs: int) -> list[dict[str, Any]]:  # best at a = 0.1, b = 10
        far = [math.log10(t.parameters["a"]) + 1 for t in trials]
        wide = [math.log10(t.parameters["b"]) - 1 for t in trials]
        return [{"distance": x * x + y * y} for x, y in zip(far, wide, strict=True)]

    monkeypatch.setattr(tuning, "run_all", bowl)
    trial = Case("finger", "best", "set_point", 0.25)
    kept: list[dict[str, Any]] = []
    traces = [
        tuning.tune(
            [trial], lambda _, result: result["distance"], lambda values: values,
            {"a": 1.0, "b": 1.0}, generations=25, population=8, seed=3, each=kept.append,
        )
        for _ in range(2)
    ]  # fmt: skip
    assert traces[0] == traces[1]
    assert kept == traces[0] + traces[1]
    assert traces[0][0]["values"] == {"a": 1.0, "b": 1.0}  # the start comes first
    best = min(traces[0], key=lambda entry: entry["cost"])
    assert math.log10(best["values"]["a"]) == pytest.approx(-1, abs=0.1)
    assert math.log10(best["values"]["b"]) == pytest.approx(1, abs=0.1)


def test_the_command_keeps_what_it_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("cma")
    seen: list[Case] = []

    def wants_soft(trials: list[Case], jobs: int) -> list[dict[str, Any]]:
        seen.extend(trials)
        return [
            {
                "failed": False, "first_error_cm": 1.0, "mse_cm2": 0.0,
                "final_error_cm": abs(math.log(t.parameters["stay"]["eps"] / 0.05)),
            }
            for t in trials
        ]  # fmt: skip

    monkeypatch.setattr(tuning, "run_all", wants_soft)
    monkeypatch.chdir(tmp_path)
    arguments = ["--approach", "2", "--stay", "2", "--population", "6", "--finalists", "3"]
    assert tune.main(["finger", *arguments, "--trace", "trace.json"]) == 0
    table = tomllib.loads(Path("schedule.toml").read_text())
    found, start = make_schedule(table), tuned(softdyn.load("finger"))
    assert start is not None
    for stage in ("approach", "stay"):
        before, after = getattr(start, stage).gains, getattr(found, stage).gains
        assert abs(math.log(after.eps / 0.05)) < abs(math.log(before.eps / 0.05))
        assert after.w1 == before.w1  # not tuned
    trace = json.loads(Path("trace.json").read_text())
    assert len(trace["trace"]) == 2 * (1 + 2 * 6) + 3
    assert trace["settings"]["start"] == tuning.tables(start)
    # the approach is judged alone; the finals are of whole schedules on other cases
    first, last = seen[0].parameters, seen[-1].parameters
    assert first is not None
    assert first["stay"] == first["approach"]
    assert last is not None
    assert last["stay"] != last["approach"]
    finals = [entry for entry in trace["trace"] if entry["stage"] == "final"]
    best = min(finals, key=lambda entry: entry["cost"])
    assert table == best["schedule"]

    # the summary: what made it, each stage's winner, the finals with the scores of the best
    summary = json.loads(Path("tuning.json").read_text())
    assert summary["settings"] == trace["settings"]
    for stage, winner in summary["winners"].items():
        entries = [entry for entry in trace["trace"] if entry["stage"] == stage]
        assert winner["cost"] == min(entry["cost"] for entry in entries)
        assert winner["start_cost"] == entries[0]["cost"]
    assert [final["cost"] for final in summary["finals"]] == [final["cost"] for final in finals]
    assert [final for final in summary["finals"] if "scores" in final] == [
        {key: best[key] for key in ("schedule", "scores", "cost")}
    ]

    # and it is enough to make the same again
    Path("tuning.json").rename("first.json")
    assert tune.main(["--again", "first.json", "--trace", "again.json"]) == 0
    assert Path("again.json").read_text() == Path("trace.json").read_text()
    assert Path("first.json").read_text() == Path("tuning.json").read_text()
    assert tune.main(["--again", "trace.json"]) == 0
    Path("bad.json").write_text("{}")
    assert tune.main(["--again", "bad.json"]) == 2
    assert tune.main(["--again", "none.json"]) == 2


def test_the_kept_summaries_can_be_made_again() -> None:
    found = sorted((ROOT / "docs" / "tuning").glob("*.json"))
    assert found
    for path in found:
        wanted = tuning.read(path)
        assert make_schedule(wanted.start) == make_schedule(
            tuning.first_schedule(wanted.robot, wanted.start)
        )
        assert wanted.seed > 0
        assert set(wanted.generations) == set(tuning.STAGES)
