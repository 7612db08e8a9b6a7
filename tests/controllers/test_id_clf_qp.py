"""The condensed Soft ID-CLF-QP is the paper's QP: compared with the textbook form, solved exactly.

If the minimiser is unique, inputs are compared. The controller narrows the input bounds by
`BACKOFF` of their range. So u is compared with the true bounds, and the objective, whose slope at a
bound may be large, with equally narrowed bounds. If the minimiser is not unique (w2 = w4 = 0, or w3
= 0 and rank(B) < m), the optimal value is compared: with the controller's u fixed in the textbook
QP, the optimum must be as good as with u free.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from softdyn import SetPoint, SoftModel, State
from softdyn.controllers import Gains, IdClfQp, ImpedanceQp, SoftIdClfQp, Status
from softdyn.controllers.qps.soft_inverse_dynamics import SoftInverseDynamics
from softdyn.controllers.qps.task_qp import BACKOFF
from softdyn.controllers.qps.tip_error import TipError
from softdyn.dynamics.integrators import step_implicit
from softdyn.validation import paper
from tests.support.control_cases import (
    BUNDLED,
    GAINS,
    MICRO,
    RANK_DEFICIENT,
    drawn,
    gains_of,
    recorded,
    robot,
)
from tests.support.exact_qps import printed, solve_daqp, solve_quadprog, with_input
from tests.support.paper_qps import RANK_TOLERANCE, actuated_rows, ic_qp, id_clf_qp
from tests.support.qp_solvers import SolverAnswer, SymbolicQp, Term
from tests.support.refused import refused

RIDGE = 1e-7  # of the proximal iteration on semidefinite QPs
every_robot = pytest.mark.parametrize("name", BUNDLED + MICRO)


def cases(name: str) -> list[tuple[State, SetPoint]]:
    return [*drawn(name), *(recorded(name) if name in BUNDLED else ())]


def spread(model: SoftModel) -> float:
    return float((model.u_max - model.u_min).max()) or 1.0


def solve_both(model: SoftModel, qp: SymbolicQp) -> SolverAnswer:
    """quadprog's answer, confirmed by DAQP; both must meet the optimality conditions."""
    one, two = solve_quadprog(qp), solve_daqp(qp)
    assert one.residual < 1e-10
    assert two.residual < 1e-10
    np.testing.assert_allclose(one["u"], two["u"], rtol=0, atol=1e-8 * spread(model))
    return one


def free_at(u_ref: float, qp: SymbolicQp) -> SymbolicQp:
    """The same QP, where one input has no cost."""
    weight, u, _ = qp.cost["input"]
    return replace(qp, cost=qp.cost | {"input": Term(weight, u - u_ref)})


def relative(value: float, best: float) -> float:
    return (value - best) / max(1.0, abs(best))


@every_robot
def test_inputs_are_those_of_the_textbook_form(name: str) -> None:
    model, gains = robot(name), gains_of(name)
    controller = SoftIdClfQp(model, gains)
    for state, reference in cases(name):
        exact = solve_both(model, printed(state, reference, gains))
        u = controller(state, reference).u
        np.testing.assert_allclose(u, exact["u"], rtol=0, atol=1e-6 * spread(model))
    assert controller.guard.fallbacks == 0


@pytest.mark.parametrize("name", ["finger", "spirob", "sliding and turning"])
def test_an_input_that_costs_nothing(name: str) -> None:
    model, gains = robot(name), gains_of(name)
    u_ref = float(model.u_min[0] + 0.3 * spread(model))
    for given in (u_ref, np.full(model.nu, u_ref)):
        controller = SoftIdClfQp(model, gains, u_ref=given)
        for state, reference in cases(name)[:6]:
            exact = solve_both(model, free_at(u_ref, printed(state, reference, gains)))
            u = controller(state, reference).u
            np.testing.assert_allclose(u, exact["u"], rtol=0, atol=1e-6 * spread(model))
    for wrong in (np.zeros(model.nu + 1), "x", np.nan, [[0.0] * model.nu]):
        with refused("u_ref"):
            SoftIdClfQp(model, gains, u_ref=wrong)


@every_robot
def test_objective_is_that_of_the_textbook_form(name: str) -> None:
    model, gains = robot(name), gains_of(name)
    controller = SoftIdClfQp(model, gains)
    for state, reference in cases(name):
        qp = printed(state, reference, gains, margin=BACKOFF)
        exact = solve_both(model, qp)
        command = controller(state, reference)
        pinned = solve_quadprog(with_input(qp, command.u))
        best = exact.cost
        assert abs(relative(pinned.cost, best)) < 1e-8
        # and δ, in the units of V̇
        size = max(1.0, abs(exact["delta"][0]))
        assert abs(command.delta - exact["delta"][0]) < 1e-7 * size


