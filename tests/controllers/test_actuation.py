"""The way of a command to the plant as a controller knows it."""

from __future__ import annotations

import numpy as np
import pytest

import softdyn
from softdyn.controllers.controller import KnownRig
from softdyn.controllers.predictive.actuation import Actuation


@pytest.mark.parametrize(("delay", "lag"), [(0.0, 0.01), (0.0052, 0.0), (0.0117, 0.02)])
def test_inputs_arrive_after_the_delay_and_lag_behind_by_fine_steps_of_euler(
    delay: float, lag: float
) -> None:
    period, fine, count = 0.005, 1e-6, 6
    commands = np.random.default_rng(0).normal(size=(count, 2))
    path = Actuation(delay, lag)
    path.reset(period, np.zeros(2))
    acts, steps = np.zeros(2), round(period / fine)
    for k in range(count):
        # the mean that a controller expects over the delay is the one that comes to pass
        promised, _ = path.over_delay(period)
        mean = np.zeros(2)
        for i in range(steps):
            sent = (k * steps + i + 0.5) * fine - delay
            command = commands[int(sent / period)] if sent > 0 else np.zeros(2)
            acts = acts + fine / lag * (command - acts) if lag else command
            mean += acts / steps
        np.testing.assert_allclose(path.send(commands[k]), mean, atol=2e-3)
        np.testing.assert_allclose(path.acting, acts, atol=2e-3)
        assert promised.shape == (int(np.ceil(delay / period)), 2)


@pytest.mark.parametrize("lag", [0.0, 0.015])
def test_a_command_for_an_input_brings_it_there(lag: float) -> None:
    path, wanted = Actuation(0.0, lag), np.array([1.0, -2.0])
    path.reset(0.004, np.array([0.3, 0.1]))
    path.send(path.command_for(wanted, path.acting))
    np.testing.assert_allclose(path.acting, wanted)


@pytest.mark.parametrize(("delay", "lag"), [(0.0, 0.0), (0.0, 0.02), (0.012, 0.02)])
def test_a_command_that_was_sent_instead_counts(delay: float, lag: float) -> None:
    one, two = Actuation(delay, lag), Actuation(delay, lag)
    rng = np.random.default_rng(5)
    for link in (one, two):
        link.reset(0.005, np.zeros(2))
    for _ in range(5):
        asked, sent = rng.normal(size=(2, 2))
        one.send(asked)
        np.testing.assert_array_equal(one.send_instead(sent), two.send(sent))
        np.testing.assert_array_equal(one.acting, two.acting)


def test_a_rig_gives_what_nobody_gave_and_the_file_the_rest() -> None:
    model = softdyn.load("finger")  # its file has no delay and no lag
    rig = KnownRig(lag=0.02, delay=0.01)
    for given, wanted in (({}, (0.01, 0.02)), ({"lag": 0.05}, (0.01, 0.05)),
                          ({"delay": 0.0}, (0.0, 0.02))):  # fmt: skip
        path = Actuation.of(model, rig=rig, **given)
        assert (path.delay, path.lag) == wanted
    path = Actuation.of(model)
    assert (path.delay, path.lag) == (0.0, 0.0)
