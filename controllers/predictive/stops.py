"""Joint stops in a linear prediction: stiff springs on the joints that are at their limits."""

from __future__ import annotations

import numpy as np

from softdyn import SoftModel, State

NEAR = 2e-3  # of a joint's range: so near to its limit it is held by the stop
STIFFNESS = 1e4  # in M_jj / Δt²


class JointStops:
    """The stops of a robot.

    Parameters
    ----------
    model : SoftModel
        The robot.
    """

    def __init__(self, model: SoftModel) -> None:
        span = model.upper - model.lower
        margin = np.where(np.isfinite(span), NEAR * span, 0.0)
        self._model, self._lower, self._upper = model, model.lower + margin, model.upper - margin

    def held(self, state: State) -> np.ndarray:
        """Whether each joint (nv,) is held by a stop."""
        q = self._model.coordinates(state.q)
        held: np.ndarray = (q >= self._upper) | (q <= self._lower)
        return held

    def stiffness(self, state: State, held: np.ndarray, step: float) -> np.ndarray:
        """Stiffness (nv,) of the stops that hold, for a prediction in steps of `step` (s)."""
        stiffness: np.ndarray = np.where(held, STIFFNESS / step**2 * np.diag(state.M), 0.0)
        return stiffness
