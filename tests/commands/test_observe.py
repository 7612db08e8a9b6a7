"""`softdyn observe`: tables, pictures, recorded data, refusals."""

from __future__ import annotations

import json

import numpy as np
import pytest

import softdyn
from softdyn import SetPoint, statics
from softdyn.description.urdf_writer import write
from softdyn.estimation import Ekf, observe, observe_run
from softdyn.sensing import Sensors
from softdyn.validation import Rig, simulate
from tests.support.command import command
from tests.support.rigs import sensed, sensors

RIG = "lengths=0.0005@1000,tip=0.001@60+0.03"


def test_more_sensors_see_more():
    """A wrong start is forgotten with a camera; two lengths alone leave directions open."""
    model = softdyn.load("finger")
    rest, given = statics.settle(model, np.array([0.3, 0.1])), sensors(model)
    lengths, both = (observe(rest, which, period=0.005) for which in (given[:2], given))
    assert lengths.seen < both.seen <= both.free == 4
    assert both.tip < 0.5 * lengths.tip
    assert both.forgotten is not None
    assert both.shape_error[-1] < 0.2 * both.shape_error[0]
    assert np.all(both.deviations < both.blind)
    assert both.links[model.robot.task] == pytest.approx(both.tip, rel=1e-4)
    assert both.links[model.robot.root] == 0


def test_a_filter_of_a_right_model_has_the_expected_error():
    """At rest, with the noise of the readings and the default, adaptive process noise."""
    model, rng = softdyn.load("finger"), np.random.default_rng(5)
    rest, given = statics.settle(model, np.array([0.3, 0.1])), sensors(model)
    expected = observe(rest, given, period=0.005)
    truth = model.state(rest.q, np.zeros(model.nv))
    ideal = Sensors(model, given).measure(truth, rest.u).values
    noise = np.array([5e-4, 5e-4, 1e-3, 1e-3, 1e-3])
    observer = Ekf(model, given, start=(rest.q, np.zeros(model.nv)))
    observer.reset(u=rest.u)
    missed = []
    for k in range(600):
        found = observer.step(0.005 * k, ideal + noise * rng.normal(size=5), rest.u)
        missed.append(model.state(found.q, found.v).y - truth.y)
    error = np.sqrt(np.mean(np.sum(np.square(missed[200:]), axis=1)))
    assert 0.5 < error / expected.tip_if_right < 2
    assert expected.tip_if_right < 0.2 * expected.tip


def test_table_and_picture(tmp_path):
    done = command(
        "observe", "finger", "--sensors", RIG, "--seconds", "0.2", "--period", "0.005",
        "--plot", tmp_path / "seen.png", "--json", tmp_path / "seen.json",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert "is forgotten after" in done.out
    assert (tmp_path / "seen.png").stat().st_size > 5000
    report = json.loads((tmp_path / "seen.json").read_text())
    assert [row["joint"] for row in report["joints"]] == list(softdyn.load("finger").joint_names)


def test_along_a_run(tmp_path):
    """From a wrong start the error falls to the expected one while the arm moves."""
    model, path = softdyn.load("finger"), tmp_path / "run.npz"
    law = lambda state, _: np.array([0.4, -0.2]) * np.cos(4 * state.q[0] + 2)  # noqa: E731
    log = simulate(model, law, SetPoint(np.array([0.2, 0.0, 0.0])), duration=1.0, period=0.005)
    log.save(path)
    states = [model.state(q, v) for q, v in zip(log.q, log.v, strict=True)]
    commands, moved = [log.u[0], *log.u], np.linalg.norm(np.ptp(log.y, axis=0))
    errors = []
    for seed in range(4):
        found = observe_run(
            model, log.t, states, np.zeros(2), commands, sensors(model, rate=60.0, latency=0.03),
            seed=seed,
        )  # fmt: skip
        assert found.forgotten is not None
        errors.append(found.tip_error[-1] / found.tip)
    assert moved > 0.05
    assert len(set(errors)) == 4
    assert np.sqrt(np.mean(np.square(errors))) < 2
    done = command("observe", "finger", "--sensors", RIG, "--log", path, "--json", "-")
    assert done.code == 0, done.err
    assert json.loads(done.out)["wrong_start_forgotten_s"] < 1
    done = command("observe", "helix", "--sensors", RIG, "--log", path)
    assert done.code == 2
    assert "a run of helix" in done.err


def test_recorded_data(tmp_path):
    """The CSV of a rigged run: white residuals; a bias that the file does not state is found."""
    file, data = tmp_path / "finger.urdf", tmp_path / "run.csv"
    file.write_text(write(sensed("finger", rate=60.0, latency=0.03).robot), encoding="utf-8")
    model = softdyn.load(file)
    law = lambda state, _: np.array([0.3, -0.1]) * np.cos(8 * state.q[0] + 3)  # noqa: E731
    log = simulate(
        model, law, SetPoint(np.array([0.2, 0.0, 0.0])), duration=3.0, period=0.005,
        rig=Rig(seed=3), observer=Ekf(model),
    )  # fmt: skip
    log.to_csv(data)
    done = command("observe", file, "--data", data, "--json", "-")
    assert done.code == 0, done.err
    clean = json.loads(done.out)
    assert [row["name"] for row in clean["residuals"]] == list(log.sensor_names)
    # the finger is planar, so that its simulated camera never draws new noise of y
    moved = [row for row in clean["residuals"] if row["name"] != "camera.y"]
    assert all(0.3 < row["normalised"] < 1.5 for row in moved)
    head, *rows = data.read_text().splitlines()
    column = [k for k, title in enumerate(head.split(",")) if title.startswith("measured.camera.x")]
    rows = [row.split(",") for row in rows]
    for k, row in enumerate(rows):
        row[column[0]] = "" if k % 7 == 0 else str(float(row[column[0]]) + 0.01)
    data.write_text("\n".join([head, *map(",".join, rows)]))
    found = json.loads(command("observe", file, "--data", data, "--json", "-").out)
    before, after = clean["residuals"][2], found["residuals"][2]
    assert after["mean"] > 5 * after["error"] + abs(before["mean"])
    assert found["counts"]["skipped"] > 10
    assert after["bias"]
    assert not before["bias"]
    (line,) = (
        x for x in command("observe", file, "--data", data).out.splitlines() if "camera.x" in x
    )
    assert "bias?" in line


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--sensors", "tip"], "KIND=NOISE"),
        (["--sensors", "radar=1"], "KIND=NOISE"),
        (["--sensors", "tip=-1"], "a finite number >= 0"),
        (["--sensors", "tip=x"], "a number"),
        ([], "a list, the file having none"),
        (["--sensors", "tip=0.001", "--disturbances", "wind"], "tip_force or payload"),
        (["--sensors", "tip=0.001", "--data", "none.csv"], "none.csv"),
    ],
)
def test_refusals(words, said):
    done = command("observe", "finger", *words)
    assert done.code == 2
    assert said in done.err
    assert done.err.count("\n") == 1
