"""Times of an observer's step: the steps that are timed, and the command. No time is judged."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import softdyn
from softdyn.controllers import SoftIdClfQp
from softdyn.validation import Rig
from tests.proof import observer_time
from tests.proof.observer_time import observed_loop, observer_row
from tests.proof.timing.step_time import WARM_UP
from tests.support.command import proof
from tests.support.sensed import sensors

OWN = """
class Slow:
    def __init__(self, model):
        self.model = model

class Observer(Slow):
    def step(self, t, measurements, u):
        return None
"""


class Recorder:
    """It takes 2 ms by its clock when a late reading arrives, and 1 µs otherwise."""

    def __init__(self, clock):
        self.taken, self.clock = [], clock

    def step(self, t, measurements, u):
        self.taken.append((t, measurements, u))
        camera = [z[2:] for _, z, _ in self.taken[-2:]]
        late = len(camera) == 2 and not np.array_equal(*camera)
        self.clock.append(2_000_000 if late else 1_000)


@pytest.fixture(scope="module")
def loop():
    model = softdyn.load("finger")
    rig = Rig(sensors=sensors(model, rate=60.0, latency=0.03), seed=0)
    return observed_loop(model, SoftIdClfQp, rig, duration=0.6)


def test_steps_are_those_of_the_loop(loop):
    assert [t for t, *_ in loop.steps] == pytest.approx(loop.period * np.arange(len(loop.steps)))
    own = [math.floor((k * loop.period - 0.03) * 60 + 1e-3) for k in range(120)]
    expected = [k for k in range(1, 120) if own[k] > max(own[k - 1], -1)]
    assert expected == list(np.flatnonzero(loop.late))
    for k in expected[1:]:  # a new picture arrives; the first one was shown before
        assert not np.array_equal(loop.steps[k][1][2:], loop.steps[k - 1][1][2:])
    assert not np.array_equal(loop.steps[40][2], loop.steps[41][2])  # commands vary


def test_late_steps_have_their_own_times(loop, monkeypatch):
    clock = []
    monkeypatch.setattr(observer_time, "perf_counter_ns", lambda: sum(clock))
    observers = [Recorder(clock), Recorder(clock)]
    row = observer_row("finger", softdyn.load("finger"), observers, loop)
    assert row["samples"] == 2 * (len(loop.steps) - WARM_UP)
    assert row["late_samples"] == 2 * loop.late[WARM_UP:].sum() > 0
    assert row["late_median_us"] == pytest.approx(2000)
    assert row["median_us"] == pytest.approx(1)
    assert row["median_us"] <= row["p99_us"] <= row["p999_us"]


def test_the_command(tmp_path):
    asked = ["--robots", "finger", "--rounds", "1", "--json", "-"]
    (tmp_path / "own.py").write_text(OWN)
    own, joints = f"{tmp_path}/own.py:Observer", ["--sensors", "joints=0.001"]
    done = proof("observer-time", *asked, "--observer", own, *joints)
    (row,) = json.loads(done.out)["rows"]
    assert (row["readings"], row["late_samples"], row["late_median_us"]) == (4, 0, None)
    for words, expected in (
        (["--observer", f"{tmp_path}/own.py:Slow"], "observer: expected an object with step"),
        (["--observer", "wind"], "disturbances: expected tip_force"),
        (["--sensors", "file"], "--sensors: expected a list, the file having none"),
    ):
        done = proof("observer-time", *asked, *words)
        assert done.code == 2
        assert expected in done.err
