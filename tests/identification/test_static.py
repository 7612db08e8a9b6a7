"""Static rows, and the design of an arm: data from known values, seen by a turned camera."""

from __future__ import annotations

import json
import re
import sys
import tomllib
from functools import partial

import numpy as np
import pytest
from tqdm import tqdm

import softdyn
from softdyn import identification, statics
from softdyn.actuation.capstan import Capstan
from softdyn.commands import identify as command
from softdyn.dynamics.mimic import build
from softdyn.identification import DesignFile, Marker, Measurements, output_error
from softdyn.identification.blocks import ResidualBlock
from softdyn.identification.intervals import half_widths
from softdyn.identification.markers.camera import MarkerView, seen_at
from softdyn.identification.output_error import make_problem
from softdyn.identification.outputs import compute_outputs
from softdyn.identification.parameters import neighbours_of
from softdyn.identification.problem import Acquisition, idle
from softdyn.identification.rests import Inputs, rests, slid
from softdyn.identification.unknowns.kinds import Around
from softdyn.statics.friction import follow
from tests.support.refused import refused

ARM = """\
name = "arm"
[material]  # silicone
youngs_modulus_MPa = 0.30  # a first guess
poissons_ratio = 0.45
density_kg_m3 = 1100
[[section]]
length_mm = 200
radius_mm = [12, 8]
segments = 6
[[cable]]
name = "pull"
count = 3
offset_mm = [9, 6.0] # tapers
routing = "channel"
max_tension_N = 6
"""
POINTS = """\
[[point]]
name = "a"
s_mm = 80
offset_mm = [0, 0, 15]
[[point]]
name = "b"
s_mm = 140
offset_mm = [0, 0, -15]
[[point]]
name = "c"
s_mm = 200
offset_mm = [5, 0, 0]
"""
CAMERA = np.array([0.3, -0.2, 1.0, 0.4, 1.2, -0.8])


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "arm.toml").write_text(ARM)
    (tmp_path / "points.toml").write_text(POINTS)
    return DesignFile(tmp_path / "arm.toml", tmp_path / "points.toml")


def poses(model, names, rng, rows, noise):
    """Markers at rest under random inputs, in the world's frame."""
    u = rng.uniform(0, 0.8, (rows, model.nu)) * model.u_max
    path = np.array([model.coordinates(statics.settle(model, one).q) for one in u])
    out, _ = compute_outputs(model, names, path, np.zeros((rows, model.nv, 0)))
    return u, out + noise * rng.normal(size=out.shape)


def written(path, model, u, names, out):
    titles = [*(f"u.{one.name}" for one in model.robot.actuators), *names]
    cells = [["" if np.isnan(x) else f"{x:.9g}" for x in row] for row in np.hstack((u, out))]
    path.write_text("\n".join(",".join(row) for row in [titles, *cells]) + "\n")
    return str(path)


