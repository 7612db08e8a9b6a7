"""The rig of an arm in its table: motors, winches, slack cables and sensors."""

from __future__ import annotations

import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from softdyn import Robot, design
from softdyn.description.rig import Actuator, CommandKind, Sensor, SensorKind
from softdyn.description.robot import poses
from softdyn.description.stated_task import StatedTask, TaskKind
from softdyn.description.urdf import parse_text
from softdyn.description.urdf_writer import write
from tests.support import ROOT
from tests.support.refused import refused

ARM = """\
[material]
youngs_modulus_MPa = 0.25
density_kg_m3 = 1070
[[section]]
name = "lower"
length_mm = 100
radius_mm = 14
segments = 3
discs = 2
disc = {radius_mm = 16, thickness_mm = 2, mass_g = 1}
plate = {radius_mm = 14, thickness_mm = 4, mass_g = 2}
[[section]]
name = "upper"
length_mm = 80
radius_mm = 12
segments = 2
freedoms = ["bend", "extension"]
discs = 4
[[cable]]
name = "base"
count = 3
offset_mm = 10
routing = "channel"
to = "lower"
max_tension_N = 20
[[cable]]
name = "long"
offset_mm = 10
routing = "discs"
max_tension_N = 5
stiffness_N_m = 200
damping_Ns_m = 1
slack = true
"""
RIG = """\
[[motor]]
cables = ["base"]
command = "length"
stiffness_N_mm = 2
damping_Ns_m = 3
length_lower_mm = -50
length_upper_mm = 40
lag_ms = 20
rate_mm_s = 80
delay_ms = 5
[[motor]]
cables = ["long"]
lag_s = 0.01
rate_N_s = 30
rotor_inertia_gcm2 = 2
reduction = 50
drum_radius_mm = 10
[[sensor]]
name = "encoder"
type = "length"
cables = ["base_2", "long"]
noise_mm = 0.1
resolution_mm = 0.05
rate_Hz = 200
[[sensor]]
type = "tension"
cables = ["long"]
bias_N = 0.2
[[sensor]]
name = "imu"
type = "gyro"
s_mm = [60, 150]
offset_mm = [0, 5, 0]
rpy_deg = [90, 0, 0]
noise_deg_s = [1, 2, 3]
[[sensor]]
name = "marker"
type = "position"
disc = 3
latency_ms = 40
[[sensor]]
name = "camera"
type = "pose"
s_mm = 184
noise_mm = 1
noise_deg = [1, 1, 2]
[[sensor]]
name = "stretch"
type = "joint"
joint = "extension_5"
noise_mm = 0.5
"""


def robot(text: str) -> Robot:
    return parse_text(design.read(tomllib.loads(text)).text, path=Path("arm.urdf"))


@pytest.fixture(scope="module")
def rigged() -> Robot:
    return robot(ARM + RIG)


def test_a_motor_drives_the_cables_of_its_tables(rigged: Robot) -> None:
    *base, long = rigged.actuators
    for k, actuator in enumerate(base, 1):
        assert actuator == Actuator(
            f"base_{k}", f"base_{k}", -1.0, 0.0, 20.0, CommandKind.LENGTH, 2000.0, 3.0,
            -0.05, 0.04, 0.02, 0.08, 0.005,
        )  # fmt: skip
    assert (long.command, long.lag, long.rate, long.delay) == (CommandKind.FORCE, 0.01, 30.0, 0.0)
    cable = rigged.tendons[3]
    assert (cable.stiffness, cable.damping, cable.rest, cable.slack) == (200.0, 1.0, None, True)
    assert not any(tendon.slack for tendon in rigged.tendons[:3])
    assert [tendon.armature for tendon in rigged.tendons] == pytest.approx([0, 0, 0, 5.0])


