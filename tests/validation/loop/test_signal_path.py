"""What stands between plant and controller: delay, noise, a lag of the actuators."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from softdyn import Reference, SetPoint
from softdyn.controllers import Command
from softdyn.controllers.predictive.actuation import Actuation
from softdyn.validation.loop.signal_path import SignalPath
from softdyn.validation.twin.twin import Twin
from tests.support.control_cases import robot


class Watching:
    """A controller that keeps the states that it sees."""

    def __init__(self) -> None:
        self.seen: list[Any] = []

    def __call__(self, state: Any, reference: Reference) -> Command:
        self.seen.append(state)
        return Command(np.zeros(2))


def test_noise_moves_the_tip_by_its_size_and_the_velocity_by_that_over_a_period() -> None:
    model, inner, period = robot("finger"), Watching(), 0.005
    state = model.state(model.q0, np.zeros(model.nv))
    noisy = SignalPath(noise=0.001, seed=1).around(inner, period)
    for _ in range(2000):
        noisy(state, SetPoint(state.y))
    moved = np.array([one.y - state.y for one in inner.seen])
    assert np.sqrt(np.mean(np.sum(moved**2, axis=1))) == pytest.approx(0.001, rel=0.05)
    q, v = (np.array([getattr(one, name) for one in inner.seen]) for name in "qv")
    np.testing.assert_allclose(np.std(v), np.std(q - state.q) / period, rtol=0.05)
    assert abs(np.corrcoef(q[:, 0], v[:, 0])[0, 1]) < 0.1
    assert SignalPath().around(inner, period) is inner


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


def test_the_plant_gets_the_delayed_input_in_the_middle_of_a_period() -> None:
    """5 ms of delay in periods of 7.5 ms: the input changes between two plant steps."""
    model = robot("finger")
    given: list[float] = []

    class Keeping(Twin):
        def advance(self, u: np.ndarray, steps: int = 1) -> None:
            given.extend([u[0]] * steps)
            super().advance(u, steps)

    plant = SignalPath(delay=0.005).between(Keeping)(model.robot, timestep=5e-4)
    for command in (-0.1, -0.2):
        plant.advance(np.full(2, command), 15)
    assert given == [0.0] * 10 + [-0.1] * 15 + [-0.2] * 5
    assert SignalPath(noise=1.0).between(Keeping) is Keeping
