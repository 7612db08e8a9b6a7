"""The CLF-QP has many minimisers: tests of its cost, and of the minimiser of least norm."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize

from softdyn import Reference
from softdyn.controllers import ClfQp
from softdyn.controllers.qps.least_norm import bounded_least_norm
from tests.support.control_cases import BUNDLED, GAINS, MICRO, drawn, recorded, robot
from tests.support.exact_qps import printed
from tests.support.paper_qps import clf_qp, lyapunov, tip
from tests.support.qp_solvers import LeastNorm, Quadprog


def linearisation(state, reference, gains):
    """The paper's QP in u alone: L_g L_f y (3, m), and the drift of μ."""
    qp = printed(state, reference, gains, clf_qp)
    rows, m = qp.equal["linearisation"], state.model.nu
    return rows.matrix[:, :m], rows.constant


def cost(u, state, reference, gains) -> float:
    """w1 ‖μ - μ_ref‖² + ρ δ² at the best δ."""
    LgLf, drift = linearisation(state, reference, gains)
    task, mu = tip(state, reference), LgLf @ u + drift
    V, rest, slope = lyapunov(task, gains.eps)
    slack = max(0.0, rest + slope @ mu + V / gains.eps)
    return gains.w1 * np.sum((mu - task.mu_ref(gains)) ** 2) + gains.rho * slack**2


@pytest.mark.parametrize("which", BUNDLED + MICRO)
def test_the_least_norm_minimiser_is_taken(which):
    """Two exact QPs in turn: the optimal cost, then the least ‖u‖² at that cost.

    On the helix, some inputs move the tip a billion times less than others. The oracle cannot
    distinguish costs that agree to 1e-7, so there only our cost must not be higher.
    """
    model = robot(which)
    controller, least_norm = (
        ClfQp(model, None if which in BUNDLED else GAINS),
        LeastNorm(Quadprog(1e-7)),
    )
    span = float((model.u_max - model.u_min).max()) or 1.0
    cases = (*drawn(which, 12), *(recorded(which, 8) if which in BUNDLED else ()))
    same = 0
    for state, reference in cases:
        command = controller(state, reference)
        exact = least_norm.solve(printed(state, reference, controller.gains, clf_qp))
        ours, theirs = (
            cost(u, state, reference, controller.gains) for u in (command.u, exact["u"])
        )
        idle = cost(model.relaxed, state, reference, controller.gains)
        assert ours <= theirs * (1 + 1e-9) + 1e-9 * idle
        if np.abs(command.u - exact["u"]).max() <= 1e-6 * span:
            same += 1
            assert abs(command.delta - exact["delta"][0]) <= 1e-6 * (1 + abs(command.delta))
    assert same >= (0.8 if which == "helix" else 1) * len(cases)
    assert controller.guard.not_solved == controller.guard.fallbacks == 0
    assert controller.guard.max_bound_violation == 0


def test_no_input_is_better():
    """A bounded quasi-Newton search of the paper's QP finds no better input."""
    model = robot("finger")
    controller, rng = ClfQp(model), np.random.default_rng(0)
    bounds = list(zip(model.u_min, model.u_max, strict=True))
    for state, reference in (*drawn("finger", 6), *recorded("finger", 4)):
        u = controller(state, reference).u
        ours = cost(u, state, reference, controller.gains)
        for start in (u, rng.uniform(model.u_min, model.u_max)):
            found = scipy.optimize.minimize(
                cost, start, (state, reference, controller.gains), "L-BFGS-B", bounds=bounds,
                options={"ftol": 1e-15, "gtol": 1e-12, "maxiter": 500},
            )  # fmt: skip
            assert ours <= found.fun * (1 + 1e-9) + 1e-9


@pytest.mark.parametrize("which", BUNDLED)
def test_wild_states_are_solved(which):
    """A metre from the reference δ is a million times the effect of the inputs."""
    model, rng = robot(which), np.random.default_rng(5)
    controller = ClfQp(model)
    for state, _ in drawn(which, 60):
        away = rng.normal(size=3)
        reference = Reference(state.y + away / np.linalg.norm(away), *rng.normal(size=(2, 3)))
        controller(state, reference)
    assert controller.guard.not_solved == controller.guard.fallbacks == 0


@pytest.mark.parametrize("size", [1.0, 1e-9])
def test_least_norm_against_a_projection(size):
    """Random QPs with a feasible optimum: min ‖u‖² over the optima, by SciPy's SLSQP.

    The result must not depend on the scale of the inputs, nanonewton or newton.
    """
    rng = np.random.default_rng(3)
    for m, pulls in ((4, False), (9, False), (16, False), *[(6, True)] * 12):
        Q = np.ascontiguousarray(np.linalg.qr(rng.normal(size=(m, 3)))[0].T)
        lower, upper, u = -rng.uniform(0, 1, m), rng.uniform(0, 1, m), np.zeros(m)
        lower[:] = 0.0 if pulls else lower
        R = np.ascontiguousarray(np.triu(rng.normal(size=(3, 3))) + 3 * np.eye(3))
        inside = rng.choice([0.2, 1.0], m) * rng.uniform(lower, upper)
        goal = R @ (Q @ inside)
        assert bounded_least_norm(R, Q, size * goal, size * lower, size * upper, u) == 0
        u /= size
        reached = {
            "type": "eq",
            "fun": lambda x, Q=Q, b=inside: Q @ (x - b),
            "jac": lambda x, Q=Q: Q,
        }
        found = scipy.optimize.minimize(
            lambda x: x @ x, inside, jac=lambda x: 2 * x, method="SLSQP", constraints=reached,
            bounds=list(zip(lower, upper, strict=True)), options={"ftol": 1e-14, "maxiter": 500},
        )  # fmt: skip
        np.testing.assert_allclose(u, found.x, atol=1e-6)
        np.testing.assert_allclose(Q @ u, Q @ inside, atol=1e-12)
