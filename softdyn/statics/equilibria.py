"""Solvers for equilibria: along the falling potential, near a start, or under a rising input."""

from __future__ import annotations

from contextlib import suppress
from typing import NamedTuple, Protocol

import numpy as np
import pinocchio as pin

from softdyn.checks import array, instance
from softdyn.dynamics.derivatives import stiffness
from softdyn.dynamics.model import SoftModel, State, check_model
from softdyn.dynamics.projection import Projection, underlying_tree
from softdyn.dynamics.stops import Stops
from softdyn.statics.equilibrium import (
    ROUNDING,
    Equilibrium,
    NoEquilibrium,
    potential,
    residual,
    symmetric,
)

TOLERANCE = 1e-10  # residual over the largest force
LARGEST_STEP = 0.3  # largest motion of a joint in one iteration (rad, m), to stay in the basin
ITERATIONS = 300
SNAP = 0.3  # a ramp's step that ends this far from its prediction is halved (rad, m)
SMALLEST_RAMP_STEP = 1e-3
LEAST_STIFFNESS = 1e-9  # of a force, over a radian or a metre; a smaller stiffness counts as none


def settle(model: SoftModel, u: np.ndarray, start: np.ndarray | None = None) -> Equilibrium:
    """The stable or neutral equilibrium reached from `start` along the falling potential.

    The method is damped Newton on Π, projected on the joint limits: (∂r/∂q + λ W) d = -r on the
    free joints. W is the Hessian's diagonal, and λ is chosen so that Π falls. At a saddle the step
    goes along the direction of negative curvature.

    Parameters
    ----------
    u : ndarray, (nu,)
        Input; it need not be within its bounds.
    start : ndarray, (nq,), optional
        Configuration, q = 0 by default; joints beyond a limit are moved to it.

    Raises
    ------
    NoEquilibrium
        If the method does not converge: Π has no minimum, or rounding hides it.
    InputError
        For a wrong shape or a number that is not finite.
    """
    u = array("u", u, (check_model(model).nu,))
    stops = Stops.of(model)
    q = _placed(model, model.q0 if start is None else start)
    damping = 1e-3
    work, energy = _Work(model, u), potential(model, q, u)
    for _ in range(ITERATIONS):
        here = _forces(model, q, u)
        free = np.flatnonzero(~here.held)
        H = stiffness(model, q, u)
        block = H[np.ix_(free, free)]
        step = np.zeros(model.nv)
        if _balanced(here, H):
            escape = _downhill(block, here.scale)
            if escape is None:
                return _equilibrium(model, u, here, H)
            step[free] = escape
            sides = [(move(model, q, part * step), part * step) for part in (0.05, -0.05)]
            changes = [work.change(q, after, turn, energy) for after, turn in sides]
            q = sides[int(np.argmin(changes))][0]
            energy = potential(model, q, u)
            continue
        W = np.abs(np.diag(block)) + 1e-6 * np.abs(block).max()
        while True:
            step[free] = _newton(block, here.r[free], damping * W)
            step = stops.clip(model.coordinates(q), _limited(step))
            after = model.integrate(q, step)
            change = work.change(q, after, step, energy)
            predicted = step @ here.r + step @ H @ step / 2
            rounding = 1e-13 * (abs(energy) + here.scale)
            if abs(predicted) <= rounding:  # the change is only rounding: compare residuals
                good = _forces(model, after, u).left < here.left
            else:
                good = predicted < 0 and change <= 0.1 * predicted
            if good or damping > 1e12:
                break
            damping = max(10 * damping, 1e-6)
        if not good:
            break
        q, energy = after, energy + change
        damping = 0.0 if damping < 1e-9 else damping / 10
    here, H = _forces(model, q, u), stiffness(model, q, u)
    if _balanced(here, H, 1e4):
        return _equilibrium(model, u, here, H)
    raise NoEquilibrium(
        f"no stable equilibrium of {model.name} after {ITERATIONS} steps", here.left
    )


def balance(model: SoftModel, u: np.ndarray, start: np.ndarray) -> Equilibrium:
    """The equilibrium near `start`, stable or not: Newton's method on r(q, u) = 0.

    Parameters
    ----------
    model : SoftModel
        The robot.
    u : ndarray, (nu,)
        Input; it need not be within its bounds.
    start : ndarray, (nq,)
        Configuration; joints beyond a limit are moved to it.

    Raises
    ------
    NoEquilibrium
        If the method does not converge.
    InputError
        For a wrong shape or a number that is not finite.
    """
    u = array("u", u, (check_model(model).nu,))
    here, H = newton(model, u, start)
    return _equilibrium(model, u, here, H)


