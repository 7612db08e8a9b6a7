"""Branches of equilibria and soft stops, against hand calculations for one joint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from softdyn import statics
from softdyn.statics.branch import follow, input_scale
from softdyn.statics.stops import SoftStops
from softdyn.statics.unknown_inputs import TargetProblem
from tests.statics.test_statics import STIFFNESS, G, pendulum

WEIGHT = 0.1 * G  # m g r of the pendulum


def test_a_branch_is_followed_up_to_its_fold(tmp_path: Path) -> None:
    """Upright, u = k q - m g r sin q turns back where cos q = k / m g r, at 1.04 rad."""
    here = statics.balance(pendulum(tmp_path, height=0.1), [0.0], [0.0])
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
def test_the_size_of_an_input(tmp_path: Path, limits, gear, bounds, expected) -> None:
    changes = {
        'limit lower="-1" upper="2"': 'limit lower="{}" upper="{}"'.format(*limits),
        'gear="1" lower="-2" upper="2"': 'gear="{}" lower="{}" upper="{}"'.format(gear, *bounds),
    }
    model = pendulum(tmp_path, changes=changes)
    assert input_scale(model, statics.balance(model, [0.0], [0.0])) == pytest.approx([expected])


def test_soft_stops_repel() -> None:
    """Their potential is -μ log of both gaps; joints start inside, and no step goes outside."""
    lower, upper = np.array([-1.0, 0.5, 2.0]), np.array([2.0, 0.6, 7.0])
    weight = np.array([1e-3, 2e-3, 5e-3])
    stops = SoftStops(weight, lower, upper)
    off = np.array([1e-4, 1e-5, 1e-4])  # a ten-thousandth of the range, at most 0.1 mrad
    assert stops.within(lower - 1) == pytest.approx(lower + off, abs=1e-12)
    assert stops.within(upper) == pytest.approx(upper - off, abs=1e-12)
    at = lower + np.array([0.3, 0.8, 0.5]) * (upper - lower)
    assert np.array_equal(stops.within(at), at)

    def energy(x: np.ndarray) -> np.ndarray:
        return -weight * (np.log(x - lower) + np.log(upper - x))

    e = 1e-5 * (upper - lower)
    force, held = stops.push(at, np.zeros(3))
    assert force == pytest.approx((energy(at - e) - energy(at + e)) / (2 * e), rel=1e-6)
    assert not held.any()
    slope = (stops.push(at - e, at)[0] - stops.push(at + e, at)[0]) / (2 * e)
    assert stops.stiffness(at) == pytest.approx(slope, rel=1e-6)
    assert stops.clip(at, np.full(3, 9.0)) == pytest.approx(0.9 * (upper - at))
    assert stops.clip(at, np.full(3, -9.0)) == pytest.approx(0.9 * (lower - at))
    assert np.array_equal(stops.clip(at, np.zeros(3)), np.zeros(3))


def test_a_joint_is_near_its_stop_within_a_tenth_of_its_range(tmp_path: Path) -> None:
    narrow = {'limit lower="-1" upper="2"': 'limit lower="-0.1" upper="0.2"'}
    model = pendulum(tmp_path, changes=narrow)
    problem = TargetProblem.for_tip(model, np.zeros(3))
    near = [problem.near_stops(np.array([q])) for q in (-0.09, -0.06, 0.1, 0.16, 0.18)]
    assert near == [True, False, False, False, True]
