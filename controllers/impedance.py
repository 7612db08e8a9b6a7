"""IC and UIC: the closed-form impedance laws, saturated by clamping."""

from __future__ import annotations

from functools import partial

import numpy as np

from controllers.clf import make_clf
from controllers.controller import Command, InputGuard, guarded, rehearse
from controllers.gains import Gains, resolve
from controllers.linear_algebra import extended, factor, row_space
from controllers.task import task_error
from softdyn import Reference, SetPoint, SoftModel, State
from softdyn.compiled import compiled

# Of the reference implementation: Λ is an inverse, or a pseudo-inverse where the determinant of
# J M⁻¹ Jᵀ is small, and UIC's inner pseudo-inverse has a threshold of its own.
SMALL_DETERMINANT, TASK_INERTIA_RCOND, UIC_RCOND = 1e-2, 1e-2, 1e-8


@compiled
def task_inertia(M: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Λ = (J M⁻¹ Jᵀ)⁻¹ (3, 3), in kg."""
    mobility = J @ np.linalg.solve(M, J.T.copy())
    if abs(np.linalg.det(mobility)) >= SMALL_DETERMINANT:
        return np.ascontiguousarray(np.linalg.inv(mobility))
    values, vectors = np.linalg.eigh(mobility)
    keep = np.abs(values) > TASK_INERTIA_RCOND * np.abs(values).max()
    vectors = np.ascontiguousarray(vectors[:, keep])
    return (vectors / values[keep]) @ vectors.T.copy()


@compiled
def task_torque(  # the state's terms, then μ_ref and ÿ_ref
    M: np.ndarray, J: np.ndarray, Jdot: np.ndarray, v: np.ndarray, coriolis: np.ndarray,
    reach: np.ndarray, mu_ref: np.ndarray, yddot: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Jᵀ f (n,) with f = Λ ÿ + J⁺ᵀ C q̇ - Λ J̇ q̇ and ÿ = ÿ_ref - K_d ė - K_p e.

    Paper, (eq:impedance_acc) and (impedance_acc); Jᵀ J⁺ᵀ projects C q̇ onto range(Jᵀ), which the
    rows of `reach` span.
    """
    acceleration = yddot + mu_ref - Jdot @ v
    return J.T @ (task_inertia(M, J) @ acceleration) + reach.T @ (reach @ coriolis)


class ImpedanceLaw:
    """u = clamp(B⁺ τ): what IC and UIC share, B⁺ kept while B does not change."""

    def __init__(self, model: SoftModel, gains: Gains) -> None:
        self.guard = InputGuard(model.u_min, model.u_max)
        self._gains = gains
        self._clf = make_clf(gains.eps)
        self._B: np.ndarray | None = None
        self._factors = (np.empty((0, 0)),) * 3
        rehearse(partial(self.command, project=True), model, self.guard)

    def command(self, state: State, reference: Reference | SetPoint, *, project: bool) -> Command:
        """u = clamp(B⁺ τ); `project` removes the torques that no input can give."""
        if state.B is not self._B:
            self._factors, self._B = factor(state.B), state.B
        span, inverse, _ = self._factors
        task = task_error(state, reference, self._gains)
        reach = row_space(state.J)
        torque = task_torque(
            state.M, state.J, state.Jdot, state.v, state.bias - state.g, reach,
            task.mu_ref, task.yddot,
        )  # fmt: skip
        if project:
            torque = torque + null_torque(reach, span, torque)
        u = inverse @ (span @ (torque + state.D @ state.v + state.K + state.g))
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

    @guarded
    def __call__(self, state: State, reference: Reference | SetPoint) -> Command:
        """The input at this state; see `Command`."""
        return self._law.command(state, reference, project=False)


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

    @guarded
    def __call__(self, state: State, reference: Reference | SetPoint) -> Command:
        """The input at this state; see `Command`."""
        return self._law.command(state, reference, project=True)


@compiled
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
    span = extended(reach, range_B)
    k, n = span.shape
    task, actuated = reach @ span.T, range_B @ span.T
    N = np.eye(k) - task.T @ task
    unactuated = np.eye(k) - actuated.T @ actuated
    left, values, right = np.linalg.svd(unactuated @ N)
    largest = 1.0 if n > k else values.max()  # outside the span every singular value is 1
    keep = values > UIC_RCOND * largest
    inner = unactuated @ (span @ torque)
    rows, columns = right[keep], np.ascontiguousarray(left[:, keep])
    answer = rows.T @ ((columns.T @ inner) / values[keep])
    return -(span.T @ (N @ answer))
