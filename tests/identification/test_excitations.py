"""The choice of the best excitation, in cases with a known answer."""

from __future__ import annotations

import json

import numpy as np
import pytest

import softdyn
from softdyn import identification
from softdyn.commands import identify
from softdyn.validation.identification import excitations
from softdyn.validation.identification.excitations import Candidate, compared, comparison
from softdyn.validation.identification.trials import Excitation, trial
from tests.support.refused import refused


@pytest.fixture(scope="module")
def finger() -> softdyn.SoftModel:
    return softdyn.load("finger")


def test_the_bound_is_what_a_fit_of_the_best_has(finger, capsys, monkeypatch):
    """The predicted deviation is the one that a fit of such data states."""
    monkeypatch.setattr(excitations, "AMPLITUDES", (0.6,))
    monkeypatch.setattr(excitations, "KNOTS", (0.1, 0.3))
    arguments = [
        "finger",
        "--twin",
        "0.5",
        "--timestep",
        "5e-4",
        "--excitations",
        "--jobs",
        "1",
        "--json",
        "-",
    ]
    assert identify.main(arguments) == 0
    report = json.loads(capsys.readouterr().out)
    best, *_ = report["excitations"]
    worst = [max(one["relative"]) for one in report["excitations"]]
    assert len(worst) == 2
    assert worst == sorted(worst)
    unknowns = [one for kind in ("stiffness", "damping")
                for one in identification.parameters(finger, kind)]  # fmt: skip
    joints = [f"q.{name}" for name in finger.joint_names]
    excitation = Excitation(
        0.5, amplitude=best["amplitude"], knots=best["knots"], spread=0.0, timestep=5e-4
    )
    found = trial(finger, unknowns, joints, excitation, 1.0, 0).found
    stated = [one.deviation / one.parameter.nominal for one in found.estimates]
    assert stated == pytest.approx(best["relative"], rel=0.3)


def test_without_noise_there_is_nothing_to_compare(finger):
    with refused("noise", 0.0):
        compared(finger, identification.parameters(finger, "stiffness"), ["tip.x"],
                 Excitation(1.0), 0.0)  # fmt: skip


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--twin 1 --html page.html", "--out, --html: expected DATA, got --twin"),
        ("run.csv --excitations", "--excitations: expected --twin S, got DATA"),
        ("--twin 1e9", "seconds: expected at most 5000, got 1000000000.0"),
        ("--twin 1 --knots 1e-9", "knots: expected numbers from 0.005 to 5000, got [1e-09]"),
        ("--twin 1 --timestep 1e-300", "timestep: expected a finite number >= 1e-07"),
        ("--twin 1 --noise -1", "noise: expected a finite number >= 0"),
        ("--twin 1 --amplitude 2", "amplitude: expected numbers from 0 to 1, got [2.0]"),
        ("--twin 1 --amplitude 1 1 1", "amplitude: expected one number, or 2, got 3 of them"),
        ("--twin 1 --bias -0.1", "bias: expected numbers from 0 to 1, got [-0.1]"),
    ],
)
def test_a_twin_that_cannot_be_is_one_line(options, said, capsys):
    assert identify.main(["finger", *options.split()]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_inputs_use_their_shares_about_their_biases(finger):
    """Each input has the width of its amplitude and the offset of its bias, within its bounds."""
    t, span = np.arange(0, 20, 0.005), finger.u_max - finger.u_min

    def ends(**shares):
        u = Excitation(20.0, **shares).inputs(finger, t, np.random.default_rng(0))
        return np.array([u.min(0), u.max(0)]) / span

    middle, share = ends(amplitude=(0.2, 0.4)).mean(0), np.ptp(ends(amplitude=(0.2, 0.4)), axis=0)
    assert share == pytest.approx([0.2, 0.4], rel=0.1)
    assert middle == pytest.approx([0, 0], abs=0.02)
    off = ends(amplitude=(0.2, 0.4), bias=(0.1, 0.0)) - ends(amplitude=(0.2, 0.4))
    assert off == pytest.approx(np.array([[0.1, 0.0], [0.1, 0.0]]))
    fast, slow = np.diff(
        Excitation(20.0, knots=(0.1, 0.5)).inputs(finger, t, np.random.default_rng(0)), 2, axis=0
    ).T
    corners = [np.flatnonzero(np.abs(one) > 1e-9) for one in (fast, slow)]
    assert len(corners[0]) == pytest.approx(200, abs=2)
    assert len(corners[1]) == pytest.approx(40, abs=2)
    assert ends(amplitude=1.0, bias=0.3).max(0) == pytest.approx(finger.u_max / span)


def test_what_tells_most_comes_first(finger):
    unknowns = identification.parameters(finger, "stiffness")
    some = Candidate(Excitation(), np.array([0.01, np.inf, np.inf, np.inf]))
    none = Candidate(Excitation(), np.full(4, np.inf), "always at its stops")
    text = comparison(unknowns, [some, none])
    assert "1 of 4" in text
    assert "1.00%" in text
    assert "not identifiable with it: stiffness joint2, stiffness joint3, stiffness joint4" in text
    assert "none of them identifies a parameter: always at its stops" in comparison(
        unknowns, [none]
    )
