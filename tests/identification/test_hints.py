"""Hints: of several extensions, the one that the data were made with has the largest gain."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.optimize import root

from softdyn import identification, statics
from softdyn.commands import identify as command
from softdyn.identification import DesignFile, Measurements, compute_outputs
from softdyn.identification.hints import hints, left_out
from softdyn.identification.markers.camera import MarkerView
from softdyn.identification.problem import Acquisition
from softdyn.identification.rests import Inputs, rests
from softdyn.identification.trajectory import Start, follow
from softdyn.identification.unknowns.kinds import Around
from tests.identification.test_static import ARM, POINTS, written
from tests.support import cart
from tests.support.refused import refused
from tests.support.robots import build, load

SMALL = ARM.replace("segments = 6", "segments = 3")

NAMES = [f"point.{m}.{a}" for m in "abc" for a in "xyz"]


def tried(capsys, *words):
    """The hints by extension, and the report."""
    assert command.main([*words, "--hints", "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    return {one["extension"]: one for one in report["hints"]}, report


def stiffer(model, u):
    """Equilibria (N, n) with springs whose stiffness grows by 15 e² at the deflection e."""

    def residual(q, row):
        state = model.state(model.configuration(q), np.zeros(model.nv))
        return state.K + state.bias - state.B @ row + 15 * model.stiffness * q**3

    begin = [model.coordinates(statics.settle(model, row).q) for row in u]
    found = [root(residual, q, row) for q, row in zip(begin, u, strict=True)]
    assert all(one.success for one in found)
    return np.array([one.x for one in found])


STRAIN = "a stiffness that depends on strain"


@pytest.mark.parametrize("lacking", ["cable_friction", "offset", STRAIN])
def test_static_rows(tmp_path, capsys, lacking):
    (tmp_path / "points.toml").write_text(POINTS)
    text = SMALL.replace("max_tension", "friction = 0.15\nmax_tension")
    if lacking != "cable_friction":
        text = SMALL.replace("[9, 6.0]", "[7.5, 5.0]") if lacking == "offset" else SMALL
    (tmp_path / "true.toml").write_text(text)
    (tmp_path / "arm.toml").write_text(SMALL)
    true = DesignFile(tmp_path / "true.toml", tmp_path / "points.toml").model
    rng, u = np.random.default_rng(5), np.r_[np.linspace(0.3, 5, 6), np.linspace(4, 0.3, 6)]
    u = u[:, None] * [1, 0.4, 0]
    if lacking == STRAIN:
        path = stiffer(true, u)
    else:
        path, _ = rests(true, (), Inputs(u, np.zeros(3)), Around(true))
    out = compute_outputs(true, NAMES, path, np.zeros((*path.shape, 0)))[0]
    out += 3e-4 * rng.normal(size=out.shape)
    data = written(tmp_path / "d.csv", true, u, NAMES, out)
    words = [
        str(tmp_path / "arm.toml"),
        data,
        "--points",
        str(tmp_path / "points.toml"),
        "--static",
    ]
    found, report = tried(
        capsys, *words, "--free", "youngs_modulus", "--hold-out", "0", "--folds", "2"
    )
    assert found.keys() == {
        STRAIN, "cable_friction", "input_loss", "offset",
    }  # fmt: skip
    before = {one["before"] for one in found.values()}
    assert len(before) == 1
    assert found[lacking]["after"] == min(one["after"] for one in found.values())
    assert found[lacking]["after"] < 0.6 * before.pop()
    by = [row["by"] for row in report["residuals"]]
    assert by.count("output") == 3
    assert by.count("time") == by.count("input pull_1") == 4


def test_dry_friction_of_a_motion(tmp_path, capsys):
    text = cart.text(-4, 4)
    true = build(text.replace("<dynamics ", '<dynamics friction="0.4" '))
    (tmp_path / "file.urdf").write_text(text)
    t = 0.02 * np.arange(80)
    u = np.interp(t, 0.2 * np.arange(9), np.random.default_rng(3).uniform(-4, 4, 9))[:, None]
    none = np.zeros((1, 0))
    path, _ = follow(true, (), t, u, Start(np.array([0.2]), np.zeros(1), none, none))
    path += 1e-3 * np.random.default_rng(4).normal(size=path.shape)
    rows = Measurements(t, u, ("q.x",), path)
    np.savetxt(tmp_path / "d.csv", np.column_stack((rows.t, u, path)), delimiter=",",
               header="t,u.u,q.x", comments="")  # fmt: skip
    found, report = tried(capsys, str(tmp_path / "file.urdf"), str(tmp_path / "d.csv"))
    assert found.keys() == {"friction", "gear"}
    friction = found["friction"]
    assert friction["after"] < 0.7 * friction["before"]
    assert friction["before"] == report["rms_held_out"]


WIRE = '<sensor name="wire" type="length" tendon="cable" noise="5e-4"/>'


def wired(folder, noise, bias):
    """A robot with a cable's encoder, and data of its motion in a file."""
    model = load(folder, cart.text(-4, 4, block=WIRE))
    t, rng = 0.02 * np.arange(80), np.random.default_rng(3)
    u = np.interp(t, 0.2 * np.arange(9), rng.uniform(-4, 4, 9))[:, None]
    none, names = np.zeros((1, 0)), ("q.x", "measured.wire")
    path, _ = follow(model, (), t, u, Start(np.array([0.2]), np.zeros(1), none, none))
    out = compute_outputs(model, names, path, np.zeros((*path.shape, 0)))[0]
    out += rng.normal(size=out.shape) * [5e-4, noise] + [0, bias]
    np.savetxt(folder / "d.csv", np.column_stack((t, u, out)), delimiter=",",
               header=",".join(("t", "u.u", *names)), comments="")  # fmt: skip
    return model, str(folder / "robot.urdf"), str(folder / "d.csv")


