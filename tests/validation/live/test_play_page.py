"""`softdyn play` in a real browser, as a person uses it: mouse, keys, menus."""

from __future__ import annotations

import subprocess
import sys
import time

import numpy as np
import pytest

import softdyn
from tests.support import SCRIPTS
from tests.support.browser import Browser, required

pytestmark = required()
LAW = """
import numpy as np
class Idle:
    def __init__(self, model):
        self.u = np.zeros(model.nu)
    def __call__(self, state, reference):
        return self.u
"""


@pytest.fixture(scope="module")
def url(tmp_path_factory):
    """A finger to play with, in a process of its own, and a law of the user's in the menu."""
    own = tmp_path_factory.mktemp("own") / "idle.py"
    own.write_text(LAW)
    command = [sys.executable, SCRIPTS / "play.py", "finger", "soft-id-clf-qp", f"{own}:Idle"]
    process = subprocess.Popen([*command, "--no-open"], stdout=subprocess.PIPE, text=True)
    try:
        yield process.stdout.readline().strip()
        process.terminate()
        assert process.wait(30) == 0
    finally:
        process.kill()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return tmp_path_factory.mktemp("recorded") / "record.html"


@pytest.fixture(scope="module")
def browser(url):
    with Browser() as found:
        found.open(url)
        found.until("softdyn.leads && softdyn.frames > 5")
        yield found
        assert found.console == []
        assert {u.split("/")[2] for u in found.requests if "//" in u} == {url.split("/")[2]}


def vector(browser, name):
    return np.array(browser.run(f"Array.from(softdyn.part(softdyn.last, '{name}'))"))


def on_screen(browser, point):
    """Where a point of the world (m) is in the window (pixels)."""
    return browser.run(
        f"(p => [(p.x + 1) / 2 * innerWidth, (1 - p.y) / 2 * innerHeight])"
        f"(softdyn.stage.localToWorld(new T.Vector3(...{np.asarray(point).tolist()}))"
        f".project(softdyn.viewer.camera))"
    )


def test_the_target_follows_the_mouse_and_the_tip_the_target(browser):
    """In the robot's plane by default, along its normal with Shift."""
    before = vector(browser, "y_ref")
    goal = before + np.array([0.06, 0.0, 0.05])
    browser.drag(on_screen(browser, before), on_screen(browser, goal))
    browser.until("!softdyn.gizmo.dragging")
    browser.until(f"Math.abs(softdyn.part(softdyn.last, 'y_ref')[0] - {goal[0]}) < 0.006")
    now = vector(browser, "y_ref")
    assert now[1] == pytest.approx(before[1], abs=1e-6)
    np.testing.assert_allclose(now, goal, atol=0.006)  # a pixel is about a millimetre
    browser.until("softdyn.history.error.slice(-20).every(e => e < 0.05)", timeout=30)  # cm

    browser.drag(
        on_screen(browser, now), on_screen(browser, now + np.array([0, 0.05, 0])), shift=True
    )
    browser.until("Math.abs(softdyn.part(softdyn.last, 'y_ref')[1] - 0.05) < 0.015")
    np.testing.assert_allclose(vector(browser, "y_ref")[[0, 2]], now[[0, 2]], atol=1e-6)


def test_a_pushed_link_deflects_and_returns(browser):
    browser.key("o")
    browser.until("softdyn.state.law == 'open loop'")
    browser.key("r")
    browser.until("softdyn.part(softdyn.last, 'u').every(x => x == 0)")
    browser.settle()
    link = browser.run("softdyn.scene.links.indexOf('link4')")
    place = f"new T.Vector3().setFromMatrixPosition(softdyn.figure.links[{link}].matrixWorld)"
    at = browser.run(f"softdyn.stage.worldToLocal({place}).toArray()")
    before = vector(browser, "y")
    start, end = on_screen(browser, at), on_screen(browser, np.array(at) + np.array([0.08, 0, 0]))
    browser.press(start)
    browser.move(end)
    browser.until("softdyn.arrow.visible")
    browser.until(f"Math.abs(softdyn.part(softdyn.last, 'y')[0] - {before[0]}) > 0.004", timeout=10)
    assert " N" in browser.run("document.getElementById('newtons').value")
    browser.lift(end)
    browser.until("!softdyn.arrow.visible")
    deadline = time.monotonic() + 20
    while np.linalg.norm(vector(browser, "y") - before) > 1e-3 and time.monotonic() < deadline:
        time.sleep(0.1)
    assert np.linalg.norm(vector(browser, "y") - before) < 1e-3


