"""One step of time integration of the analytic model under a constant input."""

from __future__ import annotations

import numpy as np

from softdyn.checks import array, number
from softdyn.dynamics.model import SoftModel

Step = tuple[np.ndarray, np.ndarray]


def step_rk4(model: SoftModel, q: np.ndarray, v: np.ndarray, u: np.ndarray, h: float) -> Step:
    """Classical Runge–Kutta of order 4; stable for h λmax(M⁻¹D) below about 2.8.

    Parameters
    ----------
    model : SoftModel
        Any robot's model.
    q, v, u : array_like, (nq,), (nv,), (nu,)
        Configuration, velocity, input.
    h : float
        Step (s), may be negative.

    Raises
    ------
    InputError
        For an argument of the wrong shape or not finite, or if the state overflows within the step.
    """
    h = number("h", h)
    a1 = model.forward_dynamics(q, v, u)
    v2 = v + h / 2 * a1
    a2 = model.forward_dynamics(model.integrate(q, h / 2 * v), v2, u)
    v3 = v + h / 2 * a2
    a3 = model.forward_dynamics(model.integrate(q, h / 2 * v2), v3, u)
    v4 = v + h * a3
    a4 = model.forward_dynamics(model.integrate(q, h * v3), v4, u)
    return (
        model.integrate(q, h / 6 * (v + 2 * v2 + 2 * v3 + v4)),
        v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4),
    )


def step_implicit(model: SoftModel, q: np.ndarray, v: np.ndarray, u: np.ndarray, h: float) -> Step:
    """Semi-implicit Euler with implicit damping, (M + h D) a = B u - h(q, v); order 1.

    It is the scheme of MuJoCo's ``implicitfast``. It stays stable for any damping. This matters,
    because the damping is the stiff part of soft robots: λmax(M⁻¹D) is 1e4 and more. Where a damper
    is not linear, ∂(D q̇)/∂q̇ stands for D on the left side.

    Parameters
    ----------
    model : SoftModel
        Any robot's model.
    q, v, u : array_like, (nq,), (nv,), (nu,)
        Configuration, velocity, input.
    h : float
        Step (s), may be negative.

    Raises
    ------
    InputError
        For an argument of the wrong shape or not finite.
    """
    h, u = number("h", h), array("u", u, (model.nu,))
    state = model.state(q, v)
    D = model.tangent_damping(q, v) if model.curved else state.D
    v = state.v + h * np.linalg.solve(state.M + h * D, state.B @ u - state.h)
    return model.integrate(q, h * v), v
