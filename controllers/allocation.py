"""Joint torques into inputs, for a user's own controller: there are fewer inputs than joints."""

from __future__ import annotations

from typing import Any

import numpy as np

from softdyn import InputError, SoftModel, State
from softdyn.checks import array
from softdyn.controllers.qps.least_norm import bounded_least_norm
from softdyn.controllers.qps.linear_algebra import inner, lq, row_space
from softdyn.dynamics.model import check_model

FAR = 1e8  # torques that are so many times what the inputs can give


def allocate(model: SoftModel, state: State, tau: Any) -> np.ndarray:
    """The input whose joint torques B u come closest to `tau`: min ‖B u - τ‖² within the bounds.

    Cables that only pull have 0 as their lower bound. The minimum is exact, not the clipped
    pseudo-inverse. Where several inputs give it, as with three cables around a straight arm, the
    answer is the one with the least ‖u‖. It is continuous in `tau`. Combinations of inputs with
    less than a millionth of the largest effect at full range count as without effect.

    Parameters
    ----------
    model : SoftModel
        The robot.
    state : State
        Its present one.
    tau : array_like, (nv,)
        Joint torques and forces (N m, N). Without numbers that are finite there is nothing to come
        close to: the answer is then the input closest to 0, as where B is not finite.

    Returns
    -------
    ndarray, (nu,)
        Always finite, always in ``[u_min, u_max]``.

    Raises
    ------
    InputError
        No State of this robot, a `tau` of another shape, a bound that is not finite.
    """
    check_model(model)
    if not isinstance(state, State) or (
        state.model is not model and state.model.robot.digest != model.robot.digest
    ):
        raise InputError("state", f"a State of {model.name!r}", repr(state))
    tau = array("tau", tau, (model.nv,), finite=False)
    low, high = model.u_min, model.u_max
    if not (np.isfinite(high - low).all() and (low <= high).all()):
        raise InputError("model", "finite input bounds, lower <= upper", f"{low} to {high}")
    nearest, span = np.clip(np.zeros(model.nu), low, high), high - low
    with np.errstate(all="ignore"):
        effect = state.B * span
        size, most = (float(np.abs(x).max(initial=0.0)) for x in (effect, tau))
        if not (0 < size < np.inf and most < np.inf):  # NaN is not
            return nearest
        # of what is out of reach by far only the direction counts: no number overflows
        goal = tau / size if most / size <= FAR else tau / most * FAR
        unit = span.max()  # one for all inputs: the norm stays that of u
        basis = row_space((effect / size).T)  # of the torques that inputs can give
        reached = inner(basis, (state.B * (unit / size)).T.copy())
        rank = len(basis)
        rows, turned, triangle = np.empty(reached.shape), *np.empty((2, rank, rank))
        lq(reached, rows, triangle)
        lq(inner(rows, reached), turned, triangle)  # reached = turnedᵀ triangleᵀ rows
        u = np.empty(model.nu)
        bounded_least_norm(
            triangle.T.copy(), rows, turned @ (basis @ goal), low / unit, high / unit, u
        )
    return np.clip(u * unit, low, high) if np.isfinite(u).all() else nearest
