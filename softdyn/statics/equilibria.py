"""Equilibria under given inputs, with joint limits as unilateral stops, and their stability.

At rest M q̈ + C q̇ + D q̇ + K + g = B u leaves r(q, u) = K + g - B u = 0, the gradient of the
potential Π = U(q) + U_s(q) - Σ gear u ℓ(q). A joint at a limit may be pressed against it:

    r_i = 0 inside,   r_i ≥ 0 at the lower limit,   r_i ≤ 0 at the upper one,

which are the stationary points of Π between the limits. The stable ones are its minima: the
Hessian ∂r/∂q is positive definite on the joints that are free to move.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.linalg import eigvals

from softdyn.checks import array
from softdyn.dynamics.derivatives import pull, stiffness
from softdyn.dynamics.model import SoftModel
from softdyn.dynamics.state import State
from softdyn.exceptions import SoftdynError

TOLERANCE = 1e-10  # of the residual, relative to the largest of the forces that balance
TOUCHING = 1e-9  # a joint this close to a limit is at it (rad, m)
LARGEST_STEP = 0.3  # of a joint in one iteration (rad, m): keeps to the basin it is in
ITERATIONS = 300
SNAP = 0.3  # a ramp's step that ends this far from its prediction is halved (rad, m)
SMALLEST_RAMP_STEP = 1e-3


@dataclass(frozen=True, eq=False)
class Barrier:
    """Joint limits as smooth repulsion μ / gap: the stops without their corners.

    With exact stops, ∂q/∂u jumps where a joint meets or leaves one; a search among equilibria
    gets stuck there. It follows the smooth branch instead, for falling μ.

    Attributes
    ----------
    weight : (nv,) μ (N m rad, N m); a force f keeps a joint μ / f away from its limit.
    """

    weight: np.ndarray

    def force(self, model: SoftModel, q: np.ndarray) -> np.ndarray:
        """What the stops add to the residual (nv,), within the limits."""
        at = model.coordinates(q)
        return self.weight / (model.upper - at) - self.weight / (at - model.lower)

    def stiffness(self, model: SoftModel, q: np.ndarray) -> np.ndarray:
        """Its derivative (nv,) by each joint."""
        at = model.coordinates(q)
        return self.weight / (model.upper - at) ** 2 + self.weight / (at - model.lower) ** 2

    def inside(self, model: SoftModel, q: np.ndarray, step: np.ndarray) -> np.ndarray:
        """The part of a step (nv,) that uses up at most nine tenths of each gap."""
        at = model.coordinates(q)
        return np.clip(step, 0.9 * (model.lower - at), 0.9 * (model.upper - at))


class StaticsError(SoftdynError, ArithmeticError):
    """No equilibrium was found; the text says what was reached.

    Attributes
    ----------
    residual : largest force left unbalanced (N m, N).
    """

    def __init__(self, text: str, residual: float) -> None:
        self.text, self.residual = text, residual
        super().__init__(f"{text}: forces of {residual:.3g} (N m, N) are left unbalanced")

    def __reduce__(self) -> tuple[Any, ...]:  # crosses process boundaries
        return type(self), (self.text, self.residual)


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """A robot at rest under a constant input.

    Attributes
    ----------
    model, q, u : the robot, its configuration (nq,) and the input (nu,).
    held : (nv,) bool, joints pressed against a limit.
    limit_forces : (nv,) force of the stops on the joints (N m, N), zero on free joints.
    stiffness : (nv, nv) tangent stiffness ∂(K + g - B u)/∂q.
    """

    model: SoftModel
    q: np.ndarray
    u: np.ndarray
    held: np.ndarray
    limit_forces: np.ndarray
    stiffness: np.ndarray

    @cached_property
    def state(self) -> State:
        """Everything else the dynamics say at (q, 0)."""
        return self.model.state(self.q, np.zeros(self.model.nv))

    @property
    def y(self) -> np.ndarray:
        """Tip position (3,) in the world (m)."""
        return self.state.y

    @cached_property
    def residual(self) -> float:
        """Largest force that is not balanced (N m, N)."""
        r = self.state.K + self.state.g - self.state.B @ self.u - self.limit_forces
        return float(np.abs(r).max(initial=0.0))

    @cached_property
    def eigenvalues(self) -> np.ndarray:
        """Eigenvalues of the tangent stiffness on the free joints, ascending (N m/rad, N/m)."""
        free = ~self.held
        return np.linalg.eigvalsh(self.stiffness[np.ix_(free, free)])

    @property
    def stable(self) -> bool:
        """Whether the potential has a strict minimum here, between the joint limits."""
        values = self.eigenvalues
        return bool(values.size == 0 or values[0] > 1e-9 * np.abs(values).max())

    @cached_property
    def poles(self) -> np.ndarray:
        """Poles s (1/s) of M δq̈ + D δq̇ + ∂r/∂q δq = 0 on the free joints, rightmost first."""
        free = np.flatnonzero(~self.held)
        block = np.ix_(free, free)
        n = len(free)
        inverse = np.linalg.inv(self.state.M[block])
        A = np.zeros((2 * n, 2 * n))
        A[:n, n:] = np.eye(n)
        A[n:, :n], A[n:, n:] = -inverse @ self.stiffness[block], -inverse @ self.state.D[block]
        found = eigvals(A)
        return found[np.argsort(-found.real)]

    @cached_property
    def _free_compliance(self) -> np.ndarray:
        """(∂r/∂q)⁻¹ on the free joints, zero on the held ones (nv, nv)."""
        free = np.flatnonzero(~self.held)
        block = np.ix_(free, free)
        result = np.zeros_like(self.stiffness)
        result[block] = np.linalg.pinv(self.stiffness[block], rcond=1e-14, hermitian=True)
        return result

    @property
    def tip_compliance(self) -> np.ndarray:
        """δy/δf (3, 3) = J (∂r/∂q)⁻¹ Jᵀ (m/N): how the tip yields to a force on it."""
        J = self.state.J
        return J @ self._free_compliance @ J.T

    @property
    def joint_sensitivity(self) -> np.ndarray:
        """∂q/∂u (nv, nu) = (∂r/∂q)⁻¹ B along the branch of equilibria."""
        return self._free_compliance @ self.state.B

    @property
    def tip_sensitivity(self) -> np.ndarray:
        """∂y/∂u (3, nu) along the branch of equilibria."""
        return self.state.J @ self.joint_sensitivity


def residual(model: SoftModel, q: np.ndarray, u: np.ndarray) -> np.ndarray:
    """r(q, u) = K + g - B u (nv,), the gradient of `potential` (N m, N).

    Parameters
    ----------
    q : (nq,) configuration.
    u : (nu,) input.
    """
    state = model.state(q, np.zeros(model.nv))
    return state.K + state.bias - state.B @ array("u", u, (model.nu,))


def potential(model: SoftModel, q: np.ndarray, u: np.ndarray) -> float:
    """Π = U + U_s - Σ gear u ℓ (J), what a robot at rest under constant inputs minimises."""
    return model.potential_energy(q) - float(pull(model, u) @ model.tendon_lengths(q))


def settle(model: SoftModel, u: np.ndarray, start: np.ndarray | None = None) -> Equilibrium:
    """The stable equilibrium downhill from `start`.

    Damped Newton on Π with the projection on the joint limits: (∂r/∂q + λ W) d = -r on the free
    joints, W the Hessian's diagonal, λ such that Π falls; saddles are left along the direction
    of negative curvature.

    Parameters
    ----------
    u : (nu,) input; it need not be within its bounds.
    start : (nq,) configuration, the rest position by default; moved within the limits.

    Raises
    ------
    StaticsError
        No convergence: Π has no minimum, or rounding hides it.
    InputError
        Wrong shape or a number that is not finite.
    """
    u = array("u", u, (model.nu,))
    q = _within_limits(model, model.q0 if start is None else start)
    damping = 1e-3
    energy = potential(model, q, u)
    for _ in range(ITERATIONS):
        r, scale = _residual(model, q, u)
        held = _pressed(model, q, r)
        free = np.flatnonzero(~held)
        H = stiffness(model, q, u)
        block = H[np.ix_(free, free)]
        if np.abs(r[free]).max(initial=0.0) <= TOLERANCE * scale:
            escape = _downhill(block)
            if escape is None:
                return _equilibrium(model, q, u, held, np.where(held, r, 0.0), H)
            step = np.zeros(model.nv)
            step[free] = escape
            moved = [move(model, q, s * step) for s in (0.05, -0.05)]
            energies = [potential(model, x, u) for x in moved]
            best = int(np.argmin(energies))
            q, energy = moved[best], energies[best]
            continue
        W = np.abs(np.diag(block)) + 1e-6 * np.abs(block).max()
        while True:
            step = np.zeros(model.nv)
            step[free] = _newton(block, r[free], damping * W)
            step *= min(1.0, LARGEST_STEP / np.abs(step).max(initial=1e-300))
            step = _clip(model, q, step)
            after = model.integrate(q, step)
            change = potential(model, after, u) - energy
            predicted = step @ r + step @ H @ step / 2
            rounding = 1e-13 * (abs(energy) + scale)
            if abs(predicted) <= rounding:  # the energy no longer tells: the residual does
                good = np.abs(_free_residual(model, after, u)).max(initial=0.0) < np.abs(
                    r[free]
                ).max(initial=0.0)
            else:
                good = predicted < 0 and change <= 0.1 * predicted
            if good or damping > 1e12:
                break
            damping = max(10 * damping, 1e-6)
        if not good:
            break
        q, energy = after, energy + change
        damping = 0.0 if damping < 1e-9 else damping / 10
    r, scale = _residual(model, q, u)
    held = _pressed(model, q, r)
    left = float(np.abs(r[~held]).max(initial=0.0))
    if left <= 1e4 * TOLERANCE * scale:
        return _equilibrium(model, q, u, held, np.where(held, r, 0.0), stiffness(model, q, u))
    raise StaticsError(f"no stable equilibrium of {model.name} after {ITERATIONS} steps", left)


def balance(
    model: SoftModel, u: np.ndarray, start: np.ndarray, barrier: Barrier | None = None
) -> Equilibrium:
    """The equilibrium near `start`, stable or not: Newton's method on r(q, u) = 0.

    Parameters
    ----------
    u : (nu,) input; it need not be within its bounds.
    start : (nq,) configuration; moved within the limits.
    barrier : stops that repel instead of hold; the equilibrium's stiffness then contains theirs.

    Raises
    ------
    StaticsError
        No convergence.
    InputError
        Wrong shape or a number that is not finite.
    """
    u = array("u", u, (model.nu,))
    q = _within_limits(model, start)
    if barrier is not None:
        q = _off_the_stops(model, q)
    r, scale, held = _balance(model, q, u, barrier)
    for _ in range(60):
        free = np.flatnonzero(~held)
        size = float(np.abs(r[free]).max(initial=0.0))
        H = stiffness(model, q, u)
        if barrier is not None:
            H += np.diag(barrier.stiffness(model, q))
        if size <= TOLERANCE * scale:
            break
        step = np.zeros(model.nv)
        step[free] = -np.linalg.lstsq(H[np.ix_(free, free)], r[free], rcond=1e-14)[0]
        step *= min(1.0, LARGEST_STEP / np.abs(step).max(initial=1e-300))
        for _ in range(12):
            inside = (_clip if barrier is None else barrier.inside)(model, q, step)
            after = model.integrate(q, inside)
            r_after, scale_after, held_after = _balance(model, after, u, barrier)
            if np.linalg.norm(r_after[~held_after]) < np.linalg.norm(r[free]):
                break
            step /= 2
        else:
            break
        q, r, scale, held = after, r_after, scale_after, held_after
    if size <= 1e4 * TOLERANCE * scale:
        if barrier is not None:
            return _equilibrium(model, q, u, held, -barrier.force(model, q), H)
        return _equilibrium(model, q, u, held, np.where(held, r, 0.0), H)
    raise StaticsError(f"no equilibrium of {model.name} near the start", size)


def ramp(
    model: SoftModel, u: np.ndarray, start: Equilibrium | None = None
) -> tuple[Equilibrium, int]:
    """The stable equilibrium that raising the input slowly leads to, and the snaps on the way.

    Continuation along u(s) from the start's input (rest: the one closest to zero within bounds)
    with the tangent ∂q/∂u as predictor and `settle` as corrector. A step that ends far from its
    prediction is halved; what remains is a snap to another branch, which the robot does too.

    Parameters
    ----------
    u : (nu,) final input.
    start : where to start; at rest under the least input by default.

    Raises
    ------
    StaticsError
        No equilibrium on the way.
    """
    u = array("u", u, (model.nu,))
    found = rest(model) if start is None else start
    first, s, ds, snaps = found.u, 0.0, 0.25, 0
    while s < 1.0:
        ds = min(ds, 1.0 - s)
        target = first + (s + ds) * (u - first)
        change = _clip(model, found.q, found.joint_sensitivity @ (target - found.u))
        far = np.abs(change).max(initial=0.0) > SNAP
        if far and ds > SMALLEST_RAMP_STEP:
            ds /= 2
            continue
        guess = found.q if far else move(model, found.q, change)
        after = settle(model, target, guess)
        missed = np.abs(pin.difference(model.pin_model, guess, after.q)).max(initial=0.0)
        if missed > SNAP:
            if ds > SMALLEST_RAMP_STEP:
                ds /= 2
                continue
            snaps += 1
        found, s = after, s + ds
        ds = 2 * ds if missed < SNAP / 4 else ds
    return found, snaps


def rest(model: SoftModel) -> Equilibrium:
    """Where the robot settles from q = 0 under the input closest to zero within its bounds."""
    return settle(model, np.clip(np.zeros(model.nu), model.u_min, model.u_max))


def move(model: SoftModel, q: np.ndarray, step: np.ndarray) -> np.ndarray:
    """q ⊕ step (nq,), as far as the joint limits let each joint go."""
    return model.integrate(q, _clip(model, q, step))


# -- inside --------------------------------------------------------------------------------------


def _residual(model: SoftModel, q: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, float]:
    """r and the size of the forces in it."""
    state = model.state(q, np.zeros(model.nv))
    forces = (state.K, state.bias, state.B @ u)
    scale = max(float(np.abs(force).max(initial=0.0)) for force in forces)
    return forces[0] + forces[1] - forces[2], max(scale, 1e-12)


def _balance(
    model: SoftModel, q: np.ndarray, u: np.ndarray, barrier: Barrier | None
) -> tuple[np.ndarray, float, np.ndarray]:
    """r with the barrier in it, the size of the forces, the joints that a stop holds."""
    r, scale = _residual(model, q, u)
    if barrier is None:
        return r, scale, _pressed(model, q, r)
    return r + barrier.force(model, q), scale, np.zeros(model.nv, bool)


def _off_the_stops(model: SoftModel, q: np.ndarray) -> np.ndarray:
    at = model.coordinates(q)
    margin = np.minimum(1e-4 * (model.upper - model.lower), 1e-4)
    return model.integrate(q, np.clip(at, model.lower + margin, model.upper - margin) - at)


def _free_residual(model: SoftModel, q: np.ndarray, u: np.ndarray) -> np.ndarray:
    r, _ = _residual(model, q, u)
    return np.where(_pressed(model, q, r), 0.0, r)


def _pressed(model: SoftModel, q: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Joints at a limit that the forces press against it."""
    at = model.coordinates(q)
    lower = (at <= model.lower + TOUCHING) & (r > 0)
    upper = (at >= model.upper - TOUCHING) & (r < 0)
    return lower | upper


