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
from softdyn.compiled import compiled
from softdyn.controllers.qps.linear_algebra import lu_solve

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
        mode = start.copy()
        free = self._moved[:, : len(u)] @ u - self._moved[:, len(u)]
        _settle(self._pushed, free, self._low, self._high, SLIGHT / self.tau**2, mode)
        return mode

    def _stopped(self, mode: np.ndarray, held: np.ndarray) -> np.ndarray:
        """q̈ of the joints `held` in a mode: they end the step at their stops."""
        return np.where(mode[held] < 0, self._low[held], self._high[held])


@compiled
def _settle(pushed, free, low, high, slight, mode):
    """Pivot `mode` in place to that under the q̈ of free joints; `pushed` (n, n) maps λ to q̈."""
    n = len(free)
    held, better = np.empty(n, np.int64), np.empty(n)
    fewest, patience = n + 1, PATIENCE
    for _ in range(ROUNDS):
        count = 0
        for i in range(n):
            if mode[i] != 0:
                held[count] = i
                count += 1
        system, force = np.empty((count, count)), np.empty(count)
        for k in range(count):
            i = held[k]
            force[k] = (low[i] if mode[i] < 0 else high[i]) - free[i]
            for x in range(count):
                system[k, x] = pushed[i, held[x]]
        if not lu_solve(system, force):
            return
        wrong, last, k = 0, 0, 0
        for i in range(n):
            better[i] = mode[i]
            if mode[i] != 0:
                if mode[i] * force[k] > 0:
                    better[i] = 0.0
                k += 1
            else:
                qdd = free[i]
                for x in range(count):
                    qdd += pushed[i, held[x]] * force[x]
                if qdd < low[i] - slight:
                    better[i] = -1.0
                elif qdd > high[i] + slight:
                    better[i] = 1.0
            if better[i] != mode[i]:
                wrong, last = wrong + 1, i
        if wrong == 0:
            return
        if wrong < fewest:
            fewest, patience = wrong, PATIENCE
        elif patience > 0:
            patience -= 1
        else:
            mode[last] = better[last]
            continue
        for i in range(n):
            mode[i] = better[i]