def test_a_design_from_relabelled_markers_with_gaps_in_an_unknown_frame(arm, tmp_path, capsys):
    true = {"youngs_modulus material": 0.42e6, "offset cable pull [2]": 0.005}
    model, rng = arm.model_of(true), np.random.default_rng(3)
    names = [f"point.{m}.{a}" for m in "abc" for a in "xyz"]
    u, out = poses(model, names, rng, 30, 1e-3)
    seen = seen_at(CAMERA, out.reshape(-1, 3, 3))
    for row in seen:
        row[:] = row[rng.permutation(3)]
    seen[3, 1] = seen[8, 0] = seen[20] = np.nan
    data = written(tmp_path / "data.csv", model, u, names, seen.reshape(-1, 9))
    base = [str(arm.path), data, "--static", "--points", str(tmp_path / "points.toml")]
    free = ["--free", "youngs_modulus", "offset.2", "--camera", "fit", "--relabel"]
    out_file = tmp_path / "found.toml"
    page = str(tmp_path / "page.html")
    code = command.main([*base, *free, "--json", "-", "--out", str(out_file), "--html", page])
    report = json.loads(capsys.readouterr().out)
    assert code == 0
    assert len(report["parameters"]) == 8
    for one in report["parameters"]:
        assert one["identifiable"]
        assert one["low"] < one["value"] < one["high"]
    modulus, offset = report["parameters"][:2]
    assert (modulus["kind"], modulus["member"], modulus["unit"]) == (
        "youngs_modulus", "material", "Pa",
    )  # fmt: skip
    for one, truth in ((modulus, 0.42e6), (offset, 0.005)):
        assert one["value"] == pytest.approx(truth, rel=0.02)
        assert one["low"] < truth < one["high"]
    assert 0.001 < report["rms_held_out"] < 0.0025
    # the design's text keeps its comments, and its values are those found
    text = out_file.read_text()
    assert "# a first guess" in text
    assert "# tapers" in text
    table = tomllib.loads(text)
    assert table["material"]["youngs_modulus_MPa"] == pytest.approx(modulus["value"] / 1e6)
    assert table["cable"][0]["offset_mm"] == [9, pytest.approx(1e3 * offset["value"])]
    assert "Ljung" not in (tmp_path / "page.html").read_text()


def test_derivatives_of_equilibria_by_the_design_and_the_camera(arm):
    model = arm.model
    names = tuple(f"point.{m}.{a}" for m in "abc" for a in "xyz")
    rng = np.random.default_rng(5)
    u, out = poses(model, names, rng, 4, 0.0)
    unknowns = arm.unknowns(["youngs_modulus", "length"], ["offset"])
    unknowns += identification.camera_unknowns(CAMERA)
    view = MarkerView.of(names, CAMERA)
    data = Measurements(np.arange(4.0), u, names, out)
    problem = make_problem(model, data, unknowns, acquisition=Acquisition(True, view))
    theta = np.array([one.nominal for one in unknowns])
    (run,) = problem.simulated(theta, problem.firsts())
    assert [one.label for one in unknowns[:3]] == [
        "youngs_modulus material", "length section section_1", "offset, all",
    ]  # fmt: skip
    for k, one in enumerate(unknowns):
        step = 1e-5 * max(abs(theta[k]), 1e-3 * one.scale) * np.eye(len(theta))[k]
        ends = [problem.outputs(theta + s * step, problem.firsts())[0] for s in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * step[k])
        np.testing.assert_allclose(run.by_theta[:, :, k], slope, rtol=1e-3, atol=1e-4)


def test_words_that_choose_numbers(arm):
    def labels(*words):
        return [one.label for one in arm.unknowns(words)]

    assert labels("offset") == ["offset cable pull [1]", "offset cable pull [2]"]
    assert labels("offset.2", "radius.1") == [
        "offset cable pull [2]",
        "radius section section_1 [1]",
    ]
    assert labels("offset.pull.1", "density.material") == [
        "offset cable pull [1]", "density material",
    ]  # fmt: skip
    for word in ("youngs_modul", "segments", "material"):
        with refused(word):
            arm.unknowns([word])
    with refused("design", "twice: offset cable pull [1], offset cable pull [2], offset.2, all"):
        arm.unknowns(["offset"], ["offset.2"])
    assert neighbours_of(arm.model, (), np.zeros(0)) == ()
    assert Around(arm.model).neighbours == ()


