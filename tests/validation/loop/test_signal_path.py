"""The signal path between plant and controller: delay, noise, lag of the actuators."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from softdyn import Reference, SetPoint
from softdyn.controllers import Command, Status
from softdyn.validation.loop.signal_path import SignalPath
from tests.support.control_cases import robot


class Counting:
    def __init__(self) -> None:
        self.calls = 0
        self.seen: list[np.ndarray] = []
        self.period = 0.1

    def reset(self, period: float) -> None:
        self.period = period

    def __call__(self, state: Any, reference: Reference) -> Command:
        self.calls += 1
        self.seen.append(state.y)
        return Command(np.full(2, float(self.calls)))


def test_delay_and_noise() -> None:
    model, inner = robot("finger"), Counting()
    state = model.state(model.q0, np.zeros(model.nv))
    late = SignalPath(delay=0.01, noise=0.001, seed=1).around(inner, 0.005)
    late.reset(0.005)
    assert inner.period == 0.005
    answers = [late(state, SetPoint(state.y)).u[0] for _ in range(200)]
    assert answers == [1.0, 1.0, *range(1, 199)]
    seen = np.array(inner.seen) - state.y
    assert np.std(seen) == pytest.approx(0.001, rel=0.15)


def test_actuators_lag() -> None:
    model, inner = robot("finger"), Counting()
    state = model.state(model.q0, np.zeros(model.nv))
    late = SignalPath(lag=0.01).around(inner, 0.005)
    late.reset(0.005)
    assert inner.period == 0.005
    acts, dt = 0.0, 1e-6
    for k in range(3):  # the acting input follows the command, by small Euler steps
        inner.calls, mean = 0, 0.0  # each command is (1, 1)
        for _ in range(5000):
            mean += acts / 5000
            acts += dt / 0.01 * (1.0 - acts)
        command = late(state, SetPoint(state.y))
        assert command.u == pytest.approx(mean, abs=2e-4), k
        assert command.status is Status.OK
