"""Small QPs: exact answers, correct residuals, and no hang on hostile numbers."""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy.optimize import linprog

from softdyn.controllers.qps.qp import (
    ACCEPTED,
    SOLVERS,
    DenseQp,
    QpProblem,
    QpSolution,
    residuals,
)
from tests.support.exact_qps import solve_daqp, solve_quadprog
from tests.support.qp_solvers import SymbolicQp, Term, unknowns

PATIENCE = 10.0  # s of processor time; a hang takes at least 25 s
INF = np.inf


def draw(seed: int, n: int, rows: int, spread: float = 1.0) -> QpProblem:
    """A strictly convex, feasible problem with open, one-sided, two-sided and pinned rows."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n))
    A = rng.normal(size=(rows, n)) * 10.0 ** rng.uniform(-spread, spread, (rows, 1))
    centre = A @ rng.normal(size=n)
    width = np.linalg.norm(A, axis=1)
    lower, upper = centre - width * rng.random(rows), centre + width * rng.random(rows)
    kind = np.arange(rows) % 5
    lower[kind == 1], upper[kind == 2] = -INF, INF
    pinned = np.flatnonzero(kind == 4)[: n // 2]
    lower[pinned] = upper[pinned] = centre[pinned]
    H = root @ root.T + 0.1 * np.eye(n)
    return QpProblem(H, 5 * rng.normal(size=n), A, lower, upper)


def one_sided(p: QpProblem) -> SymbolicQp:
    """The same problem as least squares: ½ xᵀHx + gᵀx = ½ ‖Lᵀx + L⁻¹g‖² + constant, H = L Lᵀ."""
    pinned = p.lower == p.upper
    above, below = np.isfinite(p.upper) & ~pinned, np.isfinite(p.lower) & ~pinned
    (x,), root = unknowns(len(p.g)), np.linalg.cholesky(p.H)
    return SymbolicQp(
        {"x": x},
        {"all": Term(0.5, root.T @ x + np.linalg.solve(root, p.g))},
        {"pinned": p.A[pinned] @ x - p.upper[pinned]},
        {"upper": p.A[above] @ x - p.upper[above], "lower": p.lower[below] - p.A[below] @ x},
    )


def solve(problem: QpProblem, solver: DenseQp | None = None) -> QpSolution | None:
    """Make one call and check its time."""
    solver = solver or DenseQp(len(problem.g), len(problem.lower))
    for _ in range(2):  # a first call may have to compile
        began = time.thread_time()
        with np.errstate(all="ignore"):  # as the controllers' own guard does
            solution = solver.solve(problem)
        elapsed = time.thread_time() - began
        if elapsed < PATIENCE:
            break
    assert elapsed < PATIENCE
    return solution


def optimal(p: QpProblem, x: np.ndarray, z: np.ndarray, tolerance: float = 1e-8) -> bool:
    """The Karush-Kuhn-Tucker conditions, independent of `residuals`."""
    Ax = p.A @ x
    at_upper, at_lower = np.isclose(Ax, p.upper, atol=1e-7), np.isclose(Ax, p.lower, atol=1e-7)
    size = 1 + np.abs(p.H @ x).max() + np.abs(p.g).max() + np.abs(z).max(initial=0)
    return bool(
        (Ax <= p.upper + tolerance * (1 + np.abs(Ax))).all()
        and (Ax >= p.lower - tolerance * (1 + np.abs(Ax))).all()
        and np.abs(p.H @ x + p.g + p.A.T @ z).max() < tolerance * size
        and (z[~at_upper] <= tolerance * size).all()
        and (z[~at_lower] >= -tolerance * size).all()
    )


@pytest.mark.parametrize("n", [1, 2, 4, 7, 13, 20])
@pytest.mark.parametrize("ratio", [0.0, 0.5, 1.0, 2.0])
def test_random_problems(n: int, ratio: float) -> None:
    rows = round(ratio * n)
    solver = DenseQp(n, rows)  # one workspace for all, as in a controller
    for seed in range(12):
        problem = draw(seed, n, rows)
        solution = solve(problem, solver)
        assert solution is not None
        assert solution.solved
        assert optimal(problem, solution.x, solution.multipliers)
        qp = one_sided(problem)
        if rows == 0:
            answers = [np.linalg.solve(problem.H, -problem.g)]
        else:
            oracles = solve_quadprog(qp), solve_daqp(qp)
            assert max(oracle.residual for oracle in oracles) < 1e-9
            answers = [oracle["x"] for oracle in oracles]
        for x in answers:
            tolerance = 1e-8 * max(1.0, np.abs(x).max())
            np.testing.assert_allclose(solution.x, x, rtol=0, atol=tolerance)


@pytest.mark.parametrize("seed", range(10))
def test_residuals_by_another_formula(seed: int) -> None:
    problem = draw(seed, 6, 8)
    rng = np.random.default_rng(seed)
    x, z = rng.normal(size=6), rng.normal(size=8)
    z[np.isinf(problem.upper)] = -np.abs(z[np.isinf(problem.upper)])
    z[np.isinf(problem.lower)] = np.abs(z[np.isinf(problem.lower)])
    primal, dual, gap = residuals(problem, x, z)

    H, g, A, lower, upper = problem
    Ax = [sum(A[i, j] * x[j] for j in range(6)) for i in range(8)]
    worst = [max(lower[i] - Ax[i], Ax[i] - upper[i], 0.0) for i in range(8)]
    width = [upper[i] - lower[i] for i in range(8)]
    largest = max(1, *map(abs, Ax))
    shares = [
        max(worst[i] - 2.0**-44 * largest, 0.0) / width[i]
        if 0 < width[i] < 1
        else worst[i] / largest
        for i in range(8)
    ]
    expected = max(shares)
    assert primal == pytest.approx(expected, rel=1e-12)

    terms = np.stack((H @ x, g, np.einsum("ij,i->j", A, z)))
    assert dual == pytest.approx(np.abs(terms.sum(0)).max() / max(1, np.abs(terms).max()), rel=1e-9)

    # the dual function at z, with x as its minimiser: -½ xᵀHx - Σ z⁺ u + Σ z⁻ l
    support = sum(z[i] * (upper[i] if z[i] > 0 else lower[i]) for i in range(8))
    value = 0.5 * x @ H @ x + g @ x
    scale = max(1, abs(x @ H @ x), abs(g @ x), abs(support))
    dual_value = -0.5 * x @ H @ x - support
    assert gap == pytest.approx(abs(value - dual_value) / scale, rel=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_a_wrong_answer_is_not_called_solved(seed: int) -> None:
    problem = draw(seed, 6, 8)
    right = solve(problem)
    assert right is not None
    rng = np.random.default_rng(seed)
    for size in (1e-3, 1.0, 1e3):
        x = right.x + size * rng.normal(size=6)
        assert not QpSolution(
            x, right.multipliers, *residuals(problem, x, right.multipliers)
        ).solved
        z = right.multipliers + size * rng.normal(size=8)
        assert not QpSolution(right.x, z, *residuals(problem, right.x, z)).solved


@pytest.mark.parametrize("bad", [np.nan, INF])
def test_no_residual_that_is_no_number_counts_as_solved(bad: float) -> None:
    for position in range(3):
        values = [0.0, 0.0, 0.0]
        values[position] = bad
        assert not QpSolution(np.zeros(1), np.zeros(1), *values).solved
    assert QpSolution(np.zeros(1), np.zeros(1), ACCEPTED, 0.0, 0.0).solved


@pytest.mark.parametrize("seed", range(10))
def test_answers_of_every_solver_agree(seed: int) -> None:
    problem = draw(seed, 7, 9)
    exact = solve(problem)
    assert exact is not None
    assert max(exact[2:]) < 1e-12
    for solver in SOLVERS[1:]:
        alone = DenseQp(7, 9)
        alone._solvers = (solver,)
        other = solve(problem, alone)
        assert other is not None
        assert other.solved
        np.testing.assert_allclose(other.x, exact.x, rtol=0, atol=1e-7 * np.abs(exact.x).max())


def test_proxqp_answers_what_daqp_leaves() -> None:
    # a linear program; with tiny steps DAQP's repetitions end a little early
    rng = np.random.default_rng(1255)
    A = np.vstack((np.eye(3), rng.normal(size=(3, 3))))
    centre, g = A @ rng.normal(size=3), rng.normal(size=3)
    problem = QpProblem(np.zeros((3, 3)), g, A, centre - rng.random(6), centre + rng.random(6))
    first = DenseQp(3, 6)
    first._solvers = SOLVERS[:2]
    left, found = solve(problem, first), solve(problem)
    assert left is not None
    assert found is not None
    assert max(found[2:]) < max(left[2:])
    vertex = linprog(g, np.vstack((A, -A)), np.concatenate((problem.upper, -problem.lower)),
                     bounds=(None, None)).x  # fmt: skip
    np.testing.assert_allclose(found.x, vertex, rtol=0, atol=1e-7)


@pytest.mark.parametrize("exponent", [-10, -12, -14])
def test_hessians_that_are_nearly_singular(exponent: int) -> None:
    """At a condition of 1e12 DAQP's first answer is wrong in one problem of five."""
    rng = np.random.default_rng(2)
    for _ in range(50):
        axes = np.linalg.qr(rng.normal(size=(4, 4)))[0]
        H = axes * np.logspace(0, exponent, 4) @ axes.T
        A = np.vstack((np.eye(4), rng.normal(size=(2, 4))))
        centre = A @ rng.normal(size=4)
        bounds = centre - rng.random(6), centre + rng.random(6)
        found = solve(QpProblem((H + H.T) / 2, rng.normal(size=4), A, *bounds))
        assert found is not None
        assert max(found[2:]) < 1e-9


