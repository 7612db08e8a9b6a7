"""The rig in the block: read with its defaults, in overlays too, and written without them."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softdyn import Robot, parse
from softdyn.description.rig import (
    LONGEST_DELAY,
    SMALLEST_WINCH,
    Actuator,
    CommandKind,
    Sensor,
    SensorKind,
)
from softdyn.description.urdf import parse_text
from softdyn.description.urdf_writer import write
from tests.support import rig_tables
from tests.support.misuses import ARM, FORMAT

ROBOT = parse_text(ARM, path=Path("arm.urdf"))
BLOCK = """\
<softdyn version="1">
  <tendon name="flexor" stiffness="3" slack="true"><joint name="bend" coef="0.02"/></tendon>
  <tendon name="cable" slack="false">
    <site link="base" xyz="0 0 0.02"/><site link="finger" xyz="0.05 0 0.02"/>
  </tendon>
  <actuator name="winch" tendon="flexor" gear="-2" lower="0" upper="5" command="length"
    stiffness="900" damping="4" length_lower="-0.1" length_upper="0.3" lag="0.02" rate="0.08"
    delay="0.005" offset="-0.02"/>
  <actuator name="drum" tendon="cable" gear="0.5" lower="-9" upper="0" command="velocity"
    stiffness="800"/>
  <actuator name="motor" tendon="cable" gear="-1" lower="-5" upper="5" command="force" lag="0.01"/>
  <sensor name="encoder" type="length" tendon="cable" noise="1e-4" resolution="5e-5" rate="200"/>
  <sensor name="load" type="tension" tendon="flexor" bias="-0.2" upper="6"/>
  <sensor name="mocap" type="pose" link="pad" xyz="0 0 0.01" rpy="0 0.1 0" latency="0.04"
    noise="1e-4 1e-4 1e-4 0.01 0.01 0.01"/>
  <sensor name="imu" type="accelerometer" link="pad" bias="0.1 -0.2 0"/>
  <sensor name="angle" type="joint" joint="bend"/>
