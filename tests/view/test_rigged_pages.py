"""Runs with a rig on pages; `test_browser` looks at slack cables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import softdyn
from softdyn import SoftModel
from softdyn.validation import Log
from softdyn.validation.loop.pictures.replay import track
from softdyn.view.scene import Figure
from tests.support import rigs, robots


@pytest.fixture
def arm(tmp_path: Path) -> SoftModel:
    return robots.load(tmp_path, robots.WINCHED)


@pytest.fixture
def log(arm: SoftModel) -> Log:
    return rigs.turns(arm)


def test_a_replay_has_the_acting_inputs(arm: SoftModel, log: Log) -> None:
    rows = track(log, arm)
    k = np.searchsorted(log.t, rows.frames[:, 0] - 1e-6)
    np.testing.assert_allclose(rows.frames[:, 3:5], log.acting[k], atol=1e-5)
    assert np.abs(log.acting[k[:-1]] - log.u[k[:-1]]).max() > 5.0
    assert "as they act" in rows.note
    acting = log.acting.copy()
    acting[-1] = np.nan  # of a run that ended in its control step
    assert np.isfinite(track(log.altered(acting=acting), arm).frames).all()


def test_an_ideal_robot_s_cables_are_never_drawn_slack() -> None:
    for name in ("finger", "spirob"):
        assert not any(cable.slackens for cable in Figure.of(softdyn.load(name)).cables)
