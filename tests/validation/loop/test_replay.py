"""Pages of logs: the thinned samples, the names of several runs, and the commands."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_rgb

import softdyn
from softdyn import SetPoint
from softdyn.controllers import LogChannel
from softdyn.safety import HalfSpace, KeepOutSphere, Surroundings
from softdyn.validation import Log, paper, simulate
from softdyn.validation.loop.pictures.replay import COLOURS, replay, replays, show_runs, track
from softdyn.validation.loop.pictures.time_figures import compare
from softdyn.view.scene import tension_colour
from tests.support import ROOT
from tests.support.refused import refused


class Idle:
    """A controller that does nothing."""

    def __init__(self, model):
        self.u = np.zeros(model.nu)

    def __call__(self, state, reference):
        return self


@pytest.fixture(scope="module")
def model():
    return softdyn.load("finger")


@pytest.fixture(scope="module")
def log(model):
    goal = paper.set_point("finger", 0.5)
    return simulate(model, Idle(model), goal, duration=2.0, name="idle")


def scene(page):
    return json.loads(re.search(r'id="scene">(.*?)</script>', page.html("x.js"))[1])


def test_frames_are_samples_of_the_log_with_the_input_held_from_them(model, log):
    rows = track(log, model).frames
    k = np.searchsorted(log.t, rows[:, 0] - 1e-6)
    assert (k[0], k[-1]) == (0, log.steps)
    u = log.u[np.minimum(k, log.steps - 1)]
    expected = np.column_stack((log.t[k], log.q[k], u, log.y[k], log.y_ref[k]))
    np.testing.assert_allclose(rows, expected, atol=1e-6)
    assert np.diff(rows[:, 0]).max() <= 1 / 30 + log.period
    assert len(rows) >= 60
    slow = track(log, model, rate=1.0).frames
    way = np.linalg.norm(np.diff(slow[:, 7:10], axis=0), axis=1)
    assert 3 < len(slow) < len(rows)
    assert way.max() < 0.02 * log.length + np.linalg.norm(np.diff(log.y, axis=0), axis=1).max()


def test_a_diverged_run_ends_where_it_was_finite_and_says_why(model, log):
    q, error = log.q.copy(), log.error.copy()
    q[200:], error[200:] = np.nan, np.inf
    bad = log.altered(q=q, error=error, complete=False, failed=True, reason="it <exploded>")
    page = replay(bad, model)
    (found,) = scene(page)["runs"][0]["tracks"]
    assert found["note"] == "failed: it <exploded>"
    assert found["failed"]
    assert track(bad, model).frames[-1, 0] == pytest.approx(log.t[199])
    assert "<exploded>" not in page.html("x.js")


def test_a_run_without_a_step_is_a_page_too(model, log):
    none = log.altered(
        t=log.t[:1], q=log.q[:1], v=log.v[:1], y=log.y[:1], y_ref=log.y_ref[:1],
        error=log.error[:1], u=log.u[:0], V=log.V[:0], delta=log.delta[:0],
        status=log.status[:0], step_us=log.step_us[:0], complete=False, failed=True, reason="x",
    )  # fmt: skip
    assert track(none, model).frames.shape == (1, 13)
    q = log.q[:1] * np.nan
    assert track(none.altered(q=q), model).frames.shape == (0, 13)
    replay(none.altered(q=q), model).html("x.js")


def test_a_long_run_has_a_bounded_number_of_frames(model, log):
    n = 100_000
    grown = {
        name: np.resize(getattr(log, name), (n + 1, *getattr(log, name).shape[1:]))
        for name in ("q", "v", "y", "y_ref", "error")
    }
    u = np.zeros((n, 2))
    rest = dict.fromkeys(("V", "delta", "step_us"), np.zeros(n)) | {"status": np.array([""] * n)}
    long = log.altered(t=np.arange(n + 1) * 0.005, u=u, **grown, **rest)
    assert len(track(long, model).frames) <= 6001


def test_a_log_of_another_robot_is_refused(log):
    with refused("robot", "another, …"):
        replay(log, softdyn.load("spirob"))


def test_runs_are_told_apart_by_what_differs(model, log):
    other = replace(log, controller="ic")
    faster, driven = replace(log, theta=1.0), replace(log, plant="MyRig")
    labels = [[t.label for t in show_runs(logs, [model] * 2).runs[0].tracks]
              for logs in ((log, other), (log, faster), (log, driven), (log, log))]  # fmt: skip
    assert labels == [["idle", "IC"], ["set point θ = 0.5π", "set point θ = π"],
                      ["simulated", "MyRig"], ["idle", "idle"]]  # fmt: skip


def test_side_by_side_robots_do_not_overlap(model, log):
    page = show_runs([log, log, log], [model] * 3, side_by_side=True)
    x = [t.offset[0] for t in page.runs[0].tracks]
    assert np.diff(x).min() > log.length
    assert len(page.figures) == 1
    assert all(t.path is not None for t in page.runs[0].tracks)
    together = show_runs([log, log], [model] * 2).runs[0].tracks
    assert [t.offset[0] for t in together] == [0.0, 0.0]
    assert len({t.colour for t in together}) == 2


def test_obstacles_stand_once_in_one_place_and_beside_every_robot(model, log):
    around = Surroundings([KeepOutSphere([0.1, 0.0, -0.05], 0.02), HalfSpace([0, 0, 1], -0.2)])
    among = replace(log, obstacles=around.table)
    count = len(replay(log, model).figures[0].data["shapes"])
    assert len(replay(among, model).figures[0].data["shapes"]) == count + 2
    together = show_runs([among, log], [model] * 2)
    assert [len(together.figures[t.figure].scenery) for t in together.runs[0].tracks] == [2, 0]
    apart = show_runs([among, log], [model] * 2, side_by_side=True)
    assert [len(apart.figures[t.figure].scenery) for t in apart.runs[0].tracks] == [2, 2]


def test_several_runs_are_chosen_from_a_list(model, log):
    found = scene(replays([log, replace(log, failed=True, reason="r")], model, "name"))
    assert [run["title"] for run in found["runs"]] == [
        "set point θ = 0.5π", "set point θ = 0.5π (failed)",
    ]  # fmt: skip


def test_the_page_names_no_host(model, log):
    page = replay(log, model).html()
    own = page.replace(softdyn.view.page.library_file().read_text(encoding="utf-8"), "")
    assert not re.findall(r"(?:https?:)?//[a-z0-9.]+\.[a-z]{2,}", own)


@pytest.fixture
def call(tmp_path, monkeypatch, capsys):
    import importlib

    monkeypatch.chdir(tmp_path)

    def run(name, *arguments):
        code = importlib.import_module(f"softdyn.commands.{name}").main([str(a) for a in arguments])
        return code, *capsys.readouterr()

    return run


def test_replay_compares_saved_runs(call, log, tmp_path):
    log.save("a.npz")
    code, out, err = call("replay", "a.npz", "a.npz", "--labels", "x", "y", "--html", "p.html")
    assert (code, out, err) == (0, "p.html\n", "")
    text = (tmp_path / "p.html").read_text()
    assert '"label":"x"' in text
    assert '"label":"y"' in text


def test_a_replay_draws_the_robot_that_ran(call, tmp_path):
    """It draws neither the bundled robot of that name nor the changed file."""
    text = (ROOT / "urdf" / "finger.urdf").read_text()
    longer = text.replace('<origin xyz="0.06 0 0"/><parent link="link1"/>',
                          '<origin xyz="0.1 0 0"/><parent link="link1"/>')  # fmt: skip
    assert longer != text
    (tmp_path / "finger.urdf").write_text(longer)
    model = softdyn.load("finger.urdf")
    goal = replace(paper.set_point("finger", 0.5), duration=0.1)
    simulate(model, Idle(model), goal).save("long.npz")
    (tmp_path / "finger.urdf").write_text(text)  # edited again
    code, out, err = call("replay", "long.npz", "--html", "p.html")
    assert (code, out, err) == (0, "p.html\n", "")
    shown = json.loads(
        re.search(r'id="scene">(.*?)</script>', (tmp_path / "p.html").read_text())[1]
    )
    expected = scene(Log.load("long.npz").show(model))
    assert shown == expected
    for robot in ("finger", "finger.urdf"):
        code, out, err = call("replay", "long.npz", "--robot", robot, "--html", "q.html")
        assert (code, out) == (2, "")
        (line,) = err.splitlines()
        both = r"the robot of the log, \S+finger\.urdf \(\w{12}\), got another, \S+ \(\w{12}\)"
        assert re.fullmatch(rf"error: --robot for long\.npz: expected {both}", line)
    assert not (tmp_path / "q.html").exists()


def test_a_log_has_annotations_and_a_floating_base(tmp_path):
    overlay = ROOT / "docs" / "examples" / "soft_ur5.xml"
    model = softdyn.load("ur5", annotations=overlay, floating=True)
    log = simulate(model, Idle(model), SetPoint([0.4, 0.3, 0.1]), duration=0.004)
    log.save(tmp_path / "a.npz")
    again = Log.load(tmp_path / "a.npz").source
    assert again.model().robot.digest == model.robot.digest
    assert replace(again, annotations="").digest == again.digest
    with refused("the text of the log's robot", "another, …"):
        replace(again, floating=False).model()


def test_replay_draws_saved_runs(call, log, tmp_path):
    log.save("a.npz")
    cut = {name: one.values[: 3 - one.held] for name, one in log.channels.items()}
    error = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [np.nan] * 3])
    cut |= {"error": error, "y": error, "y_ref": np.zeros((3, 3)), "u": np.ones_like(cut["u"])}
    cut["q"] = np.where([[False]] * 2 + [[True]], np.nan, cut["q"])  # the last is not finite
    lost = log.altered(**cut, complete=False, failed=True, reason="it diverged")
    lost.save("lost.npz")
    code, out, err = call("replay", "a.npz", "lost.npz", "--labels", "x", "y", "--plot", "p.png")
    assert (code, out, err) == (0, "p.png\n", "")
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
    errors, *inputs = compare([log, lost], ["x", "y"]).axes
    assert len(inputs) == 2
    assert [line.get_label() for line in errors.lines] == ["x", "y (failed)"]
    np.testing.assert_allclose(errors.lines[1].get_ydata(), [100, 100])  # cm, while finite
    np.testing.assert_array_equal(inputs[1].lines[0].get_ydata()[:2], 1)


def test_rows_of_one_quantity_have_one_scale(log):
    wave = np.sin(np.arange(len(log.u)))[:, None] * [0.9, 0.5]
    strong = log.altered(u=wave)
    weak = log.altered(u=1e-3 * wave)
    alone = [tuple(compare([one], ["one"]).axes[1].get_ylim()) for one in (strong, weak)]
    assert alone[0] != alone[1]
    _, *inputs = compare([strong, weak], ["strong", "weak"]).axes
    scales = [(axes.get_yscale(), *axes.get_ylim()) for axes in inputs]
    assert scales[0] == scales[1]
    # an own channel, whose axis follows its numbers
    own = [
        log.altered(LogChannel("pull", units=("N",), values=size * np.sin(log.t)))
        for size in (1.0, 30.0)
    ]
    rows = [axes for axes in compare(own, ["a", "b"]).axes if axes.get_ylabel() == "pull (N)"]
    assert len(rows) == 2
    assert rows[0].get_ylim() == rows[1].get_ylim()
    assert rows[0].get_ylim()[1] > 30


def test_no_run_has_a_colour_of_tension():
    """In CIELAB, where 2.3 is just noticeable; formulas of CIE 15 and IEC 61966-2-1."""

    def lab(rgb):
        c = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
        f = (c @ np.array(to_xyz).T) / [0.9505, 1.0, 1.089]
        f = np.where(f > 216 / 24389, np.cbrt(f), (24389 / 27 * f + 16) / 116)
        x, y, z = f.T
        return np.stack((116 * y - 16, 500 * (x - y), 200 * (y - z)), axis=-1)

    runs = lab(np.array([to_rgb(colour) for colour in COLOURS]))
    tensions = lab(np.array([tension_colour(part) for part in np.linspace(-1, 1, 201) ** 3]))
    assert np.linalg.norm(runs[:, None] - tensions, axis=2).min() > 40
    apart = np.linalg.norm(runs[:, None] - runs, axis=2)[np.triu_indices(len(runs), 1)]
    assert apart.min() > 30


@pytest.mark.parametrize("arguments", [
    ("a.npz",), ("a.npz", "--plot", "no/folder/p.png"), ("a.npz", "--plot", "p.txt"),
    ("missing.npz", "--html", "p.html"), ("a.npz", "--html", "no/folder/p.html"),
    ("a.npz", "--labels", "x", "y", "--html", "p.html"),
    ("a.npz", "--robot", "spirob", "--html", "p.html"),
])  # fmt: skip
def test_replay_s_bad_input_is_one_line(call, log, tmp_path, arguments):
    log.save("a.npz")
    code, out, err = call("replay", *arguments)
    assert (code, out) == (2, "")
    assert re.fullmatch(r"error: .* expected .*, got .*\n", err)
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]


def test_run_writes_its_replay_and_shows_it_live(call, tmp_path, monkeypatch):
    """Without a browser the live loop does not wait, keeps its pace and reports its frames."""
    monkeypatch.setattr("softdyn.validation.live.watching.WAIT", 0.0)
    common = ("finger", "ic", "--theta", "0.5", "--duration", "0.5", "--json", "-")
    code, plain, _ = call("run", *common, "--html", "run.html")
    assert code in (0, 1)
    assert (tmp_path / "run.html").stat().st_size > 8e5
    code, out, err = call("run", *common, "--view", "--no-open", "--speed", "5")
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\?token=\S+\n", err)
    shown, plain = json.loads(out), json.loads(plain)
    viewer = shown.pop("viewer")
    # 40 a second of the clock, which is slower where the machine is
    assert 2 <= viewer["frames"] <= 40 * 0.5 / viewer["pace"] + 2
    assert viewer["wake_us"]["p99"] >= viewer["wake_us"]["median"] >= 0
    assert 0 < viewer["pace"] < 6
    for report in (shown, plain):  # the machine's
        del report["step_us"], report["missed_deadlines"]
    assert shown == plain


def test_view_writes_a_page(call, tmp_path):
    assert call("view", "finger", "--html", "rest.html") == (0, "rest.html\n", "")
    assert '"loop":true' in (tmp_path / "rest.html").read_text()
    code, _, err = call("view", "nobody")
    assert code == 2
    assert err.count("\n") == 1


def test_a_log_saved_and_loaded_is_the_same_page(model, log, tmp_path):
    log.save(tmp_path / "a.npz")
    assert replay(Log.load(tmp_path / "a.npz"), model).html("x") == replay(log, model).html("x")
