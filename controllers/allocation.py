"""Joint torques into inputs, for a user's own controller: there are fewer inputs than joints."""

from __future__ import annotations

from typing import Any

import numpy as np

from softdyn import InputError, SoftModel, State
from softdyn.checks import array

FAR = 1e8  # torques that are so many times what the inputs can give
ROUNDS = 20  # of the active set method, for each input: it takes about one


def allocate(model: SoftModel, state: State, tau: Any) -> np.ndarray:
    """The input whose joint torques B u come closest to `tau`: min ‖B u - τ‖² within the bounds.

    Cables that only pull are bounds from 0 on. The minimum is exact, not the clipped pseudo-inverse
    (SciPy's BVLS: Stark & Parker 1995, Computational Statistics 10). Where several inputs give
    it, as with three cables around a straight arm, it is one of them.

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
    from scipy.optimize import lsq_linear  # slow to import: not where a law is one of ours

    if not isinstance(state, State) or (
        state.model is not model and state.model.robot.digest != model.robot.digest
    ):
        raise InputError("state", f"a State of {model.name!r}", repr(state))
    tau = array("tau", tau, (model.nv,), finite=False)
    low, high = model.u_min, model.u_max
    if not (np.isfinite(high - low).all() and (low <= high).all()):
        raise InputError("model", "finite input bounds, lower <= upper", f"{low} to {high}")
    nearest = np.clip(np.zeros(model.nu), low, high)
    free = high > low  # the others have no choice
    base, span = nearest[free], (high - low)[free]
    with np.errstate(all="ignore"):
        effect, left = state.B[:, free] * span, tau - state.B @ nearest
        size, most = (float(np.abs(x).max(initial=0.0)) for x in (effect, left))
        if not (0 < size < np.inf and most < np.inf):  # NaN is not
            return nearest
        # of what is out of reach by far only the direction counts: no number overflows
        goal = left / size if most / size <= FAR else left / most * FAR
        # what no input can give adds a constant to the squares, and would hide the rest in rounding
        Q, R = np.linalg.qr(effect / size)
    bounds = (low[free] - base) / span, (high[free] - base) / span
    part = lsq_linear(
        R, Q.T @ goal, bounds, method="bvls", tol=1e-14, max_iter=ROUNDS * model.nu
    ).x  # fmt: skip
    u = nearest.copy()
    u[free] += part * span
    return np.clip(u, low, high)
