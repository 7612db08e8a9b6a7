"""The paper's Soft ID-CLF-QP as it is printed, and two exact solvers for it: the oracle.

Variables x = (q̈, u, δ), nothing condensed; every formula straight from the paper, section "Soft
ID-CLF-QP Controller". From `controllers` it takes nothing but the numbers in a `Gains`.
"""

from __future__ import annotations

from dataclasses import dataclass

import daqp
import numpy as np
import quadprog
import scipy.linalg

from softdyn import Reference, State
from softdyn.controllers import Gains

RANK_TOLERANCE = 1e-6  # the one stated threshold: singular values below this share count as zero
SQRT3 = np.sqrt(3.0)


@dataclass(frozen=True)
class Programme:
    """min ½ xᵀHx + gᵀx + constant s.t. E x = e, A x ≤ b."""

    H: np.ndarray
    g: np.ndarray
    constant: float
    E: np.ndarray
    e: np.ndarray
    A: np.ndarray
    b: np.ndarray

    def objective(self, x: np.ndarray) -> float:
        """The paper's cost at x, constant terms included."""
        return float(x @ self.H @ x / 2 + self.g @ x + self.constant)


def actuated_rows(state: State, tolerance: float = RANK_TOLERANCE) -> tuple[np.ndarray, np.ndarray]:
    """R (r, n) and S (r, m): the actuated dynamics are R (M q̈ + h) = S u.

    Where B has full column rank, T = [Bᵀ; null(Bᵀ)] is formed and R is the first m rows of T⁻ᵀ,
    S = I: the paper's collocated form. Elsewhere there is no such T; what can be asked of the
    dynamics is their part along range(B), of which R is an orthonormal basis, and S = R B.
    """
    B = state.B
    n, m = B.shape
    basis = scipy.linalg.orth(B, rcond=tolerance)
    if basis.shape[1] < m:
        return basis.T, basis.T @ B
    T = np.vstack((B.T, scipy.linalg.null_space(B.T, rcond=tolerance).T))
    assert T.shape == (n, n)
    return np.linalg.inv(T).T[:m], np.eye(m)


def textbook(
    state: State,
    reference: Reference,
    gains: Gains,
    *,
    margin: float = 0.0,
    tolerance: float = RANK_TOLERANCE,
    decrease: bool = True,
    hard: bool = False,
    u_ref: float = 0.0,
) -> Programme:
    """The programme at a state; the null-space projector's J⁺ uses the stated threshold.

    `margin` draws the input bounds in by this share of their range. Without `decrease` it is the
    paper's IC-QP; `hard` asks all of the dynamics, M q̈ + h = B u, as the ID-CLF-QP does; `u_ref` is
    the input that costs nothing, 0 in the paper.
    """
    J, v = state.J, state.v
    n, m = state.B.shape
    size = n + m + 1
    q̈, u, δ = np.eye(size)[:n], np.eye(size)[n : n + m], np.eye(size)[-1:]

    e, ė = state.y - reference.y, state.ydot - reference.ydot
    drift = state.Jdot @ v - reference.yddot  # μ = J q̈ + drift
    mu_ref = -2 * np.sqrt(gains.Kp) * ė - gains.Kp * e
    N = np.eye(n) - np.linalg.pinv(J, rcond=tolerance) @ J
    null_ref = -gains.null_damping * N @ v

    # w1‖μ - μ_ref‖² + w2‖q̈‖² + w3‖u‖² + w4‖N q̈ - q̈_null_ref‖² + ρ δ²
    H, g, constant = np.zeros((size, size)), np.zeros(size), 0.0
    for weight, rows, target in (
        (gains.w1, J @ q̈, mu_ref - drift),
        (gains.w2, q̈, np.zeros(n)),
        (gains.w3, u, np.full(m, u_ref)),
        (gains.w4, N @ q̈, null_ref),
        (gains.rho, δ, np.zeros(1)),
    ):
        H += 2 * weight * rows.T @ rows
        g -= 2 * weight * rows.T @ target
        constant += weight * target @ target

    # V̇ ≤ -V/ε + δ with η̇ = F η + G μ and, for Q = R = I, P = [[√3 I, I], [I, √3 I]]
    I3, O3, ε = np.eye(3), np.zeros((3, 3)), gains.eps
    P = np.block([[SQRT3 * I3, I3], [I3, SQRT3 * I3]])
    shrink = np.block([[I3 / ε, O3], [O3, I3]])
    P_eps = shrink @ P @ shrink
    F, G = np.block([[O3, I3], [O3, O3]]), np.vstack((O3, I3))
    η = np.concatenate((e, ė))
    V = η @ P_eps @ η
    slope = 2 * η @ P_eps @ G  # V̇ = ηᵀ(FᵀP + PF)η + slope μ
    condition = slope @ J @ q̈ - δ[0] if decrease else np.zeros(size)
    limit = -V / ε - η @ (F.T @ P_eps + P_eps @ F) @ η - slope @ drift
    limit = limit if decrease else 0.0

    R, S = (np.eye(n), state.B) if hard else actuated_rows(state, tolerance)
    A = np.vstack((condition, u, -u, -δ))
    u_min, u_max = state.model.u_min, state.model.u_max
    inward = margin * (u_max - u_min)
    b = np.concatenate(([limit], u_max - inward, -(u_min + inward), [0.0]))
    return Programme(H, g, float(constant), R @ state.M @ q̈ - S @ u, -R @ state.h, A, b)