def test_sensors_stand_where_their_table_places_them(rigged: Robot) -> None:
    sensors = {sensor.name: sensor for sensor in rigged.sensors}
    assert list(sensors) == [
        "encoder_base_2", "encoder_long", "tension_2", "imu_1", "imu_2", "marker", "camera",
        "stretch",
    ]  # fmt: skip
    assert sensors["encoder_long"] == Sensor(
        "encoder_long", SensorKind.LENGTH, "long",
        noise=(1e-4,), rate=200.0, resolution=(5e-5,),
    )  # fmt: skip
    assert sensors["tension_2"].bias == (0.2,)
    assert sensors["stretch"] == Sensor(
        "stretch", SensorKind.JOINT, joint="extension_5", noise=(5e-4,)
    )
    placed = poses(rigged)

    def place(name: str) -> np.ndarray:
        """In the axes of the mount: the arm hangs down, its x is -z of the world."""
        rotation, translation = placed[sensors[name].link]
        return placed["base"][0].T @ (rotation @ sensors[name].xyz + translation)

    straight = {"imu_1": 0.06, "imu_2": 0.15, "marker": 0.124, "camera": 0.184}
    for name, along in straight.items():
        assert -place(name)[2] == pytest.approx(along, abs=1e-12), name
    assert sensors["imu_1"].rpy == pytest.approx((math.pi / 2, 0, 0))
    assert sensors["imu_1"].xyz[1] == 0.005
    assert sensors["imu_2"].noise == pytest.approx(np.radians([1, 2, 3]))
    assert sensors["camera"].noise == pytest.approx((1e-3, 1e-3, 1e-3, *np.radians([1, 1, 2])))
    assert sensors["marker"].latency == 0.04


def test_the_writer_writes_the_rig(rigged: Robot) -> None:
    assert parse_text(write(rigged), path=rigged.path) == rigged


def test_an_arm_without_a_rig_is_ideal() -> None:
    ideal = robot(ARM.replace("slack = true\n", ""))
    assert all(actuator.is_ideal for actuator in ideal.actuators)
    assert ideal.sensors == ()
    assert 'lag="' not in write(ideal)


