"""The generator against closed forms: what docs/rods.md claims, and the bars it is held to."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from softdyn.commands import new
from tests.proof.rods import closed_forms, tables
from tests.proof.rods.closed_forms import Rod
from tests.support import ROOT
from tests.support.arms import THREE_SECTIONS

CASES = {case.name: case for case in tables.cases()}


@pytest.fixture(scope="module")
def ladders():
    """By rule and name, at 5, 10 and 20 joints; those of two freedoms at 10."""
    names = [name for name in CASES if "180" not in name and "45°" not in name]
    found = tables.run((5, 10, 20), [CASES[name] for name in names])
    return {rule: {x.name: x for x in ladders} for rule, ladders in found.items()}


def test_gauss_nodes_meet_their_bars(ladders):
    gauss = ladders["gauss"]
    for name, ladder in gauss.items():
        at_10 = ladder.errors[1]
        if name.startswith("small force"):
            assert max(ladder.errors) < 1e-11
        elif name.startswith("frequency"):
            assert at_10 <= 2e-3
        elif "60°" in name:
            assert at_10 <= 1e-3
        elif "90°" in name:
            assert at_10 <= 2e-3
    for k, bar in ((1, 3e-5), (2, 3e-3), (3, 2.5e-2)):
        slender = gauss[f"frequency {k} (Rayleigh, r/L 0.001)"]
        assert slender.errors[0] < bar
        assert slender.orders[1] == pytest.approx(4, abs=0.3)
    assert gauss["dead force, tip at 83° (elastica)"].order == pytest.approx(2, abs=0.1)


def test_midpoints_are_second_order(ladders):
    for name, ladder in ladders["midpoint"].items():
        assert ladder.order == pytest.approx(2, abs=0.15), name


def test_gauss_is_the_better_default(ladders):
    for name, gauss in ladders["gauss"].items():
        assert max(gauss.errors) <= max(ladders["midpoint"][name].errors), name


def test_the_document_s_table_is_what_the_command_writes(ladders):
    text = (ROOT / "docs" / "rods.md").read_text(encoding="utf-8")
    for rule in ladders:
        ladder = ladders[rule]["cable in a channel, 90° (constant curvature)"]
        cells = " | ".join(f"{error:.1e}" for error in ladder.errors)
        assert f"| {ladder.name} | {cells} |" in text


def test_straight_cables_between_discs_bend_more():
    excess = tables.disc_excess((20, 40))
    # 2 (d/2 cos θ/2 - r sin θ/2) between two discs; balance of T and EI/d at each joint
    d, r = 1 / 20, 0.8 * 0.01
    tension = math.radians(60) / r
    theta = 0.05
    for _ in range(200):
        theta = tension * d * (r * math.cos(theta / 2) + d / 2 * math.sin(theta / 2))
    assert excess[0] == pytest.approx(20 * theta / math.radians(60) - 1, rel=1e-6)
    assert excess[1] == pytest.approx(excess[0] / 4, rel=0.1)


# --- the closed forms themselves, by other means -------------------------------------------------


def test_frequencies_of_textbooks():
    rod = Rod(2.0, 0.01, 3e9, 0.3, 1200.0)
    unit = math.sqrt(rod.EI / (rod.density * rod.area * 2.0**4)) / (2 * math.pi)
    expected = np.square([1.8751040687, 4.6940911330, 7.8547574382]) * unit
    np.testing.assert_allclose(closed_forms.bernoulli_frequencies(rod), expected, rtol=1e-9)
    # first order in rotary inertia, by Rayleigh's quotient with the mode shapes
    thin = closed_forms.rayleigh_frequencies(rod) / expected - 1
    x = np.linspace(0, 1, 20001)
    for k, beta in enumerate((1.8751040687, 4.6940911330, 7.8547574382)):
        s = (math.cosh(beta) + math.cos(beta)) / (math.sinh(beta) + math.sin(beta))
        w = np.cosh(beta * x) - np.cos(beta * x) - s * (np.sinh(beta * x) - np.sin(beta * x))
        slope = np.gradient(w, x)
        share = np.trapezoid(slope**2, x) / np.trapezoid(w**2, x) * (0.005 / 2.0) ** 2
        assert thin[k] == pytest.approx(-share / 2, rel=2e-3)


def test_elastica_by_a_boundary_value_problem():
    rod = Rod(1.5, 0.01, 1e6, 0.3, 1.0)
    force, (along, across) = closed_forms.elastica(rod, math.radians(83))

    def slope(s, y):  # angle, curvature, and the two coordinates
        return np.array([y[1], -force * np.cos(y[0]) / rod.EI, np.cos(y[0]), np.sin(y[0])])

    def ends(a, b):
        return np.array([a[0], b[1], a[2], a[3]])

    s = np.linspace(0, rod.length, 200)
    guess = np.array([1.4 * s / 1.5, 0 * s + 1, 0.6 * s, 0.7 * s])
    found = solve_bvp(slope, ends, s, guess, tol=1e-10, max_nodes=20000)
    assert found.success
    np.testing.assert_allclose(found.y[:, -1], [math.radians(83), 0, along, across], atol=1e-7)


# --- the command ---------------------------------------------------------------------------------


ROD = """\
[material]
youngs_modulus_MPa = 0.25
[[section]]
length_mm = 200
radius_mm = [15, 10]
[[cable]]
offset_mm = [12, 8]
routing = "channel"
max_tension_N = 5
"""


def test_converge_a_file(tmp_path, capsys):
    file = tmp_path / "rod.toml"
    file.write_text(ROD)
    segments = ["--segments", "5", "10", "20", "40"]
    assert new.main([str(file), "--converge", *segments, "--tolerance", "2e-3", "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    found = {row["quantity"]: row for row in report["quantities"]}
    assert len(found) == 2 + 3 + 1
    assert found["tip at rest"]["errors"] == pytest.approx([0, 0, 0, 0], abs=1e-12)
    (pulled,) = [name for name in found if name.startswith("tip, cable_1 at")]
    for name in ("tip held level", pulled):
        assert found[name]["order"] == pytest.approx(2, abs=0.3)
    assert report["joints_needed"] in (12, 13, 14)  # at 14 the third mode is off by 1.5e-3
    file.write_text(THREE_SECTIONS)
    assert new.main([str(file), "--converge", "--segments", "2", "200"]) == 2
    assert "two numbers up to 42" in capsys.readouterr().err
