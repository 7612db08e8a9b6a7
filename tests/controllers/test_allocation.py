"""Inputs for given joint torques: the exact minimum within the bounds, for all torques."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import quadprog
from scipy.optimize import lsq_linear

import softdyn
from softdyn import design
from softdyn.controllers import allocate
from tests.support.arms import THREE_SECTIONS
from tests.support.refused import refused

ROBOTS = ("finger", "helix", "spirob")


def drawn(name: str, count: int):
    """States and torques: some feasible, some beyond the bounds, some outside range(B)."""
    model, rng = softdyn.load(name), np.random.default_rng(3)
    for k in range(count):
        wild = rng.uniform(-0.3, 0.3, model.nv) * (k > 0)  # the first: straight, B of spirob rank 2
        q = model.configuration(np.clip(wild, model.lower, model.upper))
        state = model.state(q, rng.normal(size=model.nv))
        inside = state.B @ rng.uniform(model.u_min, model.u_max)
        yield model, state, inside * 3.0 ** (k % 3 - 1) + (k % 2) * rng.normal(size=model.nv)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_input_is_the_optimum_of_its_qp(name: str):
    """At a minimum over a box the gradient points out of the box; for a convex cost this suffices.

    If B has full rank, the minimum is unique, and quadprog finds the same.
    """
    ranks = set()
    for model, state, tau in drawn(name, 60):
        u = allocate(model, state, tau)
        assert ((model.u_min <= u) & (u <= model.u_max)).all()
        B, span = state.B, model.u_max - model.u_min
        slope = span * (B.T @ (B @ u - tau))
        scale = np.abs(B * span).max() * (np.abs(B) @ span).max() + np.abs(B.T @ tau).max()
        at_low, at_high = u <= model.u_min + 1e-9 * span, u >= model.u_max - 1e-9 * span
        assert (slope[~at_low] <= 1e-9 * scale).all()
        assert (slope[~at_high] >= -1e-9 * scale).all()
        ranks.add(int(np.linalg.matrix_rank(B)))
        if np.linalg.cond(B) < 1e5:
            E = B * span
            sides = np.hstack((np.eye(model.nu), -np.eye(model.nu)))
            ends = np.concatenate((model.u_min / span, -model.u_max / span))
            exact = quadprog.solve_qp(E.T @ E, E.T @ tau, sides, ends)[0]
            np.testing.assert_allclose(u / span, exact, atol=1e-6)
    assert len(ranks) == (2 if name == "spirob" else 1)


@pytest.fixture(scope="module")
def tapered(tmp_path_factory: pytest.TempPathFactory) -> softdyn.SoftModel:
    """Nine cables, six bends that they can give: every torque has a family of minimisers."""
    path = Path(tmp_path_factory.mktemp("tapered"), "arm.urdf")
    table = tomllib.loads(THREE_SECTIONS.replace("count = 4", "count = 3"))
    path.write_text(design.urdf(design.make_arm(table)))
    return softdyn.load(path)


def shortest(B: np.ndarray, tau: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """SciPy finds a minimiser; then quadprog finds the shortest input with the same torques."""
    one = lsq_linear(B, tau, (low, high), method="bvls", tol=1e-15, max_iter=500).x
    _, singular, rows = np.linalg.svd(B)
    rows = rows[: int((singular > 1e-9 * singular[0]).sum())]
    sides = np.vstack((rows, np.eye(len(low)), -np.eye(len(low))))
    # the bounds are slightly wider, because the first minimiser may lie on the edge of the box
    ends = np.concatenate((rows @ one, low - 1e-9, -high - 1e-9))
    return quadprog.solve_qp(np.eye(len(low)), np.zeros(len(low)), sides.T, ends, len(rows))[0]


def test_of_all_minimisers_the_shortest_is_taken(tapered: softdyn.SoftModel):
    rng = np.random.default_rng(5)
    cases = list(drawn("spirob", 1))
    state = tapered.state(tapered.q0, np.zeros(tapered.nv))
    for k in range(30):
        inside = state.B @ rng.uniform(0, 20, 9)
        # torques outside range(B), and torques beyond the bounds
        cases.append((tapered, state, (k % 3) * inside + rng.normal(size=tapered.nv)))
    at_bounds = 0
    for model, seen, tau in cases:
        u = allocate(model, seen, tau)
        exact = shortest(seen.B, tau, model.u_min, model.u_max)
        np.testing.assert_allclose(u, exact, atol=1e-6 * model.u_max.max())
        at_bounds += ((u == model.u_min) | (u == model.u_max)).any()
    assert at_bounds > len(cases) // 2


def test_the_input_is_continuous_in_the_torque(tapered: softdyn.SoftModel):
    """Halving the steps of a path of torques halves the largest step of the input, too."""
    rng = np.random.default_rng(1)
    state = tapered.state(tapered.q0, np.zeros(tapered.nv))
    for _ in range(3):
        ends = [state.B @ rng.uniform(0, 8, 9) + 0.02 * rng.normal(size=tapered.nv) for _ in "ab"]
        steps = []
        for count in (200, 400):
            path = [
                allocate(tapered, state, ends[0] + share * (ends[1] - ends[0]))
                for share in np.linspace(0.0, 1.0, count + 1)
            ]
            steps.append(np.abs(np.diff(path, axis=0)).max())
        assert steps[1] < 0.51 * steps[0] < 0.1


def test_hostile_numbers_give_an_input_within_the_bounds():
    model = softdyn.load("spirob")
    state = model.state(model.q0, np.zeros(model.nv))
    fine, rng = np.ones(model.nv), np.random.default_rng(0)
    taus = [fine * x for x in (np.nan, np.inf, -1e308, 1e300, 5e-324, 0.0)]
    taus += [10.0 ** rng.uniform(-300, 300, model.nv) for _ in range(5)]
    cases = [(state, tau) for tau in taus]
    for x in (np.nan, np.inf, 1e308, 1e-308, 0.0):
        B = np.array(state.B)
        B[3, 1] = x
        cases += [(replace(state, B=B), fine), (replace(state, B=np.full_like(B, x)), fine)]
    for seen, tau in cases:
        u = allocate(model, seen, tau)
        assert u.shape == (3,)
        assert ((model.u_min <= u) & (u <= model.u_max)).all()


def test_what_is_no_question_is_refused():
    finger, spirob = softdyn.load("finger"), softdyn.load("spirob")
    state = finger.state(finger.q0, np.zeros(4))
    for model, seen, tau, name in (
        (finger, state, [1, 2, 3], "tau"),
        (finger, state, ["a"] * 4, "tau"),
        (spirob, state, np.zeros(27), "state"),
        (finger, "state", np.zeros(4), "state"),
    ):
        with refused(name):
            allocate(model, seen, tau)
    # a copy of the robot is the same robot
    u = allocate(softdyn.load("finger"), state, state.B @ np.array([0.3, -0.2]))
    np.testing.assert_allclose(u, [0.3, -0.2], atol=1e-12)