WRONG = {
    "slack without a spring": (
        "stiffness_N_m = 200\n",
        "",
        ("[[cable]] 2: stiffness", 0.0),
    ),
    "negative friction": (
        "slack = true",
        "friction = -0.1",
        ("[[cable]] 2: friction", -0.1),
    ),
    "too much friction": (
        "slack = true",
        "friction = 11",
        ("[[cable]] 2: friction", 11.0),
    ),
    "negative spring": ("N_m = 200", "N_m = -200", ("[[cable]] 2: stiffness", -200.0)),
    "unknown cable": (
        '["base"]',
        '["bace"]',
        ("[[motor]] 1: cables", "'bace'; did you mean 'base'?"),
    ),
    "two motors of a cable": ('["long"]\nlag', '["base_1"]\nlag', ("motors", 2)),
    "unknown command": (
        '"length"\nst',
        '"lenght"\nst',
        ("[[motor]] 1: command", "'lenght'; did you mean 'length'?"),
    ),
    "winch without a spring": (
        "stiffness_N_mm = 2\n",
        "",
        ("[[motor]] 1: stiffness", 0.0),
    ),
    "spring of a force": (
        "lag_s = 0.01",
        "stiffness_N_m = 1",
        ("[[motor]] 2: stiffness", 'command "force"'),
    ),
    "bound of a force": (
        "lag_s = 0.01",
        "length_upper_m = 1",
        ("[[motor]] 2: length_upper", 'command "force"'),
    ),
    "crossed bounds": ("= -50", "= 50", ("[[motor]] 1: length_lower", "0.05 and 0.04")),
    "rotor of a winch": (
        "lag_ms = 20",
        "rotor_inertia_gcm2 = 2\ndrum_radius_mm = 9",
        ("[[motor]] 1: armature", "0.002469…"),
    ),
    "rotor without a drum": ("drum_radius_mm = 10\n", "", ("[[motor]] 2", "none")),
    "negative lag": ("lag_ms = 20", "lag_ms = -20", ("[[motor]] 1: lag", -0.02)),
    "no rate": ("rate_mm_s = 80", "rate_mm_s = 0", ("[[motor]] 1: rate", 0.0)),
    "rate of another command": (
        "rate_mm_s",
        "rate_N_s",
        ("[[motor]] 1: rate_N_s", "'rate_N_s'; did you mean 'rate_m_s'?"),
    ),
    "unknown type": ('"gyro"', '"imu"', ("[[sensor]] 3: type", "'imu'")),
    "unit of another type": (
        "bias_N =",
        "bias_mm =",
        ("[[sensor]] 2: bias_mm", "'bias_mm'; did you mean 'bias_mN'?"),
    ),
    "no place": ("disc = 3\n", "", ("[[sensor]] 4", "none")),
    "two places": ("disc = 3", "disc = 3\ns_mm = 1", ("[[sensor]] 4", "both")),
    "no such disc": ("disc = 3", "disc = 7", ("[[sensor]] 4: disc", 7)),
    "beyond the end": ("s_mm = 184", "s_mm = 185", ("sensor 'camera'", "0.185 m")),
    "before the base": ("s_mm = 184", "s_mm = -1", ("[[sensor]] 5: points", -0.001)),
    "no such joint": (
        "extension_5",
        "extension_1",
        ("sensor 'stretch': joint", "'extension_1'; did you mean 'extension_5'?"),
    ),
    "no joint": ('"extension_5"', '"elbow"', ("[[sensor]] 6: joint", "'elbow'")),
    "two numbers": (
        "[1, 2, 3]",
        "[1, 2]",
        ("[[sensor]] 3: noise", "[0.017453292519943295, 0.03490658503988659]"),
    ),
    "numbers for a scalar": (
        "noise_mm = 0.1",
        "noise_mm = [1, 2]",
        ("[[sensor]] 1: noise", "[0.001, 0.002]"),
    ),
    "negative noise": (
        "noise_mm = 0.1",
        "noise_mm = -1",
        ("[[sensor]] 1: noise", -0.001),
    ),
    "negative latency": (
        "latency_ms = 40",
        "latency_ms = -40",
        ("[[sensor]] 4: latency", -0.04),
    ),
    "negative rate": ("rate_Hz = 200", "rate_Hz = -1", ("[[sensor]] 1: rate", -1.0)),
    "a name no file holds": ('"encoder"', '"<>"', ("[[sensor]] 1: name", "'<>'")),
    "same names": ('"marker"', '"camera"', ("sensors", "camera")),
}


@pytest.mark.parametrize(("old", "new", "message"), WRONG.values(), ids=WRONG)
def test_misuse_is_one_line(old: str, new: str, message: str) -> None:
    text = (ARM + RIG).replace(old, new, 1)
    assert text != ARM + RIG
    with refused(*message) as caught:
        design.read(tomllib.loads(text), "arm.toml")
    assert str(caught.value).startswith("")
    assert "\n" not in str(caught.value)


def test_the_example_of_the_page_is_read() -> None:
    arm, rig = re.findall("```toml\n(.*?)```", (ROOT / "docs" / "design.md").read_text(), re.S)[:2]
    found = robot(arm + rig)
    assert {actuator.command for actuator in found.actuators} == {CommandKind.LENGTH}
    assert [sensor.name for sensor in found.sensors][3:] == ["imu_1", "imu_2", "joint_3"]


TASKS = """\
[[task]]
[[task]]
name = "way"
kind = "axis"
direction = [1, 0, 0]
weight = 0.1
level = 1
[[task]]
frame = "segment_2"
axes = ["x", "z"]
Kp = 30
"""


