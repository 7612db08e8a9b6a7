"""Rows at rest out of data over time: the plateaus of a staircase, against their closed form."""

import json

import numpy as np
import pytest

import softdyn
from softdyn import InputError, identification, statics
from softdyn.commands import identify as command
from softdyn.identification import Measurements, rest_rows
from softdyn.identification.data import csv_text

STEP, HOLD, RATE = 0.01, 2.0, 8.0  # s, s, 1/s: a first-order arm that follows u


def staircase(levels=(0.0, 1.0, 2.0, 0.5), noise=0.0, rate=RATE, gaps=False):
    """The exact answer of ẏ = rate (u - y) to steps, sampled."""
    t = np.arange(0.0, HOLD * len(levels), STEP)
    part = np.minimum((t / HOLD).astype(int), len(levels) - 1)
    u, y, before = np.array(levels)[part], np.empty_like(t), 0.0
    for k, level in enumerate(levels):
        inside = part == k
        y[inside] = level + (before - level) * np.exp(-rate * (t[inside] - k * HOLD))
        before = level + (before - level) * np.exp(-rate * HOLD)
    y += noise * np.random.default_rng(0).normal(size=len(t))
    if gaps:
        y[::3] = np.nan
    return Measurements(t, u[:, None], ("tip.x",), y[:, None])


@pytest.mark.parametrize(("noise", "gaps"), [(0.0, False), (0.05, False), (0.05, True)])
def test_each_plateau_is_one_row(noise, gaps):
    rows, moving = rest_rows(staircase(noise=noise, gaps=gaps))
    assert moving == 0
    np.testing.assert_array_equal(rows.u[:, 0], [0.0, 1.0, 2.0, 0.5])
    np.testing.assert_allclose(rows.outputs[:, 0], rows.u[:, 0], atol=2e-3 + 0.3 * noise)


def test_a_plateau_that_still_moves_is_left_out_and_counted():
    data = staircase((0.0, 0.01, 0.0, 0.01, 2.0), rate=1.5)
    rows, moving = rest_rows(data)
    assert (len(rows.t), moving) == (4, 1)
    assert rows.u.max() == pytest.approx(0.01)


@pytest.mark.parametrize("hold", [3.0, 0.0, np.nan])
def test_too_few_rows_and_a_bad_time_are_one_line(hold):
    with pytest.raises(InputError):
        rest_rows(staircase(), hold)


def test_the_command_writes_rows_that_give_the_same_fit(tmp_path, capsys):
    model, rng = softdyn.load("finger"), np.random.default_rng(2)
    levels = rng.uniform(-0.2, 0.3, (5, model.nu)) * model.u_max
    rests = np.array([statics.settle(model, u).q for u in levels])
    u, q = np.repeat(levels, 20, axis=0), np.repeat(rests, 20, axis=0)
    q += 1e-4 * rng.normal(size=q.shape)
    names = tuple(f"q.{name}" for name in model.joint_names)
    data = Measurements(0.1 * np.arange(len(u)), u, names, q)
    log, rows = tmp_path / "log.csv", tmp_path / "rows.csv"
    log.write_text(csv_text(data, model))
    fits = []
    for how in ((str(log), "--rests", "--rows", str(rows)), (str(rows), "--static")):
        code = command.main(["finger", *how, "--free", "stiffness", "--json", "-"])
        found = json.loads(capsys.readouterr().out)
        fits.append((code, found["parameters"]))
    assert fits[0] == fits[1]
    titles, *lines = rows.read_text().splitlines()
    assert titles.split(",") == ["t (s)", *(f"u.{a.name}" for a in model.robot.actuators), *names]
    means = q.reshape(5, 20, -1)[:, 10:].mean(1)  # the last half of each stretch
    np.testing.assert_allclose([[float(x) for x in line.split(",")[1:]] for line in lines],
                               np.hstack((levels, means)), rtol=1e-12)  # fmt: skip


def test_gaps_and_directions_are_written_and_read_again(tmp_path):
    model, path = softdyn.load("finger"), tmp_path / "rows.csv"
    way = np.sign(np.arange(3 * model.nu) - 2.0).reshape(3, -1)
    data = Measurements(
        np.array([0.1, 0.25, 1 / 3]), np.full((3, model.nu), 0.1), ("tip.x", "tip.z"),
        np.array([[0.1, np.nan], [0.2, -0.1], [np.nan, 1 / 7]]), way,
    )  # fmt: skip
    path.write_text(csv_text(data, model))
    read = identification.read_csv(path, model, static=True)
    for name in ("t", "u", "outputs", "direction"):
        np.testing.assert_array_equal(getattr(read, name), getattr(data, name))
    assert read.names == data.names
