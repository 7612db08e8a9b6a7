"""When a run ends early, and when one that reached its end counts as failed."""

from __future__ import annotations

import math

DIVERGED = 2.0  # ‖e‖ in robot lengths
RESOLUTION = 1e-6  # m; a final error below it is zero, whatever the initial one was


def not_finite(t: float) -> str:
    """Why a run ends whose plant has a state at `t` (s) that is not finite."""
    return f"the plant diverged at t = {t:.4g} s: a state that is not finite"


def plant_stopped(t: float, warning: str) -> str:
    """Why a run ends whose plant could not go on at `t` (s)."""
    return f"the plant diverged at t = {t:.4g} s: {warning}"


def no_input(t: float, fault: str) -> str:
    """Why a run ends whose controller gave no usable input at `t` (s)."""
    return f"the controller failed at t = {t:.4g} s: {fault}"


def tip_diverged(t: float, distance: float, length: float) -> str | None:
    """Why a run ends whose tip is `distance` (m) from its reference; None while that is tolerable.

    Parameters
    ----------
    t : float
        Time (s).
    distance : float
        ‖e‖ (m).
    length : float
        The robot's length (m); no distance is too far for a robot of length 0.
    """
    if distance <= (DIVERGED * length if length > 0 else math.inf):
        return None
    return (
        f"the tip diverged at t = {t:.4g} s: {distance:.3g} m from its reference, "
        f"more than twice the length of {length:.3g} m"
    )


def not_converged(initial: float, final: float) -> str | None:
    """Why a run that reached its end is failed all the same, by its first and last ‖e‖ (m)."""
    if final < initial or final <= RESOLUTION:
        return None
    return (
        f"no convergence: the final error of {100 * final:.3g} cm is not below "
        f"the initial {100 * initial:.3g} cm"
    )
