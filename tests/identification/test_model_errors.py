"""A discrepancy model of an arm whose cables share tension, which the fitted model lacks."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from softdyn import InputError, identification
from softdyn.commands import identify as command
from softdyn.identification import DesignFile, MarkerView, Measurements
from softdyn.identification.model_errors.discrepancy import (
    fit_discrepancy,
    gain_of,
    left_out,
    predicted,
    shapes_of,
)
from softdyn.identification.outputs import measured_outputs
from softdyn.identification.problem import Acquisition
from softdyn.identification.rests import Inputs, rests
from softdyn.identification.unknowns.kinds import Around
from tests.identification.test_static import ARM, POINTS, written

NAMES = tuple(f"point.{m}.{a}" for m in "abc" for a in "xyz")


@pytest.fixture(scope="module")
def bent(tmp_path_factory):
    """The arm's file, and 15 rows in which a cable's tension is partly in the next one too."""
    folder = tmp_path_factory.mktemp("bent")
    (folder / "arm.toml").write_text(ARM)
    (folder / "points.toml").write_text(POINTS)
    made, rng = DesignFile(folder / "arm.toml", folder / "points.toml"), np.random.default_rng(4)
    model = made.model
    u = rng.uniform(0, 4, (15, 3)) * (rng.uniform(size=(15, 3)) < 0.6)
    B = model.state(np.zeros(model.nq), np.zeros(model.nv)).B
    force = 0.2 * np.roll(u, 1, axis=1) @ B.T
    path, _ = rests(model, (), Inputs(u, np.zeros(3), force=force), Around(model))
    out = measured_outputs(model, NAMES, path, np.zeros((*path.shape, 0)))[0]
    out += 3e-4 * rng.normal(size=out.shape)
    return made, Measurements(np.arange(15.0), u, NAMES, out)


@pytest.fixture(scope="module")
def found(bent):
    made, data = bent
    taken = Acquisition(True, MarkerView.of(NAMES))
    unknowns = made.unknowns(["youngs_modulus"])
    return identification.identify(made.model, data, unknowns, hold_out=0.0, taken=taken)


def test_missing_forces_are_found_and_their_gain_is_on_unseen_rows(found):
    model = fit_discrepancy(found.fit)
    gain = gain_of(found.fit, model)
    assert gain.fitted[0] == pytest.approx(found.rms)
    assert gain.fitted[1] < 0.5 * gain.fitted[0]
    assert gain.fitted[1] < gain.unseen[1] < 0.7 * gain.unseen[0]
    assert f"{1e3 * gain.unseen[1]:.3g}" in str(gain)
    nothing = replace(model, weights=np.zeros_like(model.weights))
    plain = predicted(found.fit.problem, found.fit.theta, nothing)
    np.testing.assert_allclose(plain, found.data.outputs - found.residuals, atol=1e-12)


def test_shapes_are_smooth_and_of_one_axis(bent):
    shapes = shapes_of(bent[0].model)
    np.testing.assert_allclose(shapes.T @ shapes, np.eye(6), atol=1e-12)
    for name, row in zip(bent[0].model.joint_names, shapes, strict=True):
        y, z = np.abs(row[:3]).max() > 1e-9, np.abs(row[3:]).max() > 1e-9
        first = bent[0].model.joint_names[0].startswith("bend_y")
        assert (y, z) == ((True, False) if name.startswith("bend_y") == first else (False, True))


def test_rows_left_out_and_refusals(found):
    residuals = left_out(found.fit, 3)
    assert np.isfinite(residuals).all()
    assert 0.8 < np.sqrt((residuals**2).mean() / (found.residuals**2).mean()) < 1.6
    with pytest.raises(InputError, match="2 to 15 parts of static rows, 4 or more, got 16"):
        left_out(found.fit, 16)


def test_the_command_states_the_gain(bent, tmp_path, capsys):
    made, data = bent
    rows = written(tmp_path / "d.csv", made.model, data.u, NAMES, data.outputs)
    base = [str(made.path), rows, "--static", "--points", str(made.points), "--hold-out", "0"]
    free = ["--free", "youngs_modulus", "--folds", "3"]
    code = command.main([*base, *free, "--discrepancy", str(tmp_path / "m.json")])
    text = capsys.readouterr().out
    assert code == 0
    assert "discrepancy model, rms x 1000" in text
    assert "on rows left out, in 3 parts" in text
    made = json.loads((tmp_path / "m.json").read_text())
    assert made["unseen"][1] < made["unseen"][0]