# -- hostile ---------------------------------------------------------------------------------------


def poisoned() -> list[QpProblem]:
    problems = []
    for seed, value in enumerate((np.nan, INF, -INF)):
        for field in range(5):
            arrays = [a.copy() for a in draw(seed, 5, 6)]
            arrays[field].flat[field % arrays[field].size] = value
            problems.append(QpProblem(*arrays))
            arrays[field][...] = value
            problems.append(QpProblem(*[a.copy() for a in arrays]))
    return problems


@pytest.mark.parametrize("problem", poisoned())
def test_numbers_that_are_not(problem: QpProblem) -> None:
    solver = DenseQp(5, 6)
    good = draw(3, 5, 6)
    first = solve(good, solver)
    solution = solve(problem, solver)
    legal = (
        all(np.isfinite(a).all() for a in problem[:3])
        and not np.isnan(problem.lower).any()
        and not np.isnan(problem.upper).any()
        and (problem.lower <= problem.upper).all()
        and (problem.lower < INF).all()
        and (problem.upper > -INF).all()
    )
    if legal:  # an open bound
        assert solution is not None
        assert solution.solved
    else:
        assert solution is None
    after = solve(good, solver)
    assert first is not None
    assert after is not None
    np.testing.assert_array_equal(first.x, after.x)


