"""The oracle's formulas against the paper's definitions, independent of `controllers`."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from tests.support.control_cases import drawn, gains_of
from tests.support.paper_qps import (
    PAPER_QPS,
    TaskTerms,
    actuated_rows,
    lyapunov,
    tip,
)
from tests.support.qp_solvers import LeastNorm, Quadprog, unknowns


@pytest.mark.parametrize("r", [3, 6])
def test_the_lyapunov_function_solves_the_riccati_equation(r):
    rng, eps = np.random.default_rng(r), 0.05
    task = TaskTerms(np.zeros((r, 4)), np.zeros((r, 4)), *rng.normal(size=(3, r)))
    zero, eye = np.zeros((r, r)), np.eye(r)
    F, G = np.block([[zero, eye], [zero, zero]]), np.vstack((zero, eye))
    P = scipy.linalg.solve_continuous_are(F, G, np.eye(2 * r), eye)
    scale = np.repeat([1 / eps, 1.0], r)
    eta, mu = np.concatenate((task.e, task.edot)), rng.normal(size=r)

    def V(eta):
        return (scale * eta) @ P @ (scale * eta)

    found = lyapunov(task, eps)
    assert pytest.approx(V(eta), rel=1e-12) == found.V
    # V̇ along η̇ = F η + G μ; V is quadratic, so a central difference is exact
    rate = (V(eta + F @ eta + G @ mu) - V(eta - F @ eta - G @ mu)) / 2
    assert found.drift + found.slope @ mu == pytest.approx(rate, rel=1e-10)


@pytest.mark.parametrize("write", PAPER_QPS.values(), ids=PAPER_QPS)
def test_every_constraint_of_a_qp_is_met_by_its_answer(write):
    for state, reference in drawn("helix", 5):
        gains = gains_of("helix")
        task = tip(state, reference)
        qp = write(unknowns, state, task, gains)
        solver = LeastNorm(Quadprog(1e-7)) if "mu" in qp.variables else Quadprog()
        answer = solver.solve(qp)
        assert answer.residual < 1e-10
        u = answer["u"]
        bound = 1e-6 * (state.model.u_max - state.model.u_min)
        assert (u >= state.model.u_min - bound).all()
        assert (u <= state.model.u_max + bound).all()
        if "mu" in qp.variables:  # ÿ = L_f² y + L_g L_f y u
            qdd = np.linalg.solve(state.M, state.B @ u - state.h)
        else:
            qdd = answer["qdd"]
            residual = actuated_rows(state.B)[0] @ (state.M @ qdd + state.h - state.B @ u)
            np.testing.assert_allclose(residual, 0, atol=1e-6 * np.abs(state.h).max())
        mu = state.J @ qdd + state.Jdot @ state.v - reference.yddot
        if "mu" in qp.variables:
            np.testing.assert_allclose(mu, answer["mu"], rtol=1e-6, atol=1e-6 * np.abs(mu).max())
        if "delta" in qp.variables:
            V, drift, slope = lyapunov(task, gains.eps)
            assert drift + slope @ mu <= -V / gains.eps + answer["delta"][0] + 1e-6 * V / gains.eps
            assert answer["delta"][0] >= -1e-9 * V
