"""The rig's data: an ideal robot keeps its text and digest, and every field of a rig counts."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from softdyn.description.rig import Actuator, CommandKind, Sensor, SensorKind
from softdyn.description.robot import PathEnd, driven_end, input_units
from softdyn.description.urdf import parse_text
from softdyn.description.urdf_writer import write
from softdyn.statics.suspicious_values import suspicious_values
from tests.support.misuses import ARM

ROBOT = parse_text(ARM, path=Path("arm.urdf"))
OTHER = {
    "command": CommandKind.LENGTH, "stiffness": 900.0, "damping": 2.0, "length_lower": 0.1,
    "length_upper": 0.2, "lag": 0.02, "rate": 3.0, "delay": 0.005,
    "offset": 0.01, "unit": "Pa", "area_growth": (0.5,), "area_length": 0.1,
}  # fmt: skip


def test_the_text_of_an_ideal_actuator_has_five_fields() -> None:
    actuator = Actuator("u", "t", -1.0, 0.0, 5.0)
    assert repr(actuator) == "Actuator(name='u', tendon='t', gear=-1.0, lower=0.0, upper=5.0)"
    assert actuator.is_ideal
    assert not actuator.is_winch


def test_every_other_field_is_in_the_text_and_in_the_digest() -> None:
    assert [field.name for field in fields(Actuator)][5:] == list(OTHER)
    ideal = ROBOT.actuators[1]
    digests = {ROBOT.digest}
    for name, value in OTHER.items():
        changed = replace(ideal, **{name: value})
        assert f", {name}={value!r})" in repr(changed)
        # a chamber's pressure may act at once
        assert changed.is_ideal == (name in ("unit", "area_growth", "area_length"))
        digests.add(replace(ROBOT, actuators=(ROBOT.actuators[0], changed)).digest)
    assert len(digests) == 1 + len(OTHER)


def test_a_chamber_keeps_its_unit_in_the_file_and_behind_an_ideal_rig() -> None:
    pushed = replace(ROBOT.actuators[1], gear=2e-4, upper=5e4, unit="Pa", lag=0.05)
    robot = replace(ROBOT, actuators=(ROBOT.actuators[0], pushed))
    assert parse_text(write(robot), path=robot.path) == robot
    assert input_units(robot) == ("0.1 N m", "Pa")
    assert pushed.ideal == replace(pushed, lag=0.0)
    assert pushed.ideal.is_chamber


@pytest.mark.parametrize(
    ("lower", "upper", "said"),
    [(0, 1.5, 1), (0, 150, 1), (0, 1.5e5, 0), (-8e4, 0, 0), (-2e5, 1e5, 1), (0, 5e7, 1), (0, 0, 0)],
)
def test_a_pressure_that_no_chamber_has_is_said(lower: float, upper: float, said: int) -> None:
    chamber = Actuator("u2", "cable", 2e-4, lower, upper, unit="Pa")
    robot = replace(ROBOT, actuators=(ROBOT.actuators[0], chamber))
    assert sum("Pa" in line for line in suspicious_values(robot)) == said
    assert not any("cables carry" in line for line in suspicious_values(robot))


def test_friction_of_a_cable_and_its_driven_end_are_in_the_digest_and_in_the_file() -> None:
    first, *others = ROBOT.tendons
    rubbing = replace(first, friction=0.1)
    robots = [ROBOT] + [
        replace(ROBOT, tendons=(tendon, *others))
        for tendon in (rubbing, replace(first, friction=0.2), replace(rubbing, driven=PathEnd.LAST))
    ]
    assert len({robot.digest for robot in robots}) == len(robots)
    assert all(parse_text(write(robot), path=robot.path) == robot for robot in robots)


def test_a_cable_is_driven_at_the_end_nearer_to_the_base_unless_the_file_names_it() -> None:
    _, cable, *_ = ROBOT.tendons
    back = replace(cable, sites=cable.sites[::-1])
    for tendon, expected in (
        (cable, PathEnd.FIRST),
        (back, PathEnd.LAST),
        (replace(back, driven=PathEnd.FIRST), PathEnd.FIRST),
        (replace(cable, driven=PathEnd.LAST), PathEnd.LAST),
    ):
        assert driven_end(ROBOT, tendon) is expected


def test_slack_and_every_field_of_a_sensor_are_in_the_digest() -> None:
    first, *others = ROBOT.tendons
    sensor = Sensor("s", SensorKind.POSE, link="pad")
    change = {
        "name": "other", "kind": SensorKind.GYRO, "tendon": "cable", "link": "base",
        "joint": "bend", "xyz": (0.0, 0.0, 1.0), "rpy": (0.0, 0.0, 1.0), "noise": (1.0,),
        "bias": (1.0,), "rate": 1.0, "latency": 1.0, "resolution": (1.0,),
        "lower": (-1.0,), "upper": (1.0,), "to": "base",
    }  # fmt: skip
    assert set(change) == {field.name for field in fields(Sensor)}
    robots = [
        ROBOT,
        replace(ROBOT, tendons=(replace(first, slack=True), *others)),
        replace(ROBOT, sensors=(sensor,)),
        *(replace(ROBOT, sensors=(replace(sensor, **{k: v}),)) for k, v in change.items()),
    ]
    assert len({robot.digest for robot in robots}) == len(robots)


@pytest.mark.parametrize(
    ("gear", "lower", "upper", "pushes"),
    [(-1, 0, 5, False), (-1, -1, 5, True), (2, -5, 0, False), (2, -5, 1, True), (0, -5, 5, False)],
)
def test_an_input_pushes_if_it_lengthens_the_tendon(
    gear: float, lower: float, upper: float, pushes: bool
) -> None:
    assert Actuator("u", "t", gear, lower, upper).pushes is pushes


def test_a_sensor_s_frame_and_sizes() -> None:
    sizes = {kind.value: kind.size for kind in SensorKind}
    assert sizes == {
        "length": 1, "tension": 1, "position": 3, "pose": 6, "gyro": 3, "accelerometer": 3,
        "joint": 1, "bend": 1, "pressure": 1,
    }  # fmt: skip
    sensor = Sensor("s", SensorKind.GYRO, link="pad", xyz=(1.0, 2.0, 3.0), rpy=(0, 0, np.pi / 2))
    np.testing.assert_array_equal(sensor.origin.translation, [1, 2, 3])
    np.testing.assert_allclose(sensor.origin.rotation @ [1, 0, 0], [0, 1, 0], atol=1e-15)
