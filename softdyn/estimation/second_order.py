"""The part of a reading that its Jacobian does not show, while the state is poorly known.

With the covariance P of q and the second derivatives H of a reading, the second-order filter
(Bar-Shalom, Li and Kirubarajan 2001, section 10.3) expects the reading ½ tr(H P) away from h(q),
and adds ½ tr(H P H P) to its variance. Without this a first reading of the tip leaves a filter that
is sure of a wrong shape.
"""

from __future__ import annotations

import numpy as np

from softdyn.estimation.readings import Reader
from softdyn.sensing import Measurement

SHARP = 30.0  # times its own variance; a reading that is known as well as this is as good as linear


def second_order(
    read: Reader,
    state: tuple[np.ndarray, np.ndarray, np.ndarray],
    predicted: Measurement,
    P: np.ndarray,
    variance: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """The shift of the expected readings (k,), and their variances (k,) with the nonlinear part.

    Parameters
    ----------
    read : Reader
        It evaluates the readings.
    state : (ndarray, ndarray, ndarray)
        q (nq,), v (nv,) and u (nu,).
    predicted : Measurement
        The readings there.
    P : ndarray, (2 nv, 2 nv)
        Covariance of q and q̇.
    variance : ndarray, (k,)
        The readings' own variances.
    """
    rows, n = predicted.jacobian, len(state[1])
    if np.all(np.einsum("ij,ij->i", rows @ P, rows) < SHARP * variance):
        return np.zeros(len(variance)), variance
    products = read.hessians(*state) @ P[:n, :n]
    shift = 0.5 * np.trace(products, axis1=1, axis2=2)
    return shift, variance + 0.5 * np.einsum("kij,kji->k", products, products)