def test_the_bias_of_a_sensor_is_tried_after_the_fit_is_printed(tmp_path, capsys, monkeypatch):
    _, robot, data = wired(tmp_path, 5e-4, 0.05)
    shown, tried_ones = [], []

    def watched(*words, **options):
        shown.append(capsys.readouterr().out)
        tried_ones.extend(hints(*words, **options))
        return tried_ones

    monkeypatch.setattr("softdyn.identification.hints.hints", watched)
    command.main([robot, data, "--hints"])
    after = capsys.readouterr().out
    assert "stiffness x" in shown[0]
    assert "stiffness x" not in after
    gains = {one.extension: one.after / one.before for one in tried_ones}
    assert {"friction", "sensor_bias"} <= gains.keys()
    assert min(gains, key=gains.__getitem__) == "sensor_bias"
    assert gains["sensor_bias"] < 0.3
    assert "sensor_bias" in after


@pytest.mark.parametrize("times", [1, 3])
def test_residuals_stand_beside_the_noise_of_the_file_s_sensors(tmp_path, times):
    model, _, data = wired(tmp_path, times * 5e-4, 0.0)
    found = identification.identify(
        model, identification.read_csv(data, model),
        identification.parameters(model, "stiffness"), hold_out=0,
    )  # fmt: skip
    beside = found.report()["file_noise"]
    assert beside["ratios"] == {"measured.wire": pytest.approx(times, rel=0.2)}
    assert beside["samples"] == 80
    assert beside["chi2"] == pytest.approx(80 * times**2, rel=0.4)
    assert (beside["p"] < 0.01) == (times > 1)
    assert "wire" in str(found)


def test_rows_left_out_and_refusals(tmp_path):
    (tmp_path / "arm.toml").write_text(SMALL)
    (tmp_path / "points.toml").write_text(POINTS)
    made = DesignFile(tmp_path / "arm.toml", tmp_path / "points.toml")
    model, rng = made.model, np.random.default_rng(4)
    u = rng.uniform(0, 4, (9, 3)) * (rng.uniform(size=(9, 3)) < 0.6)
    path, _ = rests(model, (), Inputs(u, np.zeros(3)), Around(model))
    out = compute_outputs(model, NAMES, path, np.zeros((*path.shape, 0)))[0]
    data = Measurements(np.arange(9.0), u, NAMES, out + 3e-4 * rng.normal(size=out.shape))
    acquisition = Acquisition(True, MarkerView.of(NAMES))
    unknowns = made.unknowns(["youngs_modulus"])
    found = identification.identify(model, data, unknowns, hold_out=0.0, acquisition=acquisition)
    residuals = left_out(found.fit, 3)
    assert np.isfinite(residuals).all()
    assert 0.8 < np.sqrt((residuals**2).mean() / (found.residuals**2).mean()) < 1.6
    with refused("folds", 10):
        left_out(found.fit, 10)
