"""Channels that a controller of one's own declares: one file names them, every view shows them."""

from __future__ import annotations

import base64
import json
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader

import softdyn
from softdyn import InputError, SetPoint
from softdyn.controllers import Command, Compensated, JointLimits, LogChannel, SafetyFilter
from softdyn.validation import Log, simulate
from softdyn.validation.bench.drive import Drive
from softdyn.validation.loop.mcap_file import save_mcap
from tests.support.bench import NearDriver, bench_arm, tower
from tests.support.cart import TARGET, steer
from tests.support.command import command
from tests.support.refused import refused

OPTIONS = {"duration": 0.3, "period": 0.01}
# the only file that names the channels
SLIDING = """
import numpy as np
from softdyn.controllers import Command, LogChannel


class Sliding:
    channels = (
        LogChannel("surface", units=("m/s",)),
        LogChannel.of("parts", [("p", "m"), ("d", "m/s")]),
        LogChannel("phase", text=True),
    )

    def __init__(self, model):
        self.model = model

    def __call__(self, state, reference):
        error = np.linalg.norm(reference.y - state.y)
        speed = np.linalg.norm(state.ydot)
        u = np.clip(np.zeros(self.model.nu), self.model.u_min, self.model.u_max)
        values = {"surface": 5 * error - speed, "parts": [error, speed]}
        return Command(u, values=values | {"phase": "far" if error > 0.05 else "near"})
"""


class Steering:
    """The cart's controller, which tells its error, its force, and every second mode."""

    channels = (
        LogChannel.of("parts", [("error", "m"), ("force", "N")]),
        LogChannel("mode", text=True),
        LogChannel("seldom", units=("s",), gaps=True),
    )

    def __init__(self):
        self.told = []

    def __call__(self, state, reference):
        u = steer(state, reference).u
        k = len(self.told)
        self.told.append((float(state.y[0] - reference.y[0]), float(u[0])))
        values = {"parts": self.told[-1], "mode": f"mode {k}"}
        return Command(u, values=values | ({"seldom": 0.5 * k} if k % 2 else {}))


@pytest.fixture
def run(cart):
    law = Steering()
    return law, simulate(cart, law, TARGET, **OPTIONS)


def test_what_a_controller_tells_is_in_its_log(run):
    law, log = run
    np.testing.assert_array_equal(log["parts"], law.told)
    assert log["mode"].tolist() == [f"mode {k}" for k in range(log.steps)]
    expected = [0.5 * k if k % 2 else np.nan for k in range(log.steps)]
    np.testing.assert_array_equal(log["seldom"], expected)
    assert log.columns("parts") == (("error", "m"), ("force", "N"))
    assert "parts" in log
    np.testing.assert_array_equal(log.parts, log["parts"])


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_they_come_back_from_files(run, tmp_path, suffix):
    _, log = run
    file = tmp_path / f"run.{suffix}"
    log.save(file) if suffix == "npz" else log.to_csv(file)
    again = Log.load(file) if suffix == "npz" else Log.from_csv(file)
    for name in ("parts", "mode", "seldom"):
        np.testing.assert_array_equal(again[name], log[name])
        assert again.channels[name].titles == log.channels[name].titles


def test_a_figure_has_a_panel_for_each_with_numbers(run):
    _, log = run
    labels = [axes.get_ylabel() for axes in log.plot().axes]
    assert labels[2:] == ["parts (m, N)", "seldom (s)"]
    lines = log.plot().axes[2].lines
    assert [line.get_label() for line in lines] == ["parts.error (m)", "parts.force (N)"]
    np.testing.assert_array_equal(lines[1].get_ydata()[:-1], log["parts"][:, 1])


def test_one_file_is_enough_for_all_views(tmp_path):
    """The command line: a log, a table and a page, all with the channels of the user's file."""
    (tmp_path / "sliding.py").write_text(SLIDING)
    for name in ("run.npz", "run.csv"):
        command(
            "run", "finger", f"{tmp_path / 'sliding.py'}:Sliding", "--theta", "0.5", "--duration",
            "0.1", "--log", str(tmp_path / name), "--html", str(tmp_path / "run.html"),
            "--no-verdict",
        )  # fmt: skip
    log = Log.load(tmp_path / "run.npz")
    error = np.linalg.norm(log.error[:-1], axis=1)
    np.testing.assert_allclose(log["parts"][:, 0], error, atol=1e-12)
    np.testing.assert_allclose(log["surface"], 5 * error - log["parts"][:, 1], atol=1e-12)
    header = (tmp_path / "run.csv").read_text().partition("\n")[0]
    assert "surface (m/s),parts.p (m),parts.d (m/s),phase," in header
    page = (tmp_path / "run.html").read_text()
    scene = json.loads(page.partition('id="scene">')[2].partition("</script>")[0])
    (track,) = scene["runs"][0]["tracks"]
    titles = [one["titles"] for one in track["series"]]
    assert titles == [["surface (m/s)"], ["parts.p (m)", "parts.d (m/s)"], ["phase"]]
    shown = np.frombuffer(base64.b64decode(track["series"][0]["values"]), "<f4")
    np.testing.assert_allclose(shown[[0, -1]], log["surface"][[0, -1]], rtol=1e-6)
    assert track["series"][2]["values"] == ["far"] * len(shown)
    save_mcap(tmp_path / "run.mcap", log)
    with (tmp_path / "run.mcap").open("rb") as file:
        told = [json.loads(m.data) for _, c, m in make_reader(file).iter_messages(["/parts"])]
    np.testing.assert_allclose([row["d"] for row in told], log["parts"][:, 1], rtol=1e-7)


