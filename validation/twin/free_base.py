"""A model with a floating base in MuJoCo's variables, so that both engines integrate alike.

MuJoCo integrates the velocity of the base's origin in the world's axes and moves that origin along
a straight line while the base turns. Pinocchio's `integrate` follows the screw of a constant twist.
The two differ only beyond the order of a scheme. With R the rotation of the base,

    w = (R v_linear, ω, q̇_joints),    ẇ = (R (v̇_linear + ω × v_linear), ω̇, q̈_joints).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from softdyn.dynamics.integrators import Step, step_implicit
from softdyn.dynamics.model import SoftModel


class FreeBase:
    """Forward dynamics and positions of a model in the velocities w of the module's docstring."""

    def __init__(self, model: SoftModel) -> None:
        self._model = model

    def velocity(self, q: np.ndarray, w: np.ndarray) -> np.ndarray:
        """The model's v (nv,) from w (nv,)."""
        return np.concatenate((_rotation(q).T @ w[:3], w[3:]))

    def from_velocity(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """w (nv,) from the model's v (nv,)."""
        return np.concatenate((_rotation(q) @ v[:3], v[3:]))

    def acceleration(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """ẇ (nv,) from the model's acceleration."""
        return np.concatenate((_rotation(q) @ (a[:3] + np.cross(v[3:6], v[:3])), a[3:]))

    def forward_dynamics(self, q: np.ndarray, w: np.ndarray, u: np.ndarray) -> np.ndarray:
        """ẇ (nv,) under the input u (nu,)."""
        v = self.velocity(q, w)
        return self.acceleration(q, v, self._model.forward_dynamics(q, v, u))

    def integrate(self, q: np.ndarray, dw: np.ndarray) -> np.ndarray:
        """The configuration (nq,) after the displacement dw (nv,)."""
        turned = self._model.integrate(q, np.concatenate((np.zeros(3), dw[3:])))
        turned[:3] += dw[:3]
        return turned


def rk4_on_rotations(
    q: np.ndarray,
    w: np.ndarray,
    h: float,
    slope: Callable[[np.ndarray, np.ndarray], np.ndarray],
    move: Callable[[np.ndarray, np.ndarray], np.ndarray],
    turning: slice,
) -> Step:
    """One step (q, w) of MuJoCo's Runge–Kutta of order 4, Munthe-Kaas on the rotations.

    Parameters
    ----------
    q, w : np.ndarray, (nq,), (nv,)
        Configuration and velocity.
    h : float
        The step (s).
    slope : Callable
        (q, w) → ẇ.
    move : Callable
        (q, displacement) → q.
    turning : slice
        Indices in w of the base's angular velocity in its own axes; empty for a fixed base.

    Returns
    -------
    Step
        (q, w) at the end of the step.
    """
    rates: list[np.ndarray] = []
    slopes: list[np.ndarray] = []
    for share in (0.0, 0.5, 0.5, 1.0):
        moved = h * share * rates[-1] if rates else np.zeros_like(w)
        speed = w + h * share * slopes[-1] if slopes else w
        slopes.append(slope(move(q, moved), speed))
        rates.append(speed.copy())
        if moved[turning].any():
            rates[-1][turning] = _rotation_vector_rate(moved[turning], speed[turning])
    weights = (1 / 6, 1 / 3, 1 / 3, 1 / 6)
    mean, gain = (np.tensordot(weights, stages, 1) for stages in (rates, slopes))
    return move(q, h * mean), w + h * gain


def _rotation_vector_rate(turned: np.ndarray, angular: np.ndarray) -> np.ndarray:
    """Rate of the rotation vector `turned` (3,) under an angular velocity (3,) in body axes.

    The inverse of the differential of exp: ω + θ × ω / 2 + c θ × (θ × ω),
    c = (1 - |θ|/2 cot |θ|/2) / |θ|².
    """
    angle = float(np.linalg.norm(turned))
    c = 1 / 12 + angle**2 / 720
    if angle > 1e-2:
        c = (1 - angle / 2 / np.tan(angle / 2)) / angle**2
    cross = np.cross(turned, angular)
    return angular + cross / 2 + c * np.cross(turned, cross)


def step_free_rk4(model: SoftModel, q: np.ndarray, v: np.ndarray, u: np.ndarray, h: float) -> Step:
    """MuJoCo's Runge–Kutta of order 4 under the held input u (nu,)."""
    free = FreeBase(model)
    q, w = rk4_on_rotations(
        q,
        free.from_velocity(q, v),
        h,
        lambda q, w: free.forward_dynamics(q, w, u),
        free.integrate,
        slice(3, 6),
    )
    return q, free.velocity(q, w)


def step_free_implicit(
    model: SoftModel, q: np.ndarray, v: np.ndarray, u: np.ndarray, h: float
) -> Step:
    """`step_implicit` in w. Only the update differs, because the base has no damping."""
    free = FreeBase(model)
    a = (step_implicit(model, q, v, u, h)[1] - v) / h
    w = free.from_velocity(q, v) + h * free.acceleration(q, v, a)
    q = free.integrate(q, h * w)
    return q, free.velocity(q, w)


def _rotation(q: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) of the quaternion (x, y, z, w) in q."""
    return Rotation.from_quat(q[3:7]).as_matrix()
