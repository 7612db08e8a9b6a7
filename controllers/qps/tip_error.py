"""The tip's error, which every controller of the paper uses, and the Lyapunov condition on it."""

from __future__ import annotations

import numpy as np

from softdyn import Reference, SetPoint, State
from softdyn.compiled import compiled
from softdyn.controllers.gains import Gains
from softdyn.controllers.qps.clf import make_clf
from softdyn.tasks.targets import StackedReference


class TipError:
    """Error of the tip, paper section "Input-Output Linearization"; updated at every step.

    In a stacked reference its target is the one called `name`.

    Attributes
    ----------
    mu_ref : ndarray, (3,)
        μ_ref = -K_d ė - K_p e (m/s²), e = y - y_ref.
    yddot : ndarray, (3,)
        ÿ_ref (m/s²).
    row : ndarray, (3,)
        The row of the decrease condition row·μ - δ ≤ bound; see `Clf.decrease`.
    bound : ndarray, (1,)
        The bound of this condition.
    V : float
        Value of the Lyapunov function.
    J, Jdot, ydot : ndarray, (3, n), (3, n), (3,)
        Those of the state.
    """

    rows = 3

    def __init__(self, gains: Gains, name: str = "") -> None:
        clf = make_clf(gains.eps)
        self._numbers = float(gains.Kp), float(gains.Kd), float(clf.eps), clf.P_eps
        values = np.zeros(10)
        self.mu_ref, self.yddot, self.row = values[:3], values[3:6], values[6:9]
        self.bound = values[9:]
        self._goal = np.zeros((3, 3))
        self._name = name
        self.V = 0.0

    def update(self, state: State, reference: Reference | SetPoint) -> None:
        """The error of `state` against `reference`."""
        if self._name and isinstance(reference, StackedReference):
            reference = reference.targets.get(self._name, reference)
        self.J, self.Jdot, self.ydot = state.J, state.Jdot, state.ydot
        goal = self._goal  # a copy, so that the kernel always gets one kind of array
        goal[0], goal[1], goal[2] = reference.y, reference.ydot, reference.yddot
        self.V = _error(
            state.y, state.ydot, goal, *self._numbers,
            self.mu_ref, self.yddot, self.row, self.bound,
        )  # fmt: skip


@compiled
def _error(y, ydot, goal, Kp, Kd, eps, P_eps, mu_ref, yddot, row, bound):
    eta = np.empty(6)
    for x in range(3):
        eta[x], eta[3 + x] = y[x] - goal[0, x], ydot[x] - goal[1, x]
        mu_ref[x] = -Kd * eta[3 + x] - Kp * eta[x]
        yddot[x] = goal[2, x]
    twice_V, drift = 0.0, 0.0
    for i in range(6):
        gradient = 0.0
        for j in range(6):
            gradient += 2.0 * P_eps[i, j] * eta[j]
        twice_V += gradient * eta[i]
        if i < 3:
            drift += gradient * eta[3 + i]
        else:
            row[i - 3] = gradient
    bound[0] = -twice_V / 2 / eps - drift
    return twice_V / 2
