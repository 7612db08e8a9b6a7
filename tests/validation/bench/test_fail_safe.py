"""The newest readings, the bounds of tensions, and the time of an estimate, without a loop."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import softdyn
from softdyn.description.rig import Actuator
from softdyn.validation.bench.driver import NewestReadings
from softdyn.validation.bench.fail_safe import FailSafe, RigLimits, Stop, StopCause
from softdyn.validation.bench.plant import SOONEST, SeeingObserver
from tests.support.bench import bench_arm

NAN = math.nan


@pytest.fixture(scope="module")
def model():
    return bench_arm()


def test_a_repeated_stamp_and_a_value_that_is_not_finite_bring_no_reading():
    read = NewestReadings(3)
    read.take([1.0, 2.0, 3.0], [5.0, 5.0, NAN], 5.0)
    np.testing.assert_array_equal(read.new, [1.0, 2.0, NAN])
    read.take([9.0, 9.0, 9.0], [5.0, 4.0, 5.5], 6.0)  # the same stamp, an older one, a first one
    np.testing.assert_array_equal(read.new, [NAN, NAN, 9.0])
    np.testing.assert_array_equal(read.values, [1.0, 2.0, 9.0])
    np.testing.assert_array_equal(read.stamps, [5.0, 5.0, 5.5])
    read.take([math.inf, -math.inf, 8.0], [7.0, 7.0, 7.0], 7.0)
    np.testing.assert_array_equal(read.new, [NAN, NAN, 8.0])
    np.testing.assert_array_equal(read.stamps, [5.0, 5.0, 7.0])


@pytest.mark.parametrize("bias", [0.0, 4.0, -4.0])
def test_the_bound_of_a_tension_is_that_of_all_motors_of_its_tendon(model, bias):
    """60 N of one motor and 2 times 10 N of another, 5 % and 6 deviations of 0.5 N more."""
    more = Actuator("uc", "b", -2.0, -10.0, 5.0)
    robot = replace(
        model.robot, actuators=(*model.robot.actuators, more),
        sensors=tuple(
            replace(s, bias=(bias,)) if s.name == "load" else s for s in model.robot.sensors
        ),
    )  # fmt: skip
    safe = FailSafe(softdyn.build(robot), RigLimits(), 0.005)
    bound = 80.0 * 1.05 + 3.0 + bias
    for tension in (bound - 0.01, bound + 0.01):
        read = NewestReadings(6)
        read.take([0.0, 0.0, tension, 0.0, 0.0, 0.0], np.ones(6), 1.0)
        if tension < bound:
            safe.readings(read, 1.0)
        else:
            with pytest.raises(Stop) as stopped:
                safe.readings(read, 1.0)
            assert stopped.value.cause is StopCause.TENSION


def test_the_estimate_of_a_late_step_is_of_its_newest_reading(model):
    """The period begins at 100.02 s; a reading of 100.0234 s came before the step was late."""
    read, times = NewestReadings(6), []

    def step(t, measurements, u, stamps, sent):
        times.append((t, stamps[0], sent))
        return SimpleNamespace(q=np.zeros(2), v=np.zeros(2))

    rig = SimpleNamespace(read=read, begin=100.0, time=0.02, sent_at=100.016, pose=np.zeros(2))
    seeing = SeeingObserver(SimpleNamespace(step=step), rig, FailSafe(model, RigLimits(), 0.005))
    read.take(np.zeros(6), np.full(6, 100.018), 100.0201)  # in time: of the period's begin
    seeing.step(0.02, read.new, np.zeros(2))
    rig.time = 0.025
    read.take(np.zeros(6), np.append(np.full(5, 100.0282), 100.0234), 100.0285)
    seeing.step(0.025, read.new, np.zeros(2))
    seeing.step(0.025, read.new, np.zeros(2))  # never twice at one time
    found = np.array(times)
    assert found[:, 0] == pytest.approx([0.02, 0.0282, 0.0282 + SOONEST], abs=1e-9)
    assert found[:, 1] == pytest.approx([0.018, 0.0282, 0.0282], abs=1e-9)
    assert found[:, 2] == pytest.approx([0.016] * 3, abs=1e-9)