def test_the_cases_cover_what_they_should() -> None:
    for name in BUNDLED:
        model, controller = robot(name), SoftIdClfQp(robot(name))
        margins = []
        for state, reference in cases(name):
            u = controller(state, reference).u
            margins.append(min((u - model.u_min).min(), (model.u_max - u).min()))
        assert min(margins) < 1e-6 * spread(model), name  # saturated
        assert max(margins) > 1e-4 * spread(model), name  # and not

    def rank(matrix: np.ndarray) -> int:
        values = scipy.linalg.svdvals(matrix)
        return int((values > RANK_TOLERANCE * values[0]).sum())

    assert all(rank(state.J) < 3 for state, _ in cases("finger"))
    assert rank(recorded("spirob")[0][0].J) < 3  # hanging straight
    assert rank(recorded("spirob")[0][0].B) == 2  # three cables at 120°
    for name in RANK_DEFICIENT:
        assert rank(cases(name)[0][0].B) < robot(name).nu
    n_and_m = {(robot(name).nv, robot(name).nu) for name in MICRO}
    assert any(n < 3 + m for n, m in n_and_m)
    assert any(n < m for n, m in n_and_m)


@pytest.mark.parametrize(
    "weights",
    [
        {"w2": 0.0, "w4": 0.0},
        {"w3": 0.0},
        {"w4": 0.0},
        {"w3": 0.0, "w4": 0.0},
        {"w2": 0.0},
        {"w1": 0.0},
        {"null_damping": 0.0},
    ],
    ids=str,
)
@every_robot
def test_edges_of_the_weights(name: str, weights: dict[str, float]) -> None:
    model, gains = robot(name), replace(gains_of(name), **weights)
    controller = SoftIdClfQp(model, gains)
    compared = 0
    for state, reference in cases(name)[::3]:
        qp = printed(state, reference, gains, margin=BACKOFF)
        command = controller(state, reference)
        assert command.status is Status.OK
        exact = solve_quadprog(qp, RIDGE)
        pinned = solve_quadprog(with_input(qp, command.u), RIDGE)
        assert pinned.residual < 1e-9
        gap = relative(pinned.cost, exact.cost)
        assert gap < 1e-7  # never worse than the oracle
        if exact.residual < 1e-10:  # the oracle itself has converged
            compared += 1
            assert gap > -1e-7
    assert compared


@pytest.mark.parametrize("name", [*BUNDLED, "n < 3 + m", "planar", *RANK_DEFICIENT])
def test_the_theorem_in_the_oracles_own_answer(name: str) -> None:
    # docs/derivations.md: at the optimum q̈ + c q̇ lies in the span of Jᵀ and of M range(B)
    gains = gains_of(name)
    c = gains.w4 * gains.null_damping / (gains.w2 + gains.w4)
    for state, reference in cases(name):
        exact = solve_quadprog(printed(state, reference, gains))
        q̈ = exact["qdd"]
        rows = actuated_rows(state.B)[0] @ state.M
        span = scipy.linalg.orth(np.vstack((state.J, rows / np.linalg.norm(rows))).T, rcond=1e-9)
        rest = q̈ + c * state.v
        outside = rest - span @ (span.T @ rest)
        assert np.abs(outside).max() <= 1e-7 * max(1.0, np.abs(rest).max())


@every_robot
def test_the_slack_is_never_negative(name: str) -> None:
    controller = SoftIdClfQp(robot(name), gains_of(name))
    for state, reference in cases(name):
        delta = controller(state, reference).delta
        assert delta >= -1e-9 * max(1.0, abs(delta))


@every_robot
def test_the_qp_has_at_most_m_plus_4_unknowns(name: str) -> None:
    model, gains = robot(name), gains_of(name)
    dynamics = SoftInverseDynamics(gains, model.nu)
    state, reference = cases(name)[0]
    tip = TipError(gains)
    tip.update(state, reference)
    condensed = dynamics.condense(state, state.M, state.h, tip)
    assert dynamics.size == model.nu + 3
    assert condensed.H.shape == (model.nu + 3,) * 2
    assert condensed.mu_map.shape == (3, model.nu + 3)


def test_collocated_rows_are_the_pseudo_inverse() -> None:
    # the paper's T⁻ᵀ with T = [Bᵀ; null(Bᵀ)] has B⁺ as its first m rows
    for name in (*BUNDLED, "n < 3 + m", "planar", "sliding and turning"):
        for state, _ in drawn(name)[:4]:
            R, S = actuated_rows(state.B)
            assert len(R) == robot(name).nu
            np.testing.assert_array_equal(S, np.eye(len(R)))
            inverse = np.linalg.pinv(state.B)
            np.testing.assert_allclose(R, inverse, rtol=0, atol=1e-9 * np.abs(inverse).max())


