"""The Lyapunov function: against its closed form, its Riccati equation, and its own derivative."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from softdyn.controllers.qps.clf import F, G, make_clf

EPSILONS = (0.001, 0.01, 0.03, 0.05, 1.0, 7.0)
every_epsilon = pytest.mark.parametrize("eps", EPSILONS)


def shrink(eps: float) -> np.ndarray:
    return np.diag([1 / eps] * 3 + [1.0] * 3)


@every_epsilon
def test_closed_form_for_unit_weights(eps: float) -> None:
    # P = [[√3 I, I], [I, √3 I]] solves 1 = p₁₂², 2 p₁₂ + 1 = p₂₂², p₁₁ = p₁₂ p₂₂
    P = np.kron([[np.sqrt(3), 1.0], [1.0, np.sqrt(3)]], np.eye(3))
    expected = shrink(eps) @ P @ shrink(eps)
    np.testing.assert_allclose(make_clf(eps).P_eps, expected, rtol=1e-12, atol=1e-12 / eps)


def random_weights(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(6, 6)), rng.normal(size=(3, 3))
    return A @ A.T + 0.1 * np.eye(6), B @ B.T + 0.1 * np.eye(3)


@pytest.mark.parametrize("seed", range(5))
def test_riccati_equation(seed: int) -> None:
    Q, R = random_weights(seed)
    P = make_clf(1.0, Q, R).P_eps
    residual = F.T @ P + P @ F - P @ G @ np.linalg.solve(R, G.T @ P) + Q
    assert np.abs(residual).max() < 1e-9 * np.abs(P).max() ** 2
    assert np.linalg.eigvalsh(P)[0] > 0
    np.testing.assert_allclose(P, P.T, rtol=0, atol=1e-12 * np.abs(P).max())


@every_epsilon
def test_decrease_row_is_the_derivative_along_trajectories(eps: float) -> None:
    clf, rng, step = make_clf(eps), np.random.default_rng(1), 1e-5 * eps
    for _ in range(20):
        # e ~ ε ė, so that no part of V dominates
        eta, mu = shrink(1 / eps) @ rng.normal(size=6), rng.normal(size=3) / eps

        def V(t: float, eta: np.ndarray = eta, mu: np.ndarray = mu) -> float:
            e, edot = eta[:3], eta[3:]  # η̇ = F η + G μ under constant μ, solved exactly
            moved = np.concatenate((e + t * edot + t * t / 2 * mu, edot + t * mu))
            return moved @ clf.P_eps @ moved

        value, row, bound = clf.decrease(eta)
        assert value == pytest.approx(V(0.0), rel=1e-12)
        derivative = (V(step) - V(-step)) / (2 * step)
        # the condition V̇ ≤ -V/ε reads row·μ ≤ bound
        excess = derivative + value / eps
        size = abs(derivative) + value / eps + abs(bound)
        assert row @ mu - bound == pytest.approx(excess, abs=1e-8 * size)


@every_epsilon
def test_the_condition_can_always_be_met(eps: float) -> None:
    # RES-CLF: μ = -(Gᵀ P G-feedback of the Riccati equation at rate 1/ε) keeps row·μ ≤ bound
    clf, rng = make_clf(eps), np.random.default_rng(2)
    for _ in range(50):
        eta = shrink(1 / eps) @ rng.normal(size=6)
        _, row, bound = clf.decrease(eta)
        mu = -G.T @ clf.P_eps @ eta / eps
        assert row @ mu <= bound + 1e-9 * abs(bound)


@every_epsilon
def test_rapid_exponential_bound(eps: float) -> None:
    # with the least μ that meets V̇ ≤ -V/ε: V(t) ≤ e^(-t/ε) V(0) and, for ε < 1,
    # ‖η(t)‖ ≤ √(λmax(P)/λmin(P)) / ε · e^(-t/2ε) ‖η(0)‖ (Ames et al. 2014, definition 3)
    clf = make_clf(eps)

    def least(eta: np.ndarray) -> np.ndarray:
        _, row, bound = clf.decrease(eta)
        square = row @ row
        return min(0.0, bound) / square * row if square > 0 else np.zeros(3)

    P = make_clf(1.0).P_eps
    ratio = np.sqrt(np.linalg.eigvalsh(P)[-1] / np.linalg.eigvalsh(P)[0])
    for seed in range(3):
        eta = shrink(1 / eps) @ np.random.default_rng(seed).normal(size=6)
        times = np.linspace(0, 6 * eps, 25)
        path = solve_ivp(
            lambda t, eta: F @ eta + G @ least(eta), (0, times[-1]), eta,
            t_eval=times, rtol=1e-9, atol=1e-12 * np.abs(eta).max(), max_step=eps / 20,
        )  # fmt: skip
        assert path.success
        for t, now in zip(times, path.y.T, strict=True):
            assert clf.decrease(now)[0] <= np.exp(-t / eps) * clf.decrease(eta)[0] * (1 + 1e-6)
            bound = ratio * max(1 / eps, 1.0) * max(eps, 1.0) * np.exp(-t / (2 * eps))
            assert np.linalg.norm(now) <= bound * np.linalg.norm(eta) * (1 + 1e-6)


def test_the_riccati_feedback_decays_as_it_should() -> None:
    # independent of `decrease`: closed loop μ = -(1/ε) Gᵀ P_ε η by the matrix exponential
    eps = 0.05
    clf = make_clf(eps)
    closed = F - G @ G.T @ clf.P_eps / eps
    eta = np.array([1.0, -2.0, 0.5, 3.0, 0.0, -1.0])
    for t in np.linspace(0, 10 * eps, 11):
        now = expm(closed * t) @ eta
        assert clf.decrease(now)[0] <= np.exp(-t / eps) * clf.decrease(eta)[0] * (1 + 1e-9)


def test_at_the_goal_there_is_nothing_to_ask() -> None:
    V, row, bound = make_clf(0.05).decrease(np.zeros(6))
    assert V == 0
    assert bound == 0
    np.testing.assert_array_equal(row, np.zeros(3))


@pytest.mark.parametrize(("share", "rate"), [(0.1, 0.92), (0.15, 0.88), (0.2, 0.83), (0.5, 0.46)])
def test_what_a_hold_costs(share, rate):
    """The worst decay over all η, if the least μ for the condition is held for `share` of ε."""
    clf, rng, worst = make_clf(0.05), np.random.default_rng(1), np.inf
    for angle in np.linspace(0, np.pi, 721):
        along = rng.normal(size=3)
        along /= np.linalg.norm(along)
        e, edot = np.cos(angle) * clf.eps * along, np.sin(angle) * along
        V, a, b = clf.decrease(np.concatenate((e, edot)))
        mu, T = min(b, 0.0) * a / (a @ a), share * clf.eps
        after = np.concatenate((e + T * edot + T * T / 2 * mu, edot + T * mu))
        worst = min(worst, np.log(V / clf.decrease(after)[0]) / share)
    assert worst == pytest.approx(rate, abs=0.006)
