"""One control step as the paper computes it: the programme as printed, cvxpy builds it, SCS solves.

Nothing is condensed, scaled or kept: every step forms the dense projectors, writes the programme
of the paper's text in its own variables and hands it to cvxpy anew, as the reference
implementation does. The terms of the dynamics are given, so what differs from `controllers` is the
programme and its solver alone. Needs the extra ``bench``.

The reference implementation writes ‖x‖² as ``square(norm(x))``, which cvxpy turns into
second-order cones; ``sum_squares`` says the same and stays a quadratic programme, about twice as
fast. Both forms are here, and `scripts/step_time.py` reports both.
"""

from __future__ import annotations

from collections.abc import Callable

import cvxpy as cp
import numpy as np
import scipy.linalg

from softdyn import Reference, SetPoint, State
from softdyn.controllers import Gains
from softdyn.controllers.programmes.clf import F, G, make_clf

RANK_TOLERANCE = 1e-6  # singular values below this share of the largest count as zero

Expression = cp.Expression
Squares = Callable[[Expression], Expression]
Programme = tuple[Expression, Expression, Expression, list[cp.Constraint]]


class PaperStack:
    """(state, reference) → u (nu,) of one of the paper's QP laws; NaN where SCS has no answer.

    Parameters
    ----------
    law : ``soft-id-clf-qp``, ``id-clf-qp``, ``ic-qp`` or ``clf-qp``.
    gains : as for the controller of that name.
    quadratic : write ‖x‖² as ``sum_squares(x)``, not as the reference implementation does.
    accuracy : SCS's absolute and relative tolerance; cvxpy's default (1e-5), which the reference
        implementation uses, where it is omitted.
    """

    def __init__(
        self, law: str, gains: Gains, *, quadratic: bool = False, accuracy: float | None = None
    ) -> None:
        self._squares: Squares = cp.sum_squares if quadratic else square_of_norm
        self._programme = PROGRAMMES[law]
        self._gains = gains
        self._decrease = law != "ic-qp"
        self._P = make_clf(gains.eps).P_eps
        self._options = {} if accuracy is None else {"eps": accuracy, "max_iters": 200_000}

    def __call__(self, state: State, reference: Reference | SetPoint) -> np.ndarray:
        """Build and solve the programme at this state."""
        gains = self._gains
        e, edot = state.y - reference.y, state.ydot - reference.ydot
        eta, mu_ref = np.concatenate((e, edot)), -gains.Kd * edot - gains.Kp * e
        u, mu, cost, constraints = self._programme(state, reference, gains, self._squares)
        cost += gains.w1 * self._squares(mu - mu_ref)
        constraints += [u >= state.model.u_min, u <= state.model.u_max]
        if self._decrease:
            delta = cp.Variable()  # of either sign, as there: a negative one only tightens
            cost += gains.rho * cp.square(delta)
            V = eta @ self._P @ eta
            drift = eta @ (F.T @ self._P + self._P @ F) @ eta
            Vdot = drift + 2 * (eta @ self._P @ G) @ mu
            constraints.append(Vdot <= -V / gains.eps + delta)
        try:
            cp.Problem(cp.Minimize(cost), constraints).solve(solver=cp.SCS, **self._options)
        except cp.SolverError:
            return np.full(state.model.nu, np.nan)
        return np.full(state.model.nu, np.nan) if u.value is None else u.value


def square_of_norm(x: Expression) -> Expression:
    """‖x‖², spelled as in the reference implementation."""
    return cp.square(cp.norm(x))


def soft_inverse_dynamics(
    state: State, reference: Reference | SetPoint, gains: Gains, squares: Squares
) -> Programme:
    """Paper, "Soft ID-CLF-QP" and "IC-QP": the actuated rows are hard, M̄_a q̈_a + h̄_a = u."""
    R, S = actuated_rows(state.B)
    u, qdd, mu, cost = _inverse_dynamics(state, reference, gains, squares)
    return u, mu, cost, [(R @ state.M) @ qdd + R @ state.h == S @ u]


def inverse_dynamics(
    state: State, reference: Reference | SetPoint, gains: Gains, squares: Squares
) -> Programme:
    """ID-CLF-QP: all rows are hard, M q̈ + h = B u."""
    u, qdd, mu, cost = _inverse_dynamics(state, reference, gains, squares)
    return u, mu, cost, [state.M @ qdd + state.h == state.B @ u]


def linearisation(
    state: State, reference: Reference | SetPoint, gains: Gains, squares: Squares
) -> Programme:
    """Paper, "CLF-QP": L_g L_f y u = -L_f² y + μ + ÿ_ref."""
    mobility = state.J @ np.linalg.inv(state.M)
    u, mu = cp.Variable(state.model.nu), cp.Variable(3)
    drift = state.Jdot @ state.v - mobility @ state.h
    law = (mobility @ state.B) @ u == mu + reference.yddot - drift
    return u, mu, cp.Constant(0.0), [law]


def actuated_rows(B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R (r, n) and S (r, m) of the actuated dynamics R (M q̈ + h) = S u.

    With T = [Bᵀ; null(Bᵀ)] the first m rows of T⁻ᵀ, and S = I; where B has no full column rank, and
    T no inverse, an orthonormal basis of range(B), and S = R B.
    """
    m = B.shape[1]
    complement = scipy.linalg.null_space(B.T, rcond=RANK_TOLERANCE)
    if complement.shape[1] > len(B) - m:
        R = scipy.linalg.orth(B, rcond=RANK_TOLERANCE).T
        return R, R @ B
    return np.linalg.inv(np.vstack((B.T, complement.T))).T[:m], np.eye(m)


def _inverse_dynamics(
    state: State, reference: Reference | SetPoint, gains: Gains, squares: Squares
) -> tuple[cp.Variable, cp.Variable, Expression, Expression]:
    """u, q̈, μ and w2 ‖q̈‖² + w3 ‖u‖² + w4 ‖N q̈ - q̈_null_ref‖²."""
    n, m = state.B.shape
    u, qdd = cp.Variable(m), cp.Variable(n)
    N = np.eye(n) - np.linalg.pinv(state.J, rcond=RANK_TOLERANCE) @ state.J
    null_ref = -gains.null_damping * N @ state.v
    mu = state.J @ qdd + state.Jdot @ state.v - reference.yddot
    cost = gains.w2 * squares(qdd) + gains.w3 * squares(u)
    return u, qdd, mu, cost + gains.w4 * squares(N @ qdd - null_ref)


PROGRAMMES: dict[str, Callable[[State, Reference | SetPoint, Gains, Squares], Programme]] = {
    "soft-id-clf-qp": soft_inverse_dynamics,
    "id-clf-qp": inverse_dynamics,
    "ic-qp": soft_inverse_dynamics,
    "clf-qp": linearisation,
}
