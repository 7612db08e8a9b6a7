"""The programs of docs/examples: each runs, is short, says what it makes, and stands in a page.

They run in this process, which has all imports and kernels. Their names are checked in
test_promised_names.
"""

from __future__ import annotations

import re
import runpy

import pytest

from tests.support import ROOT

EXAMPLES = ROOT / "docs/examples"
CLASSES = {"dynamixel_rig", "hold_law", "ros2_rig", "served_rig"}  # for a command, no programs
LEARNS = {"learn_policy"}  # half a minute; tests/test_docs.py runs it in its page
PROGRAMS = sorted(path for path in EXAMPLES.glob("*.py") if path.stem not in CLASSES | LEARNS)
MOST_LINES = 40
LONGER = {"own_ilqr": 90, "crocoddyl_adapter": 50, "casadi_adapter": 55}  # lines
PACKAGES = {f"{name}_adapter": name for name in ("crocoddyl", "casadi", "jax")}
PACKAGES["random_copies"] = "mujoco_warp"
MADE = re.compile(r"\b\w+\.(?:png|html|urdf)\b")
FIRST_FILE = b"\x89PNG", b"<!DOCTYPE html", b"<?xml", b"<robot"


def test_there_are_eighteen():
    assert len(PROGRAMS) == 18


def test_the_page_of_predictive_control_shows_its_program():
    program = (EXAMPLES / "own_mpc.py").read_text("utf-8").split('"""', 2)[2].strip()
    assert program in (ROOT / "docs/own_mpc.md").read_text("utf-8")


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.stem)
def test_an_example_is_short_and_stands_in_the_page_of_its_topic(path):
    lines = [line for line in path.read_text("utf-8").splitlines() if line.strip()]
    assert len(lines) <= LONGER.get(path.stem, MOST_LINES)
    pages = {page.stem for page in (ROOT / "docs").glob("*.md")
             if f"(examples/{path.name})" in page.read_text("utf-8")}  # fmt: skip
    assert pages > {"api"}  # the list of all programs, and the page of its topic


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.stem)
def test_an_example_runs_and_makes_what_it_says(path, tmp_path, monkeypatch, capsys):
    if path.stem in PACKAGES:
        pytest.importorskip(PACKAGES[path.stem], reason="a package that softdyn does not need")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    runpy.run_path(str(path), run_name="__main__")
    out = capsys.readouterr().out
    assert re.search(r"\d", out)
    assert "nan" not in out or path.stem == "own_driver"  # it ends early where the machine is late
    text = path.read_text("utf-8")
    made = set(MADE.findall(text.split('"""')[1]))
    assert made <= {file.name for file in tmp_path.iterdir()}
    for name in made:
        assert (tmp_path / name).read_bytes().lstrip().startswith(FIRST_FILE)
