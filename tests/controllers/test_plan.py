"""Plans through a fold, against dense solutions of the same problems."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from softdyn import SoftModel
from softdyn.controllers.predictive import ilqr
from softdyn.controllers.predictive import plan as planning
from softdyn.controllers.predictive.ilqr import backward, search_path
from softdyn.controllers.predictive.plan import make_plan, pose
from softdyn.controllers.predictive.rest_target import RestTarget
from tests.support import cart

GOAL = np.array([cart.LENGTH + 0.1, 0.0, 0.0])
ZERO = np.zeros(1)
TARGET = RestTarget(np.array([0.1]), np.array([cart.STIFFNESS * 0.1]), True, 0.0)


@pytest.fixture
def slide(monkeypatch) -> SoftModel:
    """A cart on a spring: its dynamics are linear, so that one pass is exact."""
    monkeypatch.setattr(planning, "STEPS", 30)
    monkeypatch.setattr(ilqr, "SETTLED", 1e-12)
    monkeypatch.setattr(planning, "USEFUL", np.inf)  # the way is short, and so is the time
    return cart.cart(-1.0, 1.5)


def best_commands(model: SoftModel, lag: float, form: float, count: int) -> np.ndarray:
    """The same problem on the cart by bounded least squares over all commands at once."""
    T, kept = planning.STEP, np.exp(-planning.STEP / lag) if lag else 0.0
    mean = (1 - kept) * lag / T
    H = planning.HORIZON
    S = cart.MASS / H**2 + cart.DAMPING / H + cart.STIFFNESS
    R = 1 / S**2  # Bᵀ S⁻¹ B times the compliance 1 / S
    own = [form, (planning.SPEED * H) ** 2, planning.HOLD * R]
    matrix = cart.MASS + T * cart.DAMPING + T**2 * cart.STIFFNESS
    weighed = np.ones(count)
    weighed[-1] += planning.TAIL
    x, map_ = np.zeros(3), np.zeros((3, count))  # q, q̇, a, and their rates by the commands
    rows, right = [], []
    for k in range(count):
        one = np.eye(count)[k]
        before, of_before = x[2], map_[2]
        force = mean * before - cart.STIFFNESS * x[0]
        of_force = mean * of_before + (1 - mean) * one - cart.STIFFNESS * map_[0]
        v = (cart.MASS * x[1] + T * force) / matrix
        of_v = (cart.MASS * map_[1] + T * of_force) / matrix
        x = np.array([x[0] + T * v, v, kept * before])
        map_ = np.array([map_[0] + T * of_v, of_v, kept * of_before + (1 - kept) * one])
        weights = np.sqrt(weighed[k] * np.array(own)), np.array([1.0, 0.0, 0.0])
        for weight in weights:
            rows.append(weight[:, None] * map_)
            right.append(weight * (np.array([0.1, 0.0, TARGET.u[0]]) - x))
        change = (1 - kept) * np.sqrt(planning.RATE * R * (1 + 1e-8))
        rows.append(change * (one - of_before)[None])
        right.append(np.array([change * before]))
    bounds = (model.u_min[0], model.u_max[0])
    found = lsq_linear(np.vstack(rows), np.concatenate(right), bounds, tol=1e-14)
    return found.x


@pytest.mark.parametrize("lag", [0.0, 0.03])
def test_on_a_linear_robot_it_is_the_bounded_least_squares_solution(slide, lag) -> None:
    found = make_plan(slide, ZERO, ZERO, ZERO, [TARGET], GOAL, lag)
    assert found is not None
    expected = best_commands(slide, lag, planning.FORM, len(found.commands))
    assert (expected > 1.5 - 1e-6).any()  # a bound is active
    np.testing.assert_allclose(found.commands[:, 0], expected, atol=1e-5)
    assert found.q[-1, 0] == pytest.approx(0.1, abs=0.01)


def test_it_keeps_the_bounds_and_is_the_same_twice(slide) -> None:
    start = np.array([0.05]), np.array([-2.0]), np.array([0.3])
    given = slide, *start, [TARGET], GOAL, 0.02, 0.05
    one, other = make_plan(*given), make_plan(*given)
    assert one is not None
    assert other is not None
    assert (one.commands >= slide.u_min).all()
    assert (one.commands <= slide.u_max).all()
    for name in ("q", "v", "acting", "commands", "gains"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()


def test_the_gains_are_those_of_the_dense_solution() -> None:
    rng = np.random.default_rng(0)
    count, n, m = 7, 2, 2
    nx = 2 * n + m
    A, B = 0.4 * rng.normal(size=(count, nx, nx)), rng.normal(size=(count, nx, m))
    J, error = rng.normal(size=(count, 3, n)), rng.normal(size=(count, 3))
    away, gap = rng.normal(size=(count, nx)), rng.normal(size=(count, m))
    weight, change = np.diag(rng.uniform(0.1, 1, nx)), np.diag(rng.uniform(0.1, 1, m))
    drift, last = rng.normal(size=(count, nx)), np.diag(rng.uniform(0.1, 1, nx))
    free = np.full((count, m), 1e9)
    steps, gains = backward(
        A, B, J, error, away, gap, drift, weight, last, change, 0 * change, -free, free
    )

    def rows(x: np.ndarray, c: np.ndarray) -> np.ndarray:
        """All terms whose squares are the cost of the commands c (count, m) from x."""
        made = []
        for k in range(count):
            made.append(np.sqrt(change) @ (gap[k] + c[k] - x[-m:]))
            x = A[k] @ x + B[k] @ c[k] + drift[k]
            made += [np.sqrt(weight) @ (away[k] + x), error[k] + J[k] @ x[:n]]
        made.append(np.sqrt(last) @ (away[-1] + x))
        return np.concatenate(made)

    first = rng.normal(size=nx)
    still = rows(first, np.zeros((count, m)))
    units = np.eye(count * m).reshape(-1, count, m)
    slope = np.array([rows(first, unit) - still for unit in units]).T
    expected = np.linalg.lstsq(slope, -still, rcond=None)[0].reshape(count, m)
    x, commands = first, []
    for k in range(count):
        commands.append(steps[k] + gains[k] @ x)
        x = A[k] @ x + B[k] @ commands[k] + drift[k]
    np.testing.assert_allclose(commands, expected, atol=1e-9)


def test_the_first_guess_leads_past_a_shape_that_the_simulation_would_not_reach(slide) -> None:
    problem = pose(slide, (np.array([-0.4]), np.zeros(1), np.zeros(1)), TARGET, GOAL, 0.0)
    found = search_path(problem, problem.straight(0.2))
    assert found is not None
    path, _ = found
    assert path.gaps == 0.0
    for k in range(len(path.commands)):  # the path obeys the model
        q, v, _ = path.x[k]
        force = path.commands[k, 0] - cart.STIFFNESS * q
        T, matrix = planning.STEP, cart.MASS + planning.STEP * cart.DAMPING
        after = (cart.MASS * v + T * force) / (matrix + T**2 * cart.STIFFNESS)
        np.testing.assert_allclose(path.x[k + 1, :2], [q + T * after, after], atol=1e-9)


def test_a_coasting_robot_moves_under_the_input_that_acts(slide) -> None:
    start = np.array([0.05]), np.array([0.0]), np.array([0.3])
    problem = pose(slide, start, TARGET, GOAL, 0.0)
    after = planning.coast(problem, 3.0)
    assert after is not None
    q, v, a = after.start
    assert q == pytest.approx(0.3 / cart.STIFFNESS, abs=0.1 * 0.05)
    assert a == start[2][0]
    assert abs(v) < 0.01


def test_a_step_beyond_a_stop_is_that_of_a_stiff_spring(slide) -> None:
    q, v, force, T = np.array([9.02]), np.array([3.0]), np.array([0.4]), planning.STEP
    problem = pose(slide, (q, v, force), TARGET, GOAL, 0.0)
    found = problem.step(problem.start, force, problem.start)
    assert found is not None
    stop = 1e4 * cart.MASS / T**2
    matrix = cart.MASS + T * cart.DAMPING + T**2 * (cart.STIFFNESS + stop)
    right = cart.MASS * v - T * (cart.STIFFNESS * q + stop * (q - slide.upper) - force)
    x, A, B = found
    np.testing.assert_allclose(x[1], right / matrix, rtol=1e-6)
    by = np.array([-T * (cart.STIFFNESS + stop), cart.MASS]) / matrix
    np.testing.assert_allclose(A[1, :2], by, rtol=1e-9)
    np.testing.assert_allclose(B[1], T / matrix, rtol=1e-9)
    np.testing.assert_allclose(A[0, :2], [1 + T * by[0], T * by[1]], rtol=1e-6, atol=1e-9)