def test_a_design_is_rewritten_in_any_layout(tmp_path):
    layout = "[9, # at the base\n 6.0]"
    text = ARM.replace("[9, 6.0]", layout)
    assert text != ARM
    (tmp_path / "arm.toml").write_text(text)
    made = DesignFile(tmp_path / "arm.toml")
    assert made.rewrite({}) == text
    changed = made.rewrite({"offset cable pull [2]": 0.005})
    assert changed == text.replace(layout, layout.replace("6.0", "5.0"))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda u, out: (102 * u, out), "another unit, such as grams or mN"),
        (lambda u, out: (u, 1e3 * out), "millimetres?"),
        (lambda u, out: (u, out[:, [3, 4, 5, 0, 1, 2, 6, 7, 8]]), "a and point.b are probably exc"),
        (lambda u, out: (u, out[:, [0, 2, 1, 3, 5, 4, 6, 8, 7]] * ([1, 1, -1] * 3)), "turned by"),
    ],
)  # fmt: skip
def test_wrong_data_is_one_line(arm, tmp_path, capsys, spoil, message):
    names = [f"point.{m}.{a}" for m in "abc" for a in "xyz"]
    u, out = poses(arm.model, names, np.random.default_rng(9), 12, 1e-3)
    data = written(tmp_path / "d.csv", arm.model, *[spoil(u, out)[0]], names, spoil(u, out)[1])
    points = str(tmp_path / "points.toml")
    code = command.main(
        [str(arm.path), data, "--static", "--points", points, "--free", "youngs_modulus"]
    )
    error = capsys.readouterr().err
    assert code == 2
    assert message in error
    assert len(error.splitlines()) == 1


def test_a_robot_s_stiffness_from_its_markers(tmp_path, capsys):
    """The finger's three links; an unidentifiable damping is named."""
    finger = softdyn.load("finger")
    links = [link.name for link in finger.robot.links]
    markers = [Marker(f"m{k}", links[k], xyz=(0.01, 0.004, 0.0)) for k in (2, 3, 4)]
    model = build(identification.marked(finger.robot, markers))
    springs = identification.parameters(model, "stiffness")
    true = identification.apply_values(model, springs, np.array([1.2, 0.8, 1.1, 0.9]) * 0.01)
    rng = np.random.default_rng(11)
    names = tuple(f"point.m{k}.{a}" for k in (2, 3, 4) for a in "xyz")
    u = rng.uniform(finger.u_min, finger.u_max, (40, 2)) * 0.2
    path = np.array([model.coordinates(statics.settle(true, one).q) for one in u])
    out, _ = compute_outputs(true, names, path, np.zeros((40, 4, 0)))
    data = Measurements(np.arange(40.0), u, names, out + 1e-3 * rng.normal(size=out.shape))
    data, acquisition = identification.prepared(model, data, static=True)
    unknowns = (*springs, *identification.parameters(model, "damping", shared=True))
    found = identification.identify(model, data, unknowns, acquisition=acquisition)
    assert found.unidentifiable == ("damping, all",)
    for one, truth in zip(found.estimates, np.array([1.2, 0.8, 1.1, 0.9]) * 0.01, strict=False):
        assert one.interval[0] < truth < one.interval[1]
    dampers = identification.parameters(model, "damping")
    with refused("data", "none of 4 (damping joint1; damping joint2; damping joint3; …)"):
        identification.identify(model, data, dampers, acquisition=acquisition)


def test_a_terminal_shows_how_many_unknowns_are_fitted(monkeypatch, capsys):
    finger = softdyn.load("finger")
    names = ("tip.x", "tip.y", "tip.z")
    u = np.linspace(0, 0.1, 12)[:, None] * finger.u_max
    tips = [finger.state(statics.settle(finger, one).q, np.zeros(4)).y for one in u]
    data = Measurements(np.arange(12.0), u, names, np.array(tips))
    springs = identification.parameters(finger, "stiffness", shared=True)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    # each step is drawn, however fast the fit is
    monkeypatch.setattr(output_error, "tqdm", partial(tqdm, mininterval=0.0, miniters=1))
    found = identification.identify(
        finger, data, springs, acquisition=Acquisition(static=True), hold_out=0, progress=True
    )
    assert re.search(r"1 unknowns, 12 rows: [1-9]\d* simulations", capsys.readouterr().err)
    assert found.fit.problem.tick is idle  # the bar is gone