@pytest.mark.parametrize("theta", paper.THETAS)
def test_the_rank_threshold_decides_nothing_on_the_paths_of_spirob(theta: float) -> None:
    model, gains = robot("spirob"), gains_of("spirob")
    controller, goal = (
        SoftIdClfQp(model),
        paper.set_point("spirob", theta).reference(0.0),
    )
    q, v = model.q0, np.zeros(model.nv)
    for _ in range(10):
        state = model.state(q, v)
        u = controller(state, goal).u
        for tolerance in (1e-9, 1e-4):
            exact = solve_quadprog(printed(state, goal, gains, tolerance=tolerance))
            np.testing.assert_allclose(u, exact["u"], rtol=0, atol=1e-6 * spread(model))
        for _ in range(4):
            q, v = step_implicit(model, q, v, u, 5e-4)
    assert controller.guard.fallbacks == 0


@pytest.mark.parametrize("scale", [1e-12, 1e-8, 1e-7, 1e-6, 2e-6, 3e-6, 1e-5, 3e-5, 1e-4, 1e-2])
def test_an_almost_singular_input_matrix(scale: float) -> None:
    # as q → 0, B's smallest singular value and its inverse pass through every magnitude
    model, gains = robot("spirob"), gains_of("spirob")
    controller = SoftIdClfQp(model)
    for seed in range(18):
        rng = np.random.default_rng(seed)
        q = scale * rng.normal(size=model.nv)
        state = model.state(q, rng.normal(size=model.nv) * (0.0, 1e-3, 0.1)[seed % 3])
        goal = SetPoint(state.y + rng.normal(size=3) * (1e-4, 1e-2, 0.3)[seed // 3 % 3])
        u = controller(state, goal).u
        values = scipy.linalg.svdvals(state.B)
        if not 0.1 < values[-1] / values[0] / RANK_TOLERANCE < 10:  # the rank is not in doubt
            exact = solve_both(model, printed(state, goal, gains))
            np.testing.assert_allclose(u, exact["u"], rtol=0, atol=1e-6 * spread(model))
    assert controller.guard.fallbacks == 0
    assert controller.guard.max_bound_violation == 0


@pytest.mark.parametrize("name", BUNDLED)
def test_closed_loops_solve_every_qp(name: str) -> None:
    model, setup = robot(name), paper.setup(name)
    for theta in (0.5, 1.0):
        controller, goal = (
            SoftIdClfQp(model),
            paper.set_point(name, theta).reference(0.0),
        )
        q, v = model.q0, np.zeros(model.nv)
        for _ in range(round(0.5 / setup.period)):
            u = controller(model.state(q, v), goal).u
            for _ in range(round(setup.period / 5e-4)):
                q, v = step_implicit(model, q, v, u, 5e-4)
        assert controller.guard.fallbacks == 0
        assert controller.guard.max_bound_violation <= 1e-9 * spread(model)


@pytest.mark.parametrize("name", [*BUNDLED, "planar", "n < 3 + m", "sliding and turning"])
def test_impedance_qp_is_the_qp_without_the_condition(name: str) -> None:
    model = robot(name)
    controller = ImpedanceQp(model, None if name in BUNDLED else GAINS)
    for state, reference in cases(name):
        qp = printed(state, reference, controller.gains, ic_qp)
        exact = solve_both(model, qp)
        u = controller(state, reference).u
        np.testing.assert_allclose(u, exact["u"], rtol=0, atol=1e-6 * spread(model))


@pytest.mark.parametrize("name", [*BUNDLED, "planar", "n < 3 + m", *RANK_DEFICIENT])
def test_hard_id_clf_qp_asks_all_of_the_dynamics(name: str) -> None:
    model = robot(name)
    controller = IdClfQp(model, None if name in BUNDLED else GAINS)
    for state, reference in cases(name):
        exact = solve_quadprog(printed(state, reference, controller.gains, id_clf_qp))
        assert exact.residual < 1e-9
        u = controller(state, reference).u
        np.testing.assert_allclose(u, exact["u"], rtol=0, atol=1e-6 * spread(model))


def test_the_soft_qp_is_the_hard_one_when_fully_actuated() -> None:
    soft, hard = (C(robot("fully actuated"), GAINS) for C in (SoftIdClfQp, IdClfQp))
    for state, reference in cases("fully actuated"):
        one, two = soft(state, reference), hard(state, reference)
        np.testing.assert_allclose(one.u, two.u, rtol=0, atol=1e-7 * spread(state.model))


def test_gains_matter() -> None:
    # guards against a term that both textbook form and controller ignore
    model, gains, pairs = robot("helix"), gains_of("helix"), cases("helix")
    base = [SoftIdClfQp(model)(*pair).u for pair in pairs]
    for field in Gains.__dataclass_fields__:
        controller = SoftIdClfQp(model, replace(gains, **{field: 1.5 * getattr(gains, field)}))
        changed = [controller(*pair).u for pair in pairs]
        assert np.abs(np.subtract(changed, base)).max() > 1e-6 * spread(model), field
        for pair, u in zip(pairs, changed, strict=True):
            exact = solve_quadprog(printed(*pair, controller.gains))
            np.testing.assert_allclose(u, exact["u"], rtol=0, atol=1e-6 * spread(model))
