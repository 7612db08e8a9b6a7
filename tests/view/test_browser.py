"""The pages in a real browser: their pixels, their console and their requests."""

from __future__ import annotations

import subprocess
from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn import SetPoint, design
from softdyn.controllers import Command, LogChannel
from softdyn.description.rig import Sensor, SensorKind
from softdyn.description.robot import input_unit
from softdyn.tasks import AxisTask, PoseTask, References
from softdyn.tasks.marks import marks_of, numbers_at, stacked
from softdyn.validation import Log, paper, simulate
from softdyn.validation.loop.logged_robot import LoggedRobot
from softdyn.validation.loop.pictures.replay import replay, show_runs
from softdyn.view.live.channel import Channel
from softdyn.view.live.explorer import Explorer, open_explorer_page
from softdyn.view.page import Page, PlayedRun, Track, frames
from softdyn.view.scene import Figure
from tests.support import PATIENCE, rigs, robots
from tests.support.arms import RUBBER, loaded, pushed
from tests.support.browser import Browser, required
from tests.support.forked import forked
from tests.support.logs import make_log

pytestmark = required()
ALIKE = 40  # sum over the channels above which a pixel counts as changed


@pytest.fixture(scope="module")
def browser():
    with Browser() as found:
        yield found


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """A short run of spirob, and one of a controller that does nothing."""
    model = softdyn.load("spirob")

    class Idle:
        def __call__(self, state, reference):
            self.u = np.zeros(model.nu)
            return self

    from softdyn.controllers import SoftIdClfQp

    goal = paper.set_point("spirob", 1.0)
    made = [
        simulate(model, controller, goal, duration=0.6, name=name)
        for controller, name in ((SoftIdClfQp(model), "soft-id-clf-qp"), (Idle(), "idle"))
    ]
    return model, made


def changed(a: np.ndarray, b: np.ndarray) -> int:
    """Pixels of another colour."""
    return int((np.abs(a - b).sum(axis=2) > ALIKE).sum())


def empty_scene(browser: Browser) -> np.ndarray:
    browser.run("softdyn.stage.visible = false")
    picture = browser.pixels("canvas")
    browser.run("softdyn.stage.visible = true")
    return picture


def seek(browser: Browser, t: float) -> np.ndarray:
    browser.run(f"(softdyn.pause(), softdyn.seek({t}), 1)")
    return browser.pixels("canvas")


def test_a_replay_file_shows_the_robot_move_and_talks_to_nobody(browser, logs, tmp_path):
    model, (log, _) = logs
    file = tmp_path / "replay.html"
    file.write_text(replay(log, model).html(), encoding="utf-8")
    browser.open(file.as_uri())
    assert browser.run("softdyn.playing || softdyn.time > 0")
    start, end = seek(browser, 0.0), seek(browser, 0.6)
    assert changed(start, empty_scene(browser)) > 1500
    assert changed(start, end) > 1000
    assert browser.console == []
    assert browser.requests
    assert {url.partition(":")[0] for url in browser.requests} <= {"file", "data", "blob"}
    assert [url for url in browser.requests if url.startswith("file")] == [file.as_uri()]


def test_channels_of_one_s_own_have_a_chart_and_the_value_of_the_moment(browser, tmp_path):
    model = softdyn.load("finger")

    def law(state, reference):
        k = float(law.calls)
        law.calls += 1
        values = {"counted": [k, -2 * k] if k < 60 else [np.nan, 0.0], "side": "left"}
        return Command(np.zeros(model.nu), values=values)

    law.calls = 0
    law.channels = (
        LogChannel.of("counted", [("up", ""), ("down", "m")]), LogChannel("side", text=True),
    )  # fmt: skip
    log = simulate(model, law, SetPoint([0.1, 0.0, -0.1]), duration=0.5)
    replay(log, model).save(tmp_path / "channels.html")
    browser.open((tmp_path / "channels.html").as_uri() + "#pause")
    told = "[...document.querySelectorAll('#channels p')].map(p => p.textContent)"
    browser.run(f"(softdyn.seek({log.t[40]}), 1)")
    up, down, side = browser.run(told)
    k = float(up.removeprefix("counted.up"))  # of the frame before
    assert 30 <= k <= 40
    assert float(down.removeprefix("counted.down (m)")) == -2 * k
    assert side == "sideleft"
    browser.run(f"(softdyn.seek({log.t[90]}), 1)")
    assert browser.run(told)[0] == "counted.up–"
    drawn = "document.querySelector('#channels canvas').getContext('2d')"
    assert browser.run(f"{drawn}.getImageData(0, 0, 200, 40).data.some(x => x > 0)")
    assert browser.run("softdyn.strips[0].chart.low") == pytest.approx(-118.0, abs=8)
    assert browser.console == []


