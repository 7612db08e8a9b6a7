"""Biases and latencies of sensors, from logs of a rig; a cable that slackens."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest

import softdyn
from softdyn import identification
from softdyn.commands import identify as command
from softdyn.commands import rollout as rollout_command
from softdyn.identification import DesignFile, Measurements, compute_outputs
from softdyn.identification.output_error import make_problem
from softdyn.identification.trajectory import Start, follow
from softdyn.identification.unknowns.sensor_errors import biases, with_biases, without_repeats
from tests.support import cart
from tests.support.refused import refused
from tests.support.robots import cable, load

SENSORS = """
<sensor name="camera" type="position" link="tip" noise="1e-3" rate="50" latency="{camera}" bias="{bias} 0 0"/>
<sensor name="wire" type="length" tendon="cable" noise="5e-4" latency="{wire}" bias="{zero}"/>
<sensor name="load" type="tension" tendon="cable" noise="0.01"/>
"""  # noqa: E501
TRUE = {"camera": 0.03, "bias": 0.004, "wire": 0.01, "zero": -0.02}
# implicitfast moves half a step too early, which would be a latency
RIG = ("--integrator", "rk4", "--period", "0.005", "--rig", "--log")
READINGS = ("measured.camera.x", "measured.camera.y", "measured.camera.z", "measured.wire")


def sensed(folder, name="robot.urdf", motor="", stiffness=cart.STIFFNESS, **errors):
    errors = dict.fromkeys(TRUE, 0.0) | errors
    text = cart.text(-4, 4, stiffness=stiffness, block=SENSORS.format(**errors))
    text = text.replace('gear="1"', f'gear="1" {motor}')
    (folder / name).write_text(text)
    return str(folder / name)


def pushes(folder, seconds=2.0):
    """A file of random inputs, after 0.1 s without any."""
    rng = np.random.default_rng(7)
    u = np.interp(np.arange(0, seconds, 0.01), np.arange(0, seconds + 0.2, 0.2),
                  np.r_[0, rng.uniform(-4, 4, int(seconds / 0.2 + 0.5))])  # fmt: skip
    (folder / "u.csv").write_text("t,u.u\n" + "".join(f"{0.01 * k:g},{x:g}\n" for k, x in
                                                      enumerate(u)))  # fmt: skip
    return str(folder / "u.csv")


@pytest.mark.parametrize("motor", ["", 'lag="0.03"'])
def test_bias_and_latency_from_the_log_of_a_rig(tmp_path, capsys, motor):
    """The robot's own stiffness and damping are unknown too, and nothing but sensors is read."""
    true = sensed(tmp_path, "true.urdf", motor, **TRUE)
    log = str(tmp_path / "run.csv")
    assert rollout_command.main([true, "--inputs", pushes(tmp_path, 1.4), *RIG, log]) == 0
    file = sensed(tmp_path, "file.urdf", motor, stiffness=11.0)
    free = ["stiffness", "damping", "sensor_bias", "sensor_latency"]
    found = str(tmp_path / "found.urdf")
    capsys.readouterr()
    code = command.main([file, log, "--outputs", "measured", "--free", *free, "--out", found,
                         "--json", "-"])  # fmt: skip
    report = json.loads(capsys.readouterr().out)
    assert code == 0
    assert list(report["noise"]) == list(READINGS)  # not the tension
    truth = {
        "stiffness x": cart.STIFFNESS, "damping x": cart.DAMPING,
        "sensor_bias camera.x": 0.004, "sensor_bias camera.y": 0, "sensor_bias camera.z": 0,
        "sensor_bias wire": -0.02, "sensor_latency camera": 0.03, "sensor_latency wire": 0.01,
    }  # fmt: skip
    rows = {one["label"]: one for one in report["parameters"]}
    assert rows.keys() == truth.keys()
    for label, value in truth.items():
        one = rows[label]
        assert abs(one["value"] - value) < 3 * one["deviation"], label
        assert one["deviation"] < (1e-3 if "sensor" in label else 0.02)
    camera, wire, _ = softdyn.load(found).robot.sensors
    assert camera.latency == pytest.approx(rows["sensor_latency camera"]["value"], rel=1e-9)
    assert camera.bias[0] == pytest.approx(rows["sensor_bias camera.x"]["value"], rel=1e-9)
    assert wire.bias[0] == pytest.approx(-0.02, abs=1e-3)