def test_intervals_allow_errors_that_a_pose_shares():
    rng = np.random.default_rng(1)
    J, groups = np.ones((60, 1)), np.repeat(np.arange(10), 6)
    white, shared = rng.normal(size=60), np.repeat(rng.normal(size=10), 6)
    alone = half_widths(ResidualBlock(white, J, np.zeros((60, 0))), groups)
    wide = half_widths(ResidualBlock(shared, J, np.zeros((60, 0))), groups)
    assert alone[0] == pytest.approx(2.0 / np.sqrt(60), rel=0.3)
    assert wide[0] == pytest.approx(2.26 / np.sqrt(10), rel=0.5)


def rubbing(arm, mu=0.1):
    """The arm with cables that rub, and a file for it."""
    path = arm.path.with_name("rubbing.toml")
    path.write_text(ARM.replace("max_tension", f"friction = {mu}\nmax_tension"))
    return DesignFile(path, arm.points)


def test_rests_with_friction_balance_and_their_derivatives(arm):
    """The balance is written out from the capstan equation of the cable's bends, joint by joint."""
    made = rubbing(arm, 0.15)
    model, rng = made.model, np.random.default_rng(2)
    u = rng.uniform(0.5, 4, (3, 3))
    way = np.array([[1.0, -1, 1], [-1, 1, 1], [1, 1, -1]])
    names = tuple(f"point.{m}.{a}" for m in "abc" for a in "xyz")
    unknowns = made.unknowns(["cable_friction", "youngs_modulus", "input_loss"])
    data = Measurements(np.arange(3.0), u, names, rng.normal(size=(3, 9)), way)
    problem = make_problem(model, data, unknowns, acquisition=Acquisition(True))
    theta = np.array([one.nominal for one in unknowns])
    theta[2:] = 0.2
    (run,) = problem.simulated(theta, problem.firsts())
    for k in range(len(theta)):
        step = 1e-4 * max(theta[k], 1e-3) * np.eye(len(theta))[k]
        ends = [problem.outputs(theta + s * step, problem.firsts())[0] for s in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * step[k])
        np.testing.assert_allclose(run.by_theta[:, :, k], slope, rtol=1e-3, atol=1e-5)
    inputs = Inputs(u, np.full(3, 0.2), way)
    path, _ = rests(model, (), inputs, Around(model))
    for q, row, sign in zip(path, u, way, strict=True):
        state = model.state(q, np.zeros(model.nv))
        tau = state.K + state.g
        for tendon, pull, d in zip(model.robot.tendons, row - 0.2 * sign, sign, strict=True):
            behind = 1.0
            for term in tendon.terms:  # half of each bend's arm is before its guide
                j = model.joint_names.index(term.joint)
                before, behind = behind, behind * np.exp(-d * 0.15 * abs(q[j]))
                tau[j] += pull * term.coef * (before + behind) / 2
        assert np.abs(tau).max() < 1e-5 * np.abs(state.K).max()


def test_the_last_direction_from_the_order_of_the_rows(arm):
    """A loop of one input: pulled in on the way up, paid out on the way down."""
    made = rubbing(arm)
    u = np.zeros((5, 3))
    u[:, 0] = [1, 2, 3, 2, 1]
    told = np.array([[1.0, -1, -1]] * 3 + [[-1.0, 1, 1]] * 2)
    free, stated = (
        rests(made.model, (), Inputs(u, np.zeros(3), way), Around(made.model))[0]
        for way in (None, told)
    )
    np.testing.assert_allclose(free, stated, atol=1e-9)
    assert np.linalg.norm(free[1]) < np.linalg.norm(free[3])  # hysteresis


