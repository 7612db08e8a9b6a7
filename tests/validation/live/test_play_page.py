"""`softdyn play` in a real browser, used by mouse, keys and menus."""

from __future__ import annotations

import asyncio
import subprocess

import numpy as np
import pytest
from tornado.websocket import websocket_connect

import softdyn
from softdyn.controllers import SoftIdClfQp
from softdyn.tasks import AxisTask, PoseTask
from softdyn.tasks.targets import exp3
from softdyn.validation import Rig, paper, play
from softdyn.validation.live.watching import open_watch_page, watch
from softdyn.validation.loop.closed_loop import ClosedLoop
from softdyn.validation.loop.pictures.replay import replay
from softdyn.validation.loop.settings import RunOptions
from tests.support import PATIENCE, robots
from tests.support.browser import Browser, required
from tests.support.forked import forked

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
    """A finger in a separate process, with a user's controller in the menu."""
    own = tmp_path_factory.mktemp("own") / "idle.py"
    own.write_text(LAW)
    words = ("play", "finger", "soft-id-clf-qp", f"{own}:Idle", "--no-open")
    process = forked(*words, stdout=subprocess.PIPE)
    try:
        yield process.stdout.readline().strip()
        process.terminate()
        assert process.wait(PATIENCE) == 0
    finally:
        process.kill()


@pytest.fixture(scope="module")
def page(url):
    with Browser(pause=60) as found:
        found.open(url)
        found.until("softdyn.leads && softdyn.frames > 5")
        yield found
        assert found.console == []
        assert {u.split("/")[2] for u in found.requests if "//" in u} == {url.split("/")[2]}


@pytest.fixture
def browser(page):
    """The page with its robot reset, so that no test depends on another."""
    for message in ("do: 'mismatch'", "do: 'law', name: 'soft-id-clf-qp'", "do: 'ghost', on: false",
                    "do: 'pause', on: true", "do: 'reset'"):  # fmt: skip
        page.run(f"softdyn.say({{{message}}})")
    page.until("softdyn.state.paused && softdyn.one(softdyn.last, 't') == 0")
    page.run("softdyn.say({do: 'pause', on: false})")
    page.until("!softdyn.state.paused && softdyn.one(softdyn.last, 't') > 0")
    return page


@pytest.fixture(scope="module")
def other():
    with Browser(pause=60) as found:
        yield found


@pytest.fixture
def recorded(browser, tmp_path):
    """A recording of half a second."""
    browser.key("v")
    browser.until("document.getElementById('record').classList.contains('on')")
    t = vector(browser, "t")[0]
    browser.until(f"softdyn.one(softdyn.last, 't') > {t} + 0.5")
    browser.key("v")
    browser.until("!document.getElementById('recorded').hidden")
    text = browser.run("fetch(document.getElementById('recorded').href).then(r => r.text())")
    (tmp_path / "record.html").write_text(text, encoding="utf-8")
    return tmp_path / "record.html"


def vector(browser, name):
    return np.array(browser.run(f"Array.from(softdyn.part(softdyn.last, '{name}'))"))


def on_screen(browser, point):
    """The place in the window (pixels) of a point of the world (m)."""
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
    browser.until("!softdyn.handle.dragging")
    browser.until(f"Math.abs(softdyn.part(softdyn.last, 'y_ref')[0] - {goal[0]}) < 0.006")
    now = vector(browser, "y_ref")
    assert now[1] == pytest.approx(before[1], abs=1e-6)
    np.testing.assert_allclose(now, goal, atol=0.006)  # a pixel is about a millimetre
    browser.until("softdyn.recent[0].column('error').most.slice(-20).every(e => e < 0.05)")  # cm

    browser.drag(
        on_screen(browser, now), on_screen(browser, now + np.array([0, 0.05, 0])), shift=True
    )
    browser.until("Math.abs(softdyn.part(softdyn.last, 'y_ref')[1] - 0.05) < 0.015")
    np.testing.assert_allclose(vector(browser, "y_ref")[[0, 2]], now[[0, 2]], atol=1e-6)


