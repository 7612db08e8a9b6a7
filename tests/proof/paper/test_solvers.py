"""Solvers of QPs: their answers to one QP agree."""

from __future__ import annotations

import numpy as np
import pytest

from softdyn import InputError
from tests.proof.paper.paper_qps import PAPER_QPS, PrintedLaw, clf_qp
from tests.proof.paper.solvers import (
    Affine,
    LeastNorm,
    Quadprog,
    Scs,
    SymbolicQp,
    Term,
    Unsolved,
    optional,
    unknowns,
)
from tests.support.control_cases import drawn, gains_of, recorded
from tests.support.daqp import Daqp
from tests.support.printed import printed


def test_expressions_are_what_their_operators_say():
    rng = np.random.default_rng(0)
    x, y = unknowns(3, 2)
    at, A, b = rng.normal(size=5), rng.normal(size=(4, 3)), rng.normal(size=4)
    B = rng.normal(size=(4, 2))
    rows = b - A @ x + (B @ y - 2 * b) - 1.0
    expected = -b - A @ at[:3] + B @ at[3:] - 1.0
    assert isinstance(rows, Affine)
    np.testing.assert_allclose(rows.at(at), expected)
    np.testing.assert_allclose((-rows).at(at), -expected)


def test_least_norm_among_the_minimisers():
    # (2, 1) is nearest to 0 among all points with x₀ + x₁ = 3, x₁ ≤ 1
    (x,) = unknowns(3)
    sum_ = np.array([[1.0, 1.0, 0.0]]) @ x
    bound = np.array([[0.0, 1.0, 0.0]]) @ x - 1.0
    qp = SymbolicQp({"x": x}, {"sum": Term(2.0, sum_ - 3.0)}, {}, {"bound": bound})
    answer = LeastNorm(Quadprog(1e-7)).solve(qp)
    np.testing.assert_allclose(answer["x"], [2.0, 1.0, 0.0], atol=1e-9)
    assert answer.cost == pytest.approx(0, abs=1e-18)


def test_least_norm_of_the_clf_qp_costs_nothing_and_is_no_longer():
    shorter = 0
    for state, reference in (*drawn("helix", 4), *recorded("helix")):
        qp = printed(state, reference, gains_of("helix"), clf_qp)
        one = Quadprog(1e-7).solve(qp)
        least = LeastNorm(Quadprog(1e-7)).solve(qp)
        assert least.cost <= one.cost * (1 + 1e-6) + 1e-12
        gain = np.linalg.norm(one["u"]) - np.linalg.norm(least["u"])
        assert gain > -1e-6
        shorter += gain > 1e-3
    assert shorter  # the first solver chose another minimiser


@pytest.mark.parametrize("name", PAPER_QPS)
def test_scs_and_the_exact_solvers_agree(name):
    pytest.importorskip("cvxpy")
    state, reference = drawn("spirob", 5)[4]
    gains, write = gains_of("spirob"), PAPER_QPS[name]
    span = float((state.model.u_max - state.model.u_min).max())
    ridge = 1e-7 if name == "clf-qp" else 0.0
    exact = PrintedLaw(write, gains, Quadprog(ridge))(state, reference)
    close = PrintedLaw(write, gains, Scs(quadratic=True, accuracy=1e-9))(state, reference)
    np.testing.assert_allclose(close["u"], exact["u"], rtol=0, atol=1e-4 * span)
    assert close.cost == pytest.approx(exact.cost, rel=1e-4)


def test_what_has_no_answer_says_so():
    (x,) = unknowns(1)
    cost = {"x": Term(1.0, x)}
    nothing = SymbolicQp({"x": x}, cost, {}, {"low": 1.0 - x, "high": x + 1.0})
    for solver in (Quadprog(), Daqp()):
        with pytest.raises(Unsolved):
            solver.solve(nothing)
    with pytest.raises(Unsolved, match="not quadratic"):
        Quadprog().solve(SymbolicQp({"x": x}, {"x": Term(1.0, x, order=1)}, {}, {}))
    with pytest.raises(InputError, match="pip install cvxpy scs"):
        optional("no_such_module", "cvxpy scs")
