"""Derivatives of accelerations and of the balance of forces, with gravity's and tendons' parts.

`softdyn.dynamics.balance.ForceBalance` has the whole. Derivatives by q are along the velocity
coordinates, q ⊕ dv. A continuous joint then has one column, and every Jacobian has nv columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from softdyn.checks import array, vector
from softdyn.dynamics.balance import ForceBalance
from softdyn.dynamics.model import SoftModel, State, check_model
from softdyn.dynamics.projection import Projection, project, underlying_tree
from softdyn.dynamics.tree import tree_of

if TYPE_CHECKING:
    import softdyn


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
        ∂/∂u.
    parameters : ndarray, (k, P)
        ∂/∂θ, θ the P parameters that were given.
    """

    value: np.ndarray
    q: np.ndarray
    v: np.ndarray
    u: np.ndarray
    parameters: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))


def acceleration_derivatives(
    model: SoftModel,
    q: np.ndarray,
    v: np.ndarray,
    u: np.ndarray,
    parameters: Sequence[softdyn.identification.Parameter] = (),
) -> Derivatives:
    """q̈ (rad/s², m/s²) of `SoftModel.forward_dynamics` and its Jacobians.

    The balance r(q, q̇, q̈; u, θ) = 0 determines q̈; hence ∂q̈/∂x = -M⁻¹ ∂r/∂x for x = q, q̇, u, θ.

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
    parameters : sequence of softdyn.identification.Parameter
        Parameters of this model, as `softdyn.identification.parameters` or a design's file gives
        them: stiffness, damping, mass, bending stiffness and others. The derivatives are those of
        the identification.

    Raises
    ------
    InputError
        For a wrong shape or a number that is not finite; for parameters of friction, which is not
        part of `forward_dynamics`, and for parameters of a reduced model or of one with mimic
        joints.
    """
    qdd = check_model(model).forward_dynamics(q, v, u)
    terms, n, m = ForceBalance(model, motors=())(q, v, qdd, u), model.nv, model.nu
    by_theta = parameter_columns(parameters, model, q, v, qdd, u)
    sides = terms.by_q, terms.by_v, terms.by_commands, by_theta
    blocks = np.linalg.solve(terms.by_a, -np.hstack(sides))
    return Derivatives(qdd, *np.split(blocks, [n, 2 * n, 2 * n + m], axis=1))


def parameter_columns(
    parameters: Sequence[softdyn.identification.Parameter],
    model: SoftModel,
    q: np.ndarray,
    v: np.ndarray,
    a: np.ndarray,
    u: np.ndarray,
) -> np.ndarray:
    """∂r/∂θ (n, p) of the balance r = M a + h - B u, as in `acceleration_derivatives`."""
    if not len(parameters):
        return np.zeros((model.nv, 0))
    import softdyn  # its public names; the dynamics stand below the identification

    columns: np.ndarray = softdyn.identification.motion_columns(parameters, model.state(q, v), a, u)
    return columns


def tangent_dynamics(
    model: SoftModel, q: np.ndarray, v: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """K_t = ∂(h - B u)/∂q and D_t = ∂h/∂q̇ (nv, nv) of M δq̈ + D_t δq̇ + K_t δq = B δu.

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
    still = np.zeros(check_model(model).nv)
    terms = ForceBalance(model, motors=())(q, v, still, vector("u", u, model.nu))
    return terms.by_q, terms.by_v


def total_damping(state: State) -> np.ndarray:
    """∂(D q̇ - F)/∂q̇ (nv, nv): the damping of dampers and of forces of one's own.

    It is D without such forces, where the dampers are linear.
    """
    model, D = state.model, state.D
    if model.curved:
        tree, S = underlying_tree(model)
        q = model.expand(state.q) if isinstance(model, Projection) else state.q
        v, cables = state.v if S is None else S @ state.v, tree.tendon_geometry(q)
        at = tree.coordinates(q), cables.lengths, cables.moment_arms, v
        D = project(S, tree.passive_forces(*at).by_v)
    return D if not model.forced else D - model.force_derivatives(state.q, state.v)[1]


def mass_columns(model: SoftModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Joint forces (nv, bodies) that each moving body's inertia needs for the motion (q, v, a).

    A column is Pinocchio's regressor times the body's ten parameters. The sum over the bodies is
    M a + C v + g without armature. Bodies are in the order of
    `softdyn.dynamics.tree.TreeModel.engine`.

    Parameters
    ----------
    model : SoftModel
        A model without mimic joints.
    q, v, a : array_like, (nq,), (nv,), (nv,)
        Configuration, velocity, acceleration.
    """
    tree = tree_of(model)
    inertias = [body.toDynamicParameters() for body in tree.engine.inertias[1:]]
    q, v, a = tree.about_base(np.asarray(q, float)), np.asarray(v, float), np.asarray(a, float)
    regressor = pin.computeJointTorqueRegressor(tree.engine, tree.pin_data, q, v, a)
    return np.einsum("nbp,bp->nb", regressor.reshape(model.nv, -1, 10), np.array(inertias))


def stiffness(model: SoftModel, q: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Tangent stiffness (nv, nv) ∂(K + g - F - B u)/∂q, the Hessian of the potential.

    The potential is U(q) + U_s(q) - Σ u V(q), V = gear ℓ, and that of one's own forces. An
    equilibrium with a positive definite stiffness is stable. With a force that has no potential the
    stiffness need not be symmetric.

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
    return tangent_dynamics(model, q, np.zeros(check_model(model).nv), u)[0]


def gravity_stiffness(model: SoftModel, q: np.ndarray) -> np.ndarray:
    """∂g/∂q (nv, nv), the Hessian of gravity's energy."""
    q = array("q", q, (check_model(model).nq,))
    tree, S = underlying_tree(model)
    here = tree.about_base(model.expand(q) if isinstance(model, Projection) else q)
    hessian = pin.computeGeneralizedGravityDerivatives(tree.engine, tree.pin_data, here)
    return project(S, np.reshape(np.array(hessian), (tree.nv, tree.nv)))


def tendon_forces(model: SoftModel, u: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Force (tendons,) Σ gear u of the actuators along each tendon: B u = Σ aₜᵀ f_t.

    Parameters
    ----------
    model : SoftModel
        The robot's model.
    u : ndarray, (m,)
        Input.
    lengths : ndarray, (tendons,)
        Tendon lengths, on which the area of a chamber may depend.
    """
    tree, _ = underlying_tree(model)
    forces = np.bincount(tree.actuated, tree.gears_at(lengths) * u, len(model.tendons.names))
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
    tree, S = underlying_tree(model)
    if isinstance(model, Projection):
        q, v = model.expand(q), model.S @ v
    bend, rates = tree.tendon_geometry(q).curvature(force, v)
    return project(S, bend), rates if S is None else rates @ S
