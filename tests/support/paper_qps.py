"""The paper's controllers as printed, with every unknown explicit: the oracle.

Each formula is taken directly from the paper. Only the numbers in a `Gains` come from
`controllers`. A QP is written in the variables of any `Solver`. The minimiser is not unique for
CLF-QP with more inputs than task rows, without full rank of J M⁻¹ B, or with a weight of zero.
There, compare controllers by their cost, or by the input that `LeastNorm` chooses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg

from softdyn import Reference, State
from softdyn.controllers.gains import Gains
from tests.support.qp_solvers import Solver, SolverAnswer, SymbolicQp, Term

# the only threshold: singular values below this share of the largest count as zero
RANK_TOLERANCE = 1e-6
Variables = Callable[..., Sequence[Any]]


@dataclass(frozen=True, eq=False)
class TaskTerms:
    """The regulated output y with its error to the reference; r = 3 in the paper.

    Attributes
    ----------
    J, Jdot : array, (r, n)
        ẏ = J q̇ and its rate.
    e, edot : array, (r,)
        y - y_ref and its rate.
    yddot : array, (r,)
        ÿ_ref.
    """

    J: np.ndarray
    Jdot: np.ndarray
    e: np.ndarray
    edot: np.ndarray
    yddot: np.ndarray

    def mu_ref(self, gains: Gains) -> np.ndarray:
        """μ_ref = -K_d ė - K_p e with K_d = 2 √K_p."""
        return -2 * np.sqrt(gains.Kp) * self.edot - gains.Kp * self.e


def tip(state: State, reference: Reference) -> TaskTerms:
    """The paper's task: the position of the tip."""
    e, edot = state.y - reference.y, state.ydot - reference.ydot
    return TaskTerms(state.J, state.Jdot, e, edot, reference.yddot)


class Lyapunov(NamedTuple):
    """V, and V̇ = drift + slope · μ."""

    V: float
    drift: float
    slope: np.ndarray


def lyapunov(task: TaskTerms, eps: float) -> Lyapunov:
    """V = ηᵀ P_ε η, with the solution P = [[√3 I, I], [I, √3 I]] of (eq:care) for Q = R = I."""
    eye, zero = np.eye(len(task.e)), np.zeros((len(task.e),) * 2)
    P = np.block([[np.sqrt(3.0) * eye, eye], [eye, np.sqrt(3.0) * eye]])
    shrink = np.block([[eye / eps, zero], [zero, eye]])
    P_eps = shrink @ P @ shrink
    F, G = np.block([[zero, eye], [zero, zero]]), np.vstack((zero, eye))
    eta = np.concatenate((task.e, task.edot))
    drift = eta @ (F.T @ P_eps + P_eps @ F) @ eta
    return Lyapunov(eta @ P_eps @ eta, drift, 2 * eta @ P_eps @ G)


def actuated_rows(B: np.ndarray, tolerance: float = RANK_TOLERANCE) -> tuple[np.ndarray, ...]:
    """R (r, n) and S (r, m) of the actuated dynamics, eq. (actuated): R (M q̈ + h) = S u.

    If B has full column rank, T = [Bᵀ; null(Bᵀ)] is formed and R is the first m rows of T⁻ᵀ, S = I:
    the paper's collocated form. Without full rank there is no such T. Then R is an orthonormal
    basis of range(B) and S = R B, so that only the dynamics along range(B) are imposed.
    """
    m = B.shape[1]
    basis = scipy.linalg.orth(B, rcond=tolerance)
    if basis.shape[1] < m:
        return basis.T, basis.T @ B
    T = np.vstack((B.T, scipy.linalg.null_space(B.T, rcond=tolerance).T))
    return np.linalg.inv(T).T[:m], np.eye(m)


def null_projector(J: np.ndarray, tolerance: float = RANK_TOLERANCE) -> np.ndarray:
    """N = I - J⁺ J (n, n)."""
    return np.eye(J.shape[1]) - np.linalg.pinv(J, rcond=tolerance) @ J


