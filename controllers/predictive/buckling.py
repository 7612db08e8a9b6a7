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

TIMES = 20.0  # the pull beside the least tension that buckles
KEEPS = 5.0  # beside it, the tension that keeps the arm buckled
LASTS = 0.6  # s
AGAIN = 1.0  # s from the end of a pull to the next
FAR = 0.03  # m from the path
LATE = 0.05  # s so far from it


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


class Pull:
    """Inputs that buckle the arm at the begin of a path and keep it so.

    The first is also for whenever the tip has left the path. If nothing pulled in between, the
    buckled shape would relax, because the tip alone determines the inputs.

    Parameters
    ----------
    model : SoftModel
        A robot.
    least : ndarray, (nu,)
        Its `buckling_input`.
    """

    def __init__(self, model: SoftModel, least: np.ndarray) -> None:
        self.u = np.clip(TIMES * least, model.u_min, model.u_max)
        self.after = np.clip(KEEPS * least, model.u_min, model.u_max)

    def reset(self, period: float) -> None:
        """Begin a path with a control period (s): the first state far from it starts a pull."""
        self._period = period
        self._since, self._late = LASTS + AGAIN, LATE

    def __call__(self, distance: float) -> np.ndarray:
        """The input (nu,) to prefer while the tip is that far (m) from the path."""
        self._late = self._late + self._period if distance > FAR else 0.0
        if self._late > LATE and self._since >= LASTS + AGAIN:
            self._since = 0.0
        pulls = self._since < LASTS
        self._since += self._period
        return self.u if pulls else self.after
