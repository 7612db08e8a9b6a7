"""Motors with delay, bounded rate and lag over steps of any length, against fine integration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn.actuation.drives import Drives
from softdyn.description.rig import CommandKind

FINE = 1e-5
SENT = [(0.0, 0.4), (0.01, -0.7), (0.02, 0.2), (0.03, 0.9), (0.04, 0.9)]


@pytest.mark.parametrize("lag", [0.0, 0.013])
@pytest.mark.parametrize("delay", [0.0, 0.0123])
@pytest.mark.parametrize("rate", [np.inf, 40.0])
@pytest.mark.parametrize("speed", [False, True])
def test_means_over_uneven_steps(lag, delay, rate, speed):
    """One motor has these values; the other acts at once."""
    model = softdyn.load("finger")
    first, second = model.robot.actuators
    changes = {"lag": lag, "delay": delay, "rate": rate}
    if speed:
        changes |= {
            "command": CommandKind.VELOCITY, "stiffness": 1e3, "gear": -1.0, "lower": 0.0,
        }  # fmt: skip
    model = softdyn.build(replace(model.robot, actuators=(replace(first, **changes), second)))
    drives = Drives.of(model)
    state = model.state(model.q0, np.zeros(4))
    drives.reset(state, np.zeros(2), 0.0)
    free = drives._free[0]
    limited = acting = 0.0
    for k, (begin, command) in enumerate(SENT):
        drives.send(begin, np.array([command, command]))
        for at, end in ((begin, begin + 0.0037), (begin + 0.0037, begin + 0.01)):
            means = drives.over(at, end)
            assert means[1] == pytest.approx(command, abs=1e-12)
            total = 0.0
            for t in np.arange(at + FINE / 2, end, FINE):
                target = next((c for s, c in SENT[k::-1] if s + delay <= t), 0.0)
                limited += np.clip(target - limited, -rate * FINE, rate * FINE)
                kept = np.exp(-FINE / lag) if lag else 0.0
                acting = kept * acting + (1 - kept) * limited
                free += speed * acting * FINE
                total += (free if speed else acting) * FINE
            exact = total / (end - at)
            # a bounded rate is taken at its middle, and a free length at the middle of its way
            coarse = 0.06 if np.isfinite(rate) else 2e-3
            assert means[0] == pytest.approx(exact, abs=coarse)
    assert len(drives._sent) <= 3


def test_commands_are_forgotten_where_every_step_is_a_gap():
    """No span is predicted over a gap, and the commands of long ago are still dropped."""
    model = softdyn.load("finger")
    actuators = tuple(replace(one, delay=0.02) for one in model.robot.actuators)
    model = softdyn.build(replace(model.robot, actuators=actuators))
    drives = Drives.of(model)
    drives.reset(model.state(model.q0, np.zeros(4)), np.zeros(2), 0.0)
    for k in range(100):
        drives.send(float(k), np.full(2, k / 100))
    assert len(drives._sent) <= 3
    assert drives.over(99.0, 99.01) == pytest.approx(0.98)  # sent 20 ms before


@pytest.mark.parametrize("delay", [0.0, 0.004])
def test_commands_that_are_sent_within_a_span(delay):
    """The commands before them act until then."""
    drives = Drives(np.zeros(2), np.full(2, delay), np.full(2, np.inf))
    drives.begin(np.array([1.0, 2.0]), 0.0)
    drives.send(0.0 if delay else 0.004, np.array([3.0, -2.0]))
    assert drives.over(0.0, 0.01) == pytest.approx([2.2, -0.4])
    assert drives.over(0.01, 0.02) == pytest.approx([3.0, -2.0])
