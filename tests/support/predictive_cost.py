"""The predictive controller's cost by its definition, simulated in state space."""

from __future__ import annotations

import numpy as np

from softdyn import Reference, SoftModel, State
from softdyn.controllers.mpc import MpcParameters
from softdyn.controllers.predictive import stops
from softdyn.controllers.predictive.objective import SIZE
from softdyn.dynamics.derivatives import tangent_dynamics

KNOTS = (1, 3, 6, 12, 30)  # weights of docs/beyond.md, "Predictive control"


def linear(state: State, u: np.ndarray, held: np.ndarray, stop: float) -> tuple:
    """K_t and D_t of the prediction, with a spring of stop · M_jj at each held joint."""
    K, D = tangent_dynamics(state.model, state.q, state.v, u)
    K = K.copy()
    for j in np.flatnonzero(held):
        K[j, j] += stop * state.M[j, j]
    return K, D


def euler(state: State, u: np.ndarray, force: np.ndarray, held: np.ndarray, period: float):
    """q̇ after a period by backward Euler under u and a joint force, by fixed-point equations."""
    K, D = linear(state, u, held, stops.STIFFNESS / (MpcParameters().horizon / KNOTS[-1]) ** 2)
    n = len(state.v)
    # unknowns (p, q̇): p = T q̇,  M (q̇ - q̇₀) = T (f - K p - D (q̇ - q̇₀))
    rows = np.block([[np.eye(n), -period * np.eye(n)], [period * K, state.M + period * D]])
    f = state.B @ u - state.h + force
    right = np.concatenate((np.zeros(n), (state.M + period * D) @ state.v + period * f))
    return np.linalg.solve(rows, right)[n:]


def cost(
    model: SoftModel, state: State, goal: Reference, u0: np.ndarray, held: np.ndarray,
    unmodelled: np.ndarray, knots: np.ndarray,
) -> float:  # fmt: skip
    """The cost of the inputs (knots, m) at the knots, by simulating the horizon.

    It counts the tip along the tangent, and joint speeds and inputs in the metric of the robot at
    rest. Each step uses the two-stage method of Alexander (1977) in state space.
    """
    p = MpcParameters()
    H, n, steps = p.horizon, model.nv, KNOTS[-1]
    dt = H / steps
    W, R = metric(model)
    K, D = linear(state, u0, held, stops.STIFFNESS / dt**2)
    f = state.B @ u0 - state.h + unmodelled + D @ state.v
    z, total, before = np.concatenate((np.zeros(n), state.v)), 0.0, 0
    inputs = np.vstack((u0, knots))
    for index, end in enumerate(KNOTS):
        span, start, stop = end - before, inputs[index], inputs[index + 1]
        for k in range(span):
            u = start + (k + 0.5) / span * (stop - start)
            z = alexander(state.M, K, D, f + state.B @ (u - u0), z, dt)
            t = (before + k + 1) * dt
            wanted = goal.y + goal.ydot * t + goal.yddot * t**2 / 2
            error = state.y + state.J @ z[:n] - wanted
            rush = z[n:] - pace(W, state.J, goal.ydot + goal.yddot * t)
            total += error @ error + p.speed**2 * rush @ W @ rush
        rate = stop - start
        total += p.rate * (rate @ R @ rate) / span + p.rate * SIZE * span * (stop @ R @ stop)
        before = end
    return float(total)


def alexander(
    M: np.ndarray, K: np.ndarray, D: np.ndarray, f: np.ndarray, z: np.ndarray, dt: float
) -> np.ndarray:
    """(p, q̇) after a step of Alexander's method for M q̈ = f - D q̇ - K p, in state space."""
    n, gamma, Mi = len(M), 1 - 1 / np.sqrt(2), np.linalg.inv(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-Mi @ K, -Mi @ D]])
    implicit, b = np.eye(2 * n) - gamma * dt * A, np.concatenate((np.zeros(n), Mi @ f))
    k1 = np.linalg.solve(implicit, A @ z + b)
    k2 = np.linalg.solve(implicit, A @ (z + dt * (1 - gamma) * k1) + b)
    result: np.ndarray = z + dt * ((1 - gamma) * k1 + gamma * k2)
    return result


def metric(model: SoftModel) -> tuple[np.ndarray, np.ndarray]:
    """W (n, n) of joint speeds and R (m, m) of inputs, from the robot at rest."""
    rest, H = model.state(model.q0, np.zeros(model.nv)), MpcParameters().horizon
    S = rest.M / H**2 + rest.D / H + np.diag(model.stiffness)
    mobility = np.linalg.norm(rest.J @ np.linalg.inv(S) @ rest.J.T, 2)
    return H**2 * mobility * S, mobility * rest.B.T @ np.linalg.inv(S) @ rest.B


def size(model: SoftModel, u: np.ndarray) -> float:
    """The cost of the inputs' size for a constant u, which V does not contain."""
    return float(MpcParameters().rate * SIZE * KNOTS[-1] * (u @ metric(model)[1] @ u))


def pace(W: np.ndarray, J: np.ndarray, ydot: np.ndarray) -> np.ndarray:
    """Joint speeds (n,) of least metric W that move the tip at ẏ: of the minimum's conditions."""
    n, r = len(W), len(J)
    conditions = np.block([[W, J.T], [J, np.zeros((r, r))]])
    right = np.concatenate((np.zeros(n), ydot))
    return np.linalg.lstsq(conditions / np.abs(W).max(), right / np.abs(W).max(), rcond=1e-9)[0][:n]
