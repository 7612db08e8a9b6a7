"""The oracle's formulas against the paper's definitions, independent of `controllers`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from tests.proof.paper.paper_qps import (
    PAPER_QPS,
    TaskTerms,
    actuated_rows,
    impedance,
    inputs,
    inverse,
    lyapunov,
    null_projector,
    tip,
    underactuated,
)
from tests.proof.paper.solvers import LeastNorm, Quadprog, unknowns
from tests.support.control_cases import BUNDLED, drawn, gains_of, recorded


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


@pytest.mark.parametrize("name", BUNDLED)
def test_actuated_rows_pick_the_input_from_the_dynamics(name):
    rng = np.random.default_rng(0)
    for state, _ in (*drawn(name, 4), *recorded(name, 2)):
        R, S = actuated_rows(state.B)
        u = rng.normal(size=state.B.shape[1])
        np.testing.assert_allclose(R @ (state.B @ u), S @ u, rtol=0, atol=1e-9 * np.abs(u).max())
        rank = int((scipy.linalg.svdvals(state.B) > 1e-6 * scipy.linalg.norm(state.B, 2)).sum())
        assert len(R) == rank


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


def test_impedance_gives_the_task_the_acceleration_it_asks_for():
    # in free space, all joints driven: ÿ = ÿ_ref - K_d ė - K_p e, whatever C, K, D and g are
    for state, reference in drawn("spirob", 6):
        task, gains = tip(state, reference), gains_of("spirob")
        torque = impedance(state, task, gains) + state.D @ state.v + state.K + state.g
        qdd = np.linalg.solve(state.M, torque - state.h)
        yddot = state.J @ qdd + state.Jdot @ state.v
        # J⁺ᵀ C q̇ replaces Λ J M⁻¹ C q̇: only that difference remains
        mobility = state.J @ np.linalg.inv(state.M) @ state.J.T
        coriolis = state.C @ state.v
        rest = mobility @ inverse(state.J).T @ coriolis
        rest -= state.J @ np.linalg.solve(state.M, coriolis)
        wanted = reference.yddot + task.mu_ref(gains) + rest
        np.testing.assert_allclose(yddot, wanted, atol=1e-7 * np.abs(wanted).max())


def test_uic_leaves_no_torque_where_nothing_acts():
    # eq. (null): J'f + N τ_null lies in range(B), as far as N permits
    for state, reference in drawn("helix", 4):
        task, gains = tip(state, reference), gains_of("helix")
        torque = impedance(state, task, gains)
        found = underactuated(state, task, torque)
        unreached = np.eye(len(torque)) - state.B @ inverse(state.B)
        N = null_projector(task.J)
        best = np.linalg.lstsq(unreached @ N, -unreached @ torque, rcond=1e-6)[0]
        least = np.linalg.norm(unreached @ (torque + N @ best))
        assert np.linalg.norm(unreached @ found) <= least * (1 + 1e-6) + 1e-9
        u = inputs(state, found)
        wanted = inverse(state.B) @ (found + state.h - state.bias + state.g)
        np.testing.assert_allclose(u, wanted, rtol=1e-9, atol=1e-9 * np.abs(wanted).max())


def test_a_singular_mobility_has_a_pseudo_inverse():
    state, reference = drawn("finger", 3)[2]  # planar: its y row is zero
    task = tip(state, reference)
    assert not task.J[1].any()
    assert np.isfinite(impedance(state, task, gains_of("finger"))).all()
    tall = replace(task, J=np.eye(3, state.model.nv))
    assert np.linalg.matrix_rank(null_projector(tall.J)) == state.model.nv - 3
