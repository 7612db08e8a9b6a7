"""One backward Euler step with joint stops, and its exact Jacobians.

With q⁺ = q ⊕ T v⁺ the step solves

    r(q⁺, v⁺, (v⁺ - v) / T; c, d) = 0

by Newton's method, r from `softdyn.dynamics.balance`. A joint that would leave its limits is held
at the stop, q⁺ = limit, as long as the stop pushes it inward (`Stops.solve`). With
A = M / T + ∂r/∂v + T ∂r/∂q, the free joints have

    ∂v⁺/∂v = A⁻¹ M / T,   ∂v⁺/∂q = -A⁻¹ ∂r/∂q,   ∂v⁺/∂d = -A⁻¹ ∂r/∂d,

and A⁻¹ maps a joint force to v⁺. A held joint has ∂v⁺/∂q = -1 / T and no other derivative.

The first Newton step takes r and its Jacobians from the linear model at the end of the step before,
if that leads to a solution.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softdyn.dynamics.balance import BalanceTerms, ForceBalance
from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.stops import Stops

NEAR = 1e-10  # rad, m: the last Newton step is smaller; the Jacobians are of its begin
MOST = 12  # Newton steps


class ImplicitStepResult(NamedTuple):
    """A step and its derivatives.

    Attributes
    ----------
    q, v : ndarray, (nq,), (n,)
        The state after it.
    by_state : ndarray, (n, 2n + nd)
        ∂v⁺ by q, v and d.
    by_force : ndarray, (n, n)
        ∂v⁺ by a joint force that acts during the step.
    held : ndarray of int, (n,)
        1 for a joint at its upper stop, -1 at the lower one, 0 for a free joint.
    inputs : ndarray, (m,)
        The inputs u at its end.
    """

    q: np.ndarray
    v: np.ndarray
    by_state: np.ndarray
    by_force: np.ndarray
    held: np.ndarray
    inputs: np.ndarray


class ImplicitStep:
    """Backward Euler steps of a robot.

    Parameters
    ----------
    model : SoftModel
        The robot's model.
    balance : ForceBalance, optional
        The balance of its forces, by default with the motors of its file and no disturbance.
    """

    def __init__(self, model: SoftModel, balance: ForceBalance | None = None) -> None:
        self._model, self._stops = model, Stops.of(model)
        self._stops.prepare()
        # without continuous joints the sum takes a tenth of the time
        self._moved = np.add if model.nq == model.nv else model.integrate
        self._balance = ForceBalance(model) if balance is None else balance
        self.forget()

    def forget(self) -> None:
        """The next step does not begin on the linear model of the last one."""
        # the last balance and its arguments, if the step had a solution
        self._last: tuple[BalanceTerms, tuple[np.ndarray, ...]] | None = None

    def __call__(
        self,
        q: np.ndarray,
        v: np.ndarray,
        commands: np.ndarray,
        d: np.ndarray,
        step: float,
        held: np.ndarray | None = None,
    ) -> ImplicitStepResult | None:
        """The state after a step; None if the iteration does not converge.

        Parameters
        ----------
        q, v : ndarray, (nq,), (n,)
            State.
        commands : ndarray, (m,)
            Constant inputs; for a winch the free length of its cable.
        d : ndarray, (nd,)
            Disturbances.
        step : float
            T (s).
        held : ndarray of int, (n,), optional
            The stops that held in the last step, a first guess.
        """
        held = np.zeros(self._model.nv, np.int64) if held is None else held
        last, self._last = self._last, None
        found = None if last is None else self._solve(q, v, commands, d, step, held, last)
        return self._solve(q, v, commands, d, step, held, None) if found is None else found

    def _solve(
        self,
        q: np.ndarray,
        v: np.ndarray,
        commands: np.ndarray,
        d: np.ndarray,
        step: float,
        held: np.ndarray,
        last: tuple[BalanceTerms, tuple[np.ndarray, ...]] | None,
    ) -> ImplicitStepResult | None:
        """Newton's method, its first step on the linear model of the last balance."""
        model, speed, there = self._model, v, self._moved(q, step * v)
        for _ in range(MOST):
            point = there, speed, (speed - v) / step, commands, d
            if last is None:
                terms = self._balance.trusted(*point)
                residual = terms.residual
            else:
                terms, before = last
                residual = _linear_residual(terms, before, point)
            A = terms.by_a / step + terms.by_v + step * terms.by_q
            at = model.coordinates(there)
            try:
                change, held = self._stops.solve(A, residual, at, step, held)
            except np.linalg.LinAlgError:  # a singular matrix
                return None
            speed = speed + change
            if not np.isfinite(speed).all():
                return None
            there = self._moved(q, step * speed)
            if last is None and step * np.abs(change).max(initial=0.0) < NEAR:
                if self._moved is np.add:
                    self._last = terms, (there, speed, (speed - v) / step, commands, d)
                return _result(there, speed, terms, A, step, held)
            last = None
        return None


def _linear_residual(
    terms: BalanceTerms, before: tuple[np.ndarray, ...], point: tuple[np.ndarray, ...]
) -> np.ndarray:
    """r (n,) at a point by the linear model about another one, where it is zero."""
    jacobians = terms.by_q, terms.by_v, terms.by_a, terms.by_commands, terms.by_d
    total = np.zeros(len(terms.residual))
    for by, here, there in zip(jacobians, point, before, strict=True):
        total += by @ (here - there)
    return total


def _result(
    q: np.ndarray, v: np.ndarray, terms: BalanceTerms, A: np.ndarray, step: float, held: np.ndarray
) -> ImplicitStepResult:
    """The step's end with its derivatives."""
    n = len(v)
    right = np.hstack((-terms.by_q, terms.by_a / step, -terms.by_d))
    if held.any():
        free = held == 0
        # a held joint moves with q, and so drives the free ones
        of_held = np.where(free, 0.0, -1.0 / step)
        right[:, :n] -= A * of_held
        inverse = np.zeros((n, n))
        inverse[np.ix_(free, free)] = np.linalg.inv(A[free][:, free])
        by_state = inverse @ right
        by_state.flat[:: by_state.shape[1] + 1] += of_held
    else:
        inverse = np.linalg.inv(A)
        by_state = inverse @ right
    return ImplicitStepResult(q, v, by_state, inverse, held, terms.inputs)