class FrictionAtRest(Protocol):
    """Joint forces of cables that rub, for `newton`."""

    def forces(self, state: State) -> np.ndarray:
        """The forces (nv,) in a state at rest (N m, N)."""

    def stiffness(self, state: State) -> np.ndarray:
        """Their part in the tangent stiffness (nv, nv), -∂forces/∂q."""


def newton(
    model: SoftModel,
    u: np.ndarray,
    start: np.ndarray,
    friction: FrictionAtRest | None = None,
) -> tuple[Forces, np.ndarray]:
    """Newton's method of `balance`, also with friction: K + g - B u - friction = 0.

    Returns
    -------
    forces : Forces
        The forces at the equilibrium.
    stiffness : ndarray, (nv, nv)
        The tangent stiffness, with that of friction.
    """
    stops, q = Stops.of(model), _placed(model, start)
    here = _forces(model, q, u, friction)
    for _ in range(60):
        at, H = model.coordinates(q), stiffness(model, q, u)
        if friction is not None:
            H += friction.stiffness(here.state)
        size = here.left
        if _balanced(here, H):
            break
        free = np.flatnonzero(~here.held)
        step = np.zeros(model.nv)
        r = here.r - here.stops
        step[free] = -np.linalg.lstsq(H[np.ix_(free, free)], r[free], rcond=1e-14)[0]
        step = _limited(step)
        for _ in range(12):
            after = model.integrate(q, stops.clip(at, step))
            there = _forces(model, after, u, friction)
            if np.linalg.norm(there.r - there.stops) < np.linalg.norm(r):
                break
            step /= 2
        else:
            break
        q, here = after, there
    if _balanced(here, H, 1e4):
        return here, H
    name = model.name if friction is None else f"{model.name} with friction"
    raise NoEquilibrium(f"no equilibrium of {name} near the start", size)


def ramp(
    model: SoftModel, u: np.ndarray, start: Equilibrium | None = None
) -> tuple[Equilibrium, int]:
    """Raise the input slowly to `u`; return the stable equilibrium and the number of snaps.

    The method is continuation along u(s) from the start's input, with the tangent ∂q/∂u as
    predictor and `settle` as corrector. A step that ends far from its prediction is halved. If the
    shortest step still ends far away, the robot snaps to another branch, as a real one would.

    Parameters
    ----------
    u : ndarray, (nu,)
        Final input.
    start : Equilibrium, optional
        The first equilibrium; by default `rest`, under the input closest to zero within its bounds.

    Raises
    ------
    NoEquilibrium
        If there is no equilibrium on the way.
    """
    u = array("u", u, (check_model(model).nu,))
    found = instance(
        "start", rest(model) if start is None else start, Equilibrium, "an Equilibrium"
    )
    first, s, ds, snaps = found.u, 0.0, 0.25, 0
    while s < 1.0:
        ds = min(ds, 1.0 - s)
        target = first + (s + ds) * (u - first)
        change = Stops.of(model).clip(
            model.coordinates(found.q), found.joint_sensitivity @ (target - found.u)
        )
        far = np.abs(change).max(initial=0.0) > SNAP
        if far and ds > SMALLEST_RAMP_STEP:
            ds /= 2
            continue
        guess = found.q if far else move(model, found.q, change)
        after = settle(model, target, guess)
        missed = _apart(model, guess, after.q)
        if missed > SNAP:
            if ds > SMALLEST_RAMP_STEP:
                ds /= 2
                continue
            snaps += 1
        found, s = after, s + ds
        ds = 2 * ds if missed < SNAP / 4 else ds
    return found, snaps


def rest(model: SoftModel) -> Equilibrium:
    """The equilibrium that `settle` finds from q = 0 under the input closest to zero in bounds."""
    return settle(model, check_model(model).relaxed)


def move(model: SoftModel, q: np.ndarray, step: np.ndarray) -> np.ndarray:
    """q ⊕ step (nq,), with each joint's motion cut at its limits."""
    return model.integrate(q, Stops.of(model).clip(model.coordinates(q), step))


class Forces(NamedTuple):
    """The forces at a shape at rest."""

    state: State
    r: np.ndarray  # (nv,) K + g - F - B u - friction
    scale: float  # size of the forces in r
    stops: np.ndarray  # (nv,) force of the stops
    held: np.ndarray  # (nv,) bool, joints that a stop holds

    @property
    def left(self) -> float:
        """The largest unbalanced force."""
        return float(np.abs(self.r - self.stops).max(initial=0.0))


class _Work:
    """The change of the potential along a step.

    If a force of one's own has no potential, it is the work against all forces along the step, by
    Simpson's rule.
    """

    def __init__(self, model: SoftModel, u: np.ndarray) -> None:
        self._model, self._u = model, u
        self._conserves = model.conserves

    def change(self, q: np.ndarray, after: np.ndarray, step: np.ndarray, energy: float) -> float:
        """Π(after) - energy (J) for the step (nv,) from q, where Π is the energy."""
        if self._conserves:
            return potential(self._model, after, self._u) - energy
        middle = self._model.integrate(q, step / 2)
        first, half, last = (residual(self._model, x, self._u) for x in (q, middle, after))
        return float(step @ (first + 4 * half + last)) / 6