def with_input(programme: Programme, u: np.ndarray) -> Programme:
    """The same programme with its inputs pinned to `u` (m,), within their bounds or not."""
    m = len(u)
    n = len(programme.g) - m - 1
    pin = np.eye(n + m + 1)[n : n + m]
    keep = [0, -1]  # decrease and δ ≥ 0
    return Programme(
        programme.H,
        programme.g,
        programme.constant,
        np.vstack((programme.E, pin)),
        np.concatenate((programme.e, u)),
        programme.A[keep],
        programme.b[keep],
    )


@dataclass(frozen=True)
class Exact:
    """An answer to a programme: x, and the largest residual of its optimality conditions."""

    x: np.ndarray
    residual: float


def _scaled(p: Programme) -> tuple[Programme, np.ndarray, float]:
    """Unit Hessian diagonal, unit rows, answers of order one; x = scale · size · scaled x."""
    diagonal = np.diag(p.H)
    scale = 1 / np.sqrt(np.where(diagonal > 1e-12 * diagonal.max(), diagonal, 1.0))
    E, A = p.E * scale, p.A * scale
    rows_E, rows_A = np.linalg.norm(E, axis=1), np.linalg.norm(A, axis=1)
    rows_E[rows_E == 0] = rows_A[rows_A == 0] = 1.0
    e, b, g = p.e / rows_E, p.b / rows_A, p.g * scale
    size = max(1.0, np.abs(e).max(initial=0), np.abs(b).max(initial=0), np.abs(g).max())
    H = p.H * np.outer(scale, scale)
    return (
        Programme(H, g / size, 0.0, E / rows_E[:, None], e / size, A / rows_A[:, None], b / size),
        scale,
        size,
    )


def kkt_residual(p: Programme, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> float:
    """Largest violation of stationarity, feasibility, sign and complementarity at (x; y, z).

    For scaled programmes (entries of order one): absolute, but for multipliers larger than one.
    """
    size = max(1.0, np.abs(y).max(initial=0), np.abs(z).max(initial=0))
    slack = p.b - p.A @ x
    return float(
        max(
            np.abs(p.H @ x + p.g + p.E.T @ y + p.A.T @ z).max() / size,
            np.abs(p.E @ x - p.e).max(initial=0),
            (-slack).max(initial=0),
            (-z).max(initial=0),
            np.abs(np.minimum(slack, z)).max(initial=0),
        )
    )


def solve_quadprog(programme: Programme, ridge: float = 0.0, steps: int = 60) -> Exact:
    """Goldfarb and Idnani's dual active-set method.

    It needs a positive definite Hessian. A semidefinite one takes the proximal-point iteration
    x ← argmin f + ½ ridge ‖x - x_previous‖², whose fixed points are the minimisers of f itself;
    the residual is that of f, whatever the ridge.
    """
    p, scale, size = _scaled(programme)
    rows, limits = np.vstack((-p.E, -p.A)).T, np.concatenate((-p.e, -p.b))
    H, x = p.H + ridge * np.eye(len(p.g)), np.zeros(len(p.g))
    best = Exact(x, np.inf)
    for _ in range(steps if ridge else 1):
        x, _, _, _, multipliers, _ = quadprog.solve_qp(H, ridge * x - p.g, rows, limits, len(p.e))
        z = multipliers[len(p.e) :]
        # quadprog reports |y| of an equality; stationarity gives its sign back
        y = np.linalg.lstsq(p.E.T, -(p.H @ x + p.g + p.A.T @ z))[0] if len(p.e) else np.zeros(0)
        residual = kkt_residual(p, x, y, z)
        if residual < best.residual:
            best = Exact(x * scale * size, residual)
        if residual < 1e-12:
            break
    return best


def solve_daqp(programme: Programme) -> Exact:
    """Arnström's dual active-set method."""
    p, scale, size = _scaled(programme)
    rows = np.ascontiguousarray(np.vstack((p.E, p.A)))
    upper = np.concatenate((p.e, p.b))
    lower = np.concatenate((p.e, np.full(len(p.b), -1e30)))
    sense = np.concatenate((np.full(len(p.e), 5), np.zeros(len(p.b)))).astype(np.int32)
    x, _, flag, info = daqp.solve(
        np.ascontiguousarray(p.H), p.g.copy(), rows, upper, lower, sense,
        primal_tol=1e-12, dual_tol=1e-12, iter_limit=10_000,
    )  # fmt: skip
    if flag < 1:
        raise ArithmeticError(f"DAQP: exit flag {flag}")
    lam = np.asarray(info["lam"])
    x, y, z = np.asarray(x), lam[: len(p.e)], lam[len(p.e) :]
    return Exact(x * scale * size, kkt_residual(p, x, y, z))
