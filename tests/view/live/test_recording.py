"""A recording of frames: it begins at 0, has one run, and ends where it is full."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from softdyn.view.live import recording
from softdyn.view.live.recording import Recording

PULL = [1, 2, 3, 4, 5, 6]  # force and point


def frame(*values):
    return np.array(values, "<f4").tobytes()


@pytest.fixture
def made():
    return Recording(pickle.dumps(None), 2, "robot")


def test_a_recording_begins_at_zero_with_the_columns_of_a_replay_and_of_a_pull(made):
    assert not made.add(frame(1, 2, 3))
    assert not made.end()  # it was not on
    made.begin()
    for t in (10.0, 10.5, 10.5, 12.0):  # a robot that stands still shows one frame again
        made.add(frame(t, 2 * t, *PULL, 9))
    assert made.end()
    assert made._done.tolist() == [
        [0.0, 20.0, *PULL], [0.5, 21.0, *PULL], [2.0, 24.0, *PULL]
    ]  # fmt: skip
    assert not made.add(frame(13, 2, 3))


def test_a_reset_begins_another_run(made):
    made.begin()
    for t in (3.0, 4.0, 0.25, 0.5):
        made.add(frame(t, t))
    made.end()
    assert made._done.tolist() == [[0.0, 0.25], [0.25, 0.5]]


def test_a_full_recording_says_so(made, monkeypatch):
    monkeypatch.setattr(recording, "MOST", 3)
    made.begin()
    assert [made.add(frame(t, t)) for t in (1, 2, 3)] == [False, False, True]
