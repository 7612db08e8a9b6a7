"""Measured states and unmodelled joint forces, from how the last prediction was missed.

The prediction for this instant is missed by r_q = q ⊖ q⁻ and r_v = q̇ - q̇⁻. A force that the model
lacks moves both, in the same direction; measurement noise moves each by itself. The correlation of
the two, joint by joint, therefore says how far to trust the measurement, w in [0, 1]:

- w = 1: the state is the measured one, and the missing acceleration a grows by r_v / T over a
  memory.
- w = 0: a fading-memory filter of third order (Morrison 1969; Zarchan and Musoff, "Fundamentals of
  Kalman Filtering", chapter 9) with θ = e^(-T/τ) keeps part of the prediction,
  q = q⁻ ⊕ (1 - θ³) r_q, q̇ = q̇⁻ + 3/2 (1 - θ)² (1 + θ) r_q / T, and a grows by
  1/2 (1 - θ)³ r_q / T².

Independent errors, averaged over a window with the share s of a period, have a squared correlation
of s/2 in the mean. Up to eight times that it counts as none. The force
is d = S a, with S = M + T D_t + T² K_t, which maps a change of speed over one period to a force.
The trusts act on a, before S couples the joints: otherwise an error that is noise in one joint
would push another.
"""

from __future__ import annotations

import math

import numpy as np

from softdyn import SoftModel, State

FADING = 0.04  # τ (s)
WINDOW = 0.1  # s, of the correlation
CHANCE = 4.0  # squared correlation that counts as none, in shares of a period in the window
SLIGHT = 1e-6  # rad, m: corrections below it leave the model's matrices as they are
JUMP = 0.5  # rad, m: a state this far from its prediction is a new one


class StateFilter:
    """The filter of the predictive controller.

    Parameters
    ----------
    model : SoftModel
        The robot.
    memory : float
        Time constant (s) of d where the measurement is trusted.

    Attributes
    ----------
    force : ndarray, (nv,)
        d, the unmodelled joint forces.
    noisy : bool
        Whether the last measurement was mostly noise: a mean trust below 1/2, and corrections.
    """

    def __init__(self, model: SoftModel, memory: float) -> None:
        self._model, self._memory = model, memory

    def reset(self, period: float) -> None:
        """Begin a run with a control period (s)."""
        n, theta = self._model.nv, math.exp(-period / FADING)
        self._period = period
        self.force, self.noisy = np.zeros(n), False
        self._held = np.zeros(n, bool)
        self._squares = np.zeros((3, n))  # means of r_q², r_v², r_q r_v
        self._expected: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._kept = theta**3
        self._speed = 1.5 * (1 - theta) ** 2 * (1 + theta) / period
        self._push = 0.5 * (1 - theta) ** 3 / period**2
        self._trusted = min(1.0, period / self._memory) / period

    def forget(self) -> None:
        """The next state has no prediction."""
        self._expected = None

    def expect(self, q: np.ndarray, v: np.ndarray, matrix: np.ndarray) -> None:
        """The state (nq,), (nv,) predicted for the next call, and S (nv, nv)."""
        self._expected = q, v, matrix

    def __call__(self, state: State, held: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """p = q ⊖ (measured q) and q̇ (nv,) to go on from, and d (nv,).

        The forces of the stops are not part of d: joints that are at a stop now or were so one
        period ago keep their measured state and their d, and d is 0 at a stop.
        """
        nothing = np.zeros(self._model.nv)
        off, kept, pushed, trust = nothing, nothing, nothing, 1.0
        if self._expected is not None:
            q, v, matrix = self._expected
            missed = self._model.coordinates(state.q) - self._model.coordinates(q)
            stopped = held | self._held
            if (stopped | (np.abs(missed) < JUMP)).all():  # else it is a new state
                off, kept, gained, trust = self._corrections(missed, state.v - v, stopped)
                pushed = np.where(stopped, 0.0, matrix @ gained)
        self._held, self.noisy = held, trust < 0.5 and bool(np.abs(off).max() > SLIGHT)
        self.force = np.where(held, 0.0, self.force + pushed)
        return off, state.v - kept, self.force

    def _corrections(
        self, missed: np.ndarray, late: np.ndarray, stopped: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """Changes (n,) of q, of q̇ and of a by r_q and r_v, and the mean trust."""
        share = min(1.0, self._period / WINDOW)
        means = np.stack((missed * missed, late * late, missed * late))
        self._squares += share * (means - self._squares)
        by_q, by_v, both = self._squares
        both, chance = np.maximum(both, 0.0), min(CHANCE * share, 0.5)
        trust = np.minimum(both * both / np.maximum(by_q * by_v, 1e-300), 1.0)
        trust = np.maximum(trust - chance, 0.0) / (1 - chance)
        doubt = 1 - trust
        gained = trust * self._trusted * late + doubt * self._push * missed
        off = np.where(stopped, 0.0, -doubt * self._kept * missed)
        kept = np.where(stopped, 0.0, doubt * (late - self._speed * missed))
        return off, kept, gained, float(trust.mean())
