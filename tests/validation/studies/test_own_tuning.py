"""Tuning of anyone's robot: what it is tried on, what a run costs, what is written when."""

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
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.sources import load_model
from softdyn.validation.studies.own import tuning as own_tuning


@pytest.fixture
def arm(tmp_path):
    file = tmp_path / "arm.urdf"
    file.write_text(softdyn.load("finger").robot.path.read_text())
    return file


def test_search_finals_and_test_share_no_target(arm):
    tasks = own_tuning.find_tasks(str(arm), None, softdyn.load(arm), seed=1)
    assert {name: len(some) for name, some in tasks.points.items()} == own_tuning.POINTS
    every = [tuple(y) for some in tasks.points.values() for y in some]
    assert len({*every}) == len(every)
    start = tasks.model.state(tasks.model.q0, np.zeros(4)).y
    assert min(np.linalg.norm(np.array(y) - start) for y in every) > 0.05 * 0.24
    schedule = own_tuning.drawn(tasks, np.random.default_rng(0))
    assert make_schedule(schedule).approach == make_schedule(schedule).stay
    with pytest.raises(InputError, match="a robot with inputs"):
        own_tuning.find_tasks("ur5", None, load_model("ur5"), seed=1)


def test_a_run_costs_its_errors_in_parts_of_the_length():
    case = Case("finger", "best", "point", (0.1, 0, -0.1))
    run = {"failed": False, "mse_cm2": 4.0, "final_error_cm": 0.5}
    # 2 cm of a tenth of 1 m, 0.5 cm of a hundredth
    assert own_tuning.cost(1.0, case, run) == pytest.approx(0.2 + 0.5)
    assert own_tuning.cost(1.0, case, run | {"failed": True}) == 10.0
    assert own_tuning.cost(1.0, case, run | {"mse_cm2": None}) == 10.0


@pytest.mark.parametrize("wins", [True, False])
def test_only_what_beats_predictive_control_is_written(arm, wins, monkeypatch, capsys):
    """Two short runs a candidate; who wins the test is decided here."""
    for name, value in (
        ("POINTS", {"search": 1, "final": 1, "test": 1}), ("PATHS", dict.fromkeys(
            ("search", "final", "test"), 0)), ("POINT_TIME", 0.05), ("WINDOW", 0.05),
        ("FINALISTS", 1), ("DRAWN", 4), ("ENDS", {"draw": 0.0, "approach": 0.0, "stay": 0.0}),
    ):  # fmt: skip
        monkeypatch.setattr(own_tuning, name, value)
    real = own_tuning.compared

    def decided(*arguments):
        rows = real(*arguments)
        rows[0]["cost"] = rows[1]["cost"] + (-1 if wins else 0)
        return rows

    monkeypatch.setattr(own_tuning, "compared", decided)
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
