"""The oracle's programmes for exact solvers, and what tests change in them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from softdyn import Reference, State
from softdyn.controllers import Gains
from softdyn.validation.paper.paper_qps import soft_id_clf_qp, tip
from softdyn.validation.paper.solvers import Answer, Daqp, Programme, Quadprog, unknowns


def printed(
    state: State,
    reference: Reference,
    gains: Gains,
    write: Callable[..., Programme] = soft_id_clf_qp,
    *,
    margin: float = 0.0,
    **options: Any,
) -> Programme:
    """A programme at a state; `margin` draws the input bounds in by this share of their range."""
    programme = write(unknowns, state, tip(state, reference), gains, **options)
    inward = margin * (state.model.u_max - state.model.u_min)
    below = programme.below
    drawn_in = {name: below[name] + inward for name in ("upper", "lower")}
    return replace(programme, below=below | drawn_in)


def with_input(programme: Programme, u: np.ndarray) -> Programme:
    """The same programme with its inputs pinned to `u` (m,), within their bounds or not."""
    below = {k: rows for k, rows in programme.below.items() if k not in ("upper", "lower")}
    pin = {"pinned": programme.variables["u"] - u}
    return replace(programme, equal=programme.equal | pin, below=below)


def solve_quadprog(programme: Programme, ridge: float = 0.0) -> Answer:
    return Quadprog(ridge).solve(programme)


def solve_daqp(programme: Programme) -> Answer:
    return Daqp().solve(programme)