def test_the_page_s_kinematics_and_cables_are_the_model_s(browser, logs, tmp_path):
    model, (log, _) = logs
    file = tmp_path / "replay.html"
    file.write_text(replay(log, model).html(), encoding="utf-8")
    browser.open(file.as_uri() + "#pause")
    shown = browser.run("softdyn.tracks[0].frames.map(f => Array.from(f))")
    assert len(shown) > 18
    for frame in shown[:: len(shown) // 6]:
        browser.run(f"(softdyn.seek({frame[0]}), 1)")
        q = np.array(frame[1 : 1 + model.nv])
        tip = browser.run("softdyn.tracks[0].figure.tip()")
        np.testing.assert_allclose(tip, model.state(q, np.zeros(model.nv)).y, atol=2e-6)
        lengths = browser.run(
            "softdyn.tracks[0].figure.cables.map(c => c.points.slice(1)"
            ".reduce((sum, p, i) => sum + p.distanceTo(c.points[i]), 0))"
        )
        np.testing.assert_allclose(lengths, model.tendon_lengths(q), atol=5e-6)
        k = int(np.searchsorted(log.t, frame[0] - 1e-6))
        np.testing.assert_allclose(
            frame[1 + model.nv : 4 + model.nv], log.u[min(k, 299)], atol=1e-4
        )


def test_targets_of_tasks_are_drawn_and_coincide_with_a_robot_that_fulfils_them(browser, tmp_path):
    """A pose with an own origin, and a direction of another link, at q = 0 and while it falls."""
    model = softdyn.load("finger")

    class Idle:
        tasks = (PoseTask("tip", (0.0, 0.02, 0.01)), AxisTask("link2", [1.0, 1.0, 0.0]))

        def __call__(self, state, reference):
            return np.zeros(model.nu)

    poses = model.link_poses(model.q0)
    marks = marks_of(Idle.tasks)
    goal = stacked(marks, np.concatenate([numbers_at(one, poses[one.link]) for one in marks]))
    log = simulate(model, Idle(), References(goal.targets), duration=0.2)
    log.save(tmp_path / "run.npz")
    replay(Log.load(tmp_path / "run.npz"), model).save(tmp_path / "tasks.html")
    browser.open((tmp_path / "tasks.html").as_uri() + "#pause")
    found = """softdyn.tracks[0].goals.marks.map(mark => [mark.object, mark.own].map(o => {
      o.updateWorldMatrix(true, false);
      return new T.Matrix4().copy(softdyn.stage.matrixWorld).invert().multiply(o.matrixWorld)
        .elements; }).map(e => Array.from(e)))"""
    (target, own), (way, along) = np.reshape(browser.run(found), (2, 2, 4, 4)).swapaxes(2, 3)
    np.testing.assert_allclose(target, own, atol=1e-6)
    np.testing.assert_allclose(way[:3, 2], along[:3, 2], atol=1e-6)
    np.testing.assert_allclose(way[:3, 3], poses["link2"][:3, 3], atol=1e-6)
    empty = "softdyn.tracks[0].goals.marks.forEach(m => { m.object.visible = false; }), 1"
    before = browser.pixels("canvas")
    browser.run(f"({empty}, softdyn.viewer.set_dirty(), 1)")
    assert changed(before, browser.pixels("canvas")) > 300
    browser.run("(softdyn.seek(0.2), 1)")
    (target, own), (way, along) = np.reshape(browser.run(found), (2, 2, 4, 4)).swapaxes(2, 3)
    frame = model.link_poses(log.q[-1])
    np.testing.assert_allclose(own[:3, :3], frame["tip"][:3, :3], atol=1e-5)
    np.testing.assert_allclose(own[:3, 3], (frame["tip"] @ [0, 0.02, 0.01, 1])[:3], atol=1e-5)
    np.testing.assert_allclose(target[:3, 3], (poses["tip"] @ [0, 0.02, 0.01, 1])[:3], atol=1e-6)
    np.testing.assert_allclose(way[:3, 3], frame["link2"][:3, 3], atol=1e-5)
    assert browser.console == []


def test_opacity_and_wireframe_show_what_links_hide(browser, tmp_path):
    view = softdyn.show(softdyn.load("helix"), u=np.full(9, 20.0))
    view.save(tmp_path / "helix.html")
    url = (tmp_path / "helix.html").as_uri()
    browser.open(url)
    assert browser.run("getComputedStyle(document.getElementById('bar')).display") == "none"
    opaque = browser.pixels("canvas")
    set_opacity = "(e => (e.value = 0.1, e.oninput(), 1))(document.getElementById('opacity'))"
    browser.run(set_opacity)
    clear = browser.pixels("canvas")
    assert changed(opaque, clear) > 5000
    hidden = "softdyn.tracks[0].figure.shapes.forEach(s => { s.visible = false; })"
    browser.run(hidden)
    cables = browser.pixels("canvas")
    # little of the links' colour is left beside the cables'
    assert np.abs(clear - cables).sum() < np.abs(opaque - cables).sum() / 2
    browser.run("softdyn.tracks[0].figure.shapes.forEach(s => { s.visible = true; })")
    wireframe = "(e => (e.checked = %s, e.onchange(), 1))(document.getElementById('wireframe'))"
    browser.run(set_opacity.replace("0.1", "1") + "," + wireframe % "true")
    lines = browser.pixels("canvas")
    assert min(changed(lines, other) for other in (opaque, clear, cables)) > 2000
    browser.run(wireframe % "false")
    assert changed(opaque, browser.pixels("canvas")) == 0
    browser.open(url + "#wireframe")
    assert changed(lines, browser.pixels("canvas")) == 0
    assert browser.console == []


def test_a_view_s_open_page_follows_what_is_displayed(browser):
    model = softdyn.load("finger")
    view = softdyn.show(model).open(browser=False)
    try:
        browser.open(view.url)
        before = browser.pixels("canvas")
        view.display(np.full(4, 0.4), [0.5, 0.0])
        tip = model.state(np.full(4, 0.4), np.zeros(4)).y
        browser.until("softdyn.tracks[0].u && softdyn.tracks[0].u[0] > 0.49")
        np.testing.assert_allclose(browser.run("softdyn.tracks[0].figure.tip()"), tip, atol=1e-5)
        assert changed(before, browser.pixels("canvas")) > 1000
    finally:
        view.close()
    assert view.url is None


def texts(selector: str) -> str:
    """The script that reads the text of each element."""
    return f"[...document.querySelectorAll('{selector}')].map(e => e.value ?? e.textContent)"


def test_the_card_states_the_tip_the_units_and_the_length_of_the_axes(browser, logs, tmp_path):
    model, (log, _) = logs
    file = tmp_path / "replay.html"
    file.write_text(replay(log, model).html(), encoding="utf-8")
    browser.open(file.as_uri() + "#t=0.6")
    x, y, z = (f"{100 * value:.1f}" for value in log.y[-1])
    assert browser.run(texts("#legend .tip output")) == [f"{x}, {y}, {z} cm"]
    assert browser.run(texts("#inputs summary")) == [f"inputs ({input_unit(model.robot)})"]
    assert browser.run(texts("#axes")) == ["axes x y z , each 10 cm"]  # the robot is 0.5 m long
    box = "(({min, max}) => max.x - min.x)(new T.Box3().setFromObject(softdyn.axes.object))"
    assert browser.run(box) == pytest.approx(0.1, rel=0.1)
    shown = browser.pixels("canvas")
    browser.run("softdyn.axes.object.visible = false")
    assert changed(shown, browser.pixels("canvas")) > 100


def test_a_comparison_shows_every_run_with_its_name(browser, logs, tmp_path):
    model, runs = logs
    for beside in (False, True):
        file = tmp_path / "both.html"
        page = show_runs(runs, [model, model], side_by_side=beside)
        file.write_text(page.html(), encoding="utf-8")
        browser.open(file.as_uri() + "#pause")
        names = browser.run(texts("#legend li:not(.tip) b"))
        assert names == ["Soft ID-CLF-QP", "idle"]
        both = seek(browser, 0.6)
        browser.run("softdyn.tracks[1].object.visible = false")
        one = browser.pixels("canvas")
        browser.run("softdyn.tracks[0].object.visible = false")
        assert changed(both, one) > 250
        assert changed(one, browser.pixels("canvas")) > 250
        assert browser.console == []


def test_cables_take_the_colour_of_their_tension(browser):
    model = softdyn.load("finger")
    rows = frames(
        model, [0.0, 1.0], np.zeros((2, 4)), np.array([[1.0, -1.0], [0.0, 0.0]]),
        np.zeros((2, 3)), np.zeros((2, 3)),
    )  # fmt: skip
    page = Page("finger", (Figure.of(model),), (PlayedRun("", (Track(0, rows, "x"),)),), live=True)
    with Channel(page.html()) as channel:
        browser.open(channel.url)
        browser.run("(softdyn.following = false, softdyn.seek(0), 1)")
        read = "softdyn.tracks[0].figure.cables.map(c => c.material.color.toArray())"
        (flexor, slack, slack_too, extensor) = browser.run(read)
        assert slack == slack_too
        assert flexor[0] > 2 * flexor[2]  # red where it pulls
        assert extensor[2] > 2 * extensor[0]  # blue at its antagonist
        browser.run("(softdyn.seek(1), 1)")
        assert browser.run(read) == [slack] * 4


def test_a_chamber_is_a_tube_that_reddens_and_its_pressure_is_in_kpa(browser):
    model = pushed()
    rows = frames(
        model, [0.0, 1.0], np.zeros((2, model.nv)), np.array([[1e5, 0.0], [-5e4, 0.0]]),
        np.zeros((2, 3)), np.zeros((2, 3)),
    )  # fmt: skip
    page = Page("arm", (Figure.of(model),), (PlayedRun("", (Track(0, rows, "x"),)),), live=True)
    with Channel(page.html()) as channel:
        browser.open(channel.url)
        browser.run("(softdyn.following = false, softdyn.seek(0), 1)")
        read = "softdyn.tracks[0].figure.cables.map(c => [c.radius, ...c.material.color.toArray()])"
        full, empty = browser.run(read)
        assert full[0] == empty[0] == pytest.approx(np.sqrt(4e-5 / np.pi))
        assert full[1] > 2 * full[3]
        assert empty[1] == pytest.approx(empty[3], abs=0.2)  # grey
        assert browser.run(texts("#inputs summary")) == ["inputs (kPa)"]
        assert [float(x) for x in browser.run(texts("#inputs td:last-child"))] == [100, 0]
        browser.run("(softdyn.seek(1), 1)")
        assert browser.run(read)[0][3] > 2 * browser.run(read)[0][1]  # a vacuum is blue
        assert browser.console == []


def test_an_explorer_s_slider_of_a_chamber_is_in_kpa(browser):
    model = pushed()
    with open_explorer_page(model) as channel:
        explorer = Explorer(model)
        channel.frame(explorer.frame())
        browser.open(channel.url)
        browser.until("softdyn.last !== undefined")
        browser.run("(r => (r.value = Math.cbrt(0.5), r.oninput(), 1))(softdyn.inputs[0].range)")
        assert float(browser.run("softdyn.inputs[0].value.value")) == pytest.approx(50, rel=0.01)
        assert browser.run(texts("#inputs .note"))[0].startswith("in kPa;")
        assert browser.console == []


def test_an_explorer_s_slider_shows_the_input_of_the_robot_after_a_drag(browser):
    model = softdyn.load("finger")
    with open_explorer_page(model) as channel:
        explorer = Explorer(model)
        channel.frame(explorer.frame())
        browser.open(channel.url)
        browser.until("softdyn.last !== undefined && softdyn.leads")
        read = "[softdyn.inputs[0].range.value ** 3, Number(softdyn.inputs[0].value.value)]"
        change = "(softdyn.inputs[0].range.dispatchEvent(new Event('change')), 1)"
        browser.run("(r => (r.focus(), r.value = Math.cbrt(0.5), r.oninput(), 1))"
                    "(softdyn.inputs[0].range)")  # fmt: skip

        def answer(notice):
            """The robot is not where the slider asks it to be."""
            explorer.u = np.array([0.25, 0.0])
            explorer._poses += 1
            channel.state({"notice": notice})
            channel.frame(explorer.frame(), PATIENCE)
            browser.until(f"softdyn.time == {explorer._poses} && !softdyn.fresh")
            return browser.run(read)

        assert answer("") == pytest.approx([0.5, 0.5])  # the slider is held
        browser.run(change)
        assert answer("") == pytest.approx([0.5, 0.5])  # the answer has not come yet
        assert answer("no rest") == pytest.approx([0.25, 0.25], abs=1e-6)
        assert browser.console == []


def test_many_sliders_are_folded_by_their_names(browser):
    model = softdyn.load("helix")  # three inputs in each of three sections, 36 joints
    with open_explorer_page(model) as channel:
        channel.frame(Explorer(model).frame())
        browser.open(channel.url)
        browser.until("softdyn.last !== undefined")
        folds = (
            "[...document.querySelectorAll('#{} > details')].map(d => [d.querySelector('summary')"
        )
        folds += ".textContent, d.open, d.querySelectorAll('.slider').length])"
        assert browser.run(folds.format("inputs")) == [["u1 … u6", True, 6], ["u7 … u9", False, 3]]
        assert browser.run(folds.format("joints")) == [
            ["bend1 … bend12", True, 12],
            ["lat1 … lat12", False, 12],
            ["comp1 … comp12", False, 12],
        ]  # fmt: skip
        assert browser.console == []


def test_the_live_viewer_draws_what_is_pushed(browser):
    model = softdyn.load("finger")
    width = 1 + model.nv + model.nu + 6
    track = Track(0, np.zeros((0, width)), "live")
    page = Page("finger", (Figure.of(model),), (PlayedRun("", (track,)),), live=True)

    def row(t, angle):
        q = np.full((1, 4), angle)
        state = model.state(q[0], np.zeros(4))
        return frames(model, [t], q, np.zeros((1, 2)), state.y[None], np.array([[0.15, 0, -0.15]]))

    with Channel(page.html()) as channel:
        channel.frame(row(0.0, 0.0))
        browser.open(channel.url)
        assert channel.wait(PATIENCE)
        browser.until("softdyn.tracks[0].frames.length == 1")
        before = browser.pixels("canvas")
        assert changed(before, empty_scene(browser)) > 1500
        channel.frame(row(0.1, 0.5))
        browser.until("softdyn.time > 0.09")
        assert changed(before, browser.pixels("canvas")) > 1000
        hosts = {url.split("/")[2] for url in browser.requests if not url.startswith("data:")}
        assert hosts == {channel.url.split("/")[2]}
    browser.settle()
    assert browser.console == []
    browser.run(
        "(softdyn.following = false, softdyn.seek(0), 1)"
    )  # the page keeps the run when the server is gone
    assert changed(before, browser.pixels("canvas")) < 500


def test_view_py_in_a_browser(browser):
    process = forked("view", "spirob", "--no-open", stdout=subprocess.PIPE)
    try:
        browser.open(process.stdout.readline().strip())
        first, later = seek(browser, 0.0), seek(browser, 1.2)
        assert changed(first, empty_scene(browser)) > 1500
        assert changed(first, later) > 300
        assert browser.console == []
        assert all("127.0.0.1" in url or url.startswith("data:") for url in browser.requests)
        process.terminate()
        assert process.wait(PATIENCE) == 0
    finally:
        process.kill()


def test_a_robot_s_name_is_text(browser, tmp_path):
    name = "</script><script>document.title = 'stolen'</script><img src=x onerror='stolen = 1'>"
    model = softdyn.load("finger")
    page = Page(name, (Figure.of(model),), (PlayedRun(name, (Track(0, np.zeros((0, 13)), name),)),))
    file = tmp_path / "name.html"
    file.write_text(page.html(), encoding="utf-8")
    browser.open(file.as_uri() + "#pause")
    assert browser.run("document.title") == name
    assert browser.run("document.querySelector('#legend b').textContent") == name
    assert browser.run("typeof stolen") == "undefined"
    assert browser.console == []


def test_a_phone_sees_robot_and_controls(browser, logs, tmp_path):
    model, (log, _) = logs
    file = tmp_path / "replay.html"
    file.write_text(replay(log, model).html(), encoding="utf-8")
    browser.open(file.as_uri() + "#pause", 360, 700)
    assert browser.run("document.documentElement.scrollWidth <= innerWidth")
    button = browser.run("(({width, height}) => [width, height])(play.getBoundingClientRect())")
    assert min(button) >= 34
    assert changed(seek(browser, 0.3), empty_scene(browser)) > 800


def test_a_whole_spirob_run_is_a_small_page():
    model = softdyn.load("spirob")
    n = 5000
    rng = np.random.default_rng(0)
    t, y = np.arange(n + 1) * 0.002, rng.normal(size=(n + 1, 3))
    log = make_log(
        t, np.zeros((n + 1, 3)), q=rng.normal(size=(n + 1, 27)), v=np.zeros((n + 1, 27)), y=y,
        u=np.zeros((n, 3)), u_min=model.u_min, u_max=model.u_max, length=0.5, robot="spirob",
        source=LoggedRobot.of(model),
    )  # fmt: skip
    # a tip that jumps at every step needs the largest number of frames
    assert len(replay(log, model).html()) < 5e6


def test_a_skin_moves_with_the_joints(browser, tmp_path):
    """Its circles lie about their links; it stands for the pieces that it covers."""
    arm = design.Arm((design.Section(0.2, [0.02, 0.01], RUBBER, 3),))
    model = loaded(arm, tmp_path)
    q = np.full(model.nq, 0.3)
    softdyn.show(model, q).save(tmp_path / "arm.html")
    browser.open((tmp_path / "arm.html").as_uri())
    skin = "softdyn.tracks[0].figure.skins[0]"
    points = browser.run(f"Array.from({skin}.mesh.geometry.attributes.position.array)")
    rows = np.reshape(points, (-1, 28, 3))[2:-2:4]  # between two rings there are three more rows
    figure = Figure.of(model)
    (rings,) = figure.data["skins"]
    placed = model.link_poses(q)
    for row, ring in zip(rows, rings, strict=True):
        pose = placed[figure.links[ring["link"]]] @ np.reshape(ring["pose"], (4, 4)).T
        local = (row - pose[:3, 3]) @ pose[:3, :3]
        np.testing.assert_allclose(local[:, 2], 0, atol=1e-6)
        np.testing.assert_allclose(np.hypot(*local[:, :2].T), ring["radius"], atol=1e-6)
    shown = "softdyn.tracks[0].figure.shapes.map(s => s.visible)"
    assert browser.run(shown) == [not shape.skin for shape in figure.shapes]
    browser.run("softdyn.tracks[0].figure.look(1, true)")
    assert all(browser.run(shown))
    assert not browser.run(f"{skin}.mesh.visible")


SLACK = (
    "softdyn.tracks[0].figure.cables.map("
    "c => [c.name, c.material.opacity < 1 && c.hidden.opacity < 0.3])"
)


def tense(model, q, u):
    """Whether every tendon has a tension, from sensors of the model at rest."""
    sensors = tuple(Sensor(t.name, SensorKind.TENSION, tendon=t.name) for t in model.robot.tendons)
    seen = softdyn.build(replace(model.robot, sensors=sensors))
    found = seen.measure(seen.state(q, np.zeros(model.nv)), u)
    return dict(zip(found.names, np.abs(found.values) > 1e-6, strict=True))


def test_slack_cables_of_a_page_have_no_tension(browser, tmp_path):
    """A winch's cable and a brace with a spring, along a run; a fixed tendon over followers."""
    arm = robots.load(tmp_path, robots.WINCHED)
    log = rigs.turns(arm)
    gripper = rigs.slackened(robots.load(tmp_path, robots.GRIPPER))
    rng = np.random.default_rng(2)
    q = rng.uniform(-0.5, 0.5, (12, gripper.nq))
    none, y = np.zeros((len(q), gripper.nu)), np.zeros((len(q), 3))
    moved = Track(0, frames(gripper, np.arange(12.0), q, none, y, y), "")
    pages = (
        (arm, replay(log, arm)),
        (gripper, Page("gripper", (Figure.of(gripper),), (PlayedRun("", (moved,)),))),
    )
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