@pytest.mark.parametrize("wrap", ["filter", "compensated"])
def test_a_controller_inside_another_still_tells(cart, wrap):
    law = Steering()
    outer = (
        SafetyFilter(law, cart, [JointLimits(cart)]) if wrap == "filter" else Compensated(law, cart)
    )
    log = simulate(cart, outer, TARGET, **OPTIONS)
    np.testing.assert_array_equal(log["parts"], law.told)


TWO = (LogChannel("a"), LogChannel.of("b", [("x", ""), ("y", "")]))


def telling(values, channels=TWO):
    def law(state, reference):
        return Command(steer(state, reference).u, values=values)

    law.channels = channels
    return law


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"c": 1.0}, "values of a command"), ({"b": [1.0]}, "b"), ({"a": "far"}, "a"),
        ({"a": [1.0]}, "a"), ([1.0], "values of a command"),
    ],
)  # fmt: skip
def test_values_that_were_not_declared_are_one_line(cart, values, named):
    with pytest.raises(InputError) as caught:
        simulate(cart, telling(values), TARGET, **OPTIONS)
    assert named in caught.value.name
    assert "\n" not in str(caught.value)
    assert caught.value.log.steps == 0


@pytest.mark.parametrize(
    "channels",
    [
        "a", (1,), (LogChannel("a"), LogChannel("a")), (LogChannel("t"),), (LogChannel("u"),),
        (LogChannel("measured"),), (LogChannel("robot"),), (LogChannel("summary"),),
        (LogChannel("a b"),), (LogChannel("_a"),), (LogChannel("log"),),
        (LogChannel.of("tip", [("x", "m")]),), (LogChannel("a", units=("m", "m")),),
        (LogChannel.of("a", [("x", "m"), ("x", "m")]),), (LogChannel("a", units=(1,)),),
    ],
)  # fmt: skip
def test_channels_that_no_log_can_have_are_refused_before_the_run(cart, channels):
    with pytest.raises(InputError) as caught:
        simulate(cart, telling({}, channels), TARGET, **OPTIONS)
    assert "channels" in caught.value.name
    assert not hasattr(caught.value, "log")


def test_a_value_may_be_missing_or_not_finite(cart):
    log = simulate(cart, telling({"a": np.inf}), TARGET, **OPTIONS)
    assert np.isinf(log["a"]).all()
    assert np.isnan(log["b"]).all()
    log.plot()


def test_an_answer_without_declared_channels_may_have_any_values(cart):
    class Answer:
        u, values = np.zeros(1), 7

    assert simulate(cart, lambda *_: Answer, TARGET, **OPTIONS).complete


def test_a_channel_named_as_a_topic_of_the_viewers_keeps_it_free(tmp_path):
    model = softdyn.load("finger")

    def law(state, reference):
        return Command(np.zeros(model.nu), values={"tf": 1.0})

    law.channels = (LogChannel("tf"),)
    log = simulate(model, law, SetPoint([0.1, 0.0, -0.1]), duration=0.02)
    save_mcap(tmp_path / "run.mcap", log)
    with (tmp_path / "run.mcap").open("rb") as file:
        topics = {channel.topic for _, channel, _ in make_reader(file).iter_messages()}
    assert {"/tf", "/channels/tf"} <= topics


def test_no_such_channel_is_one_line_that_lists_them(run):
    _, log = run
    with refused("a channel of the log", "'party'"):
        log["party"]
    with pytest.raises(AttributeError):
        log.party  # noqa: B018
    cut = replace(log, channels={name: log.channels[name] for name in list(log)[:-1]})
    assert "seldom" not in cut


def test_on_a_rig_a_period_that_is_left_out_repeats_the_last_values():
    model = bench_arm()
    rig = tower(model)

    def law(state, reference):
        law.calls += 1
        return Command(np.array([2.0, 1.0]), values={"calls": law.calls, "side": f"{law.calls}"})

    law.calls, law.channels = 0, (LogChannel("calls"), LogChannel("side", text=True))
    drive = Drive(
        model, law, SetPoint(np.zeros(3)), NearDriver(model), period=0.005, duration=0.1,
        watchdog=False, source=rig.hands.source,
    )  # fmt: skip
    log = drive.run(on_step=lambda step: rig.hands.pass_(0.012 * (0.028 < step.t < 0.032))).log
    left_out = np.array([status == "left out" for status in log.status])
    assert left_out.any()
    calls = log["calls"]
    np.testing.assert_array_equal(np.diff(calls), 1.0 - left_out[1:])
    assert log["side"].tolist() == [f"{call:.0f}" for call in calls]
