"""Joint stops in a linear prediction: stiff springs on the joints that are at their limits."""

from __future__ import annotations

import numpy as np

from softdyn import State
from softdyn.dynamics.stops import Stops

NEAR = 2e-3  # of a joint's range: so near to its limit it is held by the stop
STIFFNESS = 1e4  # in M_jj / Δt²


def held_joints(state: State) -> np.ndarray:
    """Whether each joint (nv,) is held by a stop."""
    return Stops.of(state.model).near(state.model.coordinates(state.q), NEAR)


def stop_stiffness(state: State, held: np.ndarray, step: float) -> np.ndarray:
    """Stiffness (nv,) of the stops that hold joints, for a prediction in steps of `step` (s)."""
    return np.where(held, STIFFNESS / step**2 * np.diag(state.M), 0.0)