def test_a_late_sensor_beside_encoders(tmp_path, capsys):
    """Its latency is longer than half of the first pieces of the data, and of the held-out part."""
    file = sensed(tmp_path, **TRUE | {"camera": 0.15})
    log = str(tmp_path / "run.csv")
    assert rollout_command.main([file, "--inputs", pushes(tmp_path, 0.8), *RIG, log]) == 0
    capsys.readouterr()
    words = ["--outputs", "q", "measured.camera", "--free", "sensor_bias", "--json", "-"]
    assert command.main([file, log, *words]) == 1
    report = json.loads(capsys.readouterr().out)
    assert report["not_told"] == ["sensor_bias wire"]
    assert report["parameters"][0]["value"] == pytest.approx(0.004, abs=1e-3)


def test_a_sensor_without_a_column_is_named(tmp_path, capsys):
    file = sensed(tmp_path, **TRUE)
    log = str(tmp_path / "run.csv")
    assert rollout_command.main([file, "--inputs", pushes(tmp_path, 0.5), *RIG, log]) == 0
    assert command.main([file, log, "--outputs", "measured.wire", "--free", "sensor_latency"]) == 1
    text = capsys.readouterr().out
    assert "not identifiable from these data: sensor_latency camera" in text


def moving(model, latencies, rows=60):
    """Data, a problem and θ of a motion from a known state under a sine."""
    t = 0.01 * np.arange(rows)
    u = np.sin(7 * t)[:, None]
    names = ("q.x", *READINGS)
    still = np.zeros((1, 0))
    path, by = follow(model, (), t, u, Start(np.array([0.1]), np.array([0.5]), still, still))
    out, _ = compute_outputs(model, names, path, by)
    unknowns = [one for kind in ("stiffness", "sensor_bias", "sensor_latency")
                for one in identification.parameters(model, kind)]  # fmt: skip
    theta = np.array([8.0, 0.01, 0.02, 0.03, 0.04, *latencies])
    return make_problem(model, Measurements(t, u, names, out), tuple(unknowns)), theta


def test_readings_and_their_derivatives(tmp_path):
    problem, theta = moving(softdyn.load(sensed(tmp_path)), (0.043, 0.017))
    firsts = problem.firsts()
    (run,) = problem.simulated(theta, firsts)
    place = np.interp(problem.data.t - 0.017, problem.data.t, run.out[:, 0])
    np.testing.assert_allclose(run.out[2:, 4], (place + 0.04)[2:], atol=2e-4)
    assert np.isnan(run.out[:5, 1]).all()  # before the run
    assert np.isfinite(run.out[5:]).all()
    for k, e in enumerate(1e-6 * np.eye(len(theta))):
        ends = [problem.outputs(theta + s * e, firsts)[0] for s in (1, -1)]
        np.testing.assert_allclose((ends[0] - ends[1]) / 2e-6, run.by_theta[:, :, k], atol=1e-6)
    with refused("sensor 'wire': latency", "0.4 s"):
        problem.outputs(np.append(theta[:-1], 0.4), firsts)


def test_held_readings_count_once(tmp_path):
    model = softdyn.load(sensed(tmp_path))
    t = 0.005 * np.arange(12)
    values = np.repeat([[1.0, 2, 3], [1, 2.5, 3], [4, 2.5, 3]], 4, 0)
    out = np.column_stack((values, t))
    found = without_repeats(model.robot, READINGS, t, out)
    np.testing.assert_array_equal(found[[4, 8]], out[[4, 8]])
    assert np.isnan(np.delete(found, [4, 8], 0)[:, :3]).all()
    np.testing.assert_array_equal(found[:, 3], t)  # has no rate
    changed = with_biases(model.robot, {"camera.y": 0.5})
    assert biases(changed) == {"camera.x": 0, "camera.y": 0.5, "camera.z": 0, "wire": 0}