def test_a_drag_leaves_the_camera_alone_and_a_finger_moves_the_target_in_depth(browser):
    camera = "softdyn.viewer.camera.position.toArray()"
    before, seen = vector(browser, "y_ref"), browser.run(camera)
    arrow = before + np.array([0, 0.15 * browser.run("softdyn.size"), 0])
    start, end = on_screen(browser, arrow), on_screen(browser, arrow + np.array([0, 0.05, 0]))
    touch(browser, "touchStart", start)
    touch(browser, "touchStart", start, [100, 300])  # another finger beside the robot
    for part in (0.5, 1.0):
        at = [a + part * (b - a) for a, b in zip(start, end, strict=True)]
        touch(browser, "touchMove", at, [100 + 50 * part, 300])
        browser.settle()
    touch(browser, "touchEnd")
    browser.until("!softdyn.handle.dragging")
    browser.until(f"softdyn.part(softdyn.last, 'y_ref')[1] > {before[1]} + 0.03")
    now = vector(browser, "y_ref")
    assert now[1] == pytest.approx(before[1] + 0.05, abs=0.015)
    np.testing.assert_allclose(now[[0, 2]], before[[0, 2]], atol=1e-6)
    assert browser.run(camera) == seen
    browser.drag([100, 300], [160, 300])
    assert np.linalg.norm(np.subtract(browser.run(camera), seen)) > 0.01
    browser.key("f")