def test_bounds_that_cross() -> None:
    problem = draw(0, 4, 6)
    for i in range(6):
        lower, upper = problem.lower.copy(), problem.upper.copy()
        lower[i], upper[i] = 1.0, 1.0 - 1e-12
        assert solve(problem._replace(lower=lower, upper=upper)) is None


def test_rows_that_contradict_each_other() -> None:
    # each row alone is valid, so that only the residuals show the error
    A = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    problem = QpProblem(
        np.eye(2), np.ones(2), A, np.array([1.0, -INF, -1]), np.array([INF, -1.0, 1])
    )
    solution = solve(problem)
    assert solution is None or not solution.solved


@pytest.mark.parametrize("exponent", [-300, -150, -30, -9, 9, 30, 150, 300])
@pytest.mark.parametrize("field", range(5))
def test_huge_and_tiny_scales(field: int, exponent: int) -> None:
    arrays = [a.copy() for a in draw(1, 5, 6)]
    arrays[field] = arrays[field] * 10.0**exponent
    problem = QpProblem(*arrays)
    solution = solve(problem)
    if solution is not None and solution.solved:
        assert np.isfinite(solution.x).all()


@pytest.mark.parametrize("exponent", [-12, -6, 6, 12])
def test_answers_scale_with_the_problem(exponent: int) -> None:
    s = 10.0**exponent
    for seed in range(5):
        H, g, A, lower, upper = draw(seed, 6, 7)
        reference = solve(QpProblem(H, g, A, lower, upper))
        assert reference is not None
        # rows in other units: the same x
        rows = solve(QpProblem(H, g, A * s, lower * s, upper * s))
        assert rows is not None
        np.testing.assert_allclose(rows.x, reference.x, rtol=1e-7, atol=1e-9)
        # unknowns in other units
        units = solve(QpProblem(H * s * s, g * s, A * s, lower, upper))
        assert units is not None
        np.testing.assert_allclose(units.x * s, reference.x, rtol=1e-7, atol=1e-9)


