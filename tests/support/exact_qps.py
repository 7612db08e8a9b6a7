"""The oracle's QPs for exact solvers, and changes that tests need."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from softdyn import Reference, State
from softdyn.controllers import Gains
from tests.support.paper_qps import soft_id_clf_qp, tip
from tests.support.qp_solvers import Daqp, Quadprog, SolverAnswer, SymbolicQp, unknowns


def printed(
    state: State,
    reference: Reference,
    gains: Gains,
    write: Callable[..., SymbolicQp] = soft_id_clf_qp,
    *,
    margin: float = 0.0,
    **options: Any,
) -> SymbolicQp:
    """A QP at a state; `margin` narrows the input bounds by this share of their range."""
    qp = write(unknowns, state, tip(state, reference), gains, **options)
    inward = margin * (state.model.u_max - state.model.u_min)
    below = qp.below
    drawn_in = {name: below[name] + inward for name in ("upper", "lower")}
    return replace(qp, below=below | drawn_in)


def with_input(qp: SymbolicQp, u: np.ndarray) -> SymbolicQp:
    """The same QP with its inputs fixed at `u` (m,), inside or outside their bounds."""
    below = {k: rows for k, rows in qp.below.items() if k not in ("upper", "lower")}
    pin = {"pinned": qp.variables["u"] - u}
    return replace(qp, equal=qp.equal | pin, below=below)


def solve_quadprog(qp: SymbolicQp, ridge: float = 0.0) -> SolverAnswer:
    return Quadprog(ridge).solve(qp)


def solve_daqp(qp: SymbolicQp) -> SolverAnswer:
    return Daqp().solve(qp)
