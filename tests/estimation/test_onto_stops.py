"""A correction beyond joint limits ends at the nearest allowed one, in the covariance's metric."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

import softdyn
from softdyn.estimation.covariance import onto_stops


def cases(model, count: int):
    """Joint coordinates, corrections of two deviations, and covariances of uneven errors."""
    rng, n = np.random.default_rng(0), model.nv
    for _ in range(count):
        root = rng.normal(size=(2 * n, 2 * n)) * np.exp(rng.normal(size=2 * n))
        P = 1e-3 * root @ root.T
        at = rng.uniform(np.maximum(model.lower, -2), np.minimum(model.upper, 2))
        yield at, 2 * np.linalg.cholesky(P) @ rng.normal(size=2 * n), P


def cost(change: np.ndarray, asked: np.ndarray, P: np.ndarray) -> float:
    return float((change - asked) @ np.linalg.solve(P, change - asked))


def test_it_is_the_best_of_all_81_active_sets_of_a_finger() -> None:
    """Each joint is free, or at one of its limits; the oracle tries all and takes the cheapest."""
    model = softdyn.load("finger")
    for at, asked, P in cases(model, 60):
        best = np.inf
        for held in product((-1, 0, 1), repeat=4):
            k = np.flatnonzero(held)
            ends = np.where(np.array(held) > 0, model.upper, model.lower)[k]
            change = asked + P[:, k] @ np.linalg.solve(P[np.ix_(k, k)], ends - (at + asked[:4])[k])
            there = at + change[:4]
            if (there <= model.upper + 1e-12).all() and (there >= model.lower - 1e-12).all():
                best = min(best, cost(change, asked, P))
        found = onto_stops(model, at, asked, P)
        assert cost(found, asked, P) == pytest.approx(best, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("name", ["helix", "spirob"])
def test_stops_only_push_and_only_where_a_joint_is(name) -> None:
    """The optimality conditions: P⁻¹ (change - asked) is the push of the stops."""
    model = softdyn.load(name)
    n = model.nv
    for at, asked, P in cases(model, 20):
        change = onto_stops(model, at, asked, P)
        there = at + change[:n]
        assert (there <= model.upper + 1e-12).all()
        assert (there >= model.lower - 1e-12).all()
        push = np.linalg.solve(P, change - asked) * np.sqrt(np.diag(P))
        small = 1e-4 * np.abs(push).max(initial=1e-9)
        upper, lower = there >= model.upper - 1e-9, there <= model.lower + 1e-9
        assert (push[:n][upper] <= small).all()
        assert (push[:n][lower] >= -small).all()
        assert (np.abs(push[:n][~upper & ~lower]) <= small).all()
        assert (np.abs(push[n:]) <= small).all()


def test_a_joint_that_is_known_exactly_stays() -> None:
    """A held joint's variance is zero, so no correction moves it."""
    model = softdyn.load("finger")
    at, asked, P = next(cases(model, 1))
    P[0], P[:, 0], asked[0] = 0.0, 0.0, 0.0
    asked[1] += 10.0
    found = onto_stops(model, at, asked, P)
    assert found[0] == 0.0
    assert at[1] + found[1] == pytest.approx(model.upper[1])


def test_a_correction_within_the_limits_is_unchanged() -> None:
    model = softdyn.load("finger")
    _, asked, P = next(cases(model, 1))
    small = 1e-3 * asked
    np.testing.assert_array_equal(onto_stops(model, np.zeros(4), small, P), small)
