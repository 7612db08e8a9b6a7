"""Radii of pulleys, identified from the motion of MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest

import softdyn
from softdyn import identification
from softdyn.identification.parameters import apply_values
from softdyn.loading import load_text
from softdyn.validation.identification.trials import Excitation, trial
from tests.support.robots import build, cable, hinge, motor

# a lever on a hinge, raised by a cable over a pulley, and stretched by one below a pin
PIN = '<cylinder link="base" xyz="0 0 0" axis="0 1 0" radius="{}" side="0 0 {}"/>'
ENDS = "base -0.06 0 0", "arm 0.06 0 0"
LEVER = hinge(
    0.1, "0.05 0 0", "1e-5 1e-4 1e-4", damping=0.01, stiffness=0.2, tip="0.1 0 0",
    block=cable("over", ENDS[0], PIN.format(0.01, 0.012), ENDS[1])
    + cable("below", ENDS[0], PIN.format(0.008, -0.02), ENDS[1], stiffness=300)
    + motor("over", 0, 20, -1, "pull"),
)  # fmt: skip


@pytest.fixture(scope="module")
def lever() -> softdyn.SoftModel:
    return build(LEVER)


def test_a_pulley_s_radius_is_found_within_its_interval(lever):
    several = identification.parameters(lever, "wrap_radius")
    assert [one.label for one in several] == ["wrap_radius over.1", "wrap_radius below.1"]
    outputs = ["q.hinge", "length.over"]
    one = trial(lever, several, outputs, Excitation(0.25, timestep=5e-4), 1.0, 2)
    assert np.abs(one.scores).max() < 3
    assert np.abs(one.relative).max() < 0.02


def test_a_side_point_stays_on_its_side_and_the_file_is_written(lever):
    """A radius beyond the stated side point leaves the cable outside."""
    several = identification.parameters(lever, "wrap_radius")
    model = apply_values(lever, several, np.array([0.02, 0.004]))
    over, below = (tendon.wraps[0] for tendon in model.robot.tendons)
    assert (over.radius, below.radius) == (0.02, 0.004)
    assert not over.inside
    assert not below.inside
    text = identification.rewrite_urdf(
        lever.robot, {"wrap_radius": {"over.1": 0.02, "below.1": 0.004}}
    )
    again = load_text(text, path=lever.robot.path)
    q = np.array([-0.2])
    np.testing.assert_allclose(again.tendon_moment_arms(q), model.tendon_moment_arms(q))
    np.testing.assert_allclose(np.abs(again.tendon_moment_arms(q)[:, 0]), [0.02, 0.004], rtol=1e-9)
