"""One backward Euler step with joint stops, and its exact Jacobians.

With q⁺ = q ⊕ T v⁺ the step solves

    r(q⁺, v⁺, (v⁺ - v) / T; c, d) = 0

by Newton's method, r from `softdyn.dynamics.balance`. A joint that would leave its limits is held
at the stop, q⁺ = limit, as long as the stop pushes it inward (`Stops.solve`). With
A = M / T + ∂r/∂v + T ∂r/∂q, the free joints have

    ∂v⁺/∂v = A⁻¹ M / T,   ∂v⁺/∂q = -A⁻¹ ∂r/∂q,   ∂v⁺/∂d = -A⁻¹ ∂r/∂d,

and A⁻¹ maps a joint force to v⁺. A held joint has ∂v⁺/∂q = -1 / T and no other derivative. On a
floating base ⊕ has slopes of its own, with which ∂r/∂q is multiplied: ∂q⁺/∂q in place of 1 and
∂q⁺/∂v⁺ in place of T.

The first Newton step takes r and its Jacobians from the linear model at the end of the step before,
if that leads to a solution.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
import pinocchio as pin

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


class Balance(Protocol):
    """The balance of joint forces: a `ForceBalance`, or one with further forces."""

    def trusted(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, commands: np.ndarray, d: np.ndarray
    ) -> BalanceTerms:
        """The balance at (q, v, a), as `ForceBalance.trusted`."""


class ImplicitStep:
    """Backward Euler steps of a robot.

    Parameters
    ----------
    model : SoftModel
        The robot's model.
    balance : Balance, optional
        The balance of its forces, by default with the motors of its file and no disturbance.
    stops : Stops, optional
        The stops of its joints, by default those of its file.
    near : float
        Newton's method ends with a step of less (rad, m). The Jacobians are those of its begin.
    """

    def __init__(
        self,
        model: SoftModel,
        balance: Balance | None = None,
        stops: Stops | None = None,
        near: float = NEAR,
    ) -> None:
        self._near = near
        self._model, self._stops = model, Stops.of(model) if stops is None else stops
        self._stops.prepare()
        # without continuous joints the sum takes a tenth of the time
        self._moved = np.add if model.nq == model.nv else model.integrate
        self._balance: Balance = ForceBalance(model) if balance is None else balance
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
        guess: np.ndarray | None = None,
    ) -> ImplicitStepResult | None:
        """The state after a step; None if the iteration does not end in balance.

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
        guess : ndarray, (n,), optional
            The velocity with which the iteration begins, by default v or that of the last step's
            linear model.
        """
        held = np.zeros(self._model.nv, np.int64) if held is None else held
        last, self._last = self._last, None
        found = None
        if last is not None and guess is None:
            found = self._solve(q, v, commands, d, step, held, v, last)
        if found is None:
            found = self._solve(q, v, commands, d, step, held, v if guess is None else guess, None)
        return found

    def _solve(
        self,
        q: np.ndarray,
        v: np.ndarray,
        commands: np.ndarray,
        d: np.ndarray,
        step: float,
        held: np.ndarray,
        speed: np.ndarray,
        last: tuple[BalanceTerms, tuple[np.ndarray, ...]] | None,
    ) -> ImplicitStepResult | None:
        """Newton's method, its first step on the linear model of the last balance."""
        model = self._model
        if last is None:  # from beyond a stop the iteration may end nowhere
            speed = self._stops.clip(model.coordinates(q), step * speed) / step
        there = self._moved(q, step * speed)
        for _ in range(MOST):
            point = there, speed, (speed - v) / step, commands, d
            if last is None:
                terms = self._balance.trusted(*point)
                residual = terms.residual
            else:
                terms, before = last
                residual = _linear_residual(terms, before, point)
            ends = ends_by(self._model, q, step * speed)
            A = newton_matrix(terms, step, ends)
            at = model.coordinates(there)
            try:
                change, held = self._stops.solve(A, residual, at, step, held)
            except np.linalg.LinAlgError:  # a singular matrix
                return None
            speed = speed + change
            if not np.isfinite(speed).all():
                return None
            there = self._moved(q, step * speed)
            if last is None and step * np.abs(change).max(initial=0.0) < self._near:
                if self._moved is np.add:
                    self._last = terms, (there, speed, (speed - v) / step, commands, d)
                if ends is not None:
                    ends = ends_by(self._model, q, step * speed)
                    A = newton_matrix(terms, step, ends)
                return linearised(there, speed, terms, A, step, held, ends)
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


def ends_by(model: SoftModel, q: np.ndarray, move: np.ndarray) -> tuple[np.ndarray, ...] | None:
    """The Jacobians (n, n) of q ⊕ move by q and by move; None where both are the identity.

    Those of a floating base are Pinocchio's, of the group of rigid motions.
    """
    if not model.robot.floating:
        return None
    base, slopes = pin.liegroups.SE3(), (np.eye(model.nv), np.eye(model.nv))
    slopes[0][:6, :6] = base.dIntegrate_dq(q[:7], move[:6])
    slopes[1][:6, :6] = base.dIntegrate_dv(q[:7], move[:6])
    return slopes


def newton_matrix(
    terms: BalanceTerms, step: float, ends: tuple[np.ndarray, ...] | None
) -> np.ndarray:
    """A (n, n), with the slopes of `ends_by`."""
    by_q = terms.by_q if ends is None else terms.by_q @ ends[1]
    matrix: np.ndarray = terms.by_a / step + terms.by_v + step * by_q
    return matrix


def linearised(
    q: np.ndarray, v: np.ndarray, terms: BalanceTerms, A: np.ndarray, step: float,
    held: np.ndarray, ends: tuple[np.ndarray, ...] | None,
) -> ImplicitStepResult:  # fmt: skip
    """The step's end with its derivatives, from the balance there.

    Parameters
    ----------
    q, v : ndarray, (nq,), (n,)
        The state at its end.
    terms : BalanceTerms
        The balance there, or so near that its Jacobians are the same.
    A : ndarray, (n, n)
        The matrix of Newton's method there.
    step : float
        T (s).
    held : ndarray of int, (n,)
        The joints at their stops.
    ends : tuple of ndarray, optional
        The slopes of `ends_by`.
    """
    n = len(v)
    by_q = terms.by_q if ends is None else terms.by_q @ ends[0]
    right = np.hstack((-by_q, terms.by_a / step, -terms.by_d))
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
