"""Plans through a fold, against dense solutions of the same problems."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from softdyn import InputError, SoftModel
from softdyn.controllers.predictive import plan as planning
from softdyn.controllers.predictive.follow import PlanFollower
from softdyn.controllers.predictive.plan import make_plan
from softdyn.controllers.predictive.rest_target import RestTarget
from softdyn.controllers.predictive.riccati import backward, bounded_minimum
from tests.support import cart

GOAL = np.array([cart.LENGTH + 0.1, 0.0, 0.0])
TARGET = RestTarget(np.array([0.1]), np.array([cart.STIFFNESS * 0.1]), True, 0.0)


@pytest.fixture
def slide(tmp_path, monkeypatch) -> SoftModel:
    """A cart on a spring: its dynamics are linear, so that one pass is exact."""
    monkeypatch.setattr(planning, "STEPS", 30)
    monkeypatch.setattr(planning, "SETTLED", 1e-12)
    text = cart.CART.format(damping=cart.DAMPING, stiffness=cart.STIFFNESS, lower=-1.0, upper=1.5)
    return cart.load(tmp_path, text)


def best_commands(model: SoftModel, lag: float, form: float, count: int) -> np.ndarray:
    """The same problem on the cart by bounded least squares over all commands at once."""
    T, kept = planning.STEP, np.exp(-planning.STEP / lag) if lag else 0.0
    mean = (1 - kept) * lag / T
    H = planning.HORIZON
    S = cart.MASS / H**2 + cart.DAMPING / H + cart.STIFFNESS
    R = 1 / S**2  # Bᵀ S⁻¹ B times the compliance 1 / S
    matrix = cart.MASS + T * cart.DAMPING + T**2 * cart.STIFFNESS
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
        weights = np.sqrt([1.0 + form, (planning.SPEED * H) ** 2, planning.HOLD * R])
        rows.append(weights[:, None] * map_)
        right.append(weights * (np.array([0.1, 0.0, TARGET.u[0]]) - x))
        change = (1 - kept) * np.sqrt(planning.RATE * R * (1 + 1e-8))
        rows.append(change * (one - of_before)[None])
        right.append(np.array([change * before]))
    bounds = (model.u_min[0], model.u_max[0])
    found = lsq_linear(np.vstack(rows), np.concatenate(right), bounds, tol=1e-14)
    return found.x


@pytest.mark.parametrize("lag", [0.0, 0.03])
def test_on_a_linear_robot_it_is_the_bounded_least_squares_solution(slide, lag) -> None:
    found = make_plan(slide, [0.0], [0.0], [0.0], TARGET, GOAL, lag)
    assert found is not None
    expected = best_commands(slide, lag, planning.FORM, len(found.commands))
    assert (expected > 1.5 - 1e-6).any()  # a bound is active
    np.testing.assert_allclose(found.commands[:, 0], expected, atol=1e-5)
    assert found.error[0] == pytest.approx(0.1)
    assert found.error[-1] < 0.01


def test_it_keeps_the_bounds_and_is_the_same_twice(slide, monkeypatch) -> None:
    monkeypatch.setattr(planning, "PULLS", (4.0,))
    monkeypatch.setattr(planning, "ITERATIONS", 8)
    given = slide, [0.05], [-2.0], [0.3], TARGET, GOAL, 0.02
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
    free = np.full((count, m), 1e9)
    steps, gains = backward(A, B, J, error, away, gap, weight, change, 0 * change, -free, free)

    def rows(x: np.ndarray, c: np.ndarray) -> np.ndarray:
        """All terms whose squares are the cost of the commands c (count, m) from x."""
        made = []
        for k in range(count):
            made.append(np.sqrt(change) @ (gap[k] + c[k] - x[-m:]))
            x = A[k] @ x + B[k] @ c[k]
            made += [np.sqrt(weight) @ (away[k] + x), error[k] + J[k] @ x[:n]]
        return np.concatenate(made)

    first = rng.normal(size=nx)
    still = rows(first, np.zeros((count, m)))
    units = np.eye(count * m).reshape(-1, count, m)
    slope = np.array([rows(first, unit) - still for unit in units]).T
    expected = np.linalg.lstsq(slope, -still, rcond=None)[0].reshape(count, m)
    x, commands = first, []
    for k in range(count):
        commands.append(steps[k] + gains[k] @ x)
        x = A[k] @ x + B[k] @ commands[k]
    np.testing.assert_allclose(commands, expected, atol=1e-9)


def test_the_bounded_minimum_is_that_of_least_squares() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        m = int(rng.integers(1, 9))
        root, g = rng.normal(size=(m + 2, m)), 3 * rng.normal(size=m)
        lower, upper = -rng.uniform(0, 1, m), rng.uniform(0, 1, m)
        H = root.T @ root + 0.1 * np.eye(m)
        L = np.linalg.cholesky(H)
        expected = lsq_linear(L.T, -np.linalg.solve(L, g), (lower, upper + 1e-12), "bvls").x
        x, free = bounded_minimum(H, g, lower, upper)
        np.testing.assert_allclose(x, expected, atol=1e-7)
        np.testing.assert_allclose((g + H @ x)[free], 0.0, atol=1e-6)


def test_a_plan_follows_where_the_tip_stays_away_from_its_target(slide) -> None:
    follow = PlanFollower(slide, 0.0, background=False)
    follow.reset(0.1)
    state = slide.state([-0.4], [0.0])
    near = slide.state([0.05], [0.0])
    given = TARGET, GOAL, state, np.zeros(1), np.zeros(1), np.zeros(1)
    assert all(follow(TARGET, GOAL, near, *given[3:]) is None for _ in range(30))
    assert follow(None, *given[1:]) is None
    answers = [follow(*given) for _ in range(40)]
    first = next(k for k, one in enumerate(answers) if one is not None)
    assert first * 0.1 == pytest.approx(1.5, abs=0.11)
    expected = make_plan(slide, [-0.4], [0.0], [0.0], TARGET, GOAL)
    np.testing.assert_array_equal(answers[first], expected.commands[0])
    assert [one is not None for one in answers].count(True) == 3  # 0.3 s, and once only


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": [0.0, 1.0]}, "q: expected"),
        ({"acting": [np.nan]}, "acting: expected"),
        ({"lag": -1.0}, "lag: expected"),
        ({"goal": [0.0]}, "goal: expected"),
    ],
)
def test_wrong_arguments_are_one_line(slide, change, message) -> None:
    given = {"q": [0.0], "v": [0.0], "acting": [0.0], "target": TARGET, "goal": GOAL}
    with pytest.raises(InputError, match=message):
        make_plan(slide, **(given | change))