def test_inputs_by_slider_and_laws_and_plant_by_menu_while_it_runs(browser):
    browser.run("(s => { s.value = 0.7; s.oninput(); })(softdyn.inputs[0].range)")
    browser.until("softdyn.part(softdyn.last, 'u')[0] > 0.3")
    assert browser.run("[...law.options].map(o => o.value).at(-1)") == "open loop"
    own = browser.run("[...law.options].map(o => o.value).find(v => v.endsWith(':Idle'))")
    for name in (own, "soft-id-clf-qp"):
        browser.run(f"(law.value = {name!r}, law.onchange(), 1)")
        browser.until(f"softdyn.state.law == {name!r}")
    browser.run("(s => { s.value = 1.3; s.onchange(); })(softdyn.mismatch.mass.range)")
    browser.until("softdyn.state.mismatch.mass == 1.3")
    t = vector(browser, "t")[0]
    browser.until(f"softdyn.one(softdyn.last, 't') > {t} + 0.2")
    assert browser.run("document.getElementById('notice').textContent") == ""


def test_pause_step_and_reset_by_key(browser):
    browser.key(" ")
    browser.until("softdyn.state.paused")
    browser.settle()
    time.sleep(0.1)
    t = vector(browser, "t")[0]
    browser.key(".")
    browser.until(f"softdyn.one(softdyn.last, 't') > {t}")
    assert vector(browser, "t")[0] == pytest.approx(t + 0.005, abs=1e-4)
    browser.key("r")
    browser.until("softdyn.one(softdyn.last, 't') == 0")
    browser.key("?")
    assert browser.run("document.getElementById('keys').open")
    browser.key("?")
    browser.key(" ")
    browser.until("!softdyn.state.paused && softdyn.one(softdyn.last, 't') > 0.1")


def test_a_recording_is_kept(browser, recorded):
    browser.key("v")
    browser.until("document.getElementById('record').classList.contains('on')")
    time.sleep(0.6)
    browser.key("v")
    browser.until("!document.getElementById('recorded').hidden")
    text = browser.run("fetch(document.getElementById('recorded').href).then(r => r.text())")
    recorded.write_text(text, encoding="utf-8")


def test_the_reach_and_the_model_beside_the_plant_are_shown(browser):
    browser.key("g")
    browser.until("softdyn.ghost.object.visible")
    browser.key("h")
    browser.until("softdyn.rests.length > 20", timeout=40)
    reach = np.array(browser.run("softdyn.rests"))
    assert np.linalg.norm(reach, axis=1).max() < 0.25  # the finger's length is 0.24 m


def test_sliders_explore_rests_and_recordings_replay(tmp_path, recorded):
    """`view --sliders`: an input leads to a rest with its ellipsoid, a joint to that pose."""
    command = [sys.executable, SCRIPTS / "view.py", "finger", "--sliders", "--no-open"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        with Browser() as page:
            page.open(process.stdout.readline().strip())
            page.until("softdyn.leads && softdyn.frames > 2 && softdyn.ellipsoid.visible")
            page.run("(s => { s.value = 0.7; s.oninput(); })(softdyn.inputs[0].range)")
            page.until("softdyn.part(softdyn.last, 'u')[0] > 0.3")
            assert page.run("softdyn.readouts.rest.value") == "stable"
            page.run("(s => { s.value = 0.5; s.oninput(); })(softdyn.joints[1].range)")
            page.until("softdyn.readouts.rest.value == 'joints by hand'")
            assert vector(page, "q")[1] == pytest.approx(0.5, abs=1e-6)
            assert not page.run("softdyn.ellipsoid.visible")
            assert page.console == []

            model = softdyn.load("finger")  # and the page that needs no server
            softdyn.show(model).save(tmp_path / "show.html")
            page.open((tmp_path / "show.html").as_uri())
            page.run("(s => { s.value = 0.5; s.oninput(); })(softdyn.joints[1].range)")
            tip = page.run("softdyn.tracks[0].figure.tip()")
            y = model.state(np.array([0, 0.5, 0, 0]), np.zeros(4)).y
            np.testing.assert_allclose(tip, y, atol=1e-5)
            assert page.console == []

            page.open(recorded.as_uri() + "#pause")
            assert page.run("softdyn.tracks[0].frames.length") > 8
            assert page.run("softdyn.tracks[0].end") > 0.2
            assert page.console == []
        process.terminate()
        assert process.wait(30) == 0
    finally:
        process.kill()