# -- QPs ------------------------------------------------------------------------------------


def soft_id_clf_qp(
    variables: Variables,
    state: State,
    task: TaskTerms,
    gains: Gains,
    tolerance: float = RANK_TOLERANCE,
) -> SymbolicQp:
    """Paper, "Soft ID-CLF-QP": the actuated rows of the dynamics are hard constraints."""
    rows = actuated_rows(state.B, tolerance)
    return _inverse_dynamics(variables, state, task, gains, rows, tolerance)


def mass_orthogonal(
    variables: Variables, state: State, task: TaskTerms, gains: Gains, *, decrease: bool
) -> SymbolicQp:
    """Soft ID-CLF-QP, or IC-QP without `decrease`, with the other T_u: T_u M⁻¹ B = 0.

    R = (Bᵀ M⁻¹ B)⁻¹ Bᵀ M⁻¹, here in a basis of range(B): actuated accelerations are the model's.
    """
    basis = scipy.linalg.orth(state.B, rcond=RANK_TOLERANCE).T @ np.linalg.inv(state.M)
    rows = basis, basis @ state.B
    return _inverse_dynamics(variables, state, task, gains, rows, decrease=decrease)


def id_clf_qp(variables: Variables, state: State, task: TaskTerms, gains: Gains) -> SymbolicQp:
    """ID-CLF-QP: the full dynamics, eq. (dynamics), are hard constraints, M q̈ + h = B u."""
    return _inverse_dynamics(variables, state, task, gains, (np.eye(len(state.v)), state.B))


def ic_qp(variables: Variables, state: State, task: TaskTerms, gains: Gains) -> SymbolicQp:
    """Paper, "IC-QP": the Soft ID-CLF-QP without δ and its condition."""
    rows = actuated_rows(state.B)
    return _inverse_dynamics(variables, state, task, gains, rows, decrease=False)


def clf_qp(variables: Variables, state: State, task: TaskTerms, gains: Gains) -> SymbolicQp:
    """Paper, "CLF-QP": L_g L_f y u = -L_f² y + μ + ÿ_ref, no weight on u."""
    u, mu, delta = variables(state.B.shape[1], len(task.e), 1)
    mobility = task.J @ np.linalg.inv(state.M)
    L2f = task.Jdot @ state.v - mobility @ state.h
    return SymbolicQp(
        {"u": u, "mu": mu, "delta": delta},
        {
            "task": Term(gains.w1, mu - task.mu_ref(gains)),
            "slack": Term(gains.rho, delta),
        },
        {"linearisation": (mobility @ state.B) @ u - mu + (L2f - task.yddot)},
        {**_bounds(state, u), **_decrease(task, gains, mu, delta)},
    )


def _inverse_dynamics(
    variables: Variables,
    state: State,
    task: TaskTerms,
    gains: Gains,
    rows: tuple[np.ndarray, ...],
    tolerance: float = RANK_TOLERANCE,
    *,
    decrease: bool = True,
) -> SymbolicQp:
    """The inverse dynamics of three QPs; the w4 term is squared (the text drops its exponent)."""
    n, m = state.B.shape
    qdd, u, *slack = variables(n, m, 1) if decrease else variables(n, m)
    mu = task.J @ qdd + (task.Jdot @ state.v - task.yddot)
    N, (R, S) = null_projector(task.J, tolerance), rows
    cost = {
        "task": Term(gains.w1, mu - task.mu_ref(gains)),
        "acceleration": Term(gains.w2, qdd),
        "input": Term(gains.w3, u),
        "null": Term(gains.w4, N @ qdd + gains.null_damping * N @ state.v),
    }
    found, below = {"qdd": qdd, "u": u}, _bounds(state, u)
    if decrease:
        found["delta"], cost["slack"] = slack[0], Term(gains.rho, slack[0])
        below |= _decrease(task, gains, mu, slack[0])
    return SymbolicQp(found, cost, {"dynamics": (R @ state.M) @ qdd - S @ u + R @ state.h}, below)


