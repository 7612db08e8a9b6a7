"""Names, rows and units of readings, and the times of a sensor."""

from __future__ import annotations

import copy
import pickle
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softdyn import InputError
from softdyn.description.readings import ReadingLayout, SampledSensor
from softdyn.description.rig import Sensor, SensorKind
from tests.support.robots import build, cable, joint, link, robot

KIND = SensorKind
SENSORS = (
    Sensor("cable", KIND.LENGTH, tendon="cable", noise=(2.0,), rate=100.0),
    Sensor("mark", KIND.POSE, link="tip", noise=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)),
    Sensor("imu", KIND.GYRO, link="tip", noise=(0.5,)),
    Sensor("slide", KIND.JOINT, joint="x"),
    Sensor("pull", KIND.TENSION, tendon="sum"),
)
ROBOT = robot(
    "r", link("world"), link("a", 1), link("tip", 1),
    joint("x", "world", "a", "1 0 0", "prismatic"),
    joint("turn", "a", "tip", at="0.1 0 0"),
    block=(
        cable("cable", "world 0 0 0.1", "tip 0.1 0 0.1", stiffness=1),
        cable("sum", "turn 1", stiffness=1),
    ),
)  # fmt: skip


def test_the_rows_of_five_sensors() -> None:
    """Written down by hand, by docs/format.md."""
    layout = ReadingLayout(SENSORS)
    assert layout.names == (
        "cable", "mark.x", "mark.y", "mark.z", "mark.rx", "mark.ry", "mark.rz",
        "imu.x", "imu.y", "imu.z", "slide", "pull",
    )  # fmt: skip
    assert layout.size == 12
    assert layout.slices == (slice(0, 1), slice(1, 7), slice(7, 10), slice(10, 11), slice(11, 12))
    assert layout.rows["imu"] == slice(7, 10)
    assert layout.rotations == (4,)
    np.testing.assert_array_equal(layout.owners, [0, *6 * [1], *3 * [2], 3, 4])
    np.testing.assert_array_equal(layout.field("noise"), [2, 1, 2, 3, 4, 5, 6, 0.5, 0.5, 0.5, 0, 0])
    np.testing.assert_array_equal(layout.field("rate"), [100, *11 * [0]])
    for other in (copy.deepcopy(layout), pickle.loads(pickle.dumps(layout))):
        assert other == layout
        assert other.rows == layout.rows


def test_the_units_of_readings_on_a_robot() -> None:
    """A joint that slides reads metres, a tendon that sums angles pulls with a torque."""
    model = build(ROBOT)
    turning = Sensor("turning", KIND.JOINT, joint="turn")
    force = Sensor("force", KIND.TENSION, tendon="cable")
    angle = Sensor("angle", KIND.LENGTH, tendon="sum")
    imu = Sensor("imu", KIND.ACCELEROMETER, link="tip")
    units = ReadingLayout((*SENSORS, turning, force, angle, imu)).units(model.robot)
    assert units == (
        "m", "m", "m", "m", "rad", "rad", "rad", "rad/s", "rad/s", "rad/s", "m", "N m",
        "rad", "N", "rad", "m/s²", "m/s²", "m/s²",
    )  # fmt: skip


def test_no_sensors_have_no_rows() -> None:
    layout = ReadingLayout(())
    assert layout.names == layout.slices == layout.rotations == ()
    assert layout.owners.shape == layout.field("noise").shape == (0,)


@pytest.mark.parametrize("kind", KIND, ids=lambda kind: kind.value)
def test_the_form_of_every_kind_is_complete(kind) -> None:
    """One name and one quantity for each component; the part that it is on is a field."""
    form = kind.form
    assert len(form.suffixes) == len(form.quantities) == kind.size
    assert form.place[0] in ("tendon", "link", "joint")
    assert all(hasattr(Sensor("s", kind), name) for name in form.place)
    assert form.rotation is None or form.suffixes[form.rotation :] == (".rx", ".ry", ".rz")
    assert not (form.of_place and form.feels_inputs)


@given(
    rate=st.sampled_from([2, 5, 8, 20, 40, 100, 125, 250, 500, 1000]),
    steps=st.integers(0, 4000), latency=st.integers(0, 200), period=st.sampled_from([1, 2, 5]),
)  # fmt: skip
def test_sampled_times_are_those_of_exact_arithmetic(rate, steps, latency, period) -> None:
    """Rational numbers say which sample is there; times that are sums of steps are rounded."""
    times = SampledSensor(float(rate), latency / 1e3)
    t = np.cumsum([0.0, *[period / 1e3] * steps])[-1]
    exact = (Fraction(steps * period - latency, 1000) * rate).__floor__()
    assert times.number(float(t)) == exact
    assert times.own_time(float(t)) == pytest.approx(exact / rate)
    assert times.period == pytest.approx(1 / rate)
    assert times.oldest == pytest.approx(1 / rate + latency / 1e3)


def test_a_sensor_without_a_rate_reads_at_every_time() -> None:
    times = SampledSensor(0.0, 0.02)
    assert times.own_time(1.25) == pytest.approx(1.23)
    assert (times.period, times.oldest) == (0.0, 0.02)
    assert not times.holds(1.0)


def test_readings_are_held_if_steps_are_shorter_than_the_interval() -> None:
    times = SampledSensor(100.0)
    assert times.holds(0.005)
    assert not times.holds(0.01)
    assert not times.holds(float(np.median(np.diff(0.01 * np.arange(1000)))))


@pytest.mark.parametrize("wrong", [{"rate": -1.0}, {"rate": 1e10}, {"latency": 11.0}], ids=str)
def test_times_out_of_range_are_refused(wrong) -> None:
    with pytest.raises(InputError) as caught:
        SampledSensor.of(Sensor("s", KIND.GYRO, link="tip", **wrong))
    assert caught.value.name == f"sensor 's': {next(iter(wrong))}"
