"""Tension that buckles an arm, so that its tip can follow a path.

Cables that pull against each other along a straight arm bend it nowhere, but they compress it. From
a certain tension on, its tangent stiffness is indefinite, and the arm has many shapes for one place
of the tip. A path that begins in the simple bend ends where an input is zero. From the buckled
shape it can be followed further.
"""

from __future__ import annotations

import numpy as np

from softdyn import SoftModel
from softdyn.controllers.predictive.objective import unseen
from softdyn.dynamics.derivatives import stiffness


def buckling_input(model: SoftModel) -> np.ndarray | None:
    """The least input (nu,) that bends nothing at rest and makes the tangent stiffness indefinite.

    None if there is none within the bounds. Starting from the input nearest to zero, it goes along
    the part of the way to the largest inputs that the joints do not feel.
    """
    B = model.state(model.q0, np.zeros(model.nv)).B
    low = model.relaxed
    size = np.maximum(np.linalg.norm(B, axis=0), 1e-300)
    null = unseen((B / size).T @ (B / size))
    way = null @ ((model.u_max - low) * size) / size
    bounds = np.where(way > 0, model.u_max - low, low - model.u_min)
    felt = np.abs(way) > 1e-9 * np.abs(way).max(initial=0.0)
    if not felt.any() or not np.isfinite(way).all():
        return None
    way = np.where(felt, way, 0.0) * float(np.min(bounds[felt] / np.abs(way[felt])))

    def indefinite(share: float) -> bool:
        return bool(np.linalg.eigvalsh(stiffness(model, model.q0, low + share * way))[0] < 0)

    stable, buckled = 0.0, 1.0
    if indefinite(stable) or not indefinite(buckled):
        return None
    for _ in range(20):
        middle = 0.5 * (stable + buckled)
        stable, buckled = (stable, middle) if indefinite(middle) else (middle, buckled)
    least: np.ndarray = low + buckled * way
    return least
