"""The torques z of Maxwell branches in a filter: known dynamics, driven by the joints' motion.

A branch's torque is a disturbance of the balance, r = … + z. Over a backward Euler step T with the
joint's rate v⁺, z⁺ = e^(-T/τ) z + γ T v⁺, where γ is `Branches.gain`. The step solves r with z⁺, so
that stiff branches do not limit it, and

    ∂r/∂v⁺ += γ T,   ∂r/∂z = e^(-T/τ).
"""

from __future__ import annotations

import numpy as np

from softdyn.dynamics.balance import BalanceTerms, ForceBalance
from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.relaxation import Branches


class CreepingBalance:
    """A balance whose disturbances include the torques z at the begin of a step.

    Parameters
    ----------
    model : SoftModel
        The robot.
    balance : ForceBalance
        Its balance, with the disturbance ``relaxation``.
    where : slice
        The torques among the disturbances.
    """

    def __init__(self, model: SoftModel, balance: ForceBalance, where: slice) -> None:
        self._balance, self._where = balance, where
        self._branches = Branches.of(model)
        self._step = np.nan

    def hold(self, step: float) -> None:
        """The next balance is that of a step (s)."""
        if step != self._step:
            self._step = step
            self._decay = self._branches.decay(step)
            self._slope = step * self._branches.gain(step)[:, None] * self._branches.rates

    def trusted(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, commands: np.ndarray, d: np.ndarray
    ) -> BalanceTerms:
        """The balance at the end of the step."""
        end = d.copy()
        end[self._where] = self._decay * d[self._where] + self._slope @ v
        terms = self._balance.trusted(q, v, a, commands, end)
        columns = terms.by_d[:, self._where]
        terms.by_v[:] += columns @ self._slope
        columns *= self._decay
        return terms

    def follow(self, d: np.ndarray, P: np.ndarray, v: np.ndarray) -> None:
        """Add the motion's part of the step to z in d (nd,), and to its covariance, in place.

        Parameters
        ----------
        d : ndarray, (nd,)
            The disturbances, already decayed.
        P : ndarray, (s, s)
            Covariance of q, q̇ and the disturbances at the end of the step.
        v : ndarray, (n,)
            q̇ then.
        """
        n, own = len(v), slice(2 * len(v) + self._where.start, 2 * len(v) + self._where.stop)
        d[self._where] += self._slope @ v
        P[own] += self._slope @ P[n : 2 * n]
        P[:, own] += P[:, n : 2 * n] @ self._slope.T
