"""Batches: one line where mujoco-warp or the interpreter is missing, and the page's figures."""

from __future__ import annotations

import sys

import pytest

from softdyn.validation.files import read_json
from tests.proof import batches
from tests.proof.__main__ import main
from tests.proof.documents.settings import MEASURED
from tests.support.command import left_as_it_was
from tests.support.refused import refused


def test_without_mujoco_warp_it_says_so(tmp_path, capsys):
    bare = tmp_path / "python"
    bare.write_text(f'#!/bin/sh\nexec {sys.executable} -S "$@"\n')  # without installed packages
    bare.chmod(0o755)
    with left_as_it_was():
        assert main(["batches", "--python", str(bare)]) == 2
    said = capsys.readouterr().err
    assert "expected an environment with mujoco-warp, got" in said


def test_without_an_interpreter_it_says_so():
    with refused("--python", "No such file or directory"):
        batches.measure("finger", "no_such_python", 1, 1)


def test_the_page_has_three_robots_that_stay_near_mujoco_at_first():
    rows = read_json(MEASURED / "batches.json", "rows of a table")["rows"]
    assert tuple(row["robot"] for row in rows) == batches.ROBOTS
    for row in rows:
        assert row["refused"] == "nothing"
        assert row["moved"] > 0.1
        assert row["after_20"] < row["after_200"] < 1e-5


def test_the_speeds_of_the_page_fit_together():
    """Worlds over the time of a step are the steps a second; the page's claims hold."""
    rows = read_json(MEASURED / "batches_gpu.json", "rows of a table")["rows"]
    assert tuple(row["robot"] for row in rows) == batches.ROBOTS
    found = {(row["robot"], row["worlds"]): row for row in batches.speeds(rows)}
    for (_, worlds), row in found.items():
        assert row["millions"] == pytest.approx(worlds / row["ms"] / 1e3, rel=0.01)
    assert found["helix", 4096]["millions"] == pytest.approx(2.2, abs=0.05)
    assert found["helix", 4096]["times"] == pytest.approx(10, abs=0.5)
    assert found["finger", 256]["times"] < 0.5 < 1.0 <= found["helix", 256]["times"] < 1.2
