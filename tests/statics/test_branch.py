"""Branches of equilibria and soft stops, against hand calculations for one joint."""

from __future__ import annotations

import numpy as np
import pytest

from softdyn import statics
from softdyn.statics.branch import follow, input_scale
from softdyn.statics.unknown_inputs import TargetProblem
from tests.statics.test_statics import STIFFNESS, G, pendulum

WEIGHT = 0.1 * G  # m g r of the pendulum


def test_a_branch_is_followed_up_to_its_fold() -> None:
    """Upright, u = k q - m g r sin q turns back where cos q = k / m g r, at 1.04 rad."""
    here = statics.balance(pendulum(height=0.1), [0.0], [0.0])
    for angle in (0.3, 0.6, 0.8, 0.9, 0.96):
        found = follow(here, np.array([STIFFNESS * angle - WEIGHT * np.sin(angle)]))
        assert found is not None
        assert found.q == pytest.approx([angle], abs=1e-8)
        here = found
    # beyond the fold the only equilibrium is at the stop, 1.96 rad away: not this branch
    assert follow(here, np.array([-0.5])) is None


@pytest.mark.parametrize(
    ("limits", "gear", "bounds", "expected"),
    [
        # of the free range of three radians only one counts
        ((-1, 2), 1, (-2, 2), STIFFNESS + WEIGHT),
        ((-0.1, 0.2), 1, (-2, 2), 0.3 * (STIFFNESS + WEIGHT)),
        ((-1, 2), -4, (-2, 2), (STIFFNESS + WEIGHT) / 4),
        ((-1, 2), 1, (-0.1, 0.5), 0.6),  # its range is less
    ],
)
def test_the_size_of_an_input(limits, gear, bounds, expected) -> None:
    changes = {
        'limit lower="-1" upper="2"': 'limit lower="{}" upper="{}"'.format(*limits),
        'gear="1" lower="-2" upper="2"': 'gear="{}" lower="{}" upper="{}"'.format(gear, *bounds),
    }
    model = pendulum(changes=changes)
    assert input_scale(model, statics.balance(model, [0.0], [0.0])) == pytest.approx([expected])


def test_soft_stops_repel() -> None:
    """Their potential is -μ log of both gaps; a limit that a joint lacks repels nothing."""
    model = pendulum()
    problem = TargetProblem.for_tip(model, np.zeros(3))
    weight, e = 0.01 * problem.force * problem.scale[:1], 1e-5

    def energy(x: np.ndarray) -> np.ndarray:
        return -weight * (np.log(x - model.lower) + np.log(model.upper - x))

    at = model.lower + 0.3 * (model.upper - model.lower)
    force, stiffness = problem.repulsion(at, 0.01)
    assert force == pytest.approx((energy(at - e) - energy(at + e)) / (2 * e), rel=1e-6)
    below, above = (problem.repulsion(at + s * e, 0.01)[0] for s in (-1, 1))
    assert stiffness == pytest.approx((below - above) / (2 * e), rel=1e-6)
    free = TargetProblem.for_tip(
        pendulum(changes={'limit lower="-1" upper="2"': "limit"}), np.zeros(3)
    )
    assert [float(x[0]) for x in free.repulsion(at, 0.01)] == [0.0, 0.0]


def test_a_joint_is_near_its_stop_within_a_tenth_of_its_range() -> None:
    narrow = {'limit lower="-1" upper="2"': 'limit lower="-0.1" upper="0.2"'}
    model = pendulum(changes=narrow)
    problem = TargetProblem.for_tip(model, np.zeros(3))
    near = [problem.near_stops(np.array([q])) for q in (-0.09, -0.06, 0.1, 0.16, 0.18)]
    assert near == [True, False, False, False, True]