def test_degenerate_active_sets() -> None:
    # the optimum sits where three rows meet in the plane, and where a row is repeated
    H, g = np.eye(2), np.array([-2.0, -2.0])
    A = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 1.0]])
    upper = np.array([1.0, 1.0, 2.0, 2.0])
    solution = solve(QpProblem(H, g, A, np.full(4, -INF), upper))
    assert solution is not None
    assert solution.solved
    np.testing.assert_allclose(solution.x, [1.0, 1.0], atol=1e-7)


def test_weakly_active_rows() -> None:
    # the unconstrained minimiser lies exactly on the bounds: multipliers are zero
    H, g = np.diag([1.0, 2.0]), np.array([-1.0, 2.0])
    solution = solve(QpProblem(H, g, np.eye(2), np.array([-5.0, -1.0]), np.array([1.0, 5.0])))
    assert solution is not None
    assert solution.solved
    np.testing.assert_allclose(solution.x, [1.0, -1.0], atol=1e-8)


def test_zero_rows() -> None:
    A = np.array([[0.0, 0.0], [1.0, 0.0]])
    H, g = np.eye(2), np.array([-3.0, 1.0])
    fine = solve(QpProblem(H, g, A, np.array([-1.0, -1.0]), np.array([1.0, 1.0])))
    assert fine is not None
    assert fine.solved
    np.testing.assert_allclose(fine.x, [1.0, -1.0], atol=1e-9)
    impossible = solve(QpProblem(H, g, A, np.array([1.0, -1.0]), np.array([2.0, 1.0])))
    assert impossible is None or not impossible.solved


def test_a_semidefinite_hessian() -> None:
    H, g = np.diag([1.0, 0.0]), np.array([-3.0, 1.0])
    solution = solve(QpProblem(H, g, np.eye(2), -np.ones(2), np.ones(2)))
    assert solution is not None
    assert solution.solved
    np.testing.assert_allclose(solution.x, [1.0, -1.0], atol=1e-7)


def test_an_unbounded_problem_is_not_called_solved() -> None:
    solution = solve(
        QpProblem(
            np.diag([1.0, 0.0]), np.array([0.0, -1.0]), np.eye(2), -np.ones(2), np.full(2, INF)
        )
    )
    assert solution is None or not solution.solved


