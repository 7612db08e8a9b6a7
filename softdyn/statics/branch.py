"""Follow a branch of equilibria, stable or not, until the tip is near a point."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from softdyn.checks import array, flag, instance, whole
from softdyn.dynamics.model import SoftModel, State
from softdyn.statics.equilibria import balance, move
from softdyn.statics.equilibrium import Equilibrium, StaticsError

REACHED = 1e-6  # m; a tip this close is at the target
Measure = Callable[[State], tuple[np.ndarray, np.ndarray]]
LARGEST_STEP = 0.3  # largest motion of a joint in one step along a branch (rad, m)


def approach(
    start: Equilibrium, target: np.ndarray, steps: int = 60, *, stay_stable: bool = False
) -> Equilibrium:
    """Follow the branch of `start` until the tip is as close to `target` as its inputs allow.

    The method is damped Gauss-Newton on ‖y(u) - y*‖ within the input bounds. Every iterate is an
    equilibrium, stable or not. It ends early if the branch folds (∂r/∂q singular).

    Parameters
    ----------
    start : Equilibrium
        The first equilibrium.
    target : ndarray, (3,)
        The target in the world (m).
    steps : int
        Largest number of steps.
    stay_stable : bool
        End before the branch turns unstable.
    """
    instance("start", start, Equilibrium, "an Equilibrium")
    target = array("target", target, (3,))

    return descend(start, tip_error(target), steps, stay_stable=stay_stable)


def tip_error(target: np.ndarray) -> Measure:
    """The error y - target of the tip (3,) in a state, and its Jacobian J."""
    return lambda state: (state.y - target, state.J)


def descend(
    start: Equilibrium, measure: Measure, steps: int = 60, *, stay_stable: bool = False
) -> Equilibrium:
    """Follow the branch of `start` until an error is as small as the inputs allow.

    Parameters
    ----------
    start, steps, stay_stable
        As in `approach`.
    measure : Callable
        State → error e (r,), zero at the target, and its Jacobian ∂e/∂q (r, nv).
    """
    from scipy.optimize import lsq_linear  # imported only here, because it is slow to import

    model, here = start.model, start
    flag("stay_stable", stay_stable)
    scale = input_scale(model, start)
    low, high = model.u_min / scale, model.u_max / scale
    damping = 1e-3
    error, jacobian = measure(here.state)
    for _ in range(whole("steps", steps)):
        if np.linalg.norm(error) < REACHED / 100 or model.nu == 0:
            break
        slope = jacobian @ here.joint_sensitivity * scale
        rows = np.vstack((slope, damping * np.linalg.norm(slope) * np.eye(model.nu)))
        goal = np.concatenate((-error, np.zeros(model.nu)))
        u = np.clip(here.u / scale, low, high)
        room = (np.minimum(low - u, -1e-12), np.maximum(high - u, 1e-12))
        du = lsq_linear(rows, goal, room, method="bvls").x * scale
        change = here.joint_sensitivity @ du
        du *= min(1.0, LARGEST_STEP / max(np.abs(change).max(initial=0.0), 1e-300))
        after = follow(here, np.clip(here.u + du, model.u_min, model.u_max))
        if after is not None and stay_stable and after.unstable:
            after = None
        left, turned = (error, jacobian) if after is None else measure(after.state)
        if after is not None and np.linalg.norm(left) < np.linalg.norm(error):
            gain = 1 - np.linalg.norm(left) / np.linalg.norm(error)
            here, error, jacobian = after, left, turned
            damping = max(damping / 10, 1e-9)
            if gain < 1e-9:
                break
        elif damping > 1e3:
            break
        else:
            damping *= 10
    return here


def input_scale(model: SoftModel, start: Equilibrium) -> np.ndarray:
    """Size of each input (nu,) that moves a joint by about a radian, but not above its range.

    It is the range where no force holds any joint.
    """
    force = np.abs(np.diag(start.stiffness)) * np.minimum(model.upper - model.lower, 1.0)
    arms = np.abs(start.state.B).max(axis=0, initial=0.0)
    span = np.maximum(model.u_max - model.u_min, 1e-9)
    firm = force.max(initial=0.0) > start.rounding
    needed = force.max() / np.maximum(arms, 1e-300) if firm else span
    return np.clip(needed, 1e-9, span)


def follow(here: Equilibrium, u: np.ndarray) -> Equilibrium | None:
    """The equilibrium under `u` (nu,) on the same branch; None if Newton's method leaves it."""
    change = here.joint_sensitivity @ (u - here.u)
    try:
        after = balance(here.model, u, move(here.model, here.q, change))
    except StaticsError:
        return None
    moved = np.abs(here.model.coordinates(after.q) - here.model.coordinates(here.q))
    return after if moved.max(initial=0.0) < 3 * LARGEST_STEP else None
