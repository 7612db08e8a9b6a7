"""The report of scripts/statics.py for Python users: its text and its numbers."""

from __future__ import annotations

import json

import numpy as np
import pytest

import softdyn
from softdyn import statics
from softdyn.validation.crosschecks.rest_report import HeldRest, rests_at
from softdyn.validation.crosschecks.rests import hold


def test_a_reachable_point_is_held_and_the_text_says_so():
    model = softdyn.load("finger")
    goal = statics.settle(model, [-0.03, 0.02])
    report = rests_at(model, {"there": goal.y}, rays=1, more=1, shapes=1, seconds=0.1)
    (target,) = report.targets
    assert target.search.distance(target.closest.rest) < 1e-6
    assert target.closest.rest.stable
    # an equilibrium runs once, even if it is the best in several respects
    assert target.closest_stable is target.closest
    away = [np.linalg.norm(sample.y - goal.y) for sample in report.samples]
    assert min(away) < max(away)
    assert target.closest_sample == pytest.approx(min(away))
    text = str(report)
    assert text.startswith(f"finger: {len(report.samples)} stable equilibria sampled\nthere (")
    assert "\n  closest        0.000 cm away, stable (eigenvalue" in text
    assert "\n  stable  " not in text
    row = json.loads(json.dumps(report.to_dict()))["targets"][0]
    assert row["closest"]["distance_cm"] < 1e-4
    assert row["closest"]["hold_s"] == 0.1
    assert row["equilibria"] == len(target.search.found)


def test_a_held_rest_is_the_twin_s_verdict():
    rest = statics.rest(softdyn.load("finger"))
    held = HeldRest.of(rest, 0.1)
    assert held.drift == hold(rest, 0.1)
    assert held.to_dict()["drift_cm"]["final"] == pytest.approx(100 * held.drift.final)
    np.testing.assert_array_equal(held.to_dict()["q"], rest.q)
    assert str(held).endswith("u = 0.000 0.000")