@pytest.mark.parametrize("seed", range(6))
def test_ill_conditioned_rows(seed: int) -> None:
    # two rows that differ in the eighth digit, as cables on almost one line
    rng = np.random.default_rng(seed)
    H, g, A, *_ = draw(seed, 4, 4)
    A[1] = A[0] + 1e-8 * rng.normal(size=4)
    centre = A @ rng.normal(size=4)
    problem = QpProblem(H, g, A, centre - 1.0, centre + 1.0)
    solution = solve(problem)
    assert solution is not None
    assert solution.solved
    qp = one_sided(problem)
    exact = solve_daqp(qp)

    def objective(x: np.ndarray) -> float:
        return float(x @ problem.H @ x / 2 + problem.g @ x)

    best = objective(exact["x"])
    assert objective(solution.x) == pytest.approx(best, rel=1e-6, abs=1e-6)


def three_cables_ahead(seed: int) -> QpProblem:
    """Inputs of three cables at five knots of a horizon: all three together have little effect."""
    rng = np.random.default_rng(seed)
    angles = 2 * np.pi / 3 * np.arange(3)
    effect = np.vstack((np.cos(angles), np.sin(angles), np.full(3, 10 ** rng.uniform(-5, -3))))
    knots, steps = np.array([0, 2, 5, 10, 20, 40]), np.arange(1, 41)
    ramps = np.cumsum([np.interp(steps, knots, one) for one in np.eye(6)[1:]], axis=1)
    F = np.einsum("kt,xa->txka", ramps, effect).reshape(-1, 15)
    H = 2 * F.T @ F
    H += 1e-10 * np.trace(H) / 15 * np.eye(15)
    g = -2 * F.T @ (F @ rng.normal(size=15) * 30 + rng.normal(size=len(F)))
    return QpProblem(H, g, np.eye(15), np.full(15, -38.0), np.full(15, 61.0))


def test_an_ill_conditioned_hessian_has_one_exact_answer() -> None:
    """Its condition is 1e10; ProxQP alone leaves a gap of 1e-7 in one problem of ten."""
    solver = DenseQp(15, 15)
    for seed in range(60):
        problem = three_cables_ahead(seed)
        solution = solve(problem, solver)
        assert solution is not None
        assert max(solution[2:]) < 1e-9
        exact = solve_quadprog(one_sided(problem))["x"]
        effect = problem.H @ (solution.x - exact)
        assert np.abs(effect).max() < 1e-8 * np.abs(problem.H @ exact).max()


def test_answers_do_not_depend_on_what_was_solved_before() -> None:
    solver = DenseQp(6, 8)
    for seed in range(20):
        problem = draw(seed, 6, 8)
        one, two = solve(problem, solver), solve(problem)
        assert one is not None
        assert two is not None
        np.testing.assert_array_equal(one.x, two.x)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("width", [1e-15, 1e-12, 1e-9, 1e-6])
def test_rows_with_hardly_any_room(seed: int, width: float) -> None:
    """Their width may be less than the rounding of their sums, which is no excess."""
    rng = np.random.default_rng(seed)
    n, narrow = 10, np.arange(10) % 2 == 1
    root = rng.normal(size=(n, n))
    A = np.eye(n) - 0.9 * np.eye(n, k=-2)
    lower = rng.normal(size=n)
    upper = lower + np.where(narrow, width, rng.uniform(0.1, 2.0, n))
    problem = QpProblem(root @ root.T + 0.01 * np.eye(n), 5 * rng.normal(size=n), A, lower, upper)
    found, pinned = solve(problem), solve(problem._replace(upper=np.where(narrow, lower, upper)))
    assert found is not None
    assert pinned is not None
    assert found.solved
    excess = np.maximum(lower - A @ found.x, A @ found.x - upper)
    assert excess[narrow].max() < 1e-13
    np.testing.assert_allclose(found.x, pinned.x, atol=1e3 * width + 1e-9)
