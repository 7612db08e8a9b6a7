"""Parts of the cross-check by hand: tolerances, distances of states."""

from __future__ import annotations

import numpy as np
import pytest

import softdyn
from softdyn.validation.crosschecks.crosscheck import (
    QUANTITIES,
    TOLERANCE,
    TOLERANCE_SPATIAL,
    TOLERANCE_TRAJECTORY,
    _tolerances,
)
from softdyn.validation.crosschecks.trajectories import distance


def test_what_spatial_tendons_enter_has_the_wider_tolerance():
    usual = dict.fromkeys((*QUANTITIES, "F"), TOLERANCE) | {"trajectory": TOLERANCE_TRAJECTORY}
    assert _tolerances(softdyn.load("finger")) == usual
    assert _tolerances(softdyn.load("spirob")) == usual | {"B": TOLERANCE_SPATIAL}
    assert TOLERANCE_TRAJECTORY < TOLERANCE < TOLERANCE_SPATIAL


def test_the_distance_of_two_states():
    """The larger one of positions and velocities; for continuous joints the shorter way."""
    circular = np.array([True, False])
    zero = np.zeros(2)

    def apart(a, b):
        return distance(
            (np.array(a[0]), np.array(a[1])), (np.array(b[0]), np.array(b[1])), circular
        )

    assert apart(([3.1, 0.0], zero), ([-3.1, 0.0], zero)) == pytest.approx((2 * np.pi - 6.2) / 3.1)
    assert apart(([0.0, 8.0], zero), ([0.0, 4.0], [9.0, 0.0])) == pytest.approx(1.0)
    assert apart(([0.0, 8.0], zero), ([0.0, 4.0], zero)) == pytest.approx(0.5)
    assert apart(([0.0, 4.0], zero), ([0.0, 8.0], zero)) == pytest.approx(0.5)
    assert apart(([0.0, 0.1], [1.0, 5.0]), ([0.0, 0.3], [0.0, 5.0])) == pytest.approx(0.2)