def test_rows_in_which_a_cable_slid_back_only_in_part(arm):
    """The capstan equation: a cable slides back all along when its tension is below e^(-2 μ Σ|q|).

    Until then no joint moves where it sticks, so Σ|q| is about that at the turn.
    """
    made, u = rubbing(arm, 0.3), np.zeros((4, 3))
    model = made.model
    bend = np.abs(
        rests(model, (), Inputs(u + 4 * np.eye(3)[0], np.zeros(3)), Around(model))[0][0]
    ).sum()
    back = 4 * np.exp(-2 * 0.3 * bend)
    assert 1 < back < 3
    u[:, 0] = 2, 4, (4 + back) / 2, 0.85 * back
    way, whole = slid(model, u, np.zeros(3))
    assert whole.tolist() == [True, True, False, True]
    assert way[[0, 1, 3], 0].tolist() == [1, 1, -1]
    u[:, 0] = 2, 4, 3.5, 2.9  # a motor whose friction takes 0.4 N holds 3.6 N, then 3.3 N
    _, whole = slid(made.model_of({"friction cable pull": 0.0}), u, np.array([0.4, 0, 0]))
    assert whole.tolist() == [True, True, False, True]


def test_friction_from_a_ramp_whose_cables_slid_back_only_in_part(arm):
    """Rows of a slow motion; those between two directions are left out, with a count."""
    path = arm.path.with_name("two.toml")
    text = ARM.replace("max_tension", "friction = 0.05\nmax_tension")
    path.write_text(text.replace("segments = 6", "segments = 2").replace("count = 3", "count = 1"))
    made = DesignFile(path, arm.points)
    true, rng = made.model_of({"friction cable pull": 0.2}), np.random.default_rng(5)
    ramp = np.concatenate([np.linspace(1, 5, 4), np.linspace(4.6, 0.6, 8), [2.0, 3.5]])
    steps = np.interp(np.arange(1, 2 * len(ramp) + 1) / 2, range(len(ramp) + 1), [0, *ramp])
    u, slow = ramp[:, None], follow(Capstan(true), [np.zeros(1), *steps[:, None]])[2::2]
    names = tuple(f"point.{m}.{a}" for m in "abc" for a in "xyz")
    q = np.array([true.coordinates(rest.state.q) for rest in slow])
    out = compute_outputs(true, names, q, np.zeros((*q.shape, 0)))[0]
    data = Measurements(np.arange(float(len(u))), u, names, out + 1e-3 * rng.normal(size=out.shape))
    unknowns = made.unknowns(["cable_friction", "youngs_modulus"])
    found = identification.identify(
        made.model, data, unknowns, hold_out=0.0, acquisition=Acquisition(static=True)
    )
    for one, truth in zip(found.estimates, (0.2, 0.3e6), strict=True):
        assert abs(one.value - truth) < 1.5 * one.half < 0.5 * truth
    left_out = len(u) - len(found.fit.problem.data.t)
    assert 1 <= left_out <= 8
    assert any(
        line.startswith(f"{left_out} of {len(u)} rows") for line in identification.doubts(found)
    )


def test_friction_of_cables_from_static_rows(arm, tmp_path, capsys):
    made = rubbing(arm, 0.05)
    true, rng = made.model_of({"friction cable pull": 0.1}), np.random.default_rng(7)
    names = [f"point.{m}.{a}" for m in "abc" for a in "xyz"]
    u = np.concatenate([np.linspace(0, 5, 5), np.linspace(4.4, 0.3, 4)])[:, None] * [1, 0, 0]
    u = np.concatenate((u, np.roll(u, 1, axis=1)))
    path, _ = rests(true, (), Inputs(u, np.zeros(3)), Around(true))
    out = compute_outputs(true, names, path, np.zeros((*path.shape, 0)))[0]
    out += 1e-3 * rng.normal(size=out.shape)
    data = written(tmp_path / "d.csv", true, u, names, out)
    base = [str(made.path), data, "--static", "--points", str(arm.points), "--hold-out", "0"]
    assert command.main([*base, "--free", "cable_friction", "youngs_modulus", "--json", "-"]) == 0
    mu, modulus = json.loads(capsys.readouterr().out)["parameters"]
    assert (mu["kind"], mu["member"]) == ("friction", "cable pull")
    assert mu["low"] < 0.1 < mu["high"] < 0.15
    assert modulus["low"] < 0.3e6 < modulus["high"]
