"""A backward Euler step of the whole dynamics, in which the joints have stops.

The stops act by forces λ (n,) that only push back (Stewart and Trinkle 1996):

    M q̈ + h = B u + λ,      low ≤ τ q̇⁺ ≤ high,      q̇⁺ = q̇ + τ q̈,

with λ ≥ 0 where τ q̇⁺ = low, λ ≤ 0 where τ q̇⁺ = high, and λ = 0 elsewhere. If M is positive
definite, this linear complementarity problem has one solution, which `Stops.solve` finds. q̈ is
piecewise linear in u. The *mode*, which joints their stops hold, decides which piece it is.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from softdyn import State
from softdyn.copies import freeze
from softdyn.dynamics.stops import Stops


def stops_around(state: State) -> Stops:
    """The stops of a robot's joints; a joint that is beyond a stop may stay there."""
    model, q = state.model, state.model.coordinates(state.q)
    stops = Stops(np.minimum(model.lower, q), np.maximum(model.upper, q))
    freeze((stops.lower, stops.upper))  # like those of a model
    return stops


class StoppedStep:
    """A step τ from a State.

    Parameters
    ----------
    state : State
        The state at its begin.
    tau : float
        The step (s), > 0 if joints have stops.
    M, h : ndarray, (n, n), (n,)
        The dynamics over the step, see `softdyn.controllers.qps.horizon`.
    stops : Stops, optional
        The joints' stops, see `stops_around`; without them there is no mode but `free`.

    Attributes
    ----------
    free : ndarray of int, (n,)
        The mode in which no stop holds a joint.
    """

    def __init__(
        self, state: State, tau: float, M: np.ndarray, h: np.ndarray, stops: Stops | None = None
    ) -> None:
        self.tau, self.free = tau, np.zeros(len(h), int)
        self._state, self._M, self._h, self._stops = state, M, h, stops
        self._q = state.model.coordinates(state.q)
        self._responses: dict[bytes, np.ndarray] = {}

    @cached_property
    def still(self) -> np.ndarray:
        """The mode (n,) of stops that hold the joints that pass them at their present velocity."""
        if self._stops is None:
            return self.free
        low, high = self._ends
        return np.where(low >= 0, -1, np.where(high <= 0, 1, 0))

    @cached_property
    def _ends(self) -> tuple[np.ndarray, np.ndarray]:
        """q̈ (n,) of joints that end the step at their lower, and at their upper stops."""
        assert self._stops is not None
        ends = np.array([self._stops.lower, self._stops.upper])
        low, high = ((ends - self._q) / self.tau - self._state.v) / self.tau
        return low, high

    def response(self, mode: np.ndarray) -> np.ndarray:
        """(X, x), (n, nu + 1), of q̈ = X u + x in a mode."""
        key = mode.tobytes()
        if key not in self._responses:
            self._responses[key] = self._response(mode)
        return self._responses[key]

    def _response(self, mode: np.ndarray) -> np.ndarray:
        right = np.column_stack((self._state.B, -self._h))
        if not mode.any():
            return np.linalg.solve(self._M, right)
        held, free = np.flatnonzero(mode), np.flatnonzero(mode == 0)
        found, (low, high) = np.zeros(right.shape), self._ends
        found[held, -1] = np.where(mode < 0, low, high)[held]
        right = right[free]
        right[:, -1] -= self._M[np.ix_(free, held)] @ found[held, -1]
        found[free] = np.linalg.solve(self._M[np.ix_(free, free)], right)
        return found

    def unstopped(self, u: np.ndarray) -> np.ndarray:
        """q̈ (n,) under u without stops."""
        qdd: np.ndarray = np.linalg.solve(self._M, self._state.B @ u - self._h)
        return qdd

    def motion(self, u: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """q̈ (n,) under u and its mode (n,), found from the mode `start`.

        The mode is -1 for joints that their lower stops hold, 1 for upper stops, else 0.
        """
        if self._stops is None:
            return self.unstopped(u), self.free
        v, A = self._state.v, self._M / self.tau
        r = self._h - self._state.B @ u - A @ v
        speeds, mode = self._stops.solve(A, r, self._q, self.tau, start)
        return (speeds - v) / self.tau, mode
