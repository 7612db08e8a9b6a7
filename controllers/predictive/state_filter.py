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
from softdyn.compiled import compiled
from softdyn.controllers.qps.linear_algebra import dot

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
        off, speed, force, trust = np.zeros(self._model.nv), state.v, self.force, 1.0
        if self._expected is not None:
            q, v, matrix = self._expected
            missed = self._model.coordinates(state.q) - self._model.coordinates(q)
            late, stopped = state.v - v, held | self._held
            off, kept, pushed, trust = _corrections(
                missed, late, stopped, matrix, self._squares, min(1.0, self._period / WINDOW),
                self._kept, self._speed, self._push, self._trusted,
            )  # fmt: skip
            speed, force = speed - kept, force + pushed
        self._held, self.noisy = held, trust < 0.5 and bool(np.abs(off).max() > SLIGHT)
        self.force = np.where(held, 0.0, force)
        return off, speed, self.force


@compiled
def _corrections(
    missed, late, stopped, matrix, squares, share, keeps, speed_gain, push, trusted
):  # fmt: skip
    """How far q, q̇ and d change from the measured ones and the last d, and the mean trust.

    Nothing changes for a new state. The mean squares move by `share`.
    """
    n = len(missed)
    off, kept, pushed = np.zeros(n), np.zeros(n), np.zeros(n)
    for i in range(n):
        if not (stopped[i] or abs(missed[i]) < JUMP):
            return off, kept, pushed, 1.0
    gained, mean, chance = np.empty(n), 0.0, min(CHANCE * share, 0.5)
    for i in range(n):
        squares[0, i] += share * (missed[i] * missed[i] - squares[0, i])
        squares[1, i] += share * (late[i] * late[i] - squares[1, i])
        squares[2, i] += share * (missed[i] * late[i] - squares[2, i])
        both = max(squares[2, i], 0.0)
        trust = min(both * both / max(squares[0, i] * squares[1, i], 1e-300), 1.0)
        trust = max(trust - chance, 0.0) / (1 - chance)
        mean += trust / n
        gained[i] = trust * trusted * late[i] + (1 - trust) * push * missed[i]
        if not stopped[i]:
            off[i] = -(1 - trust) * keeps * missed[i]
            kept[i] = (1 - trust) * (late[i] - speed_gain * missed[i])
    for i in range(n):
        if not stopped[i]:
            pushed[i] = dot(matrix[i], gained)
    return off, kept, pushed, mean
