"""Rests of robots whose cables rub: closed forms, both directions of motion, loops."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

import softdyn
from softdyn import statics
from softdyn.actuation import Capstan
from softdyn.description.robot import JointTerm, Tendon
from tests.support.cable_chains import chain, pulled
from tests.support.command import command
from tests.support.refused import refused

ARM, STIFFNESS, MU = 0.01, 0.05, 0.3


@pytest.fixture
def hinge() -> Capstan:
    """One joint with an upright axis: its weight does nothing."""
    robot = chain(np.array([[0.0, 0.0, 1.0]]), 0.1, stiffness=STIFFNESS)
    tendon = Tendon("cable", (JointTerm("j1", ARM),), friction=MU)
    return Capstan(softdyn.build(pulled(robot, tendon)))


def angle(pull: float, direction: float) -> float:
    """k q = r T (1 + exp(-d μ q)) / 2, half of the moment arm being behind the guide."""
    return brentq(
        lambda q: STIFFNESS * q - ARM * pull * (1 + np.exp(-direction * MU * q)) / 2, 0, 3
    )


def test_both_ends_of_the_interval_have_a_closed_form(hinge: Capstan) -> None:
    pulled_in, paid_out = statics.rest_interval(hinge, [-4.0])
    assert -pulled_in.state.q[0] == pytest.approx(angle(4.0, 1.0), abs=1e-9)
    assert -paid_out.state.q[0] == pytest.approx(angle(4.0, -1.0), abs=1e-9)
    assert -pulled_in.state.q[0] < -paid_out.state.q[0]


def test_a_loop_sticks_at_its_turns_and_returns_to_itself(hinge: Capstan) -> None:
    pulls = np.concatenate(
        (np.linspace(0, 4, 21), np.linspace(4, 2, 21)[1:], np.linspace(2, 4, 21))
    )
    rests = statics.follow(hinge, -pulls[:, None])
    q = -np.array([rest.state.q[0] for rest in rests])
    assert q[20] == pytest.approx(angle(4.0, 1.0), abs=1e-9)
    assert q[40] == pytest.approx(angle(2.0, -1.0), abs=1e-9)
    assert q[-1] == pytest.approx(q[20], abs=1e-9)
    stuck = pulls[21:41] > 4.0 * (1 + np.exp(-MU * q[20])) / (1 + np.exp(MU * q[20]))
    assert stuck.sum() >= 3
    np.testing.assert_allclose(q[21:41][stuck], q[20], atol=3e-5)
    directions = np.array([rest.direction[0] for rest in rests[21:41]])
    assert (np.abs(directions[stuck]) < 1).all()
    np.testing.assert_allclose(directions[~stuck], -1.0, atol=1e-6)


def test_wrong_directions_and_no_inputs_are_refused(hinge: Capstan) -> None:
    with refused("direction"):
        statics.rest_after(hinge, [-1.0], np.nan)
    with refused("inputs", "none"):
        statics.follow(hinge, [])


def test_the_command_finds_the_interval_and_draws_the_loop(tmp_path) -> None:
    robot = softdyn.load("finger").robot
    tendons = tuple(replace(tendon, friction=0.1) for tendon in robot.tendons)
    path, figure = tmp_path / "finger.urdf", tmp_path / "loop.png"
    path.write_text(softdyn.description.urdf_writer.write(replace(robot, tendons=tendons)))
    asked = ["statics", path, "--inputs", "-0.2", "-0.1", "--friction", "--json", "-"]
    code, out, _ = command(*asked, "--map", figure)
    assert code == 0
    assert 1 < json.loads(out)["apart_mm"] < 100
    assert figure.stat().st_size > 5_000
    code, _, err = command("statics", "finger", "--inputs", "-0.2", "-0.1", "--friction")
    assert code == 2
    assert "--friction: expected a robot with friction of cables, got finger" in err
    code, _, err = command("statics", path, "--friction")
    assert code == 2
