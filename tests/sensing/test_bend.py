"""A flex sensor: its angle by hand, in the twin, in an observer, in a fit, in files."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import softdyn
from softdyn import InputError, SoftModel, statics
from softdyn.commands import identify as identify_command
from softdyn.commands import rollout as rollout_command
from softdyn.description.rig import Sensor, SensorKind
from softdyn.description.urdf_writer import write as as_urdf
from softdyn.estimation import observe
from softdyn.identification import read_csv
from softdyn.sensing import Sensors
from softdyn.validation import Log, Rig, Twin, rollout
from softdyn.validation.twin.readings import Readings
from softdyn.validation.twin.state_map import StateMap
from tests.support import robots
from tests.support.oracles import slopes
from tests.support.refused import refused
from tests.support.robots import hinge, write

BEND = SensorKind.BEND
ABOUT_Y = (-math.pi / 2, 0.0, 0.0)  # the sensor's z axis along the link's y axis
SPANS = (("base", "link1"), ("link1", "link2"), ("link2", "link3"), ("link3", "link4"))


def flexed(name: str, spans, rpy=ABOUT_Y, **errors) -> SoftModel:
    """A bundled robot with a flex sensor over each span."""
    robot = softdyn.load(name).robot
    sensors = tuple(
        Sensor(f"flex_{k}", BEND, link=link, to=to, rpy=rpy, **errors)
        for k, (link, to) in enumerate(spans)
    )
    return softdyn.build(replace(robot, sensors=sensors), name)


def test_the_bend_of_a_planar_finger_is_the_sum_of_its_angles() -> None:
    """All four joints turn about y. Beyond π the reading begins anew at -π."""
    model = flexed("finger", (*SPANS, ("base", "link4")))
    q = np.array([0.9, 1.1, 0.8, 0.7])
    here = model.measure(model.state(q, np.zeros(4)), np.zeros(2))
    assert here.names == ("flex_0", "flex_1", "flex_2", "flex_3", "flex_4")
    np.testing.assert_allclose(here.values, [*q, q.sum() - 2 * math.pi], atol=1e-12)
    np.testing.assert_allclose(here.jacobian[:, :4], [*np.eye(4), np.ones(4)], atol=1e-12)
    before = model.measure(model.state(q - 0.15, np.zeros(4)), np.zeros(2))
    assert before.errors_of(here.values)[4] == pytest.approx(0.6)  # the short way


@pytest.mark.parametrize("span", [("segment_0", "segment_9"), ("segment_5", "segment_2")], ids=str)
def test_the_bend_in_space_is_that_of_the_link_s_orientations(span) -> None:
    """By SciPy's rotations; the Jacobian by differences; perpendicular bends do not count."""
    rpy = (0.4, -0.3, 0.8)
    model = flexed("spirob", [span], rpy)
    rng, sensors = np.random.default_rng(2), Sensors(model)
    own, u = Rotation.from_euler("xyz", rpy), np.zeros(model.nu)
    for _ in range(5):
        q, v = 0.3 * rng.normal(size=model.nv), rng.normal(size=model.nv)
        poses = model.link_poses(q)
        begin, end = (Rotation.from_matrix(poses[link][:3, :3]) * own for link in span)
        x, y, _ = (begin.inv() * end).apply([1.0, 0.0, 0.0])
        here = model.measure(model.state(q, v), u)
        assert here.values[0] == pytest.approx(math.atan2(y, x), abs=1e-12)

        def errors(x, q=q, v=v, here=here):
            return here.errors_of(sensors.predict(q + x, v, u)[0])[0]

        by_q = slopes(errors, model.nv, 1e-5)
        scale = max(1.0, np.abs(by_q).max())
        np.testing.assert_allclose(here.jacobian[0, : model.nv], by_q, atol=1e-8 * scale)
        np.testing.assert_array_equal(here.jacobian[0, model.nv :], 0.0)


def test_an_axis_across_the_plane_has_a_finite_reading() -> None:
    """The finger bends by a right angle about the sensor's y axis: x and y are 0."""
    model = flexed("finger", [("base", "link1")], (0.0, 0.0, 0.0))
    here = model.measure(model.state([math.pi / 2, 0, 0, 0], np.zeros(4)), np.zeros(2))
    assert np.isfinite(here.values).all()
    assert np.isfinite(here.jacobian).all()


