"""The errors of estimated disturbances that the friction of cables makes.

The friction of a cable on its guides (`softdyn.actuation.capstan`) is a joint force that stays as
long as the cable sticks. Its size follows from the file. Its sign is that of the last motion, which
no reading shows: it is s F with s from -1 to 1, and ±1 after a motion that slid everywhere. A
filter without this force finds another cause of it, a disturbance d. At rest, with the tangent
stiffness K, the readings' Jacobian H and the disturbances' forces E d, the readings change by H K⁻¹
F s, and the estimate by

    δd = (Gᵀ W G + V⁻¹)⁻¹ Gᵀ W H K⁻¹ F s,    G = H K⁻¹ E,

W the readings' information over the memory of the disturbances and V their variance. With s = ±1,
independent from cable to cable, δd has the covariance Σ δd δdᵀ. It is added to what the filter
states: an error that is considered, and not estimated (Schmidt 1966).
"""

from __future__ import annotations

import numpy as np

from softdyn.actuation.capstan import Capstan


def rubbing_forces(capstan: Capstan, q: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The joint forces (n, cables) of friction at rest, s = 1 of one cable each.

    Parameters
    ----------
    capstan : Capstan
        The robot's guides.
    q, u : ndarray, (nq,), (m,)
        Configuration and input.
    """
    guides = capstan.at(capstan.model.state(q, np.zeros(capstan.model.nv)))
    cables = [np.where(capstan.tendon == one, 1.0, 0.0) for one in np.unique(capstan.tendon)]
    pairs = [(guides.forces(u, one), guides.forces(u, -one)) for one in cables]
    return np.array([0.5 * (inward - outward) for inward, outward in pairs]).T


def rubbing_covariance(
    by_q: np.ndarray, by_d: np.ndarray, rubbing: np.ndarray, H: np.ndarray,
    information: np.ndarray, variances: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Covariance (nd, nd) of the disturbances' errors by friction.

    Parameters
    ----------
    by_q, by_d : ndarray, (n, n), (n, nd)
        Jacobians of the balance at rest, of the joints that no stop holds: K and -E.
    rubbing : ndarray, (n, cables)
        See `rubbing_forces`, of these joints.
    H, information : ndarray, (k, n), (k,)
        Jacobian of the readings, and the diagonal of W.
    variances : ndarray, (nd,)
        The diagonal of V.

    Raises
    ------
    numpy.linalg.LinAlgError
        K is singular.
    """
    bent = H @ np.linalg.solve(by_q, np.hstack((-by_d, rubbing)))
    G, moved = bent[:, : len(variances)], bent[:, len(variances) :]
    normal = G.T @ (information[:, None] * G) + np.diag(1 / variances)
    error = np.linalg.solve(normal, G.T @ (information[:, None] * moved))
    found: np.ndarray = error @ error.T
    return found
