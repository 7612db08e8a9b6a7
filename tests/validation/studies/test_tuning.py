"""Tuning of a user's robot: its targets, the cost of a run, and the condition for writing."""

from __future__ import annotations

import tomllib
import warnings

import numpy as np
import pytest

import softdyn
from softdyn import InputError
from softdyn.commands import tune as command
from softdyn.controllers import Mpc, Staged
from softdyn.controllers.schedule import make_schedule
from softdyn.controllers.staged import best
from softdyn.validation.studies import schedule_search, tuning, tuning_targets
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.sources import load_model


@pytest.fixture
def arm(tmp_path):
    file = tmp_path / "arm.urdf"
    file.write_text(softdyn.load("finger").robot.path.read_text())
    return file


@pytest.fixture(scope="module")
def targets():
    return tuning_targets.find_targets("finger", None, softdyn.load("finger"), seed=1)


def test_search_finals_and_test_share_no_target(targets):
    assert {name: len(some) for name, some in targets.points.items()} == tuning_targets.POINTS
    every = [tuple(y) for some in targets.points.values() for y in some]
    assert len({*every}) == len(every)
    start = targets.model.state(targets.model.q0, np.zeros(4)).y
    assert min(np.linalg.norm(np.array(y) - start) for y in every) > 0.05 * 0.24
    schedule = tuning.random_schedule(targets, np.random.default_rng(0))
    assert make_schedule(schedule).approach == make_schedule(schedule).stay
    with pytest.raises(InputError, match="a robot with inputs"):
        tuning_targets.find_targets("ur5", None, load_model("ur5"), seed=1)


def test_a_run_costs_its_errors_in_parts_of_the_length():
    case = Case("finger", "best", "point", (0.1, 0, -0.1))
    run = {"failed": False, "mse_cm2": 4.0, "final_error_cm": 0.5}
    # 2 cm of a tenth of 1 m, 0.5 cm of a hundredth
    assert tuning.run_cost(1.0, case, run) == pytest.approx(0.2 + 0.5)
    assert tuning.run_cost(1.0, case, run | {"failed": True}) == 10.0
    assert tuning.run_cost(1.0, case, run | {"mse_cm2": None}) == 10.0


@pytest.mark.parametrize("wins", [True, False])
def test_only_what_beats_predictive_control_is_written(arm, wins, monkeypatch, capsys):
    """Each candidate has two short runs, and the test sets the winner."""
    one, none = (dict.fromkeys(("search", "final", "test"), k) for k in (1, 0))
    for name, value in (("POINTS", one), ("PATHS", none), ("POINT_TIME", 0.05), ("WINDOW", 0.05)):
        monkeypatch.setattr(tuning_targets, name, value)
    monkeypatch.setattr(tuning, "DRAWN", 4)
    real = tuning.figures_on_test

    def decided(name, *arguments):
        return real(name, *arguments) | {"cost": 0.0 if wins and name == "best" else 1.0}

    monkeypatch.setattr(tuning, "figures_on_test", decided)
    code = command.main([str(arm), "--seconds", "1", "--jobs", "1"])
    said = capsys.readouterr().out
    written = arm.with_name("arm.schedule.toml")
    model = softdyn.load(arm)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        law = best(model)
    if wins:
        assert code == 0
        assert f"the schedule beats predictive control: {written}" in said
        assert isinstance(law, Staged)
        assert law.gains == make_schedule(tomllib.loads(written.read_text()))
    else:
        assert code == 1
        assert "predictive control is better" in said
        assert not written.exists()
        assert isinstance(law, Mpc)


@pytest.mark.parametrize(
    ("time", "price", "rival", "broken", "tested"),
    [
        (60.0, 0.05, 0.2, 0.0, 7),
        (300.0, 0.05, 0.2, 0.4, 7),
        (60.0, 0.4, 2.0, 0.2, 2),
        (160.0, 0.4, 4.0, 0.0, 4),
    ],
)
def test_the_answer_comes_in_time(targets, time, price, rival, broken, tested, monkeypatch):
    """Only runs take time: `price` and `rival` s per simulated second, two runs at a time."""
    now, rng, longest = 100.0, np.random.default_rng(0), 0.0

    def run_all(cases, _jobs):
        nonlocal now, longest
        failed = [case.controller == "best" and rng.random() < broken for case in cases]
        rates = [rival if case.controller == "mpc" else price * (1 - 0.9 * f)
                 for case, f in zip(cases, failed, strict=True)]  # fmt: skip
        took = (
            0.3 + sum(r * tuning.simulated_time(c) for r, c in zip(rates, cases, strict=True)) / 2
        )
        now, longest = now + took, max(longest, took)
        return [{"failed": f, "mse_cm2": 1.0, "final_error_cm": rng.random(),
                 "step_us": {"median": 1.0}} for f in failed]  # fmt: skip

    monkeypatch.setattr(tuning, "monotonic", lambda: now)
    for module in (tuning, schedule_search):
        monkeypatch.setattr(module, "run_all", run_all)
    found = tuning.tune_schedule(targets, time, began=now - 5.0, jobs=2)
    assert found["seconds"] == now - 95.0
    # it ends in time, up to one batch of runs, and not early
    assert 0.5 * time < found["seconds"] < time + longest
    assert found["rows"][0]["targets"] + found["rows"][0]["paths"] == tested
    assert found["rows"][0]["paths"] == 1
    text = tuning.tuning_text(targets, found)
    assert ("more with more --seconds" in text) == (tested < 7)
