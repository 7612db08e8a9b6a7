from __future__ import annotations

import numpy as np
import pytest

from softdyn.validation.bench.clock import Deadlines, TimeSource
from tests.support.bench import Hands


@pytest.fixture
def hands():
    return Hands()


@pytest.fixture
def clock(hands):
    return Deadlines(0.01, hands.source)


def test_lateness_never_adds_up(hands, clock):
    for k in range(50):
        assert clock.wait() == 0
        assert hands.time == pytest.approx(clock.begin + 0.01 * k)
        hands.pass_(0.003 + 0.0001 * (k % 7))
    assert (clock.missed, clock.in_a_row) == (0, 0)


def test_periods_are_late_from_the_first_one_on(hands):
    def now():
        hands.pass_(2e-5)  # a reading takes its time, and the first period begins late, too
        return hands.time

    clock, begun = Deadlines(0.01, TimeSource(now, hands.source.sleep)), []
    for _ in range(9):
        clock.wait()
        begun.append(hands.time)
    late = np.array(begun) - begun[0] - 0.01 * np.arange(9)
    assert clock.begin == begun[0]
    assert late.min() >= 0.0
    assert clock.late == pytest.approx(late[-1])


@pytest.mark.parametrize(
    ("work", "left_out", "missed", "late"),
    [(0.009, 0, 0, 0.0), (0.013, 0, 1, 0.003), (0.017, 1, 1, 0.0), (0.032, 2, 3, 0.002),
     (0.038, 3, 3, 0.0)],
)  # fmt: skip
def test_a_long_step_is_a_miss(hands, clock, work, left_out, missed, late):
    clock.wait()
    hands.pass_(work)
    assert clock.wait() == left_out
    assert clock.missed == clock.in_a_row == missed
    assert clock.late == pytest.approx(late)
    hands.pass_(0.001)
    assert clock.wait() == 0
    assert clock.missed == missed
    assert clock.in_a_row == 0
    assert hands.time == pytest.approx(clock.at(left_out + 2))


def test_a_system_that_wakes_too_late_is_a_miss():
    hands = Hands()
    clock = Deadlines(0.01, hands.source)
    clock.wait()
    hands.source.sleep(0.002)
    clock._sleep = lambda seconds: hands.pass_(seconds + 0.025)
    assert clock.wait() == 2
    assert clock.missed == 2
    assert clock.late == pytest.approx(0.005)
