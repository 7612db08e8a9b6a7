"""A backward Euler step of the whole dynamics, in which the joints have stops.

The stops act by forces λ (n,) that only push back (Stewart and Trinkle 1996):

    M q̈ + h = B u + λ,      q̇⁺ = q̇ + τ q̈,      lower ≤ q + τ q̇⁺ ≤ upper,

with λ = 0 for a joint that ends between its stops. `softdyn.dynamics.stops` says which stops hold
under an input. While the same stops hold, q̈ is linear in u.
"""

from __future__ import annotations

import numpy as np

from softdyn import State
from softdyn.controllers.qps.relaxed_rows import Rows
from softdyn.dynamics.stops import TOUCHING, Stops


class StoppedStep:
    """A step τ from a State.

    Parameters
    ----------
    state : State
        The state at its begin.
    tau : float
        The step (s).
    M, h : ndarray, (n, n), (n,)
        The dynamics over the step, see `softdyn.controllers.qps.horizon`.
    stops : Stops, optional
        The joints' stops; by default there are none.

    Attributes
    ----------
    free : ndarray of int, (n,)
        0 for every joint: no stop holds one.
    """

    def __init__(
        self, state: State, tau: float, M: np.ndarray, h: np.ndarray, stops: Stops | None = None
    ) -> None:
        self.tau, self.free = tau, np.zeros(len(h), np.int64)
        self._v, self._M, self._stops = state.v, M, stops
        self._forces = np.column_stack((state.B, -h))
        self._motion = np.linalg.solve(M, self._forces)
        if stops is not None:
            # a joint that is beyond a stop may stay there
            self._at = stops.within(state.model.coordinates(state.q))

    def response(self, held: np.ndarray) -> np.ndarray:
        """(X, x), (n, nu + 1), of q̈ = X u + x while stops hold these joints; see `held`."""
        k = np.flatnonzero(held)
        if self._stops is None or not k.size:
            return self._motion
        M, right = self._M.copy(), self._forces.copy()
        M[k], right[k] = 0.0, 0.0
        M[k, k] = 1.0
        ends = np.where(held > 0, self._stops.upper, self._stops.lower)
        right[k, -1] = ((ends - self._at)[k] / self.tau - self._v[k]) / self.tau
        return np.linalg.solve(M, right)

    def motion_within(self, bound: np.ndarray, held: np.ndarray, unit: np.ndarray) -> list[Rows]:
        """Rows |τ q̇⁺| ≤ `bound` (n,), or τ |q̇| where that is more; see `response` for `held`."""
        tau, v, response = self.tau, self._v, self.response(held)
        most, way = np.maximum(bound, tau * np.abs(v)), tau * (v + tau * response[:, -1])
        moved = tau**2 * response[:, :-1]
        return [Rows(moved, most - way, unit), Rows(-moved, most + way, unit)]

    def held(self, u: np.ndarray, guess: np.ndarray) -> np.ndarray:
        """Joints (n,) that stops hold under u: 1 at the upper one, -1 at the lower one, else 0.

        Raises
        ------
        LinAlgError
            For a singular M.
        """
        stops, tau, v = self._stops, self.tau, self._v
        if stops is None:
            return self.free
        end = self._at + tau * (v + tau * (self._motion[:, :-1] @ u + self._motion[:, -1]))
        if np.abs(stops.within(end) - end).max(initial=0.0) <= TOUCHING:
            return self.free
        forces, A = self._forces[:, :-1] @ u + self._forces[:, -1], self._M / tau
        return stops.solve(A, -forces - A @ v, self._at, tau, guess)[1]
