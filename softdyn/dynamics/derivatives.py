"""Analytic derivatives of the dynamics: Pinocchio's for the tree, closed forms for the tendons.

Derivatives with respect to q are along the velocity coordinates, q ⊕ dv, so that a continuous
joint counts once and every Jacobian has nv columns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from softdyn.checks import array
from softdyn.compiled import compiled
from softdyn.dynamics.model import SoftModel
from softdyn.exceptions import InputError


@dataclass(frozen=True, eq=False)
class Derivatives:
    """A function's value and its Jacobians by configuration, velocity and input.

    Attributes
    ----------
    value : (nv,) the function itself.
    q, v : (nv, nv) ∂/∂q and ∂/∂q̇.
    u : (nv, nu) ∂/∂u.
    """

    value: np.ndarray
    q: np.ndarray
    v: np.ndarray
    u: np.ndarray


def acceleration_derivatives(
    model: SoftModel, q: np.ndarray, v: np.ndarray, u: np.ndarray
) -> Derivatives:
    """q̈ (rad/s², m/s²) of `SoftModel.forward_dynamics` and its Jacobians.

    With τ = B u - D q̇ - K, ABA's derivatives at constant τ (Pinocchio) and the chain rule:
    ∂q̈/∂q = ∂aba/∂q + M⁻¹ ∂τ/∂q, ∂q̈/∂q̇ = ∂aba/∂q̇ - M⁻¹ D, ∂q̈/∂u = M⁻¹ B.

    Parameters
    ----------
    q : (nq,) configuration.
    v : (nv,) velocity.
    u : (nu,) input.

    Raises
    ------
    InputError
        Wrong shape, a number that is not finite, or a robot with mimic joints.
    """
    tau = joint_force_derivatives(model, q, v, u)
    data = model._data
    blocks = pin.computeABADerivatives(
        model.pin_model, data, np.asarray(q, float), np.asarray(v, float), tau.value
    )
    by_q, by_v, inverse = (np.reshape(block, (model.nv, model.nv)) for block in blocks)
    return Derivatives(
        np.array(data.ddq), by_q + inverse @ tau.q, by_v + inverse @ tau.v, inverse @ tau.u
    )


def joint_force_derivatives(
    model: SoftModel, q: np.ndarray, v: np.ndarray, u: np.ndarray
) -> Derivatives:
    """τ = B(q) u - D(q) q̇ - K(q) (N m, N), what tendons, springs and dampers do, and its Jacobians.

    With a_t = ∂ℓ_t/∂q, H_t = ∂²ℓ_t/∂q² and the force f_t = Σ gear u - k (ℓ - ℓ₀) - d ℓ̇ along
    tendon t, its part of τ is aₜᵀ f_t; hence ∂τ/∂q = Σ f_t H_t - k aₜ aₜᵀ - d aₜ (H_t q̇)ᵀ.

    Parameters and errors: see `acceleration_derivatives`.
    """
    state = model.state(q, v)
    u = array("u", u, (model.nu,))
    force = pull(model, u)
    arms, gain, damping = state.moment_arms, model.tendon_stiffness, model.tendon_damping
    force -= gain * (state.lengths - model.tendon_rest)
    force -= damping * (arms @ state.v)
    curvature, arm_rates = tendon_curvature(model, state.q, force, state.v)
    by_q = curvature - np.diag(model.stiffness)
    by_q -= arms.T @ (gain[:, None] * arms + damping[:, None] * arm_rates)
    return Derivatives(state.B @ u - state.D @ state.v - state.K, by_q, -state.D, state.B)


def tangent_dynamics(
    model: SoftModel, q: np.ndarray, v: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """∂(h - B u)/∂q and ∂h/∂q̇ (nv, nv): what M δq̈ + D_t δq̇ + K_t δq = B δu needs.

    RNEA's derivatives at q̈ = 0 (Pinocchio) less those of tendons, springs and dampers. The term
    (∂M/∂q) q̈ is left out on purpose: an acceleration that a stop will not allow, or that lasts a
    millisecond, must not pass for a stiffness over a horizon.

    Parameters and errors: see `acceleration_derivatives`.
    """
    forces = joint_force_derivatives(model, q, v, u)
    by_q, by_v, _ = pin.computeRNEADerivatives(
        model.pin_model, model._data, np.asarray(q), np.asarray(v), np.zeros(model.nv)
    )
    size = (model.nv, model.nv)
    return np.reshape(by_q, size) - forces.q, np.reshape(by_v, size) - forces.v


def stiffness(model: SoftModel, q: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Tangent stiffness (nv, nv) ∂(K + g - B u)/∂q: symmetric, the Hessian of the potential.

    The potential is U(q) + U_s(q) - Σ gear u ℓ(q). Positive definite at an equilibrium: stable.

    Parameters
    ----------
    q : (nq,) configuration.
    u : (nu,) input.

    Raises
    ------
    InputError
        Wrong shape or a number that is not finite.
    """
    springs = joint_force_derivatives(model, q, np.zeros(model.nv), u).q
    return gravity_stiffness(model, q) - springs


