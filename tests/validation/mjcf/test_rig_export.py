"""The rig of a URDF in an exported MJCF, read back, compared, and driven as a plant."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import softdyn
from softdyn import InputError
from softdyn.actuation import Winches
from softdyn.description.rig import CommandKind
from softdyn.validation import Rig, Twin, compare, crosscheck, simulate
from softdyn.validation.mjcf import export
from softdyn.validation.mjcf.scene import Scene
from softdyn.validation.twin.drives import part_name, parts
from tests.support import robots
from tests.support.robots import cable, hinge, joint, link, motor, robot, write

RIGS: list[dict[str, Any]] = [
    {"lag": 0.02, "delay": 0.004},
    {"command": "length", "stiffness": 900.0, "lag": 0.01, "delay": 0.0041},
    {"command": "length", "stiffness": 900.0, "damping": 3.0, "length_lower": 0.1},
    {"command": "velocity", "stiffness": 900.0, "length_lower": 0.1, "length_upper": 0.36},
    {"command": "length", "stiffness": 900.0, "length_upper": 0.36, "lag": 0.01, "offset": -0.02},
]
PASSED = ("lag", "delay", "offset")


def arm(folder: Path, rig: dict[str, Any], damping: float = 0.0) -> Path:
    """An arm with two cables and a band; both motors have the rig."""
    slack = {"stiffness": 300, "rest": 0.33, "slack": "true", "damping": damping}
    return write(folder, robot(
        "arm", link("world"), link("upper", 0.3, "0.01 0 -0.1", "2e-3 1e-4 0 2e-3 0 1e-3"),
        link("lower", 0.2, "0 0 -0.1", 1e-3),
        joint("a", "world", "upper", limit=(-2, 2), damping=0.02),
        joint("b", "upper", "lower", "0.6 0.8 0", at="0 0 -0.2", limit=(-2, 2), damping=0.02),
        block=(
            cable("left", "world 0.05 0 0.02", "upper 0.05 0 -0.1", "lower 0.05 0.01 -0.1",
                  **slack),
            cable("right", "world -0.05 0 0", "lower -0.05 0 -0.1"),
            cable("band", "b -1", stiffness=2, rest=0.05, slack="true"),
            motor("left", 0, 30, -2, "u1", **rig), motor("right", 0, 60, -1, "u2", **rig),
            '<sensor name="cable" type="length" tendon="right" latency="0.003"/>'
            '<sensor name="pull" type="tension" tendon="left"/>'
            '<sensor name="camera" type="pose" link="lower" xyz="0 0 -0.2" rpy="1 2 3" rate="100"'
            ' latency="0.01" noise="0.01"/>'
            '<sensor name="flex" type="bend" link="world" to="lower" rpy="0.3 0.2 0.1"/>'
            '<sensor name="gyro" type="gyro" link="upper"/>'
            '<sensor name="encoder" type="joint" joint="b"/>',
        ),
    ))  # fmt: skip


def test_the_unit_of_a_chamber_is_lost_in_mjcf_kept_in_urdf_and_changes_no_motion(tmp_path):
    source = tmp_path / "chamber.urdf"
    motor = 'tendon="right" gear="-1" lower="0" upper="60"'
    valve = 'tendon="right" gear="2e-4" lower="-2e4" upper="1e5" unit="Pa"'
    source.write_text(arm(tmp_path, {"lag": 0.05}).read_text().replace(motor, valve))
    result, lost = export.write_mjcf(source, tmp_path / "arm.xml", shapes=False)
    assert "actuator 'u2': that its input is a pressure in Pa" in lost
    assert not any(cause.kind == "actuator" for cause in result.causes)
    export.write_urdf(source, tmp_path / "again.urdf")
    assert softdyn.parse(tmp_path / "again.urdf").actuators == softdyn.parse(source).actuators


@pytest.mark.parametrize("robot", ["finger", "spirob"])
def test_motors_of_a_file_of_their_own_move_it_as_the_twin_behind_such_a_rig(robot, tmp_path):
    """MuJoCo alone steps the file; the twin is built from the URDF, with the rig."""
    motors = {"lag": 0.02, "delay": 0.004}
    result, _ = export.write_mjcf(robot, tmp_path / "late.xml", shapes=False, motors=motors)
    assert result.passed
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "late.xml"))
    data, loaded = mujoco.MjData(model), softdyn.load(robot)
    twin = Twin(Rig(**motors).robot(loaded.robot), rig=True, timestep=model.opt.timestep)
    rng, moved = np.random.default_rng(0), 0.0
    for k in range(400):
        if k % 50 == 0:
            low, high = model.actuator_ctrlrange.T
            u = rng.uniform(0.3 * low, 0.3 * high)
        data.ctrl[:] = u
        mujoco.mj_step(model, data)
        twin.advance(u)
        moved = max(moved, np.abs(data.qpos).max())
        np.testing.assert_allclose(data.qpos, twin.qpos, atol=1e-9)
    assert moved > 0.01
    export.write_mjcf(robot, tmp_path / "ideal.xml", shapes=False)
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "ideal.xml")).na == 0


@pytest.mark.parametrize("motors", [{"noise": 0.1}, {"lags": 1}, {"lag": -1.0}])
def test_motors_that_no_file_can_have_are_one_line(motors, tmp_path):
    with pytest.raises(InputError):
        export.write_mjcf("finger", tmp_path / "x.xml", motors=motors)
    assert not (tmp_path / "x.xml").exists()


def test_friction_of_a_cable_is_lost_in_mjcf_kept_in_urdf_and_compared(tmp_path):
    source = arm(tmp_path, {})
    rubbing = tmp_path / "rubbing.urdf"
    text = source.read_text()
    rubbing.write_text(text.replace('name="right"', 'name="right" friction="0.1"'))
    result, lost = export.write_mjcf(rubbing, tmp_path / "arm.xml", shapes=False)
    assert "tendon 'right': its friction of 0.1" in lost
    assert not result.passed
    assert "friction" in {cause.kind for cause in result.causes if not cause.one_sided}
    result, _ = export.write_urdf(rubbing, tmp_path / "again.urdf")
    assert {c.detail for c in result.causes} == {"sensor, only in one file"}
    assert softdyn.parse(tmp_path / "again.urdf").tendons[1].friction == 0.1
    other = robots.write(tmp_path, rubbing.read_text().replace('"0.1"', '"0.2"'), "other.urdf")
    (cause,) = compare(rubbing, other).causes
    assert (cause.kind, cause.where, cause.one_sided) == ("friction", "right", False)


@pytest.mark.parametrize("rig", RIGS, ids=lambda rig: " ".join(rig))
@pytest.mark.parametrize("damping", [0.0, 2.0])
def test_plain_mujoco_moves_the_exported_rig_as_the_twin(tmp_path, rig, damping):
    """Trajectory, forces and sensors of the file and of the twin, two writers of one rig."""
    source = arm(tmp_path, rig, damping)
    result, lost = export.write_mjcf(source, tmp_path / "arm.xml", shapes=False)
    assert result.passed, str(result)
    assert {c.kind for c in result.causes} <= {"effort", "limit", "feature"}
    assert "sensor 'camera': its noise" in lost
    twin = Twin(source, rig=True)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    data = mujoco.MjData(model)
    names = [model.joint(k).name for k in range(model.njnt)]
    order = [names.index(joint) for joint in twin.joint_names]
    rate = rig.get("command") == "velocity"
    start = np.array([0.31, 0.29]) if "command" in rig else np.zeros(2)
    held = 0 * start if rate else start
    twin.hold(held, start)
    for k in range(2):
        if samples := int(model.actuator_history[k, 0]):
            past = np.full((samples, 1), held[k])
            mujoco.mj_initCtrlHistory(model, data, k, None, past)
        if model.actuator_actadr[k] >= 0:
            data.act[model.actuator_actadr[k]] = start[k]
    for k in range(200):
        change = 0.02 * np.sin(0.05 * k + np.arange(2))
        u = change if rate else start + (change if "command" in rig else 3 + 100 * change)
        data.ctrl[:2] = u
        mujoco.mj_step(model, data)
        twin.advance(u)
    np.testing.assert_allclose(data.qpos[order], twin.qpos, atol=1e-9)
    assert np.abs(twin.qpos).min() > 1e-3
    for one in ((model, data), (twin.model, twin.data)):
        mujoco.mj_forward(*one)
    forces = (d.actuator_force[:2] for d in (data, twin.data))
    np.testing.assert_allclose(*forces, atol=1e-7)
    springs = {"pull:3"} if not damping else set()  # MuJoCo has no sensor of a tendon's spring
    for sensor in twin.robot.sensors:
        for name in {part_name(sensor, k) for k in range(len(parts(twin.robot, sensor)))} - springs:
            one, other = (d.sensor(name).data for d in (twin.data, data))
            turned = len(one) == 4 and one @ other < 0  # a quaternion of the other sign
            np.testing.assert_allclose(one, -other if turned else other, atol=1e-8, err_msg=name)


@pytest.mark.parametrize("rig", RIGS, ids=lambda rig: " ".join(rig))
@pytest.mark.parametrize("damping", [0.0, 2.0])
def test_the_rig_comes_back(tmp_path, rig, damping):
    """URDF → MJCF → URDF: the same actuators and slack tendons; sensors are named as lost."""
    source = arm(tmp_path, rig | {"rate": 5.0}, damping)
    result, lost = export.write_mjcf(source, tmp_path / "arm.xml", shapes=False)
    assert not result.passed
    assert "actuator 'u1': the bound 5/s of its command's rate" in lost
    moving = [c for c in result.causes if not c.one_sided]
    assert [(c.kind, c.detail, c.alone) for c in moving] == [("actuator", "rate", True)] * 2
    result, lost = export.write_urdf(tmp_path / "arm.xml", tmp_path / "back.urdf")
    assert result.passed
    assert "sensor 'camera:0'" in lost
    there, back = (softdyn.load(path).robot for path in (source, tmp_path / "back.urdf"))
    for one, other in zip(there.actuators, back.actuators, strict=True):
        assert other.command is one.command
        for name in ("stiffness", "damping", "length_lower", "length_upper", *PASSED):
            assert getattr(other, name) == pytest.approx(getattr(one, name), rel=1e-12), name
    assert [t.slack for t in back.tendons] == [True, False, True]
    assert [back.tendons[k].rest for k in (0, 2)] == pytest.approx([0.33, 0.05])


def test_a_user_s_servos_in_a_urdf(tmp_path):
    """A pulling servo becomes a winch, with its unit named; one that pushes is lost."""
    path = tmp_path / "arm.xml"
    path.write_text(
        '<mujoco><worldbody><body><joint name="h"/><geom size="0.1"/>'
        '</body></worldbody><tendon><fixed name="t"><joint joint="h" coef="1"/></fixed></tendon>'
        '<actuator><position name="winch" tendon="t" kp="50" kv="2" gear="-1" timeconst="0.03" '
        'forcelimited="true" forcerange="0 9" ctrllimited="true" ctrlrange="-0.4 0.2"/>'
        '<position name="servo" joint="h" kp="5" forcelimited="true" forcerange="-3 3"/>'
        '<velocity name="speed" joint="h" kv="5"/></actuator></mujoco>'
    )
    result, lost = export.write_urdf(path, tmp_path / "out.urdf")
    assert not result.passed
    units = [(c.where, c.a, c.b) for c in result.causes if c.detail == "unit"]
    lone = [c.where for c in result.causes if c.kind == "actuator" and c.b is None and c.a != -1.0]
    assert lone == ["servo", "speed"]
    assert units == [("winch", -1.0, None)]
    assert "actuator 'winch': that -1 in its command is 1 m" in lost
    assert "actuator 'servo': a servo that pushes" in lost
    assert any("'speed' on joint:h (gain 5, 0, 0; bias 0, 0, -5)" in line for line in lost)
    (winch,) = softdyn.load(tmp_path / "out.urdf").robot.actuators
    assert (winch.command, winch.stiffness, winch.damping) == (CommandKind.LENGTH, 50.0, 2.0)
    assert (winch.length_lower, winch.length_upper, winch.lag) == (-0.2, 0.4, 0.03)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0], data.act[0] = 0.3, 0.5, -0.25
    mujoco.mj_forward(model, data)
    ours = softdyn.load(tmp_path / "out.urdf")
    u = Winches(ours).tensions(ours.state([0.3], [0.5]), [0.25])
    assert data.actuator_force[0] == pytest.approx(u[0])  # MuJoCo's own


CHANGES = [
    ({}, {"lag": 0.02}, "lag", "lag 0; lag 0.02"),
    ({"delay": 0.01}, {"delay": 0.005}, "delay", "delay 0.01; delay 0.005"),
    ({}, RIGS[2], "command", "command force; command length"),
    (RIGS[2], RIGS[2] | {"stiffness": 800.0}, "stiffness", "stiffness 900; stiffness 800"),
    (RIGS[3], RIGS[2], "command", "command velocity; command length"),
    (RIGS[4], RIGS[4] | {"offset": 0.01}, "offset", "offset -0.02; offset 0.01"),
]


@pytest.mark.parametrize(("ours", "theirs", "detail", "words"), CHANGES)
def test_compare_names_what_differs_in_two_rigs(tmp_path, ours, theirs, detail, words):
    for name in "ab":
        (tmp_path / name).mkdir()
    a, b = arm(tmp_path / "a", ours), arm(tmp_path / "b", theirs)
    export.write_mjcf(b, tmp_path / "b.xml", shapes=False)
    for file in (b, tmp_path / "b.xml"):
        result = compare(a, file, samples=1)
        causes = [c for c in result.causes if c.kind == "actuator"]
        assert [(c.where, detail in c.detail) for c in causes] == [("u1", True), ("u2", True)]
        first, _, second = words.partition("; ")
        assert first in causes[0].a
        assert second in causes[0].b
        assert not result.passed


def winch(coef: float, k: float, d: float) -> str:
    drive = {"name": "w", "command": "length", "stiffness": k, "damping": d}
    return hinge(
        0.2, "0 0 -0.1", name="h", child="l", limit=(-2, 2), effort=0, path=[f"h {coef}"],
        pull=(0, 30), gear=-1, drive={**drive, "length_lower": -0.1, "length_upper": 0.3},
    )  # fmt: skip


SERVO = """<mujoco><compiler autolimits="true" angle="radian"/><worldbody><body name="l">
<inertial pos="0 0 -0.1" mass="0.2" diaginertia="1e-3 1e-3 1e-3"/>
<joint name="h" axis="0 1 0" range="-2 2"/></body></worldbody><actuator>
<general name="w" joint="h" gear="{gear}" ctrlrange="{low} {high}" forcerange="0 30"
  gainprm="{gain}" biastype="affine" biasprm="0 {slope} {brake}"/></actuator></mujoco>"""


@pytest.mark.parametrize("coef", [1.0, 0.05, -0.05, -2.0])
def test_a_winch_over_one_joint_is_compared_with_a_servo_on_it(tmp_path, coef):
    """T = k (c q - l) + d c q̇ at the arm c: in q the stiffness is k c², the bounds are l / c."""
    k, d, ours, theirs = 800.0, 3.0, tmp_path / "a.urdf", tmp_path / "b.xml"
    low, high = sorted((-0.1 / coef, 0.3 / coef))
    servo = {"gear": -coef, "gain": -k * coef, "slope": -k, "brake": -d, "low": low, "high": high}
    for stiffness, same in ((k, True), (1.5 * k, False)):
        ours.write_text(winch(coef, stiffness, d), encoding="utf-8")
        theirs.write_text(SERVO.format(**servo), encoding="utf-8")
        found = [c for c in compare(ours, theirs).causes if c.kind == "actuator"]
        units = [] if coef == 1.0 else ["unit"]
        assert [c.detail for c in found] == ([] if same else ["stiffness"]) + units


def test_compare_of_sensors(tmp_path):
    """Kind, target, place, rate and latency; an MJCF has no noise."""
    source, other = arm(tmp_path, {}), tmp_path / "other.urdf"
    export.write_mjcf(source, tmp_path / "arm.xml", shapes=False)
    (noise,) = (c for c in compare(source, tmp_path / "arm.xml").causes if c.kind == "feature")
    assert (noise.where, noise.detail) == ("camera", "sensor's noise")
    assert noise.one_sided
    kind, place = 'type="length" tendon="right"', 'xyz="0 0 -0.2" rpy="1'
    for old, new, *cause in (
        (kind, 'type="tension" tendon="right"', "feature", "cable", "sensor"),
        (kind, 'type="length" tendon="left"', "feature", "cable", "sensor"),
        ('type="joint" joint="b"', 'type="joint" joint="a"', "feature", "encoder", "sensor"),
        ('latency="0.003"', 'latency="0.004"', "feature", "cable", "sensor's latency"),
        ('rate="100"', 'rate="50"', "feature", "camera", "sensor's rate"),
        (place, place.replace("0.2", "0.1"), "frame", "sensor:camera", "100 mm apart"),
    ):
        text = source.read_text()
        assert text.count(old) == 1
        other.write_text(text.replace(old, new))
        export.write_mjcf(other, tmp_path / "other.xml", shapes=False)
        for file in (other, tmp_path / "other.xml"):
            causes = [c for c in compare(source, file).causes if not c.one_sided]
            found = [c for c in causes if c.kind in ("feature", "frame")]
            assert [[c.kind, c.where, c.detail] for c in found] == [cause]
    other.write_text(source.read_text().replace('name="gyro"', 'name="spin"'))
    found = [c for c in compare(source, other).causes if c.kind == "feature"]
    assert [(c.where, c.one_sided) for c in found] == [("gyro", True), ("spin", True)]


def test_compare_names_a_slack_tendon(tmp_path):
    slack, taut = arm(tmp_path, {}), tmp_path / "taut.urdf"
    taut.write_text(slack.read_text().replace(' slack="true"', ""))
    export.write_mjcf(slack, tmp_path / "slack.xml")
    for file in (slack, tmp_path / "slack.xml"):
        causes = [c for c in compare(taut, file, samples=1).causes if not c.one_sided]
        found = [(c.kind, c.where, c.detail, c.a, c.b) for c in causes]
        assert found == [("tendon", name, "slack", False, True) for name in ("left", "band")]


def test_an_exported_rig_is_the_same_plant(tmp_path):
    """A controller's forces through `Winches` and the twin, and through MuJoCo's gain and bias."""
    source = arm(tmp_path, RIGS[2], 2.0)
    export.write_mjcf(source, tmp_path / "arm.xml", shapes=False)
    model = softdyn.load(source)
    plant = Scene(model, tmp_path / "arm.xml")
    assert crosscheck(model, plant, samples=2).passed  # with the slack tendons' K and D

    def law(state: Any, reference: Any) -> Any:
        return 5 + 3 * np.sin(30 * state.q + np.arange(2))

    options = {"reference": softdyn.SetPoint([0, 0, 0]), "duration": 0.1, "period": 0.005}
    scene = simulate(model, law, plant=plant, **options)
    twin = simulate(model, law, rig="file", **options)
    np.testing.assert_allclose(scene.q, twin.q, atol=1e-9)
    assert np.abs(twin.q).max() > 1e-3
