"""DAQP as another exact solver of the paper's QPs, only for tests."""

from __future__ import annotations

import daqp
import numpy as np

from tests.proof.paper.solvers import (
    SolverAnswer,
    SymbolicQp,
    Unsolved,
    answer,
    kkt_residual,
    matrices,
    scaled,
    unknowns,
)


class Daqp:
    """Arnström's dual active-set method."""

    variables = staticmethod(unknowns)

    def __init__(self) -> None:
        self._solve = daqp.solve

    def solve(self, qp: SymbolicQp) -> SolverAnswer:
        """See `Solver`."""
        p, unit = scaled(matrices(qp))
        equal, below = len(p.e), len(p.b)
        upper = np.concatenate((p.e, p.b))
        lower = np.concatenate((p.e, np.full(below, -1e30)))
        sense = np.array([5] * equal + [0] * below, np.int32)
        x, _, flag, info = self._solve(
            np.ascontiguousarray(p.H), p.g.copy(), np.vstack((p.E, p.A)), upper, lower, sense,
            primal_tol=1e-12, dual_tol=1e-12, iter_limit=10_000,
        )  # fmt: skip
        if flag < 1:
            raise Unsolved(f"DAQP: exit flag {flag}")
        x, lam = np.asarray(x), np.asarray(info["lam"])
        residual = kkt_residual(p, x, lam[:equal], lam[equal:])
        return answer(qp, x * unit, residual)