def _clip(model: SoftModel, q: np.ndarray, step: np.ndarray) -> np.ndarray:
    """The part of a step (nv,) that stays within the joint limits."""
    at = model.coordinates(q)
    return np.clip(step, np.minimum(model.lower - at, 0), np.maximum(model.upper - at, 0))


def _within_limits(model: SoftModel, q: np.ndarray) -> np.ndarray:
    q = array("start", q, (model.nq,))
    at = model.coordinates(q)
    return model.integrate(q, np.clip(at, model.lower, model.upper) - at)


def _newton(H: np.ndarray, r: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """-(H + diag(damping))⁻¹ r, with more damping where that is not positive definite."""
    W = np.diag(damping)
    shift = 0.0
    size = np.abs(np.diag(H)) + 1e-6 * np.abs(H).max(initial=1e-300)
    while True:
        try:
            L = np.linalg.cholesky(H + W + np.diag(shift * size))
        except np.linalg.LinAlgError:
            shift = max(2 * shift, 1e-3)
            continue
        return -np.linalg.solve(L.T, np.linalg.solve(L, r))


def _downhill(H: np.ndarray) -> np.ndarray | None:
    """A direction of negative curvature, scaled to a largest entry of 1; None at a minimum."""
    try:
        np.linalg.cholesky(H)
        return None
    except np.linalg.LinAlgError:
        pass
    values, vectors = np.linalg.eigh(H)
    if values[0] >= -1e-9 * np.abs(values).max():
        return None
    direction = vectors[:, 0]
    return direction / np.abs(direction).max()


def _equilibrium(
    model: SoftModel,
    q: np.ndarray,
    u: np.ndarray,
    held: np.ndarray,
    forces: np.ndarray,
    H: np.ndarray,
) -> Equilibrium:
    for values in (q, held, forces, H):
        values.flags.writeable = False
    return Equilibrium(model, q, u, held, forces, H)