TOML = """\
name = "arm"
[material]
youngs_modulus_MPa = 0.30
density_kg_m3 = 1100
[[section]]
length_mm = 200
radius_mm = 10
segments = 2
[[cable]]
name = "pull"
count = 3
offset_mm = 8
routing = "channel"
max_tension_N = 6
[[sensor]]
name = "camera"
type = "position"
s_mm = 200
latency_ms = 0  # to be found
bias_mm = [0, 0, 0]
"""


def test_a_design_s_sensors(tmp_path, capsys):
    (tmp_path / "arm.toml").write_text(TOML)
    arm = DesignFile(tmp_path / "arm.toml")
    model, t = arm.model, 0.02 * np.arange(40)
    u = np.outer(np.sin(3 * t) ** 2, [2.0, 0.5, 0])
    names = [name for name in identification.output_names(model) if name.startswith("measured.")]
    data = Measurements(t, u, tuple(names), np.random.default_rng(1).normal(size=(40, 3)))
    unknowns = arm.unknowns(["sensor_bias", "sensor_latency"])
    assert [one.label for one in unknowns][2:] == [
        "bias sensor camera [3]", "latency sensor camera",
    ]  # fmt: skip
    problem, theta = make_problem(model, data, unknowns), np.array([0.01, 0.02, 0.03, 0.022])
    (run,) = problem.simulated(theta, problem.firsts())
    for k, e in enumerate(1e-5 * np.eye(4)):
        ends = [problem.outputs(theta + s * e, problem.firsts())[0] for s in (1, -1)]
        slope = (ends[0] - ends[1]) / 2e-5
        np.testing.assert_allclose(run.by_theta[:, :, k], slope, atol=1e-4)
    rows = run.out + 1e-4 * np.random.default_rng(2).normal(size=run.out.shape)
    titles = ["t", *(f"u.{one.name}" for one in model.robot.actuators), *names]
    np.savetxt(tmp_path / "d.csv", np.column_stack((t, u, rows)), delimiter=",",
               header=",".join(titles), comments="")  # fmt: skip
    words = ["--free", "sensor_bias", "sensor_latency", "--out", str(tmp_path / "found.toml")]
    assert command.main([str(arm.path), str(tmp_path / "d.csv"), *words]) == 0
    (sensor,) = tomllib.loads((tmp_path / "found.toml").read_text())["sensor"]
    assert sensor["latency_ms"] == pytest.approx(22, abs=1)
    assert sensor["bias_mm"] == pytest.approx([10, 20, 30], abs=0.2)
    assert "latency_ms = 2" in (tmp_path / "found.toml").read_text()


def test_the_free_length_of_a_cable_that_slackens(tmp_path):
    """A cart on a soft spring, beside a cable that is taut on one side only."""
    rope = cable("rope", "x 1", slack="true", stiffness=60, damping=0.5, rest=-0.05)
    true = load(tmp_path, cart.text(-4, 4, block=rope))
    t = 0.01 * np.arange(200)
    knots = np.r_[0, np.random.default_rng(3).uniform(-3, 3, 10)]
    u = np.interp(t, 0.2 * np.arange(11), knots)[:, None]
    rest = Start(*np.zeros((2, 1)), *np.zeros((2, 1, 0)))
    path, _ = follow(true, (), t, u, rest)
    taut = (path > -0.05).mean()
    assert 0.2 < taut < 0.8
    noisy = path + 1e-3 * np.random.default_rng(4).normal(size=path.shape)
    ropes = [replace(one, rest=-0.02) if one.name == "rope" else one for one in true.robot.tendons]
    file = softdyn.build(replace(true.robot, tendons=tuple(ropes)))
    unknowns = [one for one in identification.parameters(file, "free_length")
                if one.label.endswith("rope")]  # fmt: skip
    found = identification.identify(file, Measurements(t, u, ("q.x",), noisy), unknowns)
    (one,) = found.estimates
    assert one.interval[0] < -0.05 < one.interval[1]
    assert one.deviation < 5e-4