def _bounds(state: State, u: Any) -> dict[str, Any]:
    return {"upper": u - state.model.u_max, "lower": state.model.u_min - u}


def _decrease(task: TaskTerms, gains: Gains, mu: Any, delta: Any) -> dict[str, Any]:
    """V̇ ≤ -V/ε + δ, δ ≥ 0."""
    V, drift, slope = lyapunov(task, gains.eps)
    return {"decrease": slope[None] @ mu - delta + (drift + V / gains.eps), "slack": -delta}


PAPER_QPS: dict[str, Callable[[Variables, State, TaskTerms, Gains], SymbolicQp]] = {
    "soft-id-clf-qp": soft_id_clf_qp,
    "id-clf-qp": id_clf_qp,
    "ic-qp": ic_qp,
    "clf-qp": clf_qp,
}


@dataclass(frozen=True)
class PrintedLaw:
    """One of the QPs as a controller; it is built and solved anew at every state.

    Attributes
    ----------
    write : callable
        One of `PROGRAMMES`.
    gains : Gains
    solver : Solver
    """

    write: Callable[[Variables, State, TaskTerms, Gains], SymbolicQp]
    gains: Gains
    solver: Solver

    def __call__(self, state: State, reference: Reference) -> SolverAnswer:
        """The solver's answer at this state.

        Raises
        ------
        Unsolved
            The solver has no answer.
        """
        task = tip(state, reference)
        return self.solver.solve(self.write(self.solver.variables, state, task, self.gains))


# -- closed forms ----------------------------------------------------------------------------------


def inverse(matrix: np.ndarray) -> np.ndarray:
    """The inverse, or for a singular matrix the pseudo-inverse with the stated threshold."""
    return np.linalg.pinv(matrix, rcond=RANK_TOLERANCE)


def task_inertia(mobility: np.ndarray) -> np.ndarray:
    """Λ of J M⁻¹ Jᵀ, whose singular values are about the squares of those of J."""
    return np.linalg.pinv(mobility, rcond=RANK_TOLERANCE**2, hermitian=True)


def impedance(
    state: State,
    task: TaskTerms,
    gains: Gains,
    invert: Callable[[np.ndarray], np.ndarray] = task_inertia,
) -> np.ndarray:
    """Jᵀ f (n,) of eq. (eq:impedance_acc), f = Λ ÿ + J⁺ᵀ C q̇ - Λ J̇ q̇.

    `invert` makes Λ of J M⁻¹ Jᵀ.
    """
    J = task.J
    Lambda = invert(J @ np.linalg.inv(state.M) @ J.T)
    ahead = task.yddot + task.mu_ref(gains) - task.Jdot @ state.v
    return J.T @ (Lambda @ ahead + inverse(J).T @ (state.C @ state.v))


def underactuated(
    state: State,
    task: TaskTerms,
    torque: np.ndarray,
    pseudo_inverse: Callable[[np.ndarray], np.ndarray] = inverse,
) -> np.ndarray:
    """Eq. (UIC): (I - N [(I - I_p) N]⁺) τ, where I_p must be B B⁺ (n, n): the text prints B⁺ B.

    The inner (I - I_p) of eq. (null_tau) changes nothing, because [(I - I_p) N]⁺ contains it.
    """
    eye, N = np.eye(len(torque)), null_projector(task.J)
    unreached = eye - state.B @ inverse(state.B)
    return (eye - N @ pseudo_inverse(unreached @ N)) @ torque


def inputs(state: State, torque: np.ndarray) -> np.ndarray:
    """B⁺ (τ + D q̇ + K + g) (m,) of eqs. (IC) and (UIC), before they are clamped."""
    return inverse(state.B) @ (torque + state.D @ state.v + state.K + state.g)
