"""Inverse dynamics for the zero-order hold: the model at the end of a horizon τ.

The input stays constant for a control period T. Dampers respond much faster than that: T·λmax(M⁻¹D)
is 50 and more on soft robots. Backward Euler evaluates springs and dampers at v + τ q̈ and
q + τ v + τ² q̈. This gives

    (M + τ D + τ² K') q̈ + h + τ K' v = B u,        K' = ∂K/∂q,

the dynamics (paper, eq. (1)) with another M and another h; see `docs/hold.md`. Forces of one's own
add the symmetric parts of -∂F/∂q̇ to D and of -∂F/∂q to K', because the QPs need a symmetric M.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from softdyn import SoftModel, State
from softdyn.checks import read_only
from softdyn.compiled import compiled
from softdyn.controllers.gains import Gains
from softdyn.controllers.qps.linear_algebra import dot


class Horizon:
    """M and h of the dynamics over a horizon; the next call overwrites them.

    Parameters
    ----------
    model : SoftModel
        The robot.
    tau : float
        τ (s); at 0 the dynamics are the state's own.
    """

    def __init__(self, model: SoftModel, tau: float) -> None:
        self._model, self.tau = model, tau
        # without elastic tendons K' is constant, if the springs are linear
        elastic = model.tendon_stiffness.any() or model.curved
        self._constant = None if elastic else model.tangent_stiffness(model.q0)
        self._slackens = bool(model.tendon_slack.any())
        n = model.nv
        self._M, self._h = np.empty((n, n)), np.empty(n)
        # kernels are compiled for read-only arrays, like a State's
        self._answer = self._M.view(), self._h.view()
        for array in self._answer:
            array.flags.writeable = False

    def __reduce__(self) -> tuple[Any, ...]:
        # views would become separate arrays in a copy
        return Horizon, (self._model, self.tau)

    def __call__(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """M (n, n) and h (n,) over the horizon."""
        if self.tau == 0:
            return state.M, state.h
        stiffness = self._constant
        if stiffness is None:
            v = state.v if self._slackens else None
            stiffness = self._model.tangent_stiffness(state.q, v)
        D = state.D
        if self._model.forced:
            by_q, by_v = self._model.force_derivatives(state.q, state.v)
            stiffness = stiffness - (by_q + by_q.T) / 2
            D = read_only(D - (by_v + by_v.T) / 2)
        _over(state.M, state.h, D, state.v, stiffness, self.tau, self._M, self._h)
        return self._answer


@compiled
def _over(M, h, D, v, stiffness, tau, M_over, h_over):
    for i in range(len(v)):
        for j in range(len(v)):
            M_over[i, j] = M[i, j] + tau * D[i, j] + tau * tau * stiffness[i, j]
        h_over[i] = h[i] + tau * dot(stiffness[i], v)


def default_horizon(gains: Gains) -> float:
    """The horizon (s) of the paper's finger and helix: ε; see `docs/hold.md` for other arms."""
    return gains.eps
