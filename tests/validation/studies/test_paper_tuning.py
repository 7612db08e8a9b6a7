"""Tuning of the bundled robots: the cost of a run, the search, the command and its summary."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import softdyn
from softdyn.commands import tune
from softdyn.controllers.schedule import make_schedule, tuned
from softdyn.validation import paper
from softdyn.validation.studies import paper_tuning, schedule_search
from softdyn.validation.studies.engine.case import Case
from tests.support import ROOT


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
    assert paper_tuning.approach_cost(at, result) == pytest.approx(0.25 + 0.1)
    assert paper_tuning.stay_cost(at, {**result, "final_error_cm": 0.01 * length}) == pytest.approx(
        1
    )
    assert paper_tuning.stay_cost(along, {**result, "mse_cm2": 0.002 * length**2}) == pytest.approx(
        1
    )
    failed = {**result, "failed": True}
    lost = {**result, "mse_cm2": 1e9, "final_error_cm": 1e9}
    for cost in (paper_tuning.approach_cost, paper_tuning.stay_cost):
        assert cost(at, failed) >= cost(at, lost) > cost(at, result)


def test_the_training_set_is_not_the_papers() -> None:
    for part in paper_tuning.PARTS:
        trials = paper_tuning.search_cases("helix", part)
        assert {t.kind for t in trials} == {"set_point", "tracking"}
        assert not {t.value for t in trials if t.kind == "set_point"} & set(paper.THETAS)
        assert not {t.value for t in trials if t.kind == "tracking"} & set(paper.OMEGAS)


def test_set_points_and_trajectories_weigh_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    cases = [Case("finger", "best", "set_point", x) for x in (0.25, 0.75)]
    cases.append(Case("finger", "best", "tracking", 0.12))
    monkeypatch.setattr(schedule_search, "run_all", lambda runs, _: [r.parameters for r in runs])
    found = schedule_search.judge(
        cases, lambda case, run: run["a"] * (10 if case.kind == "tracking" else case.value), 1,
        [{"a": 1.0}, {"a": 2.0}],
    )  # fmt: skip
    assert found == [
        {"scores": [0.25, 0.75, 10.0], "cost": (0.5 + 10) / 2},
        {"scores": [0.5, 1.5, 20.0], "cost": (1 + 20) / 2},
    ]


def test_the_same_seed_gives_the_same_trace() -> None:
    pytest.importorskip("cma")

    def bowl(schedules: Sequence[Any]) -> list[dict[str, Any]]:  # best at Kp = 0.1, eps = 10
        far = [math.log10(one["stay"]["Kp"]) + 1 for one in schedules]
        wide = [math.log10(one["stay"]["eps"]) - 1 for one in schedules]
        return [{"cost": x * x + y * y} for x, y in zip(far, wide, strict=True)]

    kept: list[dict[str, Any]] = []
    traces = [
        schedule_search.search_stage(
            {"stay": {"Kp": 1.0, "eps": 1.0}}, "stay", bowl,
            generations=25, population=8, seed=3, each=kept.append,
        )
        for _ in range(2)
    ]  # fmt: skip
    assert traces[0] == traces[1]
    assert kept == traces[0] + traces[1]
    assert traces[0][0]["values"] == {"Kp": 1.0, "eps": 1.0}  # the start comes first
    best = min(traces[0], key=lambda entry: entry["cost"])
    assert math.log10(best["values"]["Kp"]) == pytest.approx(-1, abs=0.1)
    assert math.log10(best["values"]["eps"]) == pytest.approx(1, abs=0.1)


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

    monkeypatch.setattr(schedule_search, "run_all", wants_soft)
    monkeypatch.chdir(tmp_path)
    arguments = ["--approach", "2", "--stay", "2", "--population", "6", "--finalists", "3"]
    assert tune.main(["spirob", *arguments, "--trace", "trace.json"]) == 0
    table = tomllib.loads(Path("schedule.toml").read_text())
    found, start = make_schedule(table), tuned(softdyn.load("spirob"))
    assert start is not None
    for stage in ("approach", "stay"):
        before, after = getattr(start, stage).gains, getattr(found, stage).gains
        assert abs(math.log(after.eps / 0.05)) < abs(math.log(before.eps / 0.05))
        assert after.w1 == before.w1  # not tuned
    trace = json.loads(Path("trace.json").read_text())
    assert len(trace["trace"]) == 2 * (1 + 2 * 6) + 3
    assert trace["settings"]["start"] == schedule_search.schedule_tables(start)
    # the approach is judged alone; the finals judge complete schedules on other cases
    first, last = seen[0].parameters, seen[-1].parameters
    assert first is not None
    assert first["stay"] == first["approach"]
    assert last is not None
    assert last["stay"] != last["approach"]
    finals = [entry for entry in trace["trace"] if entry["stage"] == "final"]
    best = min(finals, key=lambda entry: entry["cost"])
    assert table == best["schedule"]

    # the summary: settings, each stage's winner, the finals with the scores of the best
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

    # and it suffices to repeat the search
    Path("tuning.json").rename("first.json")
    assert tune.main(["--again", "first.json", "--trace", "again.json"]) == 0
    assert Path("again.json").read_text() == Path("trace.json").read_text()
    assert Path("first.json").read_text() == Path("tuning.json").read_text()
    assert tune.main(["--again", "trace.json"]) == 0
    Path("bad.json").write_text("{}")
    assert tune.main(["--again", "bad.json"]) == 2
    assert tune.main(["--again", "none.json"]) == 2


def test_the_kept_summaries_can_be_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also older ones, whose stages lack `u_ref`."""
    pytest.importorskip("cma")
    run = {"failed": False, "first_error_cm": 1.0, "mse_cm2": 1.0, "final_error_cm": 1.0}
    monkeypatch.setattr(schedule_search, "run_all", lambda cases, _: [run] * len(cases))
    found = sorted((ROOT / "docs" / "tuning").glob("*.json"))
    assert found
    for path in found:
        wanted = paper_tuning.read_search(path)
        schedule = make_schedule(wanted.start)
        assert make_schedule(schedule_search.schedule_tables(schedule)) == schedule
        assert wanted.seed > 0
        assert set(wanted.generations) == set(schedule_search.STAGES)
        again = paper_tuning.search_schedule(
            replace(wanted, generations={"approach": 1, "stay": 1})
        )
        assert set(again["winners"]) == set(schedule_search.STAGES)