def gravity_stiffness(model: SoftModel, q: np.ndarray) -> np.ndarray:
    """∂g/∂q (nv, nv), the Hessian of gravity's energy."""
    _check(model)
    hessian = pin.computeGeneralizedGravityDerivatives(model.pin_model, model._data, q)
    return np.reshape(np.array(hessian), (model.nv, model.nv))


def _check(model: SoftModel) -> None:
    if model.robot.followers:
        raise InputError("model", "a robot without mimic joints", model.name)


def pull(model: SoftModel, u: np.ndarray) -> np.ndarray:
    """Force (tendons,) Σ gear u of the actuators along each tendon: B u = Σ aₜᵀ f_t."""
    _check(model)
    forces = np.bincount(model._actuated, model._gear * u, len(model.tendons.names))
    return forces.astype(float)  # whole numbers where there is no actuator


def tendon_curvature(
    model: SoftModel, q: np.ndarray, force: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Σ f_t ∂²ℓ_t/∂q² (nv, nv), and the rates (tendons, nv) of the moment arms along q̇ = v.

    Parameters
    ----------
    q : (nq,) configuration.
    force : (tendons,) f, along each tendon.
    v : (nv,) velocity.
    """
    tendons = model.tendons
    if not tendons.spatial:
        return np.zeros((model.nv, model.nv)), np.zeros((len(force), model.nv))
    jacobian = np.ascontiguousarray(model._joint_jacobian(q))
    start, direction, norms = tendons.directions(*model._placements())
    pairs = tendons.incidence
    order = np.argsort(pairs.segment, kind="stable")
    first = np.searchsorted(pairs.segment[order], np.arange(len(norms) + 1))
    return _curvature(
        jacobian, start, direction, norms, tendons.segment_tendon,
        pairs.dof[order], pairs.sign[order], first, force, np.asarray(v, float),
    )  # fmt: skip


@compiled
def _curvature(jacobian, start, direction, norms, segment_tendon, dof, sign, first, force, v):
    """`Tendons.hessian`, contracted: only joints between the ends of a segment bend its tendon.

    `first[s]` … `first[s + 1]` are the pairs (dof, sign) of segment s, proximal joints first.
    With c_k the difference of the ends' Jacobian columns, of a segment of length s and direction
    d, the entry (j, k) is c_j (I - ddᵀ) c_k / s, and d · (ω_j × c_k) where j moves the same end
    as the more distal k.
    """
    nv = jacobian.shape[1]
    total, rates = np.zeros((nv, nv)), np.zeros((len(force), nv))
    columns, along = np.empty((len(dof), 3)), np.empty(len(dof))
    for s in range(len(norms)):
        t, d = segment_tendon[s], direction[s]
        length = max(norms[s], 2.2250738585072014e-308)  # a segment shrunk to a point
        for a in range(first[s], first[s + 1]):
            w = jacobian[3:, dof[a]]
            p = start[s] + (norms[s] * d if sign[a] > 0 else 0.0 * d)
            columns[a, 0] = sign[a] * (jacobian[0, dof[a]] + w[1] * p[2] - w[2] * p[1])
            columns[a, 1] = sign[a] * (jacobian[1, dof[a]] + w[2] * p[0] - w[0] * p[2])
            columns[a, 2] = sign[a] * (jacobian[2, dof[a]] + w[0] * p[1] - w[1] * p[0])
            along[a] = columns[a, 0] * d[0] + columns[a, 1] * d[1] + columns[a, 2] * d[2]
        for a in range(first[s], first[s + 1]):
            j, w = dof[a], jacobian[3:, dof[a]]
            for b in range(a, first[s + 1]):
                k, c = dof[b], columns[b]
                value = -along[a] * along[b]
                for x in range(3):
                    value += columns[a, x] * c[x]
                value /= length
                if sign[a] == sign[b]:
                    value += w[0] * (c[1] * d[2] - c[2] * d[1])
                    value += w[1] * (c[2] * d[0] - c[0] * d[2])
                    value += w[2] * (c[0] * d[1] - c[1] * d[0])
                total[j, k] += force[t] * value
                rates[t, j] += value * v[k]
                if j != k:
                    total[k, j] += force[t] * value
                    rates[t, k] += value * v[j]
    return total, rates
