"""An equilibrium under given inputs: its forces, stiffness and stability.

At rest M q̈ + C q̇ + D q̇ + K + g = B u + F becomes r(q, u) = K + g - F - B u = 0. r is the gradient
of the potential Π = U(q) + U_s(q) + U_F(q) - Σ u V(q), if all forces F of one's own have a
potential. V is gear ℓ(q), or the volume of a chamber whose area changes (`softdyn.dynamics.areas`).
A joint at a limit may be pressed against it:

    r_i = 0 inside,   r_i ≥ 0 at the lower limit,   r_i ≤ 0 at the upper one.

These are the stationary points of Π between the limits. The stable ones are its minima: the Hessian
∂r/∂q is positive definite on the free joints. With a force that has no potential, ∂r/∂q is not
symmetric. A stable equilibrium then has all poles of its linear motion left of the imaginary axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import eigvals

from softdyn.checks import array, instance
from softdyn.copies import Frozen
from softdyn.dynamics.derivatives import tendon_forces, total_damping
from softdyn.dynamics.model import SoftModel, State, check_model
from softdyn.dynamics.projection import underlying_tree
from softdyn.exceptions import InputError, SoftdynError

ROUNDING = 1e-12  # of the forces, over a radian or a metre; a stiffness below it is rounding
SKEW = 1e-7  # of a stiffness; less is rounding, also that of a force's central differences
NO_ROOM = 1e-6  # of an input's bounds; a narrower range counts as none


class StaticsError(SoftdynError, ArithmeticError):
    """No equilibrium was found.

    Attributes
    ----------
    residual : float
        Largest unbalanced force at the end (N m, N).
    """

    def __init__(self, text: str, residual: float) -> None:
        self.text, self.residual = text, residual
        super().__init__(f"{text}: forces of {residual:.3g} (N m, N) are left unbalanced")

    def __reduce__(self) -> tuple[Any, ...]:  # crosses process boundaries
        return type(self), (self.text, self.residual)


class NoEquilibrium(StaticsError):
    """The search ended at a shape that is none: there is no equilibrium near the start."""


@dataclass(frozen=True, eq=False)
class Equilibrium(Frozen):
    """A robot at rest under a constant input.

    Attributes
    ----------
    model : SoftModel
        The robot.
    q : ndarray, (nq,)
        Its configuration.
    u : ndarray, (nu,)
        The input.
    held : ndarray of bool, (nv,)
        Joints pressed against a limit.
    limit_forces : ndarray, (nv,)
        Force of the stops on the joints (N m, N), zero on free joints.
    stiffness : ndarray, (nv, nv)
        Tangent stiffness ∂(K + g - F - B u)/∂q.
    """

    model: SoftModel
    q: np.ndarray
    u: np.ndarray
    held: np.ndarray
    limit_forces: np.ndarray
    stiffness: np.ndarray

    def __post_init__(self) -> None:
        n = check_model(self.model).nv
        shapes = {"q": (self.model.nq,), "u": (self.model.nu,), "limit_forces": (n,)}
        for name, shape in {**shapes, "stiffness": (n, n)}.items():
            object.__setattr__(self, name, array(name, getattr(self, name), shape))
        held = np.array(instance("held", self.held, np.ndarray, f"booleans of shape ({n},)"))
        if held.dtype != bool or held.shape != (n,):
            raise InputError("held", f"booleans of shape ({n},)", repr(held))
        held.flags.writeable = False
        object.__setattr__(self, "held", held)

    @cached_property
    def state(self) -> State:
        """All terms of the dynamics at (q, 0)."""
        return self.model.state(self.q, np.zeros(self.model.nv))

    @property
    def y(self) -> np.ndarray:
        """Tip position (3,) in the world (m)."""
        return self.state.y

    @cached_property
    def residual(self) -> float:
        """Largest unbalanced force (N m, N)."""
        r = self.state.h - self.state.B @ self.u - self.limit_forces
        return float(np.abs(r).max(initial=0.0))

    @cached_property
    def eigenvalues(self) -> np.ndarray:
        """Eigenvalues of the tangent stiffness on the free joints, ascending (N m/rad, N/m).

        They are the real parts, ascending, if a force without a potential makes some complex.
        """
        free = ~self.held
        block = self.stiffness[np.ix_(free, free)]
        return np.linalg.eigvalsh(block) if symmetric(block) else np.sort(eigvals(block).real)

    @property
    def stable(self) -> bool:
        """Whether the potential has a strict minimum here, between the joint limits.

        Without a potential it is whether all poles have a negative real part.
        """
        values = self.eigenvalues
        if self._conservative:
            return bool(values.size == 0 or values[0] > self.rounding)
        return bool(self.poles[0].real < 0 and abs(values).min() > self.rounding)

    @property
    def _conservative(self) -> bool:
        free = ~self.held
        return symmetric(self.stiffness[np.ix_(free, free)])

    @property
    def neutral(self) -> bool:
        """Whether the smallest stiffness is zero, as of a hoist whose input carries its load."""
        values = self.eigenvalues
        if not self._conservative:
            values = values[np.argsort(np.abs(values))]
        return bool(values.size and abs(values[0]) <= self.rounding)

    @property
    def unstable(self) -> bool:
        """Whether the potential falls in some direction, or a pole is on the right."""
        return not (self.stable or self.neutral)

    @property
    def loose(self) -> np.ndarray:
        """Orthonormal columns (nv, any) that span the free directions without stiffness."""
        free = np.flatnonzero(~self.held)
        block = self.stiffness[np.ix_(free, free)]
        if symmetric(block):
            values, vectors = np.linalg.eigh(block)
            found = vectors[:, np.abs(values) <= self.rounding]
        else:
            _, values, rows = np.linalg.svd(block)
            found = rows[values <= self.rounding].T
        columns = np.zeros((len(self.held), found.shape[1]))
        columns[free] = found
        return columns

    @property
    def firmness(self) -> str:
        """The word for a text: stable, neutral or unstable."""
        return "stable" if self.stable else "neutral" if self.neutral else "unstable"

    @property
    def rounding(self) -> float:
        """A stiffness up to this is zero but for rounding (N m/rad, N/m)."""
        largest = float(np.abs(self.eigenvalues).max(initial=0.0))
        return max(1e-9 * largest, ROUNDING * self._forces)

    @property
    def _forces(self) -> float:
        """The largest force on a joint (N m, N)."""
        state = self.state
        parts = (state.K, state.bias, state.F, np.abs(state.B) @ np.abs(self.u))
        return max(float(np.abs(part).max(initial=0.0)) for part in parts)

    @cached_property
    def poles(self) -> np.ndarray:
        """Poles s (1/s) of M δq̈ + D δq̇ + ∂r/∂q δq = 0 on the free joints, rightmost first.

        D contains the damping -∂F/∂q̇ of one's own forces.
        """
        free = np.flatnonzero(~self.held)
        block = np.ix_(free, free)
        n = len(free)
        inverse, D = np.linalg.inv(self.state.M[block]), total_damping(self.state)[block]
        A = np.zeros((2 * n, 2 * n))
        A[:n, n:] = np.eye(n)
        A[n:, :n], A[n:, n:] = -inverse @ self.stiffness[block], -inverse @ D
        found = eigvals(A)
        return found[np.argsort(-found.real)]

    @cached_property
    def _free_compliance(self) -> np.ndarray:
        """(∂r/∂q)⁻¹ on the free joints, zero on the held ones (nv, nv)."""
        free = np.flatnonzero(~self.held)
        block = np.ix_(free, free)
        result = np.zeros_like(self.stiffness)
        largest = np.abs(self.eigenvalues).max(initial=0.0)
        rcond = max(1e-14, ROUNDING * self._forces / largest) if largest else 1e-14
        hermitian = symmetric(self.stiffness[block])
        result[block] = np.linalg.pinv(self.stiffness[block], rcond=rcond, hermitian=hermitian)
        return result

    @property
    def tip_compliance(self) -> np.ndarray:
        """Compliance of the tip to a force on it, δy/δf (3, 3) = J (∂r/∂q)⁻¹ Jᵀ (m/N).

        It is NaN if a direction without stiffness moves the tip.
        """
        J = self.state.J
        loose = J @ self.loose
        if np.abs(loose).max(initial=0.0) > 1e-9 * np.abs(J).max(initial=0.0):
            return np.full((3, 3), np.nan)
        return J @ self._free_compliance @ J.T

    @property
    def joint_sensitivity(self) -> np.ndarray:
        """∂q/∂u (nv, nu) = (∂r/∂q)⁻¹ B along the branch of equilibria."""
        return self._free_compliance @ self.state.B

    @property
    def tip_sensitivity(self) -> np.ndarray:
        """∂y/∂u (3, nu) along the branch of equilibria."""
        return self.state.J @ self.joint_sensitivity


class RankedEquilibria(Frozen):
    """Equilibria that a search has found, the closest to its target first.

    Attributes
    ----------
    found : tuple of Equilibrium
        At least one.
    """

    found: tuple[Equilibrium, ...]

    @property
    def nearest(self) -> Equilibrium:
        """The closest equilibrium, stable or not."""
        return self.found[0]

    @property
    def nearest_stable(self) -> Equilibrium | None:
        """The closest stable equilibrium; None if none was found."""
        return next((one for one in self.found if one.stable), None)


def symmetric(H: np.ndarray) -> bool:
    """Whether a stiffness is symmetric but for rounding, so that the forces have a potential."""
    return bool(np.abs(H - H.T).max(initial=0.0) <= SKEW * np.abs(H).max(initial=0.0))


def locked_inputs(model: SoftModel) -> np.ndarray:
    """Inputs (nu,) bool whose bounds leave them one value, such as a preload."""
    size = np.maximum(np.abs(check_model(model).u_min), np.abs(model.u_max))
    return model.u_max - model.u_min <= NO_ROOM * np.maximum(size, 1e-3)


def residual(model: SoftModel, q: np.ndarray, u: np.ndarray) -> np.ndarray:
    """r(q, u) = K + g - F - B u (nv,), the gradient of `potential` (N m, N).

    Parameters
    ----------
    q : ndarray, (nq,)
        Configuration.
    u : ndarray, (nu,)
        Input.
    """
    state = check_model(model).state(q, np.zeros(model.nv))
    return state.h - state.B @ array("u", u, (model.nu,))


def potential(model: SoftModel, q: np.ndarray, u: np.ndarray) -> float:
    """Π = U + U_s + U_F - Σ u V (J); its minima are stable equilibria under constant inputs.

    U_F is the energy of those forces of one's own that have one.
    """
    u, lengths = array("u", u, (check_model(model).nu,)), model.tendon_lengths(q)
    areas = underlying_tree(model)[0].areas
    if areas is None:
        work = tendon_forces(model, u, lengths) @ lengths
    else:
        work = u @ areas.volumes(lengths)
    return model.potential_energy(q) - float(work)
