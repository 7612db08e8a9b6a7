"""Step times of two checkouts: what is compared with what. No time is judged."""

from __future__ import annotations

import json

import pytest

import softdyn
from softdyn.controllers import SoftIdClfQp
from tests.proof import compare_steps
from tests.proof.timing import comparison
from tests.proof.timing.recording import record


@pytest.fixture
def folder(tmp_path):
    states = record(softdyn.load("finger"), SoftIdClfQp, 5, duration=0.1)
    (tmp_path / "states").mkdir()
    states.save(tmp_path / "states" / "finger.npz")
    return tmp_path


def test_the_command_compares_this_checkout_with_itself(folder, monkeypatch, capsys):
    states = {"finger": folder / "states" / "finger.npz"}
    once = comparison.measure(comparison.HERE, states, ["ic"], 1)  # it starts a process
    monkeypatch.setattr(comparison, "measure", lambda *_: once)
    arguments = ["--robots", "finger", "--controllers", "ic", "--pairs", "1", "--rounds", "1",
                 "--states", "5", "--out", str(folder), "--json", "-"]  # fmt: skip
    assert compare_steps.main([str(comparison.HERE), *arguments]) in (0, 1)
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert (row["robot"], row["controller"], row["against"]) == ("finger", "ic", "old")
    assert row["ratio"] == row["new_us"] / row["base_us"] == row["low"] == row["high"]
    assert compare_steps.main([str(folder), *arguments]) == 2
    assert "softdyn/__init__.py" in capsys.readouterr().err


def test_processes_alternate_and_the_first_pair_only_warms(tmp_path, monkeypatch):
    old = tmp_path / "old"
    (old / "softdyn").mkdir(parents=True)
    (old / "softdyn" / "__init__.py").touch()
    order = []

    def sample(root, states, laws, rounds):
        order.append(root == old)
        slow = 3.0 if len(order) <= 2 else 1.0
        return {"r": {"soft-id-clf-qp": slow * (20.0 if root == old else 10.0), "best": slow * 11}}

    monkeypatch.setattr(comparison, "measure", sample)
    rows = comparison.compare(old, {"r": tmp_path}, ["soft-id-clf-qp", "best"], pairs=3)
    assert order == [False, True, True, False, False, True, True, False]
    assert [(row["against"], row["ratio"]) for row in rows] == [("old", 0.5), ("old", 1.0)]
    assert all(row["passed"] for row in rows)
    assert len(comparison.comparison_table(rows).lines) == 3