def touch(browser, kind, *points):
    places = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(points)]
    browser._call("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places})


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
    browser.until("softdyn.pull.arrow.visible")
    browser.until(f"Math.abs(softdyn.part(softdyn.last, 'y')[0] - {before[0]}) > 0.004")
    assert " N" in browser.run("document.getElementById('newtons').value")
    browser.lift(end)
    browser.until("!softdyn.pull.arrow.visible")
    there = f"softdyn.part(softdyn.last, 'y').map((y, i) => y - {before.tolist()}[i])"
    browser.until(f"Math.hypot(...{there}) < 1e-3")


def test_inputs_by_slider_and_laws_and_plant_by_menu_while_it_runs(browser):
    browser.key("o")
    browser.until("softdyn.state.law == 'open loop' && !softdyn.inputs[0].range.disabled")
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
    browser.until(f"softdyn.frames > {browser.run('softdyn.frames')} + 2")  # frames on their way
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


def test_a_page_that_loses_command_while_it_drags_lets_go(browser, url):
    """Another page takes over with the button still down, and leaves again."""

    async def take_over():
        link = await websocket_connect(url.replace("http:", "ws:").replace("/?", "/live?"))
        await link.write_message('{"do": "lead"}')
        await asyncio.to_thread(browser.until, "!softdyn.leads")
        found = browser.run("[softdyn.handle.dragging, softdyn.held]")
        link.close()
        await asyncio.to_thread(browser.until, "softdyn.leads")
        return found

    at = on_screen(browser, vector(browser, "y_ref"))
    browser.press(at)
    browser.move([at[0] + 20, at[1]])
    browser.until("softdyn.handle.dragging")
    assert asyncio.run(take_over()) == [False, None]
    browser.lift([at[0] + 20, at[1]])
    goal = (vector(browser, "y_ref") + np.array([-0.01, 0, 0.01])).tolist()
    browser.run(f"softdyn.say({{do: 'target', y: {goal}}})")
    browser.until(f"Math.abs(softdyn.target.position.x - {goal[0]}) < 1e-5")  # it follows again


def test_the_reach_and_the_model_beside_the_plant_are_shown(browser):
    browser.key("g")
    browser.until("softdyn.ghost.object.visible")
    label = browser.run("document.getElementById('ghost').parentElement.textContent.trim()")
    assert label == "model beside it"
    browser.key("h")
    browser.until("softdyn.rests.length > 20")
    reach = np.array(browser.run("softdyn.rests"))
    assert np.linalg.norm(reach, axis=1).max() < 0.25  # the finger's length is 0.24 m


def test_a_recording_replays(other, recorded):
    other.open(recorded.as_uri() + "#pause")
    assert other.run("softdyn.tracks[0].frames.length") > 8
    assert other.run("softdyn.tracks[0].end") > 0.4
    assert other.console == []


def test_a_watched_run_leaves_a_page_that_replays_it(other):
    model = softdyn.load("finger")
    goal = paper.set_point("finger", 0.5)
    options = RunOptions(duration=0.3, name="soft-id-clf-qp")
    loop = ClosedLoop(model, SoftIdClfQp(model), goal, options)
    with open_watch_page(loop) as channel:
        other.open(channel.url, 800, 600)  # as wide as in a notebook
        other.until("softdyn.link.readyState == 1")
        log, _ = watch(loop, channel)
        channel.leave(replay(log, model).html())
    other.until("!document.getElementById('recorded').hidden")  # the server is gone
    assert other.run("document.getElementById('notice').textContent") == "done"
    kept = other.run("fetch(document.getElementById('recorded').href).then(r => r.text())")
    assert kept == replay(log, model).html()
    right = "[...document.querySelectorAll('%s')].map(c => c.getBoundingClientRect().right)"
    plots, (panel,) = other.run(right % ".plot canvas"), other.run(right % "#side")
    assert len(plots) > 4
    assert max(plots) < panel  # the newest part is not cut off
    assert other.console == []


def test_sliders_explore_rests(other, tmp_path):
    """`view --sliders`: an input leads to an equilibrium with its ellipsoid, a joint to a pose."""
    page = other
    process = forked("view", "finger", "--sliders", "--no-open", stdout=subprocess.PIPE)
    try:
        page.open(process.stdout.readline().strip())
        page.until("softdyn.leads && softdyn.frames > 0 && softdyn.ellipsoid.visible")
        page.run("(s => { s.value = 0.7; s.oninput(); })(softdyn.inputs[0].range)")
        page.until("softdyn.part(softdyn.last, 'u')[0] > 0.3")
        page.until("softdyn.readouts.rest.value == 'stable'")
        page.run("(s => { s.value = 0.5; s.oninput(); })(softdyn.joints[1].range)")
        page.until("softdyn.readouts.rest.value == 'joints by hand'")
        assert vector(page, "q")[1] == pytest.approx(0.5, abs=1e-6)
        assert not page.run("softdyn.ellipsoid.visible")
        # plots have the last 12 s, every line of them
        lengths = page.run("""(() => {
          softdyn.link.onmessage = null;
          for (let k = 0; k < 400; k++) {
            const frame = new Float32Array(softdyn.last.length);
            frame[0] = 1000 + k / 20;
            frame[softdyn.scene.columns.V[0]] = k;
            softdyn.take(frame);
          }
          const [last, ...lines] = ["V", "u0"].map(name => softdyn.recent[0].column(name));
          const since = last.t.findIndex(t => t >= last.t.at(-1) - 12), t = last.t.slice(since);
          return [t.length, last.most.slice(since).length, lines[0].least.slice(since).length,
            t.at(-1) - t[0], last.most.at(-1)];
        })()""")
        assert lengths == [241, 241, 241, 12, 399]
        assert page.console == []
        process.terminate()
        assert process.wait(PATIENCE) == 0
    finally:
        process.kill()

    model = softdyn.load("finger")  # and the page that needs no server
    softdyn.show(model).save(tmp_path / "show.html")
    page.open((tmp_path / "show.html").as_uri())
    page.run("(s => { s.value = 0.5; s.oninput(); })(softdyn.joints[1].range)")
    tip = page.run("softdyn.tracks[0].figure.tip()")
    y = model.state(np.array([0, 0.5, 0, 0]), np.zeros(4)).y
    np.testing.assert_allclose(tip, y, atol=1e-5)
    assert page.console == []


def test_sliders_keep_the_commands_while_a_lag_acts(other, tmp_path):
    """Behind a rig, open loop: the sliders show what was asked for, the numbers what acts."""
    model = robots.load(tmp_path, robots.WINCHED)
    with play(model, rig=Rig(lag=10.0)) as live:
        other.open(live.url)
        other.until("softdyn.leads && softdyn.frames > 5")
        other.run('(softdyn.say({do: "inputs", u: [0, 7.5]}), 1)')
        other.until("softdyn.state.inputs[1] == 7.5 && softdyn.frames > 20")
        other.until("Number(document.querySelectorAll('#inputs input')[1].value) > 0")  # next frame
        part = "Array.from(document.querySelectorAll('#inputs {}'), e => Number(e.value))"
        asked = np.array(other.run(part.format("input"))) ** 3 * 60
        acting = other.run(part.format("output"))
        np.testing.assert_allclose(asked, [0.0, 7.5], atol=1e-6)
        assert max(acting) < 5.0
        assert other.console == []


def test_a_pose_is_moved_and_turned_by_the_mouse(other):
    """By its ball, then by a ring about its own axis; then another task's direction is turned."""
    model = softdyn.load("finger")
    tasks = [PoseTask("tip", name="hand"), AxisTask("link2", [1, 0, 0], weight=0.01)]
    with play(model, law="soft-id-clf-qp", tasks=tasks) as live:
        other.open(live.url, 1000, 700)
        other.until("softdyn.leads && softdyn.frames > 5")
        before = vector(other, "targets").astype(float)
        goal = before[:3] + np.array([0.0, 0.0, 0.06])
        other.drag(on_screen(other, before[:3]), on_screen(other, goal))
        other.until(f"Math.abs(softdyn.part(softdyn.last, 'targets')[2] - {goal[2]}) < 0.006")
        moved = vector(other, "targets")
        np.testing.assert_allclose(moved[:3], goal, atol=0.006)
        np.testing.assert_allclose(moved[3:], before[3:], atol=1e-6)

        other.key("t")
        other.until("softdyn.handle.turns")
        ring = other.run("""(() => {
          const c = softdyn.target.getWorldPosition(new T.Vector3()).project(softdyn.viewer.camera);
          const [x, y] = [(c.x + 1) / 2 * innerWidth, (1 - c.y) / 2 * innerHeight], found = [];
          for (let r = 10; r < 130; r += 3) for (let a = 0; a < 6; a += 0.1) {
            const at = [x + r * Math.cos(a), y - r * Math.sin(a)];
            const part = softdyn.handle.at({clientX: at[0], clientY: at[1]});
            if (part && part.name == "y") found.push(at);
          }
          return found; })()""")
        other.drag(ring[-1], ring[len(ring) // 2])
        other.until(f"Math.abs(softdyn.part(softdyn.last, 'targets')[4] - {moved[4]}) > 0.2")
        turned = vector(other, "targets").astype(float)
        np.testing.assert_allclose(turned[:3], moved[:3], atol=1e-6)
        turn = exp3(turned[3:6]) @ exp3(moved[3:6].astype(float)).T
        own = exp3(before[3:6])[:, 1]
        np.testing.assert_allclose(turn @ own, own, atol=1e-4)  # about its own y
        assert other.run("softdyn.readouts.goals[0].value").endswith("°")

        other.key("n")
        other.until("softdyn.aim.name == 'link2.axis' && softdyn.handle.turns")
        other.run("""(softdyn.target.quaternion.multiply(new T.Quaternion().setFromAxisAngle(
          new T.Vector3(1, 0, 0), 0.5)), softdyn.handle.changed(), 1)""")
        way = turned[6:]
        other.until("Math.hypot(...softdyn.part(softdyn.last, 'targets').slice(6)"
                    f".map((x, i) => x - {way.tolist()}[i])) > 0.4")  # fmt: skip
        now = vector(other, "targets")[6:].astype(float)
        assert now @ way == pytest.approx(np.cos(0.5), abs=1e-4)
        assert other.console == []
