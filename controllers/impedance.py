"""IC and UIC: the closed-form impedance laws, saturated by clamping."""

from __future__ import annotations

import numpy as np

from controllers.clf import make_clf
from controllers.controller import Command, InputGuard
from controllers.gains import Gains, resolve
from controllers.linear_algebra import InputFactors, factor, row_space
from controllers.task import Task, task_error
from softdyn import Reference, SetPoint, SoftModel, State

# Of the reference implementation: Λ is an inverse, or a pseudo-inverse where the determinant of
# J M⁻¹ Jᵀ is small, and UIC's inner pseudo-inverse has a threshold of its own.
SMALL_DETERMINANT, TASK_INERTIA_RCOND, UIC_RCOND = 1e-2, 1e-2, 1e-8


def task_inertia(state: State) -> np.ndarray:
    """Λ = (J M⁻¹ Jᵀ)⁻¹ (3, 3), in kg."""
    mobility = state.J @ np.linalg.solve(state.M, state.J.T)
    if abs(np.linalg.det(mobility)) < SMALL_DETERMINANT:
        return np.linalg.pinv(mobility, rcond=TASK_INERTIA_RCOND, hermitian=True)
    return np.linalg.inv(mobility)


def task_torque(state: State, task: Task) -> np.ndarray:
    """Jᵀ f (n,) with f = Λ ÿ + J⁺ᵀ C q̇ - Λ J̇ q̇ and ÿ = ÿ_ref - K_d ė - K_p e.

    Paper, (eq:impedance_acc) and (impedance_acc); Jᵀ J⁺ᵀ projects C q̇ onto range(Jᵀ).
    """
    acceleration = task.yddot + task.mu_ref - state.Jdot @ state.v
    reach = row_space(state.J)
    coriolis = state.bias - state.g
    return state.J.T @ (task_inertia(state) @ acceleration) + reach.T @ (reach @ coriolis)


class ImpedanceLaw:
    """u = clamp(B⁺ τ): what IC and UIC share, B⁺ kept while B does not change."""

    def __init__(self, model: SoftModel, gains: Gains) -> None:
        self.guard = InputGuard(model.u_min, model.u_max)
        self._clf = make_clf(gains.eps)
        self._B: np.ndarray | None = None
        self._factors: InputFactors

    def factors(self, state: State) -> InputFactors:
        """B⁺ and the range of B at this state."""
        if state.B is not self._B:
            self._factors, self._B = factor(state.B), state.B
        return self._factors

    def command(self, state: State, task: Task, torque: np.ndarray) -> Command:
        """Add the cancelled D q̇ + K + g, map through B⁺, clamp."""
        B = self.factors(state)
        u = B.inverse @ (B.range @ (torque + state.D @ state.v + state.K + state.g))
        V = self._clf.decrease(task.eta)[0]
        return self.guard.accept(u, V, np.nan, clamped=True)


class Impedance:
    """Paper, "Impedance Control": u = clamp(B⁺(Jᵀ f + D q̇ + K + g)), eq. (IC).

    Parameters and errors as for `SoftIdClfQp`.
    """

    name = "ic"

    def __init__(self, model: SoftModel, gains: Gains | None = None) -> None:
        self.gains = resolve(model, self.name, gains)
        self._law = ImpedanceLaw(model, self.gains)
        self.guard = self._law.guard

    def __call__(self, state: State, reference: Reference | SetPoint) -> Command:
        """The input at this state; see `Command`."""
        task = task_error(state, reference, self.gains)
        return self._law.command(state, task, task_torque(state, task))


class UnderactuatedImpedance:
    """Paper, "Underactuated Impedance Control", after Mistry & Righetti 2012, eq. (UIC).

    τ = (I - N [(I - I_p) N]⁺) Jᵀ f + D q̇ + K + g with I_p = B B⁺ (n × n; the paper prints B⁺B).
    Parameters and errors as for `SoftIdClfQp`.
    """

    name = "uic"

    def __init__(self, model: SoftModel, gains: Gains | None = None) -> None:
        self.gains = resolve(model, self.name, gains)
        self._law = ImpedanceLaw(model, self.gains)
        self.guard = self._law.guard

    def __call__(self, state: State, reference: Reference | SetPoint) -> Command:
        """The input at this state; see `Command`."""
        task = task_error(state, reference, self.gains)
        torque = task_torque(state, task)
        torque = torque + null_torque(row_space(state.J), self._law.factors(state).range, torque)
        return self._law.command(state, task, torque)


def null_torque(reach: np.ndarray, range_B: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """N τ_null = -N [(I - I_p) N]⁺ (I - I_p) Jᵀf (n,), paper (null_tau), in few dimensions.

    N and I - I_p are both the identity outside the span of range(Jᵀ) and range(B), at most 3 + m
    dimensions, and Jᵀf lies inside it: the pseudo-inverse is taken there.

    Parameters
    ----------
    reach : (r, n) orthonormal rows that span range(Jᵀ).
    range_B : (rank, n) orthonormal rows that span range(B).
    torque : (n,) in range(Jᵀ).
    """
    span = np.linalg.qr(np.concatenate((reach, range_B)).T)[0].T
    k, n = span.shape
    task, actuated = reach @ span.T, range_B @ span.T
    N = np.eye(k) - task.T @ task
    unactuated = np.eye(k) - actuated.T @ actuated
    left, values, right = np.linalg.svd(unactuated @ N)
    largest = 1.0 if n > k else values[0]  # outside the span every singular value is 1
    keep = values > UIC_RCOND * largest
    inner = unactuated @ (span @ torque)
    answer = (right[keep].T / values[keep]) @ (left[:, keep].T @ inner)
    return -span.T @ (N @ answer)
