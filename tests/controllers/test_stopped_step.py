"""A step with stops: its motion against an exact QP; rows hold for the motion that u leads to."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest
import quadprog

import softdyn
from softdyn import SetPoint, State
from softdyn.controllers import SafetyFilter
from softdyn.controllers.barriers import BarrierRows, JointLimits, UnsafeStart
from softdyn.controllers.qps.horizon import Horizon
from softdyn.controllers.qps.lexicographic_qp import ROOM
from softdyn.controllers.qps.qp import QpProblem, QpSolution
from softdyn.controllers.qps.stopped_step import StoppedStep, stops_around
from softdyn.safety import HalfSpace

TAU = 0.005


def exact(state: State, M: np.ndarray, h: np.ndarray, u: np.ndarray) -> np.ndarray:
    """q̈ of least ½ q̈ᵀ M q̈ - q̈ᵀ(B u - h) with the joints between their stops at the end."""
    model, n = state.model, len(h)
    q = model.coordinates(state.q)
    low = (np.minimum(model.lower - q, 0.0) / TAU - state.v) / TAU
    high = (np.maximum(model.upper - q, 0.0) / TAU - state.v) / TAU
    sides = np.hstack((np.eye(n), -np.eye(n)))
    return quadprog.solve_qp(M.copy(), state.B @ u - h, sides, np.concatenate((low, -high)))[0]


def at_stops(name: str, rng: np.random.Generator) -> tuple[State, np.ndarray]:
    """A state with joints at, near and beyond their stops, and an input."""
    model = softdyn.load(name)
    size = model.upper - model.lower
    q = model.lower + rng.uniform(-0.001, 1.001, model.nv) * size
    near = rng.integers(0, 3, model.nv)
    gap = rng.choice([0.0, 1e-4, 0.003], model.nv) * size
    q = np.where(near == 0, model.lower + gap, np.where(near == 1, model.upper - gap, q))
    v = rng.normal(size=model.nv) * size
    return model.state(model.configuration(q), v), rng.uniform(model.u_min, model.u_max)


@pytest.mark.parametrize("name", ["finger", "helix"])
def test_the_motion_is_that_of_least_gauss_constraint(name: str) -> None:
    rng, held = np.random.default_rng(3), 0
    for _ in range(20):
        state, u = at_stops(name, rng)
        M, h = Horizon(state.model, TAU)(state)
        step = StoppedStep(state, TAU, M, h, stops_around(state))
        qdd, mode = step.motion(u, step.free)
        held += np.count_nonzero(mode)
        np.testing.assert_array_equal(step.motion(u, step.still)[1], mode)
        X = step.response(mode)
        wanted = exact(state, M, h, u)
        np.testing.assert_allclose(
            X[:, :-1] @ u + X[:, -1], wanted, atol=1e-8 * np.abs(wanted).max()
        )
        np.testing.assert_allclose(qdd, wanted, atol=1e-8 * np.abs(wanted).max())
    assert held > 10


def test_rows_hold_for_the_motion_that_the_input_leads_to() -> None:
    # finger with joints at or near their stops beside a wall; each step by an exact solver
    rng, model, changed, met = np.random.default_rng(8), softdyn.load("finger"), 0, 0
    for _ in range(60):
        state, wanted = at_stops("finger", rng)
        state = model.state(state.q, 0.1 * state.v)
        normal = rng.normal(size=3)
        gap = abs(normal @ state.ydot) / np.linalg.norm(normal) / 10 + 0.002
        wall = HalfSpace(normal, normal @ state.y / np.linalg.norm(normal) - gap)
        rows = BarrierRows(model, [wall], TAU)
        rows.reset(TAU)
        problem = QpProblem(np.eye(2), -wanted, np.eye(2), model.u_min, model.u_max)
        given = QpSolution(wanted, np.zeros(2), 0.0, 0.0, 0.0)
        M, h = Horizon(model, TAU)(state)
        u = rows.enforce(problem, given, state).x
        if rows.relaxed or rows.braked:
            continue
        b, G, drift, _ = wall(state)
        qdd = exact(state, M, h, u)
        assert (np.abs(TAU * (state.v + TAU * qdd)) < 0.1 + TAU * np.abs(state.v) + 1e-3).all()
        second = G @ qdd + drift
        first = G @ state.v + TAU * second
        s, later = G @ state.v + 10 * b, first + 10 * (b + TAU * first)
        assert (1.05 * later - s)[0] > -1e-4
        changed, met = changed + (not np.array_equal(u, wanted)), met + 1
    assert changed > 10
    assert met > 40


def test_limits_of_joints_do_not_count_on_the_stops_that_they_avoid() -> None:
    """Their rows are those of free joints, also where a joint would meet its stop in the step."""
    model, rng = softdyn.load("finger"), np.random.default_rng(0)
    limits, horizon, passing = JointLimits(model), 0.03, 0
    for _ in range(40):
        q, v = rng.uniform(-0.5, 0.5, 4), 0.05 * rng.normal(size=4)
        joint, side, gap = rng.integers(4), rng.choice([-1, 1]), rng.uniform(0.002, 0.02)
        q[joint] = side * (model.upper[joint] - gap)
        v[joint] = side * gap * rng.uniform(0, 60)
        passing += horizon * abs(v[joint]) > gap
        state, pushing = model.state(q, v), rng.choice([-1, 1], 2) * model.u_max
        law = SafetyFilter(lambda *_, u=pushing: u, model, [limits], horizon=horizon)
        law.reset(TAU)
        rows = BarrierRows(model, [limits], horizon)
        rows.reset(TAU)
        with pytest.warns(UnsafeStart) if v[joint] * side > 10 * gap else nullcontext():
            u = law(state, SetPoint(state.y)).u
            free = rows.at(state)
        assert law.barrier_rows.relaxed == 0
        assert free.excess(u).max() < 2 * ROOM
    assert passing > 10
