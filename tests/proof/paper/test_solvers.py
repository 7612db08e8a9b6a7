"""Solvers of QPs: their answers to one QP agree."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.control_cases import drawn, gains_of, recorded
from tests.support.exact_qps import printed
from tests.support.paper_qps import PAPER_QPS, PrintedLaw, clf_qp
from tests.support.qp_solvers import (
    LeastNorm,
    Quadprog,
    Scs,
)


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
