"""Equilibria under the measured inputs, and their derivatives by the unknown parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softdyn.dynamics.model import SoftModel
from softdyn.identification.parameters import Parameter, columns_of
from softdyn.identification.unknowns.kinds import Around, MotionSample
from softdyn.statics.equilibria import settle


def rests(
    model: SoftModel,
    unknowns: Sequence[Parameter],
    u: np.ndarray,
    around: Around,
    guesses: dict[bytes, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Joint coordinates (N, n) at rest under each input (N, m), and their derivatives (N, n, P).

    ∂q/∂θ = -(∂r/∂q)⁻¹ ∂r/∂θ on the joints that no stop holds.

    Parameters
    ----------
    guesses : dict
        Where the search starts, by the input's bytes; the results are kept there. An input that is
        not there starts from the equilibrium of the row before.

    Raises
    ------
    StaticsError
        If no stable equilibrium is found.
    """
    n, count = model.nv, len(unknowns)
    path, by = np.empty((len(u), n)), np.zeros((len(u), n, count))
    start = None
    for k, row in enumerate(u):
        rest = settle(model, row, guesses.get(row.tobytes(), start))
        start = guesses[row.tobytes()] = rest.q
        path[k] = model.coordinates(rest.q)
        if count:
            sample = MotionSample(rest.state, np.zeros(n), row, around)
            free = ~rest.held
            block = rest.stiffness[np.ix_(free, free)]
            by[k, free] = -np.linalg.solve(block, columns_of(unknowns, sample, count)[free])
    return path, by
