"""Slack cables on pages: the page's answer is the model's tension."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import softdyn
from softdyn import SetPoint, SoftModel
from softdyn.description.rig import Sensor, SensorKind
from softdyn.validation import Log, Rig, simulate
from softdyn.validation.report.replay import replay, track
from softdyn.view.page import Page, PlayedRun, Track, frames
from softdyn.view.scene import Figure
from tests.support import micro, rigged, winched
from tests.support.browser import Browser, required

SLACK = (
    "softdyn.tracks[0].figure.cables.map("
    "c => [c.name, c.material.opacity < 1 && c.hidden.opacity < 0.3])"
)


@pytest.fixture
def arm(tmp_path: Path) -> SoftModel:
    return softdyn.load(micro.write(tmp_path, winched.ARM))


@pytest.fixture
def log(arm: SoftModel) -> Log:
    """A run in which each winch pulls in turn, with the acting inputs late."""

    def turns(state: object, reference: object) -> np.ndarray:
        calls.append(1)
        return np.array([20.0, 0.0] if len(calls) % 100 < 50 else [0.0, 15.0])

    calls: list[int] = []
    return simulate(arm, turns, SetPoint(np.zeros(3)), duration=0.4, rig=Rig(latency=0.002))


def tense(model: SoftModel, q: np.ndarray, u: np.ndarray) -> dict[str, bool]:
    """Whether every tendon has a tension, from sensors of the model at rest."""
    sensors = tuple(Sensor(t.name, SensorKind.TENSION, tendon=t.name) for t in model.robot.tendons)
    seen = softdyn.build(replace(model.robot, sensors=sensors))
    found = seen.measure(seen.state(q, np.zeros(model.nv)), u)
    return dict(zip(found.names, np.abs(found.values) > 1e-6, strict=True))


def test_a_replay_has_the_acting_inputs(arm: SoftModel, log: Log) -> None:
    rows = track(log, arm)
    k = np.searchsorted(log.t, rows.frames[:, 0] - 1e-6)
    np.testing.assert_allclose(rows.frames[:, 3:5], log.acting[k], atol=1e-5)
    assert np.abs(log.acting[k[:-1]] - log.u[k[:-1]]).max() > 5.0
    assert "as they act" in rows.note
    acting = log.acting.copy()
    acting[-1] = np.nan  # of a run that ended in its control step
    assert np.isfinite(track(replace(log, acting=acting), arm).frames).all()


def test_an_ideal_robot_s_cables_are_never_drawn_slack() -> None:
    for name in ("finger", "spirob"):
        assert not any(cable.slackens for cable in Figure.of(softdyn.load(name)).cables)


@required()
def test_slack_cables_of_a_page_have_no_tension(arm: SoftModel, log: Log, tmp_path: Path) -> None:
    """A winch's cable and a brace with a spring, along a run; a fixed tendon over followers."""
    gripper = rigged.slackened(softdyn.load(micro.write(tmp_path, micro.GRIPPER)))
    rng = np.random.default_rng(2)
    q = rng.uniform(-0.5, 0.5, (12, gripper.nq))
    none, y = np.zeros((len(q), gripper.nu)), np.zeros((len(q), 3))
    moved = Track(0, frames(gripper, np.arange(12.0), q, none, y, y), "")
    pages = (
        (arm, replay(log, arm)),
        (gripper, Page("gripper", (Figure.of(gripper),), (PlayedRun("", (moved,)),))),
    )
    with Browser() as browser:
        for model, page in pages:
            file = tmp_path / f"{model.name}.html"
            page.save(file)
            browser.open(file.as_uri() + "#pause")
            shown = browser.run("softdyn.tracks[0].frames.map(f => Array.from(f))")
            seen: dict[str, set[bool]] = {}
            for frame in shown[:: max(1, len(shown) // 12)]:
                browser.run(f"(softdyn.seek({frame[0]}), 1)")
                at = np.array(frame[1 : 1 + model.nv]), np.array(frame[1 + model.nv :][: model.nu])
                expected = tense(model, *at)
                for name, slack in browser.run(SLACK):
                    assert slack != expected[name], (name, frame[0])
                    seen.setdefault(name, set()).add(slack)
            assert {True, False} in seen.values()
            if model is arm:
                assert all(both == {True, False} for both in seen.values())
            assert browser.console == []
