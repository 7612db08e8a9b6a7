"""How disturbances drift: Gauss-Markov processes, a force of the second order, others of the first.

A component d has the deviation σ in the long run and the time τ. Of the first order it follows
ḋ = -d / τ + w, w of the density 2 σ² / τ. A force may move on while late readings are on their way,
so its rate is estimated too: d̈ = -2 ḋ / τ - d / τ² + w, critically damped, w of the density
4 σ² / τ³; the rate has the deviation σ / τ (Gelb 1974, chapter 2). The torque of a Maxwell branch
has the first order with the branch's own τ, beside what its joint's motion adds
(`softdyn.estimation.creeping`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from softdyn.dynamics.balance import Disturbance
from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.relaxation import Branches


class DriftStep(NamedTuple):
    """The processes over one step.

    Attributes
    ----------
    decay, added : ndarray, (nd,)
        Factor of a component, and variance that it gains; 1 and 0 for one with a rate.
    turn, noise : ndarray, (2, 2)
        Transition of a component and its rate, and the covariance that they gain.
    """

    decay: np.ndarray
    added: np.ndarray
    turn: np.ndarray
    noise: np.ndarray


class DisturbanceDrift:
    """The processes of a filter's disturbances.

    Parameters
    ----------
    model : SoftModel
        The robot.
    disturbances : tuple of Disturbance
        Those that are estimated, in the order of d.
    variances : ndarray, (nd,)
        σ² of each component.
    memory : float
        τ (s).

    Attributes
    ----------
    moving : ndarray of int, (nr,)
        The components with rates.
    variances : ndarray, (nd + nr,)
        Those of the components and rates in the long run.
    """

    def __init__(
        self,
        model: SoftModel,
        disturbances: tuple[Disturbance, ...],
        variances: np.ndarray,
        memory: float,
    ) -> None:
        moves = [np.full(one.size(model), one is Disturbance.TIP_FORCE) for one in disturbances]
        self.moving = np.flatnonzero(np.concatenate([*moves, np.zeros(0, bool)]))
        creeps = [np.full(one.size(model), one is Disturbance.RELAXATION) for one in disturbances]
        self._creeping = np.flatnonzero(np.concatenate([*creeps, np.zeros(0, bool)]))
        self._times = Branches.of(model).time
        own = variances[self.moving]
        self.variances = np.concatenate((variances, own / memory**2))
        self._slow, self._own = variances, own[0] if len(own) else 0.0
        self._memory = memory
        self._step, self._found = math.nan, self._over(0.0)

    def over(self, step: float) -> DriftStep:
        """The processes over a step (s)."""
        if step != self._step and len(self._slow):
            self._step, self._found = step, self._over(step)
        return self._found

    def _over(self, step: float) -> DriftStep:
        x, left = step / self._memory, math.exp(-step / self._memory)
        decay, added = np.full(len(self._slow), left), self._slow * -math.expm1(-2 * x)
        decay[self.moving], added[self.moving] = 1.0, 0.0
        if (own := self._creeping).size:
            decay[own] = np.exp(-step / self._times)
            added[own] = -self._slow[own] * np.expm1(-2 * step / self._times)
        turn = left * np.array([[1 + x, step], [-x / self._memory, 1 - x]])
        gain = left * left
        place = max(1 - gain * (1 + 2 * x + 2 * x * x), 0.0)
        rate = max(1 - gain * (1 - 2 * x + 2 * x * x), 0.0)
        both = 2 * x * x * gain / self._memory
        noise = self._own * np.array([[place, both], [both, rate / self._memory**2]])
        return DriftStep(decay, added, turn, noise)

    def move(self, d: np.ndarray, step: float) -> None:
        """Move the components and rates (nd + nr,) over a step (s), in place."""
        decay, _, turn, _ = self.over(step)
        count = len(decay)
        d[:count] *= decay
        if len(d) > count:
            force, rate = d[self.moving], d[count:].copy()
            d[self.moving] = turn[0, 0] * force + turn[0, 1] * rate
            d[count:] = turn[1, 0] * force + turn[1, 1] * rate
