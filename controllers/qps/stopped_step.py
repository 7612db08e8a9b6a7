"""A backward Euler step of the whole dynamics, in which the joints have stops.

The stops act by forces λ (n,) that only push back (Stewart and Trinkle 1996):

    M q̈ + h = B u + λ,      low ≤ τ q̇⁺ ≤ high,      q̇⁺ = q̇ + τ q̈,

with λ ≥ 0 where τ q̇⁺ = low, λ ≤ 0 where τ q̇⁺ = high, and λ = 0 elsewhere. If M is positive
definite, this linear complementarity problem has one solution. q̈ is piecewise linear in u. The
*mode*, which joints their stops hold, decides which piece it is. Block principal pivoting finds the
mode (Júdice and Pires 1994).
"""

from __future__ import annotations

import numpy as np

from softdyn import State

PATIENCE = 3  # rounds without progress, before one joint changes at a time
ROUNDS = 100
SLIGHT = 1e-9  # rad, m: joints beyond a stop by less are at it


class StoppedStep:
    """A step τ from a State.

    Parameters
    ----------
    state : State
        The state at its begin.
    tau : float
        The step (s); at 0 there is no mode but `free`.
    M, h : ndarray, (n, n), (n,)
        The dynamics over the step, see `softdyn.controllers.qps.horizon`.

    Attributes
    ----------
    free : ndarray, (n,)
        The mode in which no stop holds a joint.
    still : ndarray, (n,)
        The mode in which stops hold the joints that would pass them at their present velocity.
    """

    def __init__(self, state: State, tau: float, M: np.ndarray, h: np.ndarray) -> None:
        model, n = state.model, len(h)
        self.tau, self.free = tau, np.zeros(n)
        self._moved = np.linalg.solve(M, np.column_stack((state.B, h, np.eye(n))))
        self._pushed = self._moved[:, -n:]
        if tau:
            q = model.coordinates(state.q)
            # a joint that is beyond a stop may stay there
            ways = np.minimum(model.lower - q, 0.0), np.maximum(model.upper - q, 0.0)
            self._low, self._high = ((way / tau - state.v) / tau for way in ways)
            self.still = np.where(self._low >= 0, -1.0, np.where(self._high <= 0, 1.0, 0.0))

    def response(self, mode: np.ndarray) -> np.ndarray:
        """(X, x), (n, nu + 1), of q̈ = X u - x in a mode."""
        free, held = self._moved[:, : -len(mode)], np.flatnonzero(mode)
        if not held.size:
            return free
        missing = free[held]
        missing[:, -1] += self._stopped(mode, held)
        return free - self._pushed[:, held] @ np.linalg.solve(
            self._pushed[np.ix_(held, held)], missing
        )

    def mode(self, u: np.ndarray, start: np.ndarray) -> np.ndarray:
        """The mode under u, found from `start`.

        It is -1 for joints (n,) that their lower stops hold, 1 for upper stops, else 0.
        """
        free = self._moved[:, : len(u)] @ u - self._moved[:, len(u)]
        slight, mode = SLIGHT / self.tau**2, start.copy()
        fewest, patience = len(mode) + 1, PATIENCE
        for _ in range(ROUNDS):
            held = np.flatnonzero(mode)
            missing = self._stopped(mode, held) - free[held]
            force = np.linalg.solve(self._pushed[np.ix_(held, held)], missing)
            qdd = free + self._pushed[:, held] @ force
            better = np.where(
                qdd < self._low - slight, -1.0, np.where(qdd > self._high + slight, 1.0, 0.0)
            )
            better[held] = np.where(mode[held] * force > 0, 0.0, mode[held])
            wrong = np.flatnonzero(better != mode)
            if not wrong.size:
                break
            if wrong.size < fewest:
                fewest, patience = wrong.size, PATIENCE
            elif patience:
                patience -= 1
            else:
                wrong = wrong[-1:]
            mode[wrong] = better[wrong]
        return mode

    def _stopped(self, mode: np.ndarray, held: np.ndarray) -> np.ndarray:
        """q̈ of the joints `held` in a mode: they end the step at their stops."""
        return np.where(mode[held] < 0, self._low[held], self._high[held])
