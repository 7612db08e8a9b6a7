"""Inverse dynamics consistent with the hold: the model at the end of a horizon τ, not at its start.

The input is held while springs and dampers answer, and dampers answer fast: T·λmax(M⁻¹D) is 50 and
more on soft robots. Evaluating both by backward Euler, at v + τ q̈ and q + τ v + τ² q̈, gives

    (M + τ D + τ² K') q̈ + h + τ K' v = B u,        K' = ∂K/∂q,

the dynamics (paper, eq. (1)) with another M and another h; `docs/hold.md`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from softdyn import SoftModel, State
from softdyn.controllers.controller import SILENT
from softdyn.controllers.gains import Gains


def elastic_stiffness(model: SoftModel, q: np.ndarray) -> np.ndarray:
    """K' = ∂K/∂q (n, n); constant, and cheap, where no tendon is elastic."""
    if model.tendon_stiffness.any():
        return model.tangent_stiffness(q)
    return np.diag(model.stiffness)


def over_hold(state: State, tau: float) -> State:
    """`state` with M and h of the dynamics over the horizon `tau` (s); itself at 0.

    What it says of the tip, B, D and K is unchanged; `bias` is too, and no longer h - D v - K.
    """
    return state if tau == 0 else _over(state, tau)


@SILENT
def _over(state: State, tau: float) -> State:
    stiffness = elastic_stiffness(state.model, state.q)
    M = state.M + tau * state.D + tau**2 * stiffness
    h = state.h + tau * (stiffness @ state.v)
    M.flags.writeable = h.flags.writeable = False
    return replace(state, M=M, h=h)


def default_horizon(gains: Gains) -> float:
    """The horizon (s) to use: ε, within which the decrease condition is to act; `docs/hold.md`."""
    return gains.eps