def test_tasks_are_those_of_the_file() -> None:
    made = robot(ARM + TASKS)
    assert made.tasks == (
        StatedTask("tip", "tip"),
        StatedTask("tip", "way", TaskKind.AXIS, (), (1.0, 0.0, 0.0), 0.1, None, 1),
        StatedTask("segment_2", "segment_2", axes=("x", "z"), Kp=30.0),
    )
    assert robot(ARM + "[[task]]\n").tasks == ()
    assert robot(ARM + '[[task]]\nframe = "segment_1"\n').task == "segment_1"


def test_a_task_at_a_place_along_the_arm_has_a_frame_there() -> None:
    places = [(160, None), (160, None), (160, (0, 12, -5)), (12.5, None)]
    text = "".join(
        f'[[task]]\nname = "{k}"\ns_mm = {s}\n' + (f"offset_mm = {list(by)}\n" if by else "")
        for k, (s, by) in enumerate(places)
    )
    made = robot(ARM + text)
    frames = [task.frame for task in made.tasks]
    assert frames == ["at_160mm", "at_160mm", "at_160mm_2", "at_12_5mm"]
    assert made.task == "at_160mm"
    straight = poses(made)
    rotation, base = straight["segment_0"]
    for frame, (s, by) in zip(frames, places, strict=True):
        point = 1e-3 * (np.array([s, 0, 0]) + (by or 0))
        np.testing.assert_allclose(straight[frame][1], base + rotation @ point, atol=1e-15)
        np.testing.assert_allclose(straight[frame][0], rotation, atol=1e-15)
    parent = {joint.child: joint.parent for joint in made.joints}
    assert parent["at_12_5mm"] == "segment_1"


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ('s_mm = 10\nframe = "tip"', ("[[task]] 1", "both")),
        ("s_mm = 185", ("frame 'at_185mm'", "0.185 m")),
        ("s_mm = -1", ("frame 'at_-1mm'", -0.001)),
        ("offset_mm = [0, 0, 1]", ("<task>", "offset_mm")),
        ('frame = "segment_9"', ("<task>", "'segment_9'; did you mean 'segment_5'?")),
        ('frane = "tip"', ("<task>", "frane")),
        ('kind = "pos"', ("<task>", "'pos'; did you mean 'pose'?")),
        ('kind = "axis"', ("<task>", 'kind="axis"')),
        ('kind = "axis"\ndirection = [1, 0]', ("<task>", "'1 0'")),
        ('axes = ["rx"]', ("<task>", "'rx'; did you mean 'x'?")),
        ("weight = 0", ("<task>", 0.0)),
        ("weight = true", ("<task>", "'True'")),
        ("level = 0.5", ("<task>", 0.5)),
        ("Kp = -1", ("<task>", -1.0)),
        ('name = "a\\u0000"', ("[[task]] 1", "{'name': 'a\\x00'}")),
        ("[[task]]", ("<task>", "a second 'tip'")),
    ],
)
def test_a_misused_task_is_one_line(task: str, message: str) -> None:
    with refused(*message) as caught:
        design.read(tomllib.loads(f"{ARM}[[task]]\n{task}\n"), "arm.toml")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("lengths", [(130, 110, 90), (100, 80, 70), (7, 0.7, 0.1), (11, 13, 17.3)])
def test_a_marker_at_the_sum_of_the_sections_is_on_the_arm(lengths) -> None:
    section = '[[section]]\nlength_mm = {}\nradius_mm = 9\nsegments = 1\nname = "s{}"\n'
    text = "unusual = true\n[material]\nyoungs_modulus_MPa = 0.25\ndensity_kg_m3 = 1070\n"
    text += "".join(section.format(length, k) for k, length in enumerate(lengths))
    text += '[[sensor]]\ntype = "position"\ns_mm = {}\n'
    ends = [round(float(end), 3) for end in np.cumsum(lengths)]
    assert len(robot(text.format(ends)).sensors) == 3
    with refused("table: sensor 'position_1'"):
        robot(text.format([*ends[:2], ends[2] + 1e-4]))
