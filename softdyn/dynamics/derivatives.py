"""Analytic derivatives of the dynamics: Pinocchio's for the tree, closed forms for the tendons.

Derivatives by q are along the velocity coordinates, q ⊕ dv. A continuous joint then has one column,
and every Jacobian has nv columns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from softdyn.checks import array
from softdyn.dynamics.model import SoftModel, check_model, taut_gains
from softdyn.dynamics.projection import Projection, project, underlying_tree
from softdyn.dynamics.tree import tree_of


@dataclass(frozen=True, eq=False)
class Derivatives:
    """A function's value and its Jacobians by configuration, velocity and input.

    Attributes
    ----------
    value : ndarray, (k,)
        The function's value; accelerations and joint forces have k = nv.
    q, v : ndarray, (k, nv)
        ∂/∂q and ∂/∂q̇.
    u : ndarray, (k, nu)
        ∂/∂u, or by the commands of motors.
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
    model : SoftModel
        The robot's model.
    q : array_like, (nq,)
        Configuration.
    v : array_like, (nv,)
        Velocity.
    u : array_like, (nu,)
        Input.

    Raises
    ------
    InputError
        For a wrong shape or a number that is not finite.
    """
    tau = joint_force_derivatives(model, q, v, u)
    if isinstance(model, Projection):
        return _constrained(model, q, v, u, tau)
    tree, n = underlying_tree(model)[0], model.nv
    q, v = tree.about_base(np.asarray(q, float)), np.asarray(v, float)
    blocks = pin.computeABADerivatives(tree.pin_model, tree.pin_data, q, v, tau.value)
    by_q, by_v, inverse = (np.reshape(block, (n, n)) for block in blocks)
    qdd = np.array(tree.pin_data.ddq)
    return Derivatives(qdd, by_q + inverse @ tau.q, by_v + inverse @ tau.v, inverse @ tau.u)


def joint_force_derivatives(
    model: SoftModel, q: np.ndarray, v: np.ndarray, u: np.ndarray
) -> Derivatives:
    """τ = B u - D q̇ - K (N m, N), the force of tendons, springs and dampers, and its Jacobians.

    With a_t = ∂ℓ_t/∂q, H_t = ∂²ℓ_t/∂q² and the force f_t = Σ gear u - k (ℓ - ℓ₀) - d ℓ̇ along
    tendon t, its part of τ is aₜᵀ f_t; hence ∂τ/∂q = Σ f_t H_t - k aₜ aₜᵀ - d aₜ (H_t q̇)ᵀ.
    k = d = 0 for a slack tendon without tension.

    Parameters
    ----------
    model : SoftModel
        The robot's model.
    q : array_like, (nq,)
        Configuration.
    v : array_like, (nv,)
        Velocity.
    u : array_like, (nu,)
        Input.

    Raises
    ------
    InputError
        For a wrong shape or a number that is not finite.
    """
    state = model.state(q, v)
    u = array("u", u, (model.nu,))
    force = tendon_forces(model, u)
    arms, rates = state.moment_arms, state.moment_arms @ state.v
    gain, damping = taut_gains(model, state.lengths, rates)
    force -= gain * (state.lengths - model.tendon_rest)
    force -= damping * rates
    curvature, arm_rates = tendon_curvature(model, state.q, force, state.v)
    tree, S = underlying_tree(model)
    by_q = curvature - project(S, np.diag(tree.stiffness))
    by_q -= arms.T @ (gain[:, None] * arms + damping[:, None] * arm_rates)
    return Derivatives(state.B @ u - state.D @ state.v - state.K, by_q, -state.D, state.B)


def tangent_dynamics(
    model: SoftModel, q: np.ndarray, v: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """K_t = ∂(h - B u)/∂q and D_t = ∂h/∂q̇ (nv, nv) of M δq̈ + D_t δq̇ + K_t δq = B δu.

    They are RNEA's derivatives at q̈ = 0 (Pinocchio) minus those of tendons, springs and dampers.
    The term (∂M/∂q) q̈ is left out on purpose. It would act as a stiffness over the whole horizon,
    but q̈ may last a millisecond only, or a stop may prevent it.

    Parameters
    ----------
    model : SoftModel
        The robot's model.
    q : array_like, (nq,)
        Configuration.
    v : array_like, (nv,)
        Velocity.
    u : array_like, (nu,)
        Input.

    Raises
    ------
    InputError
        For a wrong shape or a number that is not finite.
    """
    return residual_derivatives(model, q, v, np.zeros(model.nv), u)


def residual_derivatives(
    model: SoftModel, q: np.ndarray, v: np.ndarray, a: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """∂r/∂q and ∂r/∂q̇ (nv, nv) of r = M a + h - B u; ∂r/∂a is M.

    They are RNEA's derivatives (Pinocchio) minus those of tendons, springs and dampers.

    Parameters
    ----------
    model : SoftModel
        A model without mimic joints.
    q, v, a, u : array_like, (nq,), (nv,), (nv,), (nu,)
        Configuration, velocity, acceleration, input.

    Raises
    ------
    InputError
        For a wrong shape, a number that is not finite, or a robot with mimic joints.
    """
    forces = joint_force_derivatives(model, q, v, u)
    by_q, by_v = _inverse_dynamics(model, q, v, np.asarray(a, float))
    return by_q - forces.q, by_v - forces.v


def mass_columns(model: SoftModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Joint forces (nv, bodies) that each moving body's inertia needs for the motion (q, v, a).

    A column is Pinocchio's regressor times the body's ten parameters. The sum over the bodies is
    M a + C v + g without armature. Bodies are in the order of
    `softdyn.dynamics.tree.TreeModel.pin_model`.

    Parameters
    ----------
    model : SoftModel
        A model without mimic joints.
    q, v, a : array_like, (nq,), (nv,), (nv,)
        Configuration, velocity, acceleration.
    """
    tree = tree_of(model)
    inertias = [body.toDynamicParameters() for body in tree.pin_model.inertias[1:]]
    q, v, a = tree.about_base(np.asarray(q, float)), np.asarray(v, float), np.asarray(a, float)
    regressor = pin.computeJointTorqueRegressor(tree.pin_model, tree.pin_data, q, v, a)
    return np.einsum("nbp,bp->nb", regressor.reshape(model.nv, -1, 10), np.array(inertias))


