"""Convert joint torques into bounded inputs, for a user's own controller."""

from __future__ import annotations

from typing import Any

import numpy as np

from softdyn import InputError, SoftModel, State
from softdyn.checks import array
from softdyn.controllers.qps.least_norm import bounded_least_norm
from softdyn.controllers.qps.linear_algebra import RANK_TOLERANCE, inner, lq, row_space
from softdyn.dynamics.model import check_model

FAR = 1e8  # of the inputs' largest torque; beyond it only the direction of τ counts


def allocate(model: SoftModel, state: State, tau: Any) -> np.ndarray:
    """The input whose joint torques B u come closest to `tau`: min ‖B u - τ‖² within the bounds.

    Cables that only pull have 0 as their lower bound. The result is the exact minimiser, not the
    clipped pseudo-inverse. Several inputs may be minimisers, for example with three cables around a
    straight arm; the result is then the one with the least ‖u‖. It is continuous in `tau`. A
    combination of inputs whose effect at full range is below a millionth of the largest one counts
    as without effect.

    Parameters
    ----------
    model : SoftModel
        The robot.
    state : State
        The robot's present State.
    tau : array_like, (nv,)
        Joint torques and forces (N m, N). If `tau` or B is not finite, the result is the input
        closest to 0.

    Returns
    -------
    ndarray, (nu,)
        The input, always finite and in ``[u_min, u_max]``.

    Raises
    ------
    InputError
        For a State of another robot, a `tau` of another shape, and a bound that is not finite.
    """
    # fast path of a control step: a State of this model needs no further check
    if not isinstance(state, State) or (
        state.model is not model and state.model.robot.digest != check_model(model).robot.digest
    ):
        raise InputError("state", f"a State of {check_model(model).name!r}", repr(state))
    tau = array("tau", tau, (model.nv,), finite=False)
    low, high = model.u_min, model.u_max
    if not (np.isfinite(high - low).all() and (low <= high).all()):
        raise InputError("model", "finite input bounds, lower <= upper", f"{low} to {high}")
    return _allocated(state.B, tau, low, high)


def _allocated(B: np.ndarray, tau: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    nearest, span = np.clip(np.zeros(len(low)), low, high), high - low
    with np.errstate(all="ignore"):
        effect = B * span
        size, most = (float(np.abs(x).max(initial=0.0)) for x in (effect, tau))
        if not (0 < size < np.inf and most < np.inf):  # NaN is not
            return nearest
        # far beyond the reach only the direction counts; this avoids overflow
        goal = tau / size if most / size <= FAR else tau / most * FAR
        unit = span.max()  # the same scale for all inputs, so that ‖u‖ is minimised
        # kernels get arrays of one layout for all robots, so that no second one is compiled
        basis = row_space((effect / size).T.copy(), RANK_TOLERANCE)  # of the torques of all inputs
        reached = inner(basis, (B * (unit / size)).T.copy())
        rank = len(basis)
        rows, turned, triangle = np.empty(reached.shape), *np.empty((2, rank, rank))
        lq(reached, rows, triangle)
        lq(inner(rows, reached), turned, triangle)  # reached = turnedᵀ triangleᵀ rows
        u = np.empty(len(low))
        bounded_least_norm(
            triangle.T.copy(), rows, turned @ (basis @ goal), low / unit, high / unit, u
        )
    return np.clip(u * unit, low, high) if np.isfinite(u).all() else nearest


_allocated(np.eye(2), np.ones(2), np.zeros(2), np.ones(2))  # compiles before a loop, not in it
