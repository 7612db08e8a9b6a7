"""Errors, orders and joints for a tolerance, for figures with known convergence."""

from __future__ import annotations

import numpy as np
import pytest

from softdyn.validation.rods.ladder import Ladder

COUNTS = (5, 10, 20, 40)


def ladder(p: float, c: float = 3.0, exact: bool = False, counts=COUNTS) -> Ladder:
    values = np.array([[2.0 + c * n**-p, 1.0 - c * n**-p] for n in counts])
    return Ladder("figure", counts, values, 2.0, np.array([2.0, 1.0]) if exact else None)


@pytest.mark.parametrize("p", [1, 2, 4])
@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("counts", [COUNTS, (3, 7, 12)])
def test_order_and_limit(p, exact, counts):
    found = ladder(p, exact=exact, counts=counts)
    assert found.order == pytest.approx(p, abs=1e-6)
    np.testing.assert_allclose(found.limit, [2.0, 1.0], atol=1e-9)
    errors = [3 * 2**0.5 / 2 * n**-p for n in counts]
    np.testing.assert_allclose(found.errors, errors, rtol=1e-5)


@pytest.mark.parametrize("tolerance", [0.2, 1e-2, 1e-3, 1e-5])
def test_joints_for_a_tolerance(tolerance):
    law = 3 * 2**0.5 / 2
    least = max(5, int(np.ceil((law / tolerance) ** 0.5)))
    assert ladder(2).needed(tolerance) == least


def test_rounding_has_no_order():
    same = Ladder("figure", COUNTS, np.full((4, 1), 2.0), 1.0)
    assert same.order is None
    assert same.needed(1e-6) == 5
    assert same.errors == [0, 0, 0, 0]
