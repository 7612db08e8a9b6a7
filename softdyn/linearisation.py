"""Tangent stiffness and damping of the whole robot at a state that need not be an equilibrium."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from softdyn.derivatives import joint_force_derivatives
from softdyn.model import SoftModel


def tangent_dynamics(
    model: SoftModel, q: np.ndarray, v: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """∂(h - B u)/∂q and ∂h/∂q̇ (nv, nv): what M δq̈ + D_t δq̇ + K_t δq = B δu needs.

    RNEA's derivatives at q̈ = 0 (Pinocchio) less those of tendons, springs and dampers. The term
    (∂M/∂q) q̈ is left out on purpose: an acceleration that a stop will not allow, or that lasts a
    millisecond, must not pass for a stiffness over a horizon.

    Parameters
    ----------
    q : (nq,) configuration.
    v : (nv,) velocity.
    u : (nu,) input.

    Raises
    ------
    InputError
        Wrong shape or a number that is not finite.
    """
    forces = joint_force_derivatives(model, q, v, u)
    by_q, by_v, _ = pin.computeRNEADerivatives(
        model.pin_model, model._data, np.asarray(q), np.asarray(v), np.zeros(model.nv)
    )
    size = (model.nv, model.nv)
    return np.reshape(by_q, size) - forces.q, np.reshape(by_v, size) - forces.v