@pytest.mark.parametrize("name", ["finger", "helix", "spirob"])
def test_the_twin_reads_what_the_model_reads(name) -> None:
    links = [link.name for link in softdyn.load(name).robot.links]
    model = flexed(name, [(links[1], links[-1]), (links[0], links[len(links) // 2])], (1, 2, 3))
    twin = Twin(model.robot, rig=True, limits=False)
    states, readings = StateMap(model, twin), Readings(twin, 0)
    rng = np.random.default_rng(1)
    for _ in range(4):
        q = model.configuration(0.3 * rng.normal(size=model.nv))
        twin.set_state(*states.to_twin(q, np.zeros(model.nv)))
        mujoco.mj_forward(twin.model, twin.data)
        here = model.measure(model.state(q, np.zeros(model.nv)), np.zeros(model.nu))
        assert readings.names == here.names
        np.testing.assert_allclose(here.errors_of(readings.ideal()), 0.0, atol=1e-10)


def test_an_observer_sees_a_finger_by_flex_sensors_alone() -> None:
    model = flexed("finger", SPANS, noise=(0.01,), rate=100.0, latency=0.01)
    found = observe(statics.rest(model), seconds=0.5, period=0.005)
    assert found.forgotten is not None
    assert (found.deviations < found.blind).all()
    assert found.tip < 0.01


FLEX = """<sensor name="flex" type="bend" link="base" to="tip" rpy="0 0 0" noise="1e-3"
bias="{}" latency="0.02" rate="100" lower="-2" upper="2"/><task frame="tip"/>"""


def pendulum(folder, name="pendulum.urdf", stiffness=0.8, bias=0.0):
    return write(folder, hinge(
        0.5, "0.2 0 0", "1e-3 4e-3 4e-3", axis="0 0 1", limit=(-2, 2), damping=0.02,
        stiffness=stiffness, tip="0.4 0 0", pull=(-9, 9), gear=0.1, block=FLEX.format(bias),
    ), name)  # fmt: skip


def test_a_fit_finds_a_spring_and_the_bias_of_a_flex_sensor(tmp_path, capsys) -> None:
    """From the readings alone, in the CSV of a run with the rig."""
    true = pendulum(tmp_path, "true.urdf", 0.8, 0.05)
    log, inputs = tmp_path / "run.csv", tmp_path / "u.csv"
    rows = "".join(f"{0.1 * k:g},{(-1) ** (k // 3) * 2 * (k > 1):g}\n" for k in range(16))
    inputs.write_text(f"t,u.u\n{rows}", encoding="utf-8")
    run = [str(true), "--inputs", str(inputs), "--integrator", "rk4", "--period", "0.005"]
    assert rollout_command.main([*run, "--rig", "--log", str(log)]) == 0
    assert "measured.flex (rad)" in log.read_text(encoding="utf-8").splitlines()[0]
    file = pendulum(tmp_path, stiffness=0.5)
    capsys.readouterr()
    asked = ["--outputs", "measured", "--free", "stiffness", "sensor_bias", "--json", "-"]
    assert identify_command.main([str(file), str(log), *asked]) == 0
    report = json.loads(capsys.readouterr().out)
    found = {one["label"]: one for one in report["parameters"]}
    for label, value in (("stiffness hinge", 0.8), ("sensor_bias flex", 0.05)):
        assert abs(found[label]["value"] - value) < 4 * found[label]["deviation"]
        assert found[label]["deviation"] < 0.01


def test_a_run_with_the_rig_is_read_back_from_its_csv(tmp_path) -> None:
    """The reading is the hinge's angle of 20 ms ago, up to its noise."""
    model = softdyn.load(pendulum(tmp_path))
    log = rollout(model, np.ones(1), 1.0, period=0.005, rig=Rig(seed=1))
    then = np.interp(log.t - 0.02, log.t, log.q[:, 0])
    assert np.abs(log.measured[:, 0] - then)[20:].max() < 0.05
    log.to_csv(tmp_path / "run.csv")
    again = Log.from_csv(tmp_path / "run.csv")
    assert again.sensor_names == ("flex",)
    np.testing.assert_allclose(again.measured, log.measured, rtol=1e-12)


def test_readings_that_jump_by_a_turn_are_refused(tmp_path) -> None:
    path, model = tmp_path / "data.csv", softdyn.load(pendulum(tmp_path))
    rows = "".join(f"{0.01 * k:g},0,{3 - 6 * (k % 2):g}\n" for k in range(30))
    path.write_text(f"t,u.u,measured.flex\n{rows}", encoding="utf-8")
    with refused("data.csv: column measured.flex", "3, then -3: wrapped by 2 pi?") as caught:
        read_csv(path, model)
    assert "measured.flex" in caught.value.name


def test_a_written_robot_has_the_same_sensor(tmp_path) -> None:
    robot = softdyn.load(pendulum(tmp_path)).robot
    again = robots.write(tmp_path, as_urdf(robot))
    assert softdyn.load(again).robot.sensors == robot.sensors
    assert robot.sensors[0].to == "tip"
    assert "to=" not in repr(replace(robot.sensors[0], to=""))  # digests of robots without stay


def test_the_second_link_must_be_one_of_the_robot() -> None:
    model = flexed("finger", [("base", "nowhere")])
    with pytest.raises(InputError) as caught:
        model.measure(model.state(model.q0, np.zeros(4)), np.zeros(2))
    assert caught.value.name == "sensor 'flex_0'"
