"""The part of a reading that its Jacobian does not show, while the state is poorly known.

Along an axis s_i of the covariance of q, one deviation long, the reading's second difference is

    c_i = h(q ⊕ s_i) + h(q ⊖ s_i) - 2 h(q).

The second-order filter (Bar-Shalom, Li and Kirubarajan 2001, section 10.3) expects the reading
½ Σ c_i away from h(q), and adds ½ Σ c_ij² to its variance. The mixed terms are not computed: they
are taken to be as large as they can be, which gives ½ (Σ |c_i|)². Without this a first reading of
the tip leaves a filter that is sure of a wrong shape.
"""

from __future__ import annotations

import numpy as np

from softdyn.dynamics.model import SoftModel
from softdyn.estimation.readings import Reader
from softdyn.sensing import Measurement

SHARP = 30.0  # times its own variance; a reading that is known as well as this is as good as linear
SHARE = 1e-2  # of the largest variance of q; axes with less are left out


def second_order(
    read: Reader,
    state: tuple[SoftModel, np.ndarray, np.ndarray, np.ndarray],
    predicted: Measurement,
    P: np.ndarray,
    variance: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """The shift of the expected readings (k,), and their variances (k,) with the nonlinear part.

    Parameters
    ----------
    read : Reader
        It evaluates the readings.
    state : (SoftModel, ndarray, ndarray, ndarray)
        The model, q (nq,), v (nv,) and u (nu,).
    predicted : Measurement
        The readings there.
    P : ndarray, (2 nv, 2 nv)
        Covariance of q and q̇.
    variance : ndarray, (k,)
        The readings' own variances.
    """
    model, q, v, u = state
    rows = predicted.jacobian
    if np.all(np.einsum("ij,ij->i", rows @ P, rows) < SHARP * variance):
        return np.zeros(len(variance)), variance
    values, axes = np.linalg.eigh(P[: model.nv, : model.nv])
    bends = []
    for k in np.flatnonzero(values > SHARE * values[-1]):
        axis = np.sqrt(values[k]) * axes[:, k]
        ends = (read(model.integrate(q, s * axis), v, u) for s in (1, -1))
        ahead, behind = (predicted.errors_of(end.values) for end in ends)
        bends.append(ahead + behind)
    shift = 0.5 * np.sum(bends, axis=0)
    return shift, variance + 0.5 * np.sum(np.abs(bends), axis=0) ** 2
