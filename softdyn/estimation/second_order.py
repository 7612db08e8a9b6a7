"""The part of a reading that its Jacobian does not show, while the state is poorly known.

With the covariance P of q and the second derivatives H of a reading, the second-order filter
(Bar-Shalom, Li and Kirubarajan 2001, section 10.3) expects the reading ½ tr(H P) away from h(q),
and adds ½ tr(H P H P) to its variance. Without this a first reading of the tip leaves a filter that
is sure of a wrong shape.
"""

from __future__ import annotations

import numpy as np

from softdyn.sensing import Sensors

SHARP = 30.0  # times its own variance; a reading that is known as well as this is as good as linear


def second_order(
    sensors: Sensors,
    state: tuple[np.ndarray, np.ndarray, np.ndarray],
    P: np.ndarray,
    variance: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """The shift of the expected readings (k,), and their variances (k,) with the nonlinear part.

    Parameters
    ----------
    sensors : Sensors
        They evaluate the readings.
    state : (ndarray, ndarray, ndarray)
        q (nq,), v (nv,) and u (nu,).
    P : ndarray, (s, s)
        Covariance of the errors, those of q first.
    variance : ndarray, (k,)
        The readings' own variances.
    """
    n = len(state[1])
    products = sensors.hessians(*state) @ P[:n, :n]
    shift = 0.5 * np.trace(products, axis1=1, axis2=2)
    return shift, variance + 0.5 * np.einsum("kij,kji->k", products, products)


def sharp(rows, P, variance):
    """Whether readings with these Jacobians (k, w) are as good as linear."""
    width = rows.shape[1]
    known = np.sum(rows @ P[:width, :width] * rows, axis=1)
    return bool((known < SHARP * variance).all())
