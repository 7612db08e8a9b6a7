"""All laws against the paper's text, in short; `python -m tests.proof textbook` does 300 states."""

from __future__ import annotations

import json

import numpy as np
import pytest

import softdyn
from softdyn.controllers import ClfQp, Impedance
from tests.proof import textbook
from tests.proof.laws import agreement


@pytest.mark.parametrize("robot", ["finger", "helix", "spirob", "spirob48"])
def test_the_laws_are_the_papers(robot, capsys):
    assert textbook.main(["--robots", robot, "--states", "12", "--seed", "3", "--json", "-"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [row["controller"] for row in rows] == list(textbook.LAWS)
    for row in rows:
        assert row["max_error"] <= 1e-6
        assert row["not_solved"] == 0
        assert row["saturated"] > 0
    assert max(row["others"] for row in rows) <= 4


@pytest.mark.parametrize("law", [Impedance, ClfQp])
def test_a_law_that_forgets_the_references_acceleration_differs(law, monkeypatch):
    def deaf(self, state, reference):
        return law._command(self, state, softdyn.Reference(reference.y, reference.ydot))

    broken = type("Deaf", (law,), {"_command": deaf})
    monkeypatch.setitem(agreement.CONTROLLERS, law.name, broken)
    row = agreement.compare(softdyn.load("finger"), law.name, 6)
    assert not row["passed"]
    assert np.isfinite(row["max_error"])