def stiffness(model: SoftModel, q: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Tangent stiffness (nv, nv) ∂(K + g - B u)/∂q: symmetric, the Hessian of the potential.

    The potential is U(q) + U_s(q) - Σ gear u ℓ(q). An equilibrium with a positive definite
    stiffness is stable.

    Parameters
    ----------
    model : SoftModel
        The robot's model.
    q : array_like, (nq,)
        Configuration.
    u : array_like, (nu,)
        Input.

    Raises
    ------
    InputError
        For a wrong shape or a number that is not finite.
    """
    springs = joint_force_derivatives(model, q, np.zeros(check_model(model).nv), u).q
    return gravity_stiffness(model, q) - springs


def gravity_stiffness(model: SoftModel, q: np.ndarray) -> np.ndarray:
    """∂g/∂q (nv, nv), the Hessian of gravity's energy."""
    q = array("q", q, (check_model(model).nq,))
    tree, S = underlying_tree(model)
    here = tree.about_base(model.expand(q) if isinstance(model, Projection) else q)
    hessian = pin.computeGeneralizedGravityDerivatives(tree.pin_model, tree.pin_data, here)
    return project(S, np.reshape(np.array(hessian), (tree.nv, tree.nv)))


def tendon_forces(model: SoftModel, u: np.ndarray) -> np.ndarray:
    """Force (tendons,) Σ gear u of the actuators along each tendon: B u = Σ aₜᵀ f_t."""
    tree, _ = underlying_tree(model)
    forces = np.bincount(tree.actuated, tree.gear * u, len(model.tendons.names))
    return forces.astype(float)  # without actuators bincount returns integers


def tendon_curvature(
    model: SoftModel, q: np.ndarray, force: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Σ f_t ∂²ℓ_t/∂q² (nv, nv), and the rates (tendons, nv) of the moment arms along q̇ = v.

    Parameters
    ----------
    model : SoftModel
        The robot's model.
    q : array_like, (nq,)
        Configuration.
    force : ndarray, (tendons,)
        The force f along each tendon.
    v : array_like, (nv,)
        Velocity.
    """
    if not model.tendons.spatial:
        return np.zeros((model.nv, model.nv)), np.zeros((len(force), model.nv))
    if isinstance(model, Projection):
        tree, S = model.tree, model.S
        bend, rates = tendon_curvature(tree, model.expand(q), force, S @ v)
        return project(S, bend), rates @ S
    tree, _ = underlying_tree(model)
    jacobian = tree.joint_jacobian(q)
    return model.tendons.curvature(jacobian, *tree.placements(), force, v)


def _inverse_dynamics(
    model: SoftModel, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """∂/∂q and ∂/∂q̇ (nv, nv) of M a + C q̇ + g at a constant acceleration: RNEA's derivatives."""
    tree, S = underlying_tree(model)
    given: list[np.ndarray] = [np.asarray(x, float) for x in (q, v, a)]
    if isinstance(model, Projection):
        given = [model.expand(given[0]), model.S @ given[1], model.S @ given[2]]
    here = tree.about_base(given[0])
    by_q, by_v, _ = pin.computeRNEADerivatives(tree.pin_model, tree.pin_data, here, *given[1:])
    size = (tree.nv, tree.nv)
    return project(S, np.reshape(by_q, size)), project(S, np.reshape(by_v, size))


def _constrained(
    model: Projection, q: np.ndarray, v: np.ndarray, u: np.ndarray, tau: Derivatives
) -> Derivatives:
    """Derivatives of q̈ for a projected model: ∂q̈ = M⁻¹ (∂τ - ∂(M q̈ + C q̇ + g))."""
    qdd = model.forward_dynamics(q, v, u)
    by_q, by_v = _inverse_dynamics(model, q, v, qdd)
    inverse = np.linalg.inv(model.state(q, v).M)
    return Derivatives(qdd, inverse @ (tau.q - by_q), inverse @ (tau.v - by_v), inverse @ tau.u)
