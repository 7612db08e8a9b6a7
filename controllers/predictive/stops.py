"""Joint stops in a prediction: stiff springs on the joints that are at or beyond their limits."""

from __future__ import annotations

import numpy as np

from softdyn import SoftModel, State
from softdyn.dynamics.balance import BalanceTerms, ForceBalance
from softdyn.dynamics.stops import Stops

NEAR = 2e-3  # of a joint's range: so near to its limit it is held by the stop
STIFFNESS = 1e4  # in M_jj / Δt²


def held_joints(state: State) -> np.ndarray:
    """Whether each joint (nv,) is held by a stop."""
    return Stops.of(state.model).near(state.model.coordinates(state.q), NEAR)


def stop_stiffness(state: State, held: np.ndarray, step: float) -> np.ndarray:
    """Stiffness (nv,) of the stops that hold joints, for a prediction in steps of `step` (s)."""
    return np.where(held, STIFFNESS / step**2 * np.diag(state.M), 0.0)


class SpringStops:
    """The balance of a robot's joint forces, with a stiff spring on each joint beyond a limit.

    Parameters
    ----------
    model : SoftModel
        The robot.
    balance : ForceBalance
        The balance of all other forces.
    step : float
        T (s); the springs' stiffness is in M_jj / T².
    """

    def __init__(self, model: SoftModel, balance: ForceBalance, step: float) -> None:
        self._coordinates, self._stops = model.coordinates, Stops.of(model)
        self._balance, self._stiffness = balance, STIFFNESS / step**2

    def trusted(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, commands: np.ndarray, d: np.ndarray
    ) -> BalanceTerms:
        """The balance at (q, v, a), as `ForceBalance.trusted`."""
        terms, at = self._balance.trusted(q, v, a, commands, d), self._coordinates(q)
        beyond = at - self._stops.within(at)
        if beyond.any():
            spring = self._stiffness * terms.by_a.diagonal()
            terms.residual[:] += spring * beyond
            terms.by_q.flat[:: len(at) + 1] += np.where(beyond != 0, spring, 0.0)
        return terms