# -- inside --------------------------------------------------------------------------------------


def _forces(
    model: SoftModel, q: np.ndarray, u: np.ndarray, friction: FrictionAtRest | None = None
) -> Forces:
    state = model.state(q, np.zeros(model.nv))
    r = state.h - state.B @ u
    # each cable counts alone, because cables that pull against each other sum up to rounding
    forces = [state.K, state.bias, np.abs(state.B) @ np.abs(u)]
    if model.forced:
        forces.append(state.F)
    if friction is not None:
        forces.append(friction.forces(state))
        r -= forces[-1]
    scale = max(float(np.abs(force).max(initial=0.0)) for force in forces)
    held = Stops.of(model).held(model.coordinates(q), r)
    return Forces(state, r, max(scale, 1e-12), np.where(held, r, 0.0), held)


def _balanced(here: Forces, H: np.ndarray, times: float = 1.0) -> bool:
    """Whether the residual is small beside the forces, or beside their change over a milliradian.

    The second test is for a robot that hangs straight down: all its forces are zero but for
    rounding.
    """
    scale = max(here.scale, 1e-3 * float(np.abs(H).max(initial=0.0)))
    return here.left <= times * TOLERANCE * scale


def _apart(model: SoftModel, a: np.ndarray, b: np.ndarray) -> float:
    """The largest motion of a joint between two configurations (rad, m)."""
    tree, _ = underlying_tree(model)
    if isinstance(model, Projection):
        a, b = model.expand(a), model.expand(b)
    return float(np.abs(pin.difference(tree.engine, a, b)).max(initial=0.0))


def _placed(model: SoftModel, q: np.ndarray) -> np.ndarray:
    """q (nq,) with joints beyond a stop moved to it."""
    q = array("start", q, (model.nq,))
    at = model.coordinates(q)
    return model.integrate(q, Stops.of(model).within(at) - at)


def _limited(step: np.ndarray) -> np.ndarray:
    return step * min(1.0, LARGEST_STEP / np.abs(step).max(initial=1e-300))


def _newton(H: np.ndarray, r: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """-(H + diag(damping))⁻¹ r, with more damping if this matrix is not positive definite.

    Of a matrix that is not symmetric, the symmetric part decides: then -r · step > 0.
    A joint without any stiffness, such as a hoist's, has the step of a small one along its force.
    """
    W, solve, even = np.diag(damping), np.linalg.solve, symmetric(H)
    shift = 0.0
    least = max(np.abs(H).max(initial=0.0), LEAST_STIFFNESS * np.abs(r).max(initial=0.0), 1e-300)
    size = np.abs(np.diag(H)) + 1e-6 * least
    while True:
        with suppress(np.linalg.LinAlgError):
            whole = H + W + np.diag(shift * size)
            L = np.linalg.cholesky(whole if even else (whole + whole.T) / 2)
            step = -(np.linalg.solve(L.T, np.linalg.solve(L, r)) if even else solve(whole, r))
            if np.isfinite(step).all():
                return step
        shift = max(2 * shift, 1e-3)


def _downhill(H: np.ndarray, scale: float) -> np.ndarray | None:
    """A direction of negative curvature, scaled to a largest entry of 1; None at a minimum.

    A curvature within the rounding of forces of this scale counts as none. For a matrix that is not
    symmetric it is a direction of a real negative eigenvalue, in which the robot would leave.
    """
    if not symmetric(H):
        found, columns = np.linalg.eig(H)
        found = np.where(np.abs(found.imag) <= 1e-9 * np.abs(found), found.real, np.inf)
        k = int(found.argmin())
        if found[k] >= -max(1e-9 * np.abs(H).max(), ROUNDING * scale):
            return None
        away = columns[:, k].real
        return away / np.abs(away).max()
    try:
        np.linalg.cholesky(H)
        return None
    except np.linalg.LinAlgError:
        pass
    values, vectors = np.linalg.eigh(H)
    if values[0] >= -max(1e-9 * np.abs(values).max(), ROUNDING * scale):
        return None
    direction = vectors[:, 0]
    return direction / np.abs(direction).max()


def _equilibrium(model: SoftModel, u: np.ndarray, here: Forces, H: np.ndarray) -> Equilibrium:
    # a joint that only touches its stop is free to leave it
    pressed = np.abs(here.stops) > ROUNDING * here.scale
    held = here.held & (pressed | Stops.of(model).locked)
    return Equilibrium(
        model, here.state.q, u, held, np.where(here.held & ~held, 0.0, here.stops), H
    )