</softdyn>
"""
READ_ACTUATORS = (
    Actuator("winch", "flexor", -2.0, 0.0, 5.0, CommandKind.LENGTH, 900.0, 4.0, -0.1, 0.3, 0.02,
             0.08, 0.005, -0.02),
    Actuator("drum", "cable", 0.5, -9.0, 0.0, CommandKind.VELOCITY, 800.0),
    Actuator("motor", "cable", -1.0, -5.0, 5.0, lag=0.01),
)  # fmt: skip
READ_SENSORS = (
    Sensor("encoder", SensorKind.LENGTH, "cable", noise=(1e-4,), resolution=(5e-5,), rate=200.0),
    Sensor("load", SensorKind.TENSION, "flexor", bias=(-0.2,), upper=(6.0,)),
    Sensor("mocap", SensorKind.POSE, link="pad", xyz=(0.0, 0.0, 0.01), rpy=(0.0, 0.1, 0.0),
           latency=0.04, noise=(1e-4, 1e-4, 1e-4, 0.01, 0.01, 0.01)),
    Sensor("imu", SensorKind.ACCELEROMETER, link="pad", bias=(0.1, -0.2, 0.0)),
    Sensor("angle", SensorKind.JOINT, joint="bend"),
)  # fmt: skip
INSIDE = ARM[: ARM.index("  <softdyn")] + BLOCK + "</robot>"
WITHOUT = ARM[: ARM.index("  <softdyn")] + "</robot>"


def again(robot: Robot) -> Robot:
    return parse_text(write(robot), path=robot.path)


def test_the_rig_is_read() -> None:
    robot = parse_text(INSIDE, path=Path("arm.urdf"))
    assert robot.actuators == READ_ACTUATORS
    assert robot.sensors == READ_SENSORS
    assert [tendon.slack for tendon in robot.tendons] == [True, False]
    assert again(robot) == robot


def test_the_rig_of_an_overlay_is_the_same(tmp_path: Path) -> None:
    urdf, overlay = tmp_path / "arm.urdf", tmp_path / "rig.xml"
    urdf.write_text(WITHOUT)
    overlay.write_text(BLOCK)
    robot = parse(urdf, annotations=overlay)
    inside = parse_text(INSIDE, path=urdf)
    assert robot == inside
    assert robot.digest == inside.digest
    assert again(robot) == robot


def test_defaults_are_not_written() -> None:
    robot = parse_text(ARM, path=Path("arm.urdf"))
    text = write(robot)
    for word in ("slack", "command", "lag", "rate", "delay", "offset", "length_", "sensor", "inf"):
        assert word not in text, word
    spelled = ARM.replace('upper="5"/>', 'upper="5" command="force" lag="0" delay="0"/>')
    assert parse_text(spelled, path=robot.path) == robot
    assert parse_text(spelled, path=robot.path).digest == robot.digest


def test_a_duplicate_is_found_among_sensors_only() -> None:
    text = ARM.replace("<task", '<sensor name="bend" type="joint" joint="bend"/><task')
    assert parse_text(text, path=Path("arm.urdf")).sensors[0].name == "bend"


def test_another_tool_s_sensor_is_ignored() -> None:
    camera = '<sensor name="eye" type="camera"><parent link="pad"/></sensor>'
    text = ARM.replace("<softdyn", f"{camera}<softdyn")
    robot = parse_text(text, path=Path("arm.urdf"))
    assert robot.sensors == ()
    assert robot.others == (camera,)


# -- any rig that is valid comes back as it was ------------------------------------------------

POSITIVE = st.floats(1e-300, 1e50)
NUMBER = st.floats(-1e50, 1e50).map(lambda x: x + 0.0)  # the text of a default -0 is lost
SHARE = st.floats(0, 1e50)
DELAY = st.floats(0, LONGEST_DELAY)


@st.composite
def actuators(draw: st.DrawFn, name: str) -> Actuator:
    """An input of the cable, which is slack: one that only pulls."""
    low, high = sorted([draw(SHARE), draw(SHARE)])
    gear, lower, upper = draw(st.sampled_from([(-1.0, low, high), (2.0, -high, -low)]))
    gear *= draw(st.floats(1e-3, 1e3))
    delays = {"lag": draw(SHARE), "delay": draw(DELAY), "rate": draw(POSITIVE | st.just(math.inf))}
    force = Actuator(name, "cable", gear, lower, upper, **delays)
    kind = draw(st.sampled_from(CommandKind))
    if kind is CommandKind.FORCE:
        return force
    bounds = sorted([draw(SHARE), draw(SHARE | st.just(math.inf))])
    return replace(
        force, command=kind, stiffness=draw(st.floats(SMALLEST_WINCH, 1e50)), damping=draw(SHARE),
        length_lower=draw(st.sampled_from([-math.inf, bounds[0]])), length_upper=bounds[1],
        offset=draw(NUMBER) if kind is CommandKind.LENGTH else 0.0,
    )  # fmt: skip


@st.composite
def sensors(draw: st.DrawFn, name: str) -> Sensor:
    kind = draw(st.sampled_from(SensorKind))
    values = {
        "tendon": st.sampled_from(["cable", "flexor"]), "joint": st.sampled_from(["bend", "slide"]),
        "link": st.sampled_from(["world", "pad"]), "to": st.just("base"),
        "xyz": st.tuples(NUMBER, NUMBER, NUMBER), "rpy": st.tuples(NUMBER, NUMBER, NUMBER),
    }  # fmt: skip
    place = {name: draw(values[name]) for name in kind.form.place}
    if kind is SensorKind.PRESSURE:
        place = {"tendon": "drive"}

    def components(value: st.SearchStrategy[float]) -> tuple[float, ...]:
        size = draw(st.sampled_from([1, kind.size]))
        return tuple(draw(st.lists(value, min_size=size, max_size=size)))

    limits = {"lower": st.floats(-1e6, -1.0), "upper": st.floats(1.0, 1e6)}
    stated = draw(st.sets(st.sampled_from([*limits])))
    bounds = {name: components(limits[name]) for name in stated}

    return Sensor(
        name, kind, **place, noise=components(SHARE), bias=components(NUMBER),
        rate=draw(SHARE), latency=draw(DELAY), resolution=components(SHARE),
        **bounds,
    )  # fmt: skip


@st.composite
def rigs(draw: st.DrawFn) -> Robot:
    """The arm with an elastic slack cable, a chamber and any rig."""
    flexor, cable, drive = ROBOT.tendons
    cable = replace(cable, stiffness=draw(POSITIVE), damping=draw(SHARE), slack=draw(st.booleans()))
    pull = [draw(actuators(f"u{k}")) for k in range(draw(st.integers(0, 3)))]
    ends = sorted([draw(NUMBER), draw(NUMBER)])
    pull.append(Actuator("air", "drive", draw(POSITIVE), *ends, lag=draw(SHARE), unit="Pa"))
    read = [draw(sensors(f"s{k}")) for k in range(draw(st.integers(0, 3)))]
    return replace(
        ROBOT, tendons=(flexor, cable, drive), actuators=tuple(pull), sensors=tuple(read)
    )


@settings(max_examples=100, deadline=None, derandomize=True)
@given(robot=rigs())
def test_what_is_written_is_read_back_as_an_equal_robot(robot: Robot) -> None:
    written = again(robot)
    assert written == robot
    assert write(written) == write(robot)
    assert replace(written, xml=robot.xml).digest == robot.digest


AIR = '<actuator name="air" tendon="drive" gear="1e-6" lower="0" upper="1e5" unit="Pa"/>'


@pytest.mark.parametrize("kind", SensorKind)
def test_every_kind_of_sensor_is_read(kind: SensorKind) -> None:
    place = {
        SensorKind.LENGTH: 'tendon="cable"', SensorKind.TENSION: 'tendon="cable"',
        SensorKind.PRESSURE: 'tendon="drive"', SensorKind.JOINT: 'joint="twist"',
        SensorKind.BEND: 'link="base" to="pad"',
    }.get(kind, 'link="pad"')  # fmt: skip
    more = f'{AIR}<sensor name="s" type="{kind.value}" {place}/><task'
    text = ARM.replace("<task", more)
    (sensor,) = parse_text(text, path=Path("arm.urdf")).sensors
    assert sensor.kind is kind


# -- the page ----------------------------------------------------------------------------------


def test_the_page_s_tables_are_the_docstrings() -> None:
    assert rig_tables.documented() == rig_tables.tables(), "python -m tests.support.rig_tables"


def test_the_page_s_example_fits_its_robot() -> None:
    rod, _, rig, *_ = (  # the second has a cable around a cylinder
        text
        for text in re.findall("```xml\n(.*?)```", FORMAT.read_text(), re.S)
        if "<tendon" in text
    )
    block = rig.replace("…", re.findall("<site.*?/>\n", rod, re.S)[0] * 2)
    text = re.sub("(<softdyn version.*?>).*(</softdyn>)", rf"\1{block}\2", rod, flags=re.S)
    robot = parse_text(text, path=Path("rod.urdf"))
    assert (len(robot.actuators), len(robot.sensors)) == (1, 3)
    assert robot.tendons[0].slack
